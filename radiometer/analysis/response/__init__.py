"""Response recovery: how digital numbers follow from exposure, one module per method."""
