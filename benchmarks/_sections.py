"""Writes one benchmark's section of docs/benchmarks.md and leaves the others alone."""

from __future__ import annotations

import os
import platform
from pathlib import Path

PAGE = Path(__file__).resolve().parents[1] / "docs" / "benchmarks.md"
_TITLE = "# Benchmarks\n\nEvery table is written by the command above it, on one machine in one run.\n"


def write_section(name: str, title: str, command: str, body: str, where: Path = PAGE) -> None:
    """Replace or append the section `name`: title, the command that makes it, the machine, and the body (Markdown)."""
    begin, end = f"<!-- begin {name} -->", f"<!-- end {name} -->"
    machine = f"{os.cpu_count()} cores, Python {platform.python_version()}"
    section = f"{begin}\n## {title}\n\n`{command}` ({machine})\n\n{body.strip()}\n{end}\n"
    page = where.read_text(encoding="utf-8") if where.exists() else _TITLE
    if begin in page and end in page:
        head, rest = page.split(begin, 1)
        page = head + section + rest.split(end, 1)[1].lstrip("\n")
    else:
        page = page.rstrip("\n") + "\n\n" + section
    where.parent.mkdir(exist_ok=True)
    where.write_text(page, encoding="utf-8")
