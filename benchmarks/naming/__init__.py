"""A benchmark of naming what is missing: sealed sessions in files, answers in files, and a scorer.

Any tool can take part. It reads the capture sets of `sessions/` and writes one JSON object per session:

    {"names": [{"name": "dark_current", "probability": 0.99, "alternatives": []}], "something_missing": true,
     "seconds": 4.2}

An empty list of names with `something_missing` is an abstention: something is missing, and no name fits.
"""

from benchmarks.naming.command import main as main
