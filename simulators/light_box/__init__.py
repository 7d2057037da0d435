"""The simulated light box: protocol, LEDs, serial lines, and its firmware in an AVR simulator."""
