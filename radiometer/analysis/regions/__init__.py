"""Measures of regions of a radiance map."""
