"""The forward model on tiles: what the ideal camera and a set of effects predict for every statistic."""
