"""Hardware: GenICam cameras, photograph folders, the serial light box."""
