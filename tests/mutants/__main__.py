"""`python -m tests.mutants`: draws mistakes or new names at random, and counts what the fast tests notice."""

from __future__ import annotations

import argparse
from pathlib import Path

from tests.mutants import blind, renamed


def main() -> int:
    """Record, or draw and run; 0 where the draw was run, whatever it finds."""
    parser = argparse.ArgumentParser(prog="python -m tests.mutants", description=blind.__doc__.splitlines()[0])
    parser.add_argument(
        "areas", nargs="*", help="names in tests/mutants/areas.py, of --renamed test folders; default all"
    )
    parser.add_argument("--record", action="store_true", help="write down which test runs which line")
    parser.add_argument("--blind", type=int, metavar="SEED", help="draw mistakes with this seed")
    parser.add_argument("--renamed", type=int, metavar="SEED", help="rename private functions with this seed")
    parser.add_argument("--count", type=int, default=50, help="number of functions that are renamed")
    parser.add_argument("--each", type=int, default=8, help="number of mistakes of each area")
    parser.add_argument("--report", type=Path, help="where the table is written")
    options = parser.parse_args()
    if options.renamed is not None:
        return renamed.run(options.renamed, options.areas, options.count)
    if options.blind is None and not options.record:
        parser.error("give --record, --blind SEED, or --renamed SEED")
    if options.record and (code := blind.make_record()):
        return code
    if options.blind is None:
        return 0
    return blind.run(options.blind, options.areas, options.each, options.report)


raise SystemExit(main())
