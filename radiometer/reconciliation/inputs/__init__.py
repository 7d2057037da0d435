"""Takes whatever a user names (capture set, photographs, light-meter table) and reconciles it."""
