"""Spectra, and the conversions between radiance and luminance."""
