"""Choosing exposures and taking brackets."""
