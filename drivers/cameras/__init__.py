"""Cameras: GenICam through Aravis, V4L2, Raspberry Pi, tethered photographic cameras."""
