"""Makes each listed mistake in a copy of the sources and counts which the fast tests notice.

    python -m tests.mutants [AREA ...] [--jobs 2] [--report FILE]

An area is one file `tests/mutants/<area>.yaml`: the tests of the area, and for each mutant the file, the text as it
stands, the text as it would be wrong, and why that matters to a user. A text that no longer stands exactly once in its
file is an error: the list must follow the code.
"""

from __future__ import annotations

import argparse
import ast
import importlib
import itertools
import multiprocessing
import os
import resource
import shutil
import signal
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import yaml

from testing.patience import within

ROOT = Path(__file__).resolve().parents[2]
LISTS = Path(__file__).parent
_LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # ten times faster, where PyYAML has it
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
SECONDS = 60  # of the processor for the tests of one mutant; a mutant that never ends is noticed as well
IDLE, LONGEST = 20.0, 120.0  # s without work, and in all on a quiet machine, after which one waits for ever
QUIET = ("-W", "ignore::pytest.PytestAssertRewriteWarning")  # of plugins imported beforehand
FAST = "not slow and not long and not bench and not soak and not hardware"
PASSED = (0, 5)  # 5: nothing was left to run
COMPILED = "@compiled"  # marks the functions that numba compiles
_OWN_TIMES = itertools.count(1_000_000_000)  # of files with a mistake, in s: compiled code of another is not theirs
OTHERS = (
    "aiohttp.web",
    "cv2",
    "hypothesis",
    "matplotlib.figure",
    "numba",
    "numpy",
    "pydantic",
    "pytest",
    "scipy.optimize",
)
OTHERS += ("scipy.special", "scipy.stats", "structlog", "typer.testing", "yaml")


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
        equivalent: Whether nobody could notice it, for the reason in `why`; then it must survive.
    """

    area: str
    file: str
    old: str
    new: str
    why: str
    tests: tuple[str, ...]
    equivalent: bool = False


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
        listed: dict[str, Any] = yaml.load(path.read_text(encoding="utf-8"), Loader=_LOADER)
        for entry in listed["mutants"]:
            tests = tuple(entry.get("tests", listed["tests"]))
            texts = (entry["file"], entry["old"], entry["new"], entry["why"])
            yield Mutant(path.stem, *texts, tests, entry.get("equivalent", False))


def is_current(mutant: Mutant) -> bool:
    """Tell whether the text to be changed stands in its file exactly once."""
    path = ROOT / mutant.file
    return path.is_file() and path.read_text(encoding="utf-8").count(mutant.old) == 1


def fate_of(mutant: Mutant, copy: Path) -> Outcome:
    """Make the mistake in a copy of the sources, run the tests, and mend it again."""
    if not is_current(mutant):
        return Outcome(mutant, "stale")
    sound = (copy / mutant.file).read_text(encoding="utf-8")
    return Outcome(mutant, fate_of_text(sound.replace(mutant.old, mutant.new), mutant.file, mutant.tests, copy))


def fate_of_text(text: str, file: str, tests: tuple[str, ...], copy: Path, plugins: tuple[object, ...] = ()) -> str:
    """Return `noticed` or `survived` for a whole file's text with a mistake in it, and mend the file again.

    Python knows compiled code by the source's time and size, numba likewise, but not by what it calls, nor by the
    constants that it reads elsewhere: the file gets a time that none had before, and where compiled code may read the
    mistake the compiled is kept elsewhere.
    """
    path = copy / file
    sound, times = path.read_bytes(), path.stat()
    path.write_text(text, encoding="utf-8")
    os.utime(path, (times.st_atime, next(_OWN_TIMES)))
    reaches = COMPILED in text or (
        figures_of(text, file) != figures_of(sound.decode(), file)
        and any(COMPILED in other.read_text(encoding="utf-8") for other in path.parent.glob("*.py"))
    )
    kept = {"NUMBA_CACHE_DIR": tempfile.mkdtemp(dir=copy)} if reaches else {}
    try:
        return "survived" if code_of(tests, copy, kept, plugins) in PASSED else "noticed"
    finally:
        path.write_bytes(sound)
        os.utime(path, (times.st_atime, times.st_mtime))


def figures_of(text: str, file: str) -> list[str]:
    """Return what a Python module assigns outside its functions and classes, which compiled code of others may read."""
    if not file.endswith(".py"):
        return []
    return [ast.unparse(node) for node in ast.parse(text).body if isinstance(node, ast.Assign | ast.AnnAssign)]


def preload() -> None:
    """Import what the tests need of others, once: every run is a fork that has it already."""
    for name in OTHERS:
        importlib.import_module(name)


def code_of(
    tests: tuple[str, ...],
    copy: Path,
    environment: dict[str, str] | None = None,
    plugins: tuple[object, ...] = (),
    all_of_them: bool = False,
) -> int | None:
    """Return how pytest ended for the fast tests among some in a copy; None where it had to be ended.

    It ends with the first that fails, or after all of them, however long they take.
    """
    child = os.fork()
    if child == 0:
        code = 3
        try:
            os.setsid()
            if not all_of_them:
                resource.setrlimit(resource.RLIMIT_CPU, (SECONDS, SECONDS))
            code = run_tests(tests, copy, environment or {}, plugins, () if all_of_them else ("-x",))
        finally:
            os._exit(code)
    return ended(child)


def run_tests(
    tests: tuple[str, ...],
    copy: Path,
    environment: dict[str, str],
    plugins: tuple[object, ...],
    words: tuple[str, ...],
) -> int:
    """Run the tests in this process, whose project is the copy; return how pytest ended."""
    nowhere = os.open(os.environ.get("MUTANT_LOG", os.devnull), os.O_RDWR | os.O_CREAT | os.O_APPEND)
    for stream in (0, 1, 2):
        os.dup2(nowhere, stream)
    os.chdir(copy)
    os.environ.update(environment, PYTHONPATH=str(copy))
    sys.path.insert(0, str(copy))
    if "NUMBA_CACHE_DIR" in environment:  # read by numba when it was imported
        sys.modules["numba"].config.CACHE_DIR = environment["NUMBA_CACHE_DIR"]
    own = {"radiometer", "drivers", "simulators", "tests", "benchmarks"}
    for name in [name for name in sys.modules if name.partition(".")[0] in own]:
        del sys.modules[name]
    sys.dont_write_bytecode = any((copy / "radiometer").glob("__pycache__"))  # the sound run's code is kept
    return int(pytest.main([*words, "-q", "-p", "no:cacheprovider", *QUIET, "-m", FAST, *tests], plugins=list(plugins)))


def ended(child: int) -> int | None:
    """Wait for a child and return how it ended; None where it took too long, when it is ended with all it started.

    Too long is `SECONDS` of the processor, which ends it by itself, or that it has waited for anything but the
    processor for `IDLE` s, or gone on for `LONGEST` s, both longer where the machine is busy.
    """
    worked, since = 0.0, time.monotonic()
    begun = since
    while True:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            return os.waitstatus_to_exitcode(status) if os.WIFEXITED(status) else None
        if (now := processor_s(child)) > worked + 0.1:
            worked, since = now, time.monotonic()
        if time.monotonic() - since > within(IDLE) or time.monotonic() - begun > within(LONGEST):
            os.killpg(child, signal.SIGKILL)
            os.waitpid(child, 0)
            return None
        time.sleep(0.02)


def processor_s(child: int) -> float:
    """Return how long a process that has not been waited for has worked, in s."""
    told = Path(f"/proc/{child}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
    return (int(told[11]) + int(told[12])) / os.sysconf("SC_CLK_TCK")


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
    preload()
    with tempfile.TemporaryDirectory(prefix="mutants-") as folder:
        copy = copied_sources(Path(folder))
        for tests in {mutant.tests for mutant in share}:
            if (code := code_of(tests, copy)) != 0:  # 4: misused; 5: nothing collected
                raise RuntimeError(f"pytest ends with {code} without any mutant: {' '.join(tests)}")
        outcomes = []
        for mutant in share:
            outcomes.append(fate_of(mutant, copy))
            print(f"{outcomes[-1].fate:9s} {mutant.area}: {mutant.why}", flush=True)
        return outcomes


def is_right(outcome: Outcome) -> bool:
    """Tell whether a mutant was noticed, or survived where nobody could notice it."""
    return outcome.fate == ("survived" if outcome.mutant.equivalent else "noticed")


def table(outcomes: list[Outcome]) -> str:
    """Return the score per area, and the survivors by what a user would suffer."""
    lines = ["| area | mutants | equivalent | noticed |", "|---|---|---|---|"]
    for area in sorted({outcome.mutant.area for outcome in outcomes}):
        own = [outcome for outcome in outcomes if outcome.mutant.area == area]
        fates, alike = Counter(outcome.fate for outcome in own), sum(outcome.mutant.equivalent for outcome in own)
        lines.append(f"| {area} | {len(own)} | {alike} | {fates['noticed']} |")
    left = [o for o in outcomes if not is_right(o)]
    lines += ["", *(f"* {o.fate}: `{o.mutant.file}`: {o.mutant.why}" for o in left)] if left else []
    return "\n".join(lines)


def main() -> int:
    """Run the mutants; 0 where all are noticed."""
    parser = argparse.ArgumentParser(prog="python -m tests.mutants", description=__doc__.splitlines()[0])
    parser.add_argument("areas", nargs="*", help="names of lists in tests/mutants; all by default")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--report", type=Path, help="where the table is written")
    parser.add_argument("--blind", type=int, metavar="SEED", help="draw mistakes at random in place of the lists")
    parser.add_argument("--each", type=int, default=8, help="how many are drawn of each area")
    parser.add_argument("--record", action="store_true", help="write down which test runs which line, for --blind")
    options = parser.parse_args()
    if options.record or options.blind is not None:
        from tests.mutants import blind

        if options.record and (code := blind.make_record()):
            return code
        return blind.run(options.blind, options.areas, options.each, options.report) if options.blind is not None else 0
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
    return int(not all(is_right(outcome) for outcome in outcomes))
