"""SCPI over raw sockets: IEEE 488.2 common commands and an SCPI-99 tree, both from one command table."""
