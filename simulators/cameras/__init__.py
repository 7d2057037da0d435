"""Simulated cameras, in memory and behind the GigE Vision protocol."""
