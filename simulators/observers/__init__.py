"""Simulated eyes and subjects."""
