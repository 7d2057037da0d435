"""Frames reduced to statistics: captures and tiles, sums over frames, and along what they may differ."""
