"""Draws mistakes at random, which no one chose, and counts which the fast tests notice.

    python -m tests.mutants --record                        once, and after the source or the tests changed
    python -m tests.mutants --blind SEED [AREA ...] [--each 8] [--report FILE]

A seed has read no test. It draws places of the syntax trees of an area's sources (`areas.py`) and one mistake at each
(`mistakes.py`). The fast tests that ran the line run against the mistake, the nearest first. A record of coverage by
test names them. A survivor is for people to judge: it does what the original does for any input, or a test is missing.
A seed is used once: after tests are written for its survivors, the next draw takes another seed.
"""

from __future__ import annotations

import ast
import os
import random
import re
import subprocess
import sys
import tempfile
from collections import Counter, defaultdict
from collections.abc import Container, Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path

import pytest

from tests.mutants import harness
from tests.mutants.areas import AREAS
from tests.mutants.mistakes import Mistake, drawn

RECORD = harness.ROOT / "out" / "mutants.coverage"
PACKAGES = ("radiometer", "drivers", "simulators")
NEAREST, MOST = 40, 500  # tests of the first try, and of all tries


@dataclass(frozen=True)
class Drawn:
    """A drawn mistake and what became of it."""

    area: str
    file: str
    mistake: Mistake
    fate: str = "not run"
    by: str = ""  # the test that noticed


@dataclass
class Record:
    """Which tests ran which lines: by file, then by line; and how many lines each test ran."""

    tests_of: dict[str, dict[int, set[str]]] = field(default_factory=lambda: defaultdict(dict))
    lines_of: Counter[str] = field(default_factory=Counter)

    @classmethod
    def read(cls, path: Path) -> Record:
        """Return a record that `make_record` has made.

        Raises:
            FileNotFoundError: If there is none.
        """
        from coverage import CoverageData

        if not path.is_file():
            raise FileNotFoundError(f"{path} is not there: make it by `python -m tests.mutants --record`")
        kept = CoverageData(basename=str(path))
        kept.read()
        record = cls()
        for measured in kept.measured_files():
            name = re.sub(rf".*/(?=({'|'.join(PACKAGES)})/)", "", measured)
            for line, contexts in kept.contexts_by_lineno(measured).items():
                tests = {context.partition("|")[0] for context in contexts if context}
                record.tests_of[name].setdefault(line, set()).update(tests)
                record.lines_of.update(tests)
        return record

    def tests(self, file: str, line: int) -> list[str]:
        """Return the tests that ran a line, those nearest to the file first, of these the ones that ran least.

        No test runs what runs at import or is compiled by numba. Then these tests are chosen: those that ran the
        function around the line or the lines that name what it defines, else those of the folder of the same name.
        """
        lines = self.tests_of.get(file, {})
        found = lines.get(line) or self._around(file, line) or self._beside(file)
        near = f"tests/unit/{file.removeprefix('radiometer/').rpartition('/')[0]}/"
        return sorted(found, key=lambda test: (not test.startswith(near), self.lines_of[test], test))

    def _around(self, file: str, line: int) -> set[str]:
        source = (harness.ROOT / file).read_text(encoding="utf-8")
        if not file.endswith(".py"):
            return set()
        found: set[str] = set()
        for node in ast.walk(ast.parse(source)):
            if not isinstance(node, ast.stmt) or not node.lineno <= line <= (node.end_lineno or node.lineno):
                continue
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                found |= self._ran(file, range(node.lineno, (node.end_lineno or node.lineno) + 1))
                if any(harness.COMPILED.lstrip("@") in ast.unparse(one) for one in node.decorator_list):
                    found |= self._naming(node.name)
            elif isinstance(node, ast.Assign | ast.AnnAssign):
                targets = node.targets if isinstance(node, ast.Assign) else [node.target]
                for name in {one.id for target in targets for one in ast.walk(target) if isinstance(one, ast.Name)}:
                    found |= self._naming(name)
        return found

    def _ran(self, file: str, lines: Iterable[int]) -> set[str]:
        ran = self.tests_of.get(file, {})
        return set().union(*(ran.get(line, set()) for line in lines))

    def _naming(self, name: str) -> set[str]:
        message = re.compile(rf"\b{re.escape(name)}\b")
        found: set[str] = set()
        for file in self.tests_of:
            lines = (harness.ROOT / file).read_text(encoding="utf-8").splitlines()
            found |= self._ran(file, [k for k, text in enumerate(lines, 1) if message.search(text)])
        return found

    def _beside(self, file: str) -> set[str]:
        folder = "tests/unit/firmware/" if "firmware" in file else f"tests/unit/{file.removeprefix('radiometer/')}"
        folder = folder.rpartition("/")[0] + "/"
        return {test for test in self.lines_of if test.startswith(folder)}


