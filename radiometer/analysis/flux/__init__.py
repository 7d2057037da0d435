"""The flux of a light-emitting diode, from a bracket of it."""
