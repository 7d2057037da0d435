"""Finds the term that a camera's log lacks, compared with a reference meter."""
