"""Which effects are missing: places of disagreement, candidates, names, rivals."""
