"""Quality indices of the instrument itself: what each asks for, how it is computed, and the datasheet."""
