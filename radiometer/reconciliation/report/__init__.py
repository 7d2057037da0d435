"""Writes the findings as result, report and camera model."""
