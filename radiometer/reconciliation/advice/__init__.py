"""What the data would have shown, and the capture to take next."""
