"""Statistics that several rooms use: robust scale, least squares, jackknife, restricted likelihood, model choice."""
