"""Commands that run or read the daemon, and serve simulated devices."""
