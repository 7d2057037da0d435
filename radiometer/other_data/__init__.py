"""Reconciles what is not a capture set: photographs, light-meter tables, EMVA 1288 descriptors."""
