"""Temporal modulation of light: waveforms, and the measures of flicker and of the stroboscopic effect."""
