"""Makes each listed mistake in a copy of the sources and counts which the fast tests notice.

    python -m tests.mutants [AREA ...] [--jobs 2] [--report FILE]

An area is one file `tests/mutants/<area>.yaml`: the tests of the area, and for each mutant the file, the text as it
stands, the text as it would be wrong, and why that matters to a user. A text that no longer stands exactly once in its
file is an error: the list must follow the code.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

ROOT = Path(__file__).resolve().parents[2]
LISTS = Path(__file__).parent
COPIED = (
    "radiometer",
    "drivers",
    "simulators",
    "configs",
    "tests",
    "docs",
    "benchmarks",
    "pyproject.toml",
    "README.md",
)
SECONDS = 180  # for the tests of one mutant; a mutant that hangs is noticed as well


@dataclass(frozen=True)
class Mutant:
    """One mistake.

    Attributes:
        area: Name of its list.
        file: Source file, relative to the root.
        old: Text as it stands, exactly once in the file.
        new: Text with the mistake.
        why: What a user would suffer from it.
        tests: Paths of the tests that must notice it.
    """

    area: str
    file: str
    old: str
    new: str
    why: str
    tests: tuple[str, ...]


@dataclass(frozen=True)
class Outcome:
    """What became of a mutant: `noticed`, `survived`, or `stale` where its text no longer stands in the file."""

    mutant: Mutant
    fate: str


def read_mutants(areas: list[str]) -> Iterator[Mutant]:
    """Yield the mutants of the areas named, of all where none is."""
    for path in sorted(LISTS.glob("*.yaml")):
        if areas and path.stem not in areas:
            continue
        listed: dict[str, Any] = yaml.safe_load(path.read_text(encoding="utf-8"))
        for entry in listed["mutants"]:
            tests = tuple(entry.get("tests", listed["tests"]))
            yield Mutant(path.stem, entry["file"], entry["old"], entry["new"], entry["why"], tests)


def is_current(mutant: Mutant) -> bool:
    """Tell whether the text to be changed stands in its file exactly once."""
    path = ROOT / mutant.file
    return path.is_file() and path.read_text(encoding="utf-8").count(mutant.old) == 1


def fate_of(mutant: Mutant, copy: Path) -> Outcome:
    """Make the mistake in a copy of the sources, run the tests, and mend it again."""
    if not is_current(mutant):
        return Outcome(mutant, "stale")
    path = copy / mutant.file
    sound = path.read_text(encoding="utf-8")
    path.write_text(sound.replace(mutant.old, mutant.new), encoding="utf-8")
    try:
        return Outcome(mutant, "survived" if passes(mutant.tests, copy) else "noticed")
    finally:
        path.write_text(sound, encoding="utf-8")


def passes(tests: tuple[str, ...], copy: Path) -> bool:
    """Tell whether the tests pass in a copy; what takes longer than `SECONDS` does not."""
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", *tests]
    alone = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "PYTHONDONTWRITEBYTECODE": "1"}
    try:
        done = subprocess.run(
            command,
            cwd=copy,
            env={**os.environ, **alone, "PYTHONPATH": str(copy)},
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            timeout=SECONDS,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return False
    if done.returncode not in (0, 1, 2):
        raise RuntimeError(f"pytest ended with {done.returncode} for {' '.join(tests)}")
    return done.returncode == 0


def copied_sources(folder: Path) -> Path:
    """Return a copy of everything that tests read."""
    for name in COPIED:
        source = ROOT / name
        if source.is_dir():
            shutil.copytree(source, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            shutil.copy(source, folder / name)
    return folder


def run_share(share: list[Mutant]) -> list[Outcome]:
    """Return the fates of some mutants, one after the other in one copy; the sound copy must pass first."""
    with tempfile.TemporaryDirectory(prefix="mutants-") as folder:
        copy = copied_sources(Path(folder))
        for tests in {mutant.tests for mutant in share}:
            if not passes(tests, copy):
                raise RuntimeError(f"the tests fail without any mutant: {' '.join(tests)}")
        outcomes = []
        for mutant in share:
            outcomes.append(fate_of(mutant, copy))
            print(f"{outcomes[-1].fate:9s} {mutant.area}: {mutant.why}", flush=True)
        return outcomes


def table(outcomes: list[Outcome]) -> str:
    """Return the score per area, and the survivors by what a user would suffer."""
    lines = ["| area | mutants | noticed |", "|---|---|---|"]
    for area in sorted({outcome.mutant.area for outcome in outcomes}):
        fates = Counter(outcome.fate for outcome in outcomes if outcome.mutant.area == area)
        lines.append(f"| {area} | {fates.total()} | {fates['noticed']} |")
    left = [o for o in outcomes if o.fate != "noticed"]
    lines += ["", *(f"* {o.fate}: `{o.mutant.file}`: {o.mutant.why}" for o in left)] if left else []
    return "\n".join(lines)


def main() -> int:
    """Run the mutants; 0 where all are noticed."""
    parser = argparse.ArgumentParser(prog="python -m tests.mutants", description=__doc__.splitlines()[0])
    parser.add_argument("areas", nargs="*", help="names of lists in tests/mutants; all by default")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--report", type=Path, help="where the table is written")
    options = parser.parse_args()
    mutants = list(read_mutants(options.areas))
    if not mutants:
        parser.error(f"no mutants for {' '.join(options.areas)}; lists are {[p.stem for p in LISTS.glob('*.yaml')]}")
    mutants.sort(key=lambda mutant: mutant.area)
    shares = [share for n in range(options.jobs) if (share := mutants[n :: options.jobs])]
    with multiprocessing.get_context("spawn").Pool(len(shares)) as pool:
        outcomes = [outcome for share in pool.map(run_share, shares) for outcome in share]
    page = table(outcomes)
    print(page)
    if options.report is not None:
        options.report.write_text(page + "\n", encoding="utf-8")
    return int(any(outcome.fate != "noticed" for outcome in outcomes))
