"""What every file, request and option of the program may hold: names, kinds, defaults and bounds of each field."""

from __future__ import annotations

import importlib
import re
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import pytest
from pydantic import BaseModel

from tests.unit.held.figures import moved

ROOT = Path(__file__).resolve().parents[3]
DECLARES = re.compile(r"^class \w+\((?:BaseModel|\w*Section|\w*Body|\w*Config|\w*Model)\):", re.MULTILINE)


def modules() -> dict[str, list[str]]:
    """Return the modules that declare such fields, by their package."""
    found: dict[str, list[str]] = {}
    for package in ("radiometer", "drivers", "simulators"):
        for path in sorted((ROOT / package).rglob("*.py")):
            if DECLARES.search(path.read_text(encoding="utf-8")):
                name = ".".join(path.relative_to(ROOT).with_suffix("").parts)
                found.setdefault(".".join(name.split(".")[:2]), []).append(name)
    return found


MODULES = modules()


def bare(value: Any) -> Any:
    """Return a schema without its words."""
    if isinstance(value, dict):
        return {k: bare(v) for k, v in value.items() if not (k in ("description", "title") and isinstance(v, str))}
    return [bare(v) for v in value] if isinstance(value, list) else value


def own_models(name: str) -> dict[str, Any]:
    """Return the fields of the models that a module declares itself, those of others by their names alone."""
    module = importlib.import_module(name)
    kinds = [one for one in vars(module).values() if isinstance(one, type) and one.__module__ == name]
    told = {}
    for kind in kinds:
        if issubclass(kind, BaseModel) and kind.model_fields:
            schema = bare(kind.model_json_schema())
            schema.pop("$defs", None)
            told[kind.__name__] = schema
    return told


@pytest.mark.parametrize("package", MODULES)
def test_what_fields_may_hold_is_as_it_was(package):
    """A bound that moves or turns exclusive, another default, a field more or less: none goes unseen."""
    assert not moved(f"schemas/{package}", {name: own_models(name) for name in MODULES[package]})


def test_what_parameters_of_effects_may_be_is_as_it_was():
    """Default, unit and bounds of every parameter of every effect, link of the chain and lens."""
    told: dict[str, Any] = {}
    for path in sorted((ROOT / "simulators" / "effects").glob("*.py")):
        module = importlib.import_module(f"simulators.effects.{path.stem}")
        for kind in (one for one in vars(module).values() if isinstance(one, type) and is_dataclass(one)):
            known = {one.name: (one.default, one.metadata) for one in fields(kind) if "unit" in one.metadata}
            if kind.__module__ == module.__name__ and known:
                told[f"{path.stem}.{kind.__name__}"] = {
                    name: [default, held["unit"], held["low"], held["high"], held["of_full_scale"]]
                    for name, (default, held) in known.items()
                }
    assert not moved("schemas/parameters", told)
