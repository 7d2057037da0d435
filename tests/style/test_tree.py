"""How parts stand to each other: tests mirror the packages, imports of reconcile run one way, on few floors."""

import ast
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

from tests.style.test_source import ROOT, parsed

UNIT = ROOT / "tests" / "unit"
# Firmware is no package; reports are of all readers together.
OTHERS = {"firmware", "reports"}
# Folders of files that a test compiles or reads.
WITHOUT_TESTS = {"host", "recorded"}


def folders(root: Path) -> set[str]:
    """Return the folders below one that hold Python files of their own, by their path."""
    return {
        path.parent.relative_to(root).as_posix()
        for path in root.rglob("*.py")
        if not {"__pycache__", *WITHOUT_TESTS} & set(path.parts)
    } - {"."}


def test_folders_of_tests_are_those_of_the_source():
    """Each part of the package has its own."""
    sources = folders(ROOT / "radiometer") | {
        f"{package}{'/' if name else ''}{name}"
        for package in ("drivers", "simulators")
        for name in {*folders(ROOT / package), ""}
    }
    assert folders(UNIT) - OTHERS - sources == set()
    parts = {name for name in folders(ROOT / "radiometer") if "/" not in name} | {"drivers", "simulators"}
    assert parts - folders(UNIT) == set()


# Reconcile.


ROOM = ROOT / "radiometer" / "reconciliation"
MOST_FLOORS = 15
FILES = {
    ".".join(path.relative_to(ROOT).with_suffix("").parts): path
    for path in sorted(ROOM.rglob("*.py"))
    if path.name != "__init__.py"
}


@cache
def imported_by(module: str) -> frozenset[str]:
    """Return the modules of the room that one imports, also within functions and for type checkers alone."""
    found = set()
    for node in ast.walk(parsed(FILES[module])):
        if isinstance(node, ast.ImportFrom) and node.module:
            found |= {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
    return frozenset(found & FILES.keys())


@cache
def floor_of(module: str) -> int:
    """Return the floor on which a module stands: 1 where it imports nothing of the room."""
    return 1 + max((floor_of(lower) for lower in imported_by(module)), default=0)


def test_imports_of_reconcile_go_in_no_circle_over_few_floors():
    """There is an order in which each is above what it imports."""
    order = list(TopologicalSorter({module: imported_by(module) for module in FILES}).static_order())
    assert sorted(order) == sorted(FILES)
    floors: dict[int, list[str]] = {}
    for module in FILES:
        floors.setdefault(floor_of(module), []).append(module.removeprefix("radiometer.reconciliation."))
    assert max(floors) <= MOST_FLOORS, "\n".join(f"{n}: {', '.join(names)}" for n, names in sorted(floors.items()))
