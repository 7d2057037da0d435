"""Plausible mistakes, one at a time, and the fast tests that must notice them: `make mutants`."""
