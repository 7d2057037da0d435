"""Runs tests in several processes that were collected once: `--processes=3`.

pytest-xdist starts workers that import and collect everything each for itself, next to a third process that hands out
the tests and unpacks three reports of each. Here pytest forks when all is collected. Each process takes the next group
of tests from a pipe until it is empty; what a forked one has to report it writes to a file, from which the first
process reads and reports it. One process more than there are cores works while others wait for an answer.
"""

from __future__ import annotations

import contextlib
import os
import pickle
import shutil
import signal
import tempfile
from collections import OrderedDict
from collections.abc import Callable, Iterable
from typing import IO, Any

import pytest

NUMBER_BYTES = 2  # a pipe takes and gives so few at once, so that no two processes share a number
LENGTH_BYTES = 4  # before each report
REAL_TIME = "real time"  # the group of what waits for devices and processes, one after the other
# Taken first: nothing long is left for the end, when one process has nothing else to do.
HEAVY = (
    REAL_TIME,
    "tests/unit/reconciliation",
    "tests/roundtrip",
    "tests/system",
    "tests/unit/cli",
    "tests/unit/analysis/response",
)


def grouped(items: Iterable[pytest.Item], group_of: Callable[[str], str]) -> list[list[pytest.Item]]:
    """Return the tests in their groups, those of heavy folders first, otherwise in the order they come in."""
    groups: dict[str, list[pytest.Item]] = {}
    for item in items:
        groups.setdefault(group_of(item.nodeid), []).append(item)
    return [groups[name] for name in sorted(groups, key=lightness)]


def lightness(group: str) -> int:
    """Return a group's place: the earlier its folder stands among the heavy ones, the less."""
    return next((place for place, folder in enumerate(HEAVY) if group.startswith(folder)), len(HEAVY))


class HeavyFirst(OrderedDict[str, Any]):
    """Groups of tests that wait; pytest-xdist, which puts those of many tests first, takes heavy ones first."""

    def popitem(self, last: bool = True) -> tuple[str, Any]:
        """Return the next group, of equally heavy ones the first that came."""
        group = min(self, key=lightness)
        return group, self.pop(group)


def turns(count: int) -> int:
    """Return the end of a pipe that gives every number below `count` once, to whoever reads next."""
    taken, given = os.pipe()
    os.write(given, b"".join(number.to_bytes(NUMBER_BYTES, "big") for number in range(count)))
    os.close(given)
    return taken


