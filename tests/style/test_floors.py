"""How the rooms of reconcile stand on each other: imports run one way, on few floors."""

import ast
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

from tests.style.test_source import parsed

ROOT = Path(__file__).resolve().parents[2]
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


def test_imports_of_reconcile_go_in_no_circle():
    """From no module do imports lead back to it: there is an order in which each stands above what it imports."""
    order = list(TopologicalSorter({module: imported_by(module) for module in FILES}).static_order())
    assert sorted(order) == sorted(FILES)


def test_reconcile_stands_on_few_floors():
    """The longest way of imports is short enough to be read from below."""
    floors: dict[int, list[str]] = {}
    for module in FILES:
        floors.setdefault(floor_of(module), []).append(module.removeprefix("radiometer.reconciliation."))
    assert max(floors) <= MOST_FLOORS, "\n".join(f"{n}: {', '.join(names)}" for n, names in sorted(floors.items()))
