"""Commands that capture, read and import."""
