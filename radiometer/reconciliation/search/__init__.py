"""Finds the missing effects: places of disagreement, candidates, names, rivals."""
