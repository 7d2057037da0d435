"""Frames to response, radiance and uncertainty; import the module of the method that you want."""
