"""The forward model of a camera, from the radiance of a scene to digital numbers."""
