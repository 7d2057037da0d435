"""Frames into a map of radiance: sums per pixel as frames arrive, then value, standard uncertainty and mask."""