class Teller:
    """Writes reports to a file in place of telling them.

    They are pickled, for JSON makes lists of tuples, and pytest knows a skip by its tuple of place and reason.
    """

    def __init__(self, config: pytest.Config, stream: IO[bytes]) -> None:
        self.config, self.stream = config, stream

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Write a report, of what passed no more than its name and time."""
        if report.passed and not report.sections:
            outcome: Any = (report.nodeid, report.location, report.when, report.duration, report.start, report.stop)
        else:
            outcome = self.config.hook.pytest_report_to_serializable(config=self.config, report=report)
        written = pickle.dumps(outcome)
        self.stream.write(len(written).to_bytes(LENGTH_BYTES, "big") + written)
        self.stream.flush()


class Reader:
    """Reports the reports that another process has written so far."""

    def __init__(self, config: pytest.Config, stream: IO[bytes]) -> None:
        self.config, self.stream, self.at, self.rest = config, stream, 0, b""

    def read(self) -> None:
        """Tell what is new."""
        while new := os.pread(self.stream.fileno(), 1 << 20, self.at):  # the file's place is the writer's
            self.at += len(new)
            self.rest += new
            self._tell_whole_ones()

    def _tell_whole_ones(self) -> None:
        start = 0
        while (begin := start + LENGTH_BYTES) <= len(self.rest):
            end = begin + int.from_bytes(self.rest[start:begin], "big")
            if end > len(self.rest):
                break
            self._report(pickle.loads(self.rest[begin:end]))
            start = end
        self.rest = self.rest[start:]

    def _report(self, outcome: Any) -> None:
        if isinstance(outcome, tuple):
            nodeid, location, when, duration, start, stop = outcome
            report = pytest.TestReport(
                nodeid, location, {}, "passed", None, when, duration=duration, start=start, stop=stop
            )
        else:
            report = self.config.hook.pytest_report_from_serializable(config=self.config, data=outcome)
        self.config.hook.pytest_runtest_logreport(report=report)


def run_groups(
    session: pytest.Session, groups: list[list[pytest.Item]], taken: int, between: Callable[[], object]
) -> None:
    """Run one group after the other as their turn comes, as pytest's own loop does.

    Raises:
        pytest.Session.Failed: If as many have failed as may.
    """
    item: pytest.Item | None = None
    upcoming = _next_group(groups, taken)
    while upcoming:
        group, upcoming = upcoming, []
        for place, item in enumerate(group):
            if place + 1 == len(group):
                upcoming = _next_group(groups, taken)
            following = group[place + 1] if place + 1 < len(group) else (upcoming or [None])[0]
            item.config.hook.pytest_runtest_protocol(item=item, nextitem=following)
            between()
            if session.shouldfail:
                raise session.Failed(session.shouldfail)
            if session.shouldstop:
                raise session.Interrupted(session.shouldstop)


def _next_group(groups: list[list[pytest.Item]], taken: int) -> list[pytest.Item]:
    number = os.read(taken, NUMBER_BYTES)
    return groups[int.from_bytes(number, "big")] if number else []


def forked(session: pytest.Session, groups: list[list[pytest.Item]], taken: int, stream: IO[bytes]) -> int:
    """Fork a process that runs groups as well and writes its reports; return its number once it is on its own.

    Both share the file that holds what tests print until the forked one has opened another.
    """
    parent = os.getpid()
    ready, say = os.pipe()
    child = os.fork()
    if child:
        os.close(say)
        os.read(ready, 1)
        os.close(ready)
        return child
    code = 1
    try:
        plugins = session.config.pluginmanager
        capture: Any = plugins.getplugin("capturemanager")
        if capture is not None:
            capture.stop_global_capturing()
            capture.start_global_capturing()
        plugins.unregister(name="terminalreporter")
        plugins.register(Teller(session.config, stream))
        os.write(say, b".")
        with contextlib.suppress(session.Failed):
            run_groups(session, groups, taken, lambda: os.getppid() == parent or os._exit(1))
        code = 0
    finally:
        stream.flush()
        os._exit(code)


def run(session: pytest.Session, group_of: Callable[[str], str], processes: int) -> bool:
    """Run the tests of a session in so many processes.

    Raises:
        pytest.Session.Failed: If a forked process did not come to its end.
    """
    groups = grouped(session.items, group_of)
    taken = turns(len(groups))
    with contextlib.ExitStack() as files:
        folder = tempfile.mkdtemp(prefix="pytest-of-several-", dir=os.environ.get("PYTEST_DEBUG_TEMPROOT"))
        os.environ["PYTEST_DEBUG_TEMPROOT"] = folder  # each process makes its own files there
        streams = [files.enter_context(tempfile.TemporaryFile(buffering=0)) for _ in range(processes - 1)]
        children = [forked(session, groups, taken, stream) for stream in streams]
        readers = [Reader(session.config, stream) for stream in streams]
        try:
            run_groups(session, groups, taken, lambda: [reader.read() for reader in readers])
            statuses = [os.waitpid(child, 0)[1] for child in children]
            for reader in readers:
                reader.read()
        except BaseException:
            for child in children:
                with contextlib.suppress(ProcessLookupError):
                    os.kill(child, signal.SIGKILL)
            raise
        finally:
            os.close(taken)
    if status := next(filter(None, statuses), 0):
        session.shouldfail = f"another process of tests ended with {os.waitstatus_to_exitcode(status)}"
    if session.shouldfail:
        raise session.Failed(session.shouldfail)
    if not session.testsfailed:
        shutil.rmtree(folder, ignore_errors=True)
    return True
