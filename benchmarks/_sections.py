"""Writes one benchmark's section of its page in docs/benchmarks and leaves the others alone."""

from __future__ import annotations

import os
import platform
from pathlib import Path
from typing import Final

FOLDER: Final = Path(__file__).resolve().parents[1] / "docs" / "benchmarks"
# The page of a section is the first whose beginnings fit its name.
_PAGES: Final = {
    "response": ("merge_photographs", "response", "photographs", "memorial", "left_out"),
    "measuring": ("merge", "main-job", "characterise", "honest", "trend_claims", "archive", "colour"),
    "wire": ("wire",),
    "daemon": ("daemon",),
    "reconcile": ("reconcile", "peer"),
    "adaptation": ("adaptation",),
    "files": ("reader",),
    "light-box": ("eye",),
    "sensors": ("real-sensors", "taps"),
    "naming": ("naming", "newton"),
}


def page_of(name: str) -> Path:
    """Return the page that holds a section."""
    return FOLDER / f"{next(page for page, beginnings in _PAGES.items() if name.startswith(beginnings))}.md"


def write_section(name: str, title: str, command: str, body: str, where: Path | None = None) -> None:
    """Replace or append the section `name`: title, the command that makes it, the machine, and the body (Markdown)."""
    where = where or page_of(name)
    begin, end = f"<!-- begin {name} -->", f"<!-- end {name} -->"
    machine = f"{os.cpu_count()} cores, Python {platform.python_version()}"
    section = f"{begin}\n## {title}\n\n`{command}` ({machine})\n\n{body.strip()}\n{end}\n"
    page = where.read_text(encoding="utf-8")
    if begin in page and end in page:
        head, rest = page.split(begin, 1)
        page = head + section + rest.split(end, 1)[1].lstrip("\n")
    else:
        page = page.rstrip("\n") + "\n\n" + section
    where.write_text(page, encoding="utf-8")
