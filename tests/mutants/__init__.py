"""Draws plausible mistakes at random and counts which the fast tests notice: `make mutants BLIND=seed`."""
