"""Colour of light: tristimulus values, chromaticities, colour temperature, and the matrix from a camera to them."""
