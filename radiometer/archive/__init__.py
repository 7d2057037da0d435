"""Archives: many capture sets in, one table of results out, and the trends in such a table."""
