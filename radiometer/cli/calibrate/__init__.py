"""Commands that calibrate and characterise a camera or a screen."""
