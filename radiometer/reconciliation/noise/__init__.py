"""Predicts the scatter of each statistic of a correct model, alone and together with others."""
