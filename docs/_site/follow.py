"""Follow a page word by word: write its files, run its commands, and compare their output with the page.

    python docs/_site/follow.py PAGE FOLDER [--skip-installing]

* A block with a title becomes that file.

* A `console` block is run line by line in one shell.

* A `python` block is run by itself.

* A `text` block is the output of the block before it. Each of its lines must occur in that output. Words must be
  equal. A number matches any number of the same kind. A number with ± must agree within its uncertainties.
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

_BLOCK = re.compile(r'^```(\w+)(?: title="([^"]+)")?\n(.*?)^```$', re.DOTALL | re.MULTILINE)
_NUMBER = re.compile(r"(?<![\w.])[-+−]?\d+(?:\.\d+)?(?:e[-+]?\d+)?(?![\w])")
_INTERVAL = re.compile(r"(\d[\d.e+-]*) ± (\d[\d.e+-]*)")
_INSTALLING = ("python3 -m venv", ". venv/bin/activate", "pip install")


@dataclass(frozen=True)
class Block:
    """A block of a page: its language, its title, and its text."""

    language: str
    title: str
    text: str


def blocks_of(page: Path) -> list[Block]:
    """Return the blocks of a page in order."""
    return [Block(kind, title, text) for kind, title, text in _BLOCK.findall(page.read_text(encoding="utf-8"))]


def follow(page: Path, folder: Path, *, installing: bool) -> list[str]:
    """Follow a page in a folder and return the differences from it.

    Args:
        page: The page.
        folder: An empty folder.
        installing: Whether its lines that install are run, too.

    Raises:
        RuntimeError: If a command fails.
    """
    differs: list[str] = []
    printed = ""
    for block in blocks_of(page):
        if block.title:
            (folder / block.title).write_text(block.text, encoding="utf-8")
        elif block.language == "console":
            commands = [line[2:] for line in block.text.splitlines() if line.startswith("$ ")]
            printed = _run(["bash", "-e", "-c", "\n".join(_commands(commands, folder, installing))], folder)
        elif block.language == "python":
            printed = _run([_python(folder), "-c", block.text], folder)
        elif block.language == "text":
            differs += [f"{page.name}: not printed: {line}" for line in _missing(block.text, printed)]
    return differs


def _python(folder: Path) -> str:
    own = folder / "venv" / "bin" / "python"
    return str(own) if own.exists() else sys.executable


def _commands(lines: list[str], folder: Path, installing: bool) -> Iterator[str]:
    if (folder / "venv").exists():
        yield ". venv/bin/activate"
    for line in lines:
        if installing or not line.startswith(_INSTALLING):
            yield line


def _run(words: list[str], folder: Path) -> str:
    wide = os.environ | {"COLUMNS": "100", "NO_COLOR": "1"}
    done = subprocess.run(words, cwd=folder, env=wide, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise RuntimeError(f"failed ({done.returncode}): {words[-1]}\n{done.stdout}{done.stderr}")
    return done.stdout + done.stderr


def _missing(expected: str, printed: str) -> Iterator[str]:
    there = [_plain(line) for line in printed.splitlines()]
    for line in map(_plain, expected.splitlines()):
        if line and not any(_same_kind(line, other) for other in there):
            yield line


def _plain(line: str) -> str:
    return re.sub(r"[\s│]+", " ", line).strip()


def _same_kind(expected: str, printed: str) -> bool:
    """Return whether a line begins as it should: same words, a number for each number, intervals that overlap."""
    pieces = [re.escape(piece) for piece in _NUMBER.split(expected)]
    found = re.match(f"({_NUMBER.pattern})".join(pieces), printed)
    if found is None:
        return False
    pairs = zip(_INTERVAL.findall(expected), _INTERVAL.findall(found[0]), strict=False)
    return all(_agree(*(float(x) for x in (*one, *other))) for one, other in pairs)


def _agree(value: float, wide: float, found: float, found_wide: float) -> bool:
    """Return whether two intervals meet at twice their width, and are of one order."""
    return abs(value - found) <= 2 * (wide + found_wide) and 0.2 <= found_wide / wide <= 5.0


def main() -> int:
    """Follow a page and print the differences."""
    parser = argparse.ArgumentParser(description="Follow a page word by word.")
    parser.add_argument("page", type=Path)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--skip-installing", action="store_true", help="Use the packages that are there.")
    asked = parser.parse_args()
    asked.folder.mkdir(parents=True, exist_ok=True)
    if any(asked.folder.iterdir()):
        sys.exit(f"{asked.folder} is not empty")
    differs = follow(asked.page.resolve(), asked.folder.resolve(), installing=not asked.skip_installing)
    sys.stdout.write("\n".join([*differs, f"{asked.page.name}: followed in {asked.folder}"]) + "\n")
    return 1 if differs else 0


if __name__ == "__main__":
    sys.exit(main())
