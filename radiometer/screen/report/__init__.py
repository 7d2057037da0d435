"""Report of a display: methods of the Information Display Measurements Standard, each with its conditions and u."""
