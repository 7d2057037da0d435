"""Renames private functions of the product at random and runs the fast tests: none may notice.

    python -m tests.mutants --renamed SEED [tests/unit/daemon ...] [--count 50]

A test that fails reaches inside a module, or reads a name out of a message. All functions are renamed at once, in a
copy of the sources, wherever the product names them.
"""

from __future__ import annotations

import ast
import io
import os
import random
import re
import subprocess
import sys
import tempfile
import tokenize
from collections.abc import Sequence
from pathlib import Path

from tests.mutants import harness

PRODUCT = ("radiometer", "drivers", "simulators")
FOREIGN = re.compile(r"__|_repr_\w+_$|_$")  # names that Python, notebooks or no caller uses


def private_functions(sources: Sequence[str]) -> list[str]:
    """Return the names of private functions and methods that some source texts define, each once, in order."""
    found = {
        node.name
        for text in sources
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
        if node.name.startswith("_") and not FOREIGN.match(node.name)
    }
    return sorted(found)


def rename(paths: Sequence[Path], seed: int, count: int) -> list[str]:
    """Rename functions in some files, in place, and return their names."""
    texts = {path: path.read_text(encoding="utf-8") for path in paths}
    names = private_functions(list(texts.values()))
    drawn = random.Random(seed).sample(names, min(count, len(names)))
    for path, text in texts.items():
        if any(name in text for name in drawn):
            path.write_text(with_other_names(text, drawn), encoding="utf-8")
    return drawn


def with_other_names(text: str, names: Sequence[str]) -> str:
    """Return a source text in which some names are others; words of messages and names of files stay."""
    words = re.compile(rf"(?<![}}\w])({'|'.join(names)})\b")  # after a brace a formatted string goes on
    lines = text.splitlines(keepends=True)
    for token in reversed(list(tokenize.generate_tokens(io.StringIO(text).readline))):
        formatted = token.type == tokenize.STRING and "f" in token.string[:2].lower()
        if not formatted and token.type != tokenize.NAME:
            continue
        (first, start), (last, end) = token.start, token.end
        before, after = lines[first - 1][:start], lines[last - 1][end:]
        lines[first - 1 : last] = [before + words.sub(r"\1_renamed", token.string) + after]
    return "".join(lines)


def run(seed: int, tests: Sequence[str], count: int) -> int:
    """Rename, run the fast tests in some files or folders, and return how pytest ended."""
    with tempfile.TemporaryDirectory(prefix="renamed-") as folder:
        copy = harness.copied_sources(Path(folder))
        paths = sorted(path for name in PRODUCT for path in (copy / name).rglob("*.py"))
        print(f"seed {seed}: {', '.join(rename(paths, seed, count))}", flush=True)
        words = ["-m", "pytest", "-q", "-p", "no:cacheprovider", "-m", harness.FAST, *(tests or ["tests/unit"])]
        environment = {**os.environ, "PYTHONPATH": str(copy)}
        return subprocess.run([sys.executable, *words], cwd=copy, env=environment, check=False).returncode
