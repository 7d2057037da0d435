"""Uncertainty budgets after the GUM, and the propagation of distributions."""