class Chosen:
    """A plugin that runs the tests named, in their order, and writes down those that fail."""

    def __init__(self, tests: Iterable[str], failed: Path) -> None:
        self.place, self.failed = {test: k for k, test in enumerate(tests)}, failed
        failed.write_text("", encoding="utf-8")

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        """Leave out all others."""
        items[:] = sorted((one for one in items if one.nodeid in self.place), key=lambda one: self.place[one.nodeid])

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Write down what fails."""
        if report.failed:
            with self.failed.open("a", encoding="utf-8") as stream:
                stream.write(f"{report.nodeid}\n")


def make_record() -> int:
    """Run the fast tests once and write down which ran which line; return how pytest ended."""
    RECORD.parent.mkdir(exist_ok=True)
    words = ["-m", "pytest", "-q", "-p", "no:cacheprovider", "-m", harness.FAST, "tests/unit"]
    words += ["--cov", "--cov-context=test", "--cov-report="]
    environment = {**os.environ, "COVERAGE_FILE": str(RECORD), "PYTHONPATH": str(harness.ROOT)}
    return subprocess.run([sys.executable, *words], cwd=harness.ROOT, env=environment, check=False).returncode


def sources_of(patterns: Iterable[str]) -> dict[str, str]:
    """Return the source texts that patterns of names stand for, by name."""
    paths = {path for pattern in patterns for path in harness.ROOT.glob(pattern) if path.name != "__init__.py"}
    return {path.relative_to(harness.ROOT).as_posix(): path.read_text(encoding="utf-8") for path in sorted(paths)}


def draw(seed: int, areas: list[str], each: int) -> list[Drawn]:
    """Return the mistakes that a seed draws of each area; an area's do not hang on which others are drawn.

    Raises:
        KeyError: If there is no such area.
    """
    if unknown := set(areas) - set(AREAS):
        raise KeyError(f"no area {', '.join(sorted(unknown))}; areas are {', '.join(AREAS)}")
    return [
        Drawn(area, file, mistake)
        for area in areas or AREAS
        for file, mistake in drawn(sources_of(AREAS[area]), each, random.Random(f"{seed} {area}"))
    ]


def judged(one: Drawn, record: Record, copy: Path, unsound: Container[str] = ()) -> Drawn:
    """Return a mistake with its fate; it is made in a copy of the sources and corrected again.

    Args:
        one: The mistake.
        record: Which tests ran its line.
        copy: Copy of the sources.
        unsound: Tests that fail without any mistake.
    """
    tests = [test for test in record.tests(one.file, one.mistake.line) if test not in unsound][:MOST]
    if not tests:
        return replace(one, fate="survived: no test runs it")
    text, failed = one.mistake.made_in((copy / one.file).read_text(encoding="utf-8")), copy / "failed.txt"
    for some in (tests[:NEAREST], tests[NEAREST:]):
        if some and harness.fate_of_text(text, one.file, files_of(some), copy, (Chosen(some, failed),)) != "survived":
            by = failed.read_text(encoding="utf-8").partition("\n")[0]
            return replace(one, fate="noticed", by=by or "no test: it breaks off, or never ends")
    return replace(one, fate="survived")


def files_of(tests: Iterable[str]) -> tuple[str, ...]:
    """Return the files of some tests, each once."""
    return tuple(dict.fromkeys(test.partition("::")[0] for test in tests))


def that_fail_anyway(tests: set[str], copy: Path) -> set[str]:
    """Return those of some tests that fail in the copy without any mistake: they have noticed nothing."""
    failed = copy / "failed.txt"
    harness.code_of(files_of(sorted(tests)), copy, {}, (Chosen(sorted(tests), failed),), all_of_them=True)
    return set(failed.read_text(encoding="utf-8").splitlines())


def shown(one: Drawn) -> str:
    """Return one line for people: where, what was done, and the line before and after."""
    text = (harness.ROOT / one.file).read_text(encoding="utf-8")
    line, wrong = (
        (one.mistake.made_in(text) if wrong else text)[start:].split("\n", 1)[0].strip()
        for start in [text.rfind("\n", 0, one.mistake.start) + 1]
        for wrong in (False, True)
    )
    head = f"{one.fate} | {one.area} | {one.file}:{one.mistake.line} | {one.mistake.kind}"
    return f"{head}\n    - {line}\n    + {wrong}" + (f"\n    by {one.by}" if one.by else "")


def table(outcomes: list[Drawn]) -> str:
    """Return the score of each area and of each kind of mistake, and the survivors."""
    lines = []
    for title, of in (("area", lambda one: one.area), ("kind", lambda one: one.mistake.kind)):
        lines += [f"| {title} | drawn | noticed |", "|---|---|---|"]
        groups = {name: [one for one in outcomes if of(one) == name] for name in map(of, outcomes)} | {"all": outcomes}
        for name, own in groups.items():
            lines.append(f"| {name} | {len(own)} | {sum(one.fate == 'noticed' for one in own)} |")
        lines.append("")
    return "\n".join([*lines, *(shown(one) for one in outcomes if one.fate != "noticed")])


def run(seed: int, areas: list[str], each: int, report: Path | None) -> int:
    """Draw, run, and show; what was done so far stands in the report."""
    record = Record.read(RECORD)
    harness.preload()
    outcomes: list[Drawn] = []
    with tempfile.TemporaryDirectory(prefix="mutants-") as folder:
        copy = harness.copied_sources(Path(folder))
        for one in draw(seed, areas, each):
            outcomes.append(judged(one, record, copy))
            print(shown(outcomes[-1]), flush=True)
            if report is not None:
                report.write_text(table(outcomes) + "\n", encoding="utf-8")
        unsound = that_fail_anyway({one.by for one in outcomes if "::" in one.by}, copy)
        outcomes = [judged(one, record, copy, unsound) if one.by in unsound else one for one in outcomes]
    page = table(outcomes)
    print(page)
    if report is not None:
        report.write_text(page + "\n", encoding="utf-8")
    return 0
