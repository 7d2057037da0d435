"""Commands about the installation: devices, checks, completion, manual page."""
