"""Physical effects of the forward model, one per file."""
