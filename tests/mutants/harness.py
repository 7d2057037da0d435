"""Makes one mistake in a copy of the sources and runs tests against it.

Each run is a fork that has numpy and its like imported already. A mistake is noticed when a test fails, when pytest
breaks off, and when the tests do not end.
"""

from __future__ import annotations

import ast
import importlib
import itertools
import os
import resource
import shutil
import signal
import sys
import tempfile
import time
from pathlib import Path

import pytest

from testing.patience import within

ROOT = Path(__file__).resolve().parents[2]
COPIED = ("radiometer", "drivers", "simulators", "configs", "testing", "tests", "docs", "benchmarks")
COPIED += ("pyproject.toml", "README.md")
SECONDS = 60  # of the processor for the tests of one mutant; a mutant that never ends is noticed as well
IDLE, LONGEST = 20.0, 120.0  # s without work, and in all on a quiet machine, after which one waits for ever
QUIET = ("-W", "ignore::pytest.PytestAssertRewriteWarning")  # of plugins imported beforehand
FAST = "not slow and not long and not bench and not soak and not hardware"
PASSED = (0, 5)  # 5: nothing was left to run
COMPILED = "@compiled"  # marks the functions that numba compiles
_OWN_TIMES = itertools.count(1_000_000_000)  # of files with a mistake, in s: compiled code of another is not theirs
OTHERS = ("aiohttp.web", "cv2", "hypothesis", "matplotlib.figure", "numba", "numpy", "pydantic", "pytest")
OTHERS += ("scipy.optimize", "scipy.special", "scipy.stats", "structlog", "typer.testing", "yaml")


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
    tests: tuple[str, ...], copy: Path, environment: dict[str, str], plugins: tuple[object, ...], words: tuple[str, ...]
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
    own = {"radiometer", "drivers", "simulators", "testing", "tests", "benchmarks"}
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
    reported = Path(f"/proc/{child}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
    return (int(reported[11]) + int(reported[12])) / os.sysconf("SC_CLK_TCK")


def copied_sources(folder: Path) -> Path:
    """Return a copy of everything that tests read."""
    for name in COPIED:
        source = ROOT / name
        if source.is_dir():
            shutil.copytree(source, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            shutil.copy(source, folder / name)
    return folder
