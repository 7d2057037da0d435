"""Calibrations made: the absolute scale, the flat field, and what a camera file must hold."""
