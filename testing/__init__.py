"""Support for tests and benchmarks: worlds, generators, clients, peers."""
