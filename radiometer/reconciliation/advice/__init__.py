"""Advises on the limits of the data, and on the capture to take next."""
