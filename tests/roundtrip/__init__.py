"""Round trips: what one program hides, the other has to find."""
