"""Names what makes the light of an engine's channels other than proportional to their drive."""
