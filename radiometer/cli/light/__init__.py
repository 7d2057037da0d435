"""Commands of the light box and of the dark-adaptation test."""
