"""`python -m benchmarks._interop NAME`: runs one adapter with the real package, and keeps its output in the docs."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path

PAGE = Path(__file__).resolve().parents[2] / "docs" / "benchmarks" / "interoperability.md"


def main(name: str) -> None:
    """Run one and rewrite its part of the page."""
    printed = "\n".join(importlib.import_module(f"benchmarks._interop.with_{name}").main())
    print(printed)
    begin, end = f"<!-- begin {name} -->", f"<!-- end {name} -->"
    head, rest = PAGE.read_text(encoding="utf-8").split(begin, 1)
    tail = rest.split(end, 1)[1]
    PAGE.write_text(f"{head}{begin}\n```\n{printed}\n```\n{end}{tail}", encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1])
