"""Composition root: from a configuration to real or simulated devices; the only place that imports drivers."""
