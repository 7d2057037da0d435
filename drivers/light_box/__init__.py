"""The serial LED and button box, host side."""
