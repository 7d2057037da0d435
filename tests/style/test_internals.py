"""Tests use what users of a module use: no private name, no stub of an internal object, no line of the log."""

import ast
import re
from pathlib import Path

import pytest

from tests.style.test_source import faulty, name_of, parsed

ROOT = Path(__file__).resolve().parents[2]
TESTS = sorted(path for folder in ("tests", "testing") for path in (ROOT / folder).rglob("*.py"))
PACKAGES = {"radiometer", "drivers", "simulators"}
# Stand-ins in these folders are of foreign libraries (Aravis, video4linux), which are no objects of ours.
FOREIGN = ("tests/unit/drivers/", "tests/unit/simulators/cameras/")
SETTERS = {"setattr", "delattr", "getattr"}
NO_SECRET = re.compile(r"_(asdict|replace|fields|make|exit|repr_\w+_)")  # named tuples, os._exit, how notebooks show


def is_private(name: str) -> bool:
    """Tell whether a name is private to its module or class."""
    return name.startswith("_") and not name.startswith("__") and name != "_" and not NO_SECRET.fullmatch(name)


def reaches_inside(path: Path) -> list[str]:
    """Return what a file uses that only its module should."""
    return reaches(parsed(path), foreign=name_of(path).startswith(FOREIGN))


def reaches(tree: ast.AST, *, foreign: bool = False) -> list[str]:
    """Return the private names, stubs and logs that a syntax tree uses.

    Args:
        tree: The tree.
        foreign: Whether its stubs stand for objects of foreign libraries.
    """
    found = []
    for node in ast.walk(tree):
        match node:
            case ast.ImportFrom(module=module, names=names) if (module or "").split(".")[0] in PACKAGES:
                found += [one.name for one in names if is_private(one.name)]
            case ast.Attribute(value=ast.Name(id="self" | "cls")) | ast.Attribute(value=ast.Call(func=ast.Name())):
                continue
            case ast.Attribute(attr=name) if is_private(name) or name == "capture_logs":
                found.append(ast.unparse(node))
            case ast.Call(func=ast.Attribute(attr=called) | ast.Name(id=called), args=args) if called in SETTERS:
                words = [one.value for one in args[:2] if isinstance(one, ast.Constant) and isinstance(one.value, str)]
                found += [word for word in words if is_private(word.rpartition(".")[2])]
            case ast.Name(id=name) if name in {"capture_logs", "caplog"} or (name == "SimpleNamespace" and not foreign):
                found.append(name)
    return found


def test_tests_use_what_users_use():
    """Whatever is renamed or rewritten inside a module breaks no test of what it does."""
    assert faulty(TESTS, reaches_inside) == {}


@pytest.mark.parametrize(
    ("text", "count"),
    [
        ("from radiometer.data.storage import _umask", 1),
        ("station._tasks.append(1)", 1),
        ("monkeypatch.setattr(station, '_pause_s', 1)", 1),
        ("monkeypatch.setattr('radiometer.daemon.probe._PATIENCE_S', 1)", 1),
        ("fit = SimpleNamespace(aicc=1)", 1),
        ("with structlog.testing.capture_logs() as log: run()", 1),
        ("class Fake:\n    def f(self): return self._x", 0),
        ("reading._replace(u=1); shown._repr_html_(); x.__dict__", 0),
        ("from testing.worlds import _world", 0),
    ],
)
def test_what_reaches_inside_is_found(text, count):
    """Imports, attributes, patches by name, stubs and logs are; a fake's own members and public protocols are not."""
    assert len(reaches(ast.parse(text))) == count
