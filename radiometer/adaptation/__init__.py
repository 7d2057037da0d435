"""Dark adaptation: threshold series, branch models, fits and their report."""
