"""Effects and nuisances fitted to the statistics, and judged by what they predict of held-out settings."""
