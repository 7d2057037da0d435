"""Figures as they were at the last change, so that a review sees what a change does to them.

The tests beside this file run small worlds of a fixed seed through whole parts of the program and compare every figure
that comes out with the file `held/<name>.yaml`. That says nothing of what is true: the tests of each part do, by known
values in and intervals out. It says that nothing moved unseen, down to a bound that no interval is narrow enough for.

A figure that moved on purpose is written anew by `HOLD=1 python -m pytest tests/unit/held`, and the difference of the
files belongs into the same commit as its reason.
"""

from __future__ import annotations

import enum
import math
import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml

FOLDER = Path(__file__).parent / "held"
# Between machines sums differ in their last digits; what iterates or inverts multiplies that.
SUMS, FITS = 1e-9, 1e-5
LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)

Plain = float | int | str | bool | None


def digest(values: Any) -> list[float]:
    """Return four numbers of an array that no exchange, loss or factor leaves alone.

    How many are finite (or true), their mean, their root mean square, and their mean under weights that differ from
    place to place.
    """
    array = np.asarray(values)
    if array.dtype == bool:
        array = np.where(array, 1.0, np.nan)
    flat = np.asarray(array, float).ravel()
    known = np.isfinite(flat)
    weights = 1.5 + np.cos(1.0 + np.sqrt(2.0) * np.arange(flat.size))[known]  # never 0: nothing cancels
    flat = flat[known]
    if not flat.size:
        return [0, 0.0, 0.0, 0.0]
    return [int(known.sum()), float(flat.mean()), float(np.sqrt(np.mean(flat**2))), float(np.mean(weights * flat))]


def plain(value: Any) -> Any:
    """Return nested mappings, sequences and arrays as what a file of YAML holds."""
    if isinstance(value, enum.Enum):
        return str(value)
    if isinstance(value, np.ndarray):
        return plain(value.tolist()) if value.size <= 8 else [plain(x) for x in digest(value)]
    if isinstance(value, Mapping):
        return {str(key): plain(one) for key, one in value.items()}
    if isinstance(value, set | frozenset):
        return sorted(plain(one) for one in value)
    if isinstance(value, Sequence) and not isinstance(value, str):
        if len(value) > 60 and all(isinstance(one, float) for one in value):  # a table that an effect holds
            return digest(value)
        return [plain(one) for one in value]
    if isinstance(value, bool | np.bool_):
        return bool(value)
    if isinstance(value, int | np.integer):
        return int(value)
    if isinstance(value, float | np.floating):
        return float(f"{float(value):.12g}")
    return value if value is None else str(value)


def leaves(value: Any, path: str = "") -> Iterator[tuple[str, Plain]]:
    """Yield every figure of nested mappings and sequences with its path."""
    if isinstance(value, Mapping):
        for key, one in value.items():
            yield from leaves(one, f"{path}.{key}" if path else str(key))
    elif isinstance(value, list):
        yield f"{path}.#", len(value)
        for index, one in enumerate(value):
            yield from leaves(one, f"{path}.{index}")
    else:
        yield path, value


def same(here: Plain, there: Plain, rel: float, scale: float = 0.0) -> bool:
    """Tell whether two figures are one, numbers but for a share `rel` of their size, nothing but for its rounding.

    Args:
        here: The one.
        there: The other.
        rel: That share.
        scale: Size of what a number is the mean of: it may cancel to nothing, but what it is summed from does not.
    """
    numbers = all(isinstance(one, int | float) and not isinstance(one, bool) for one in (here, there))
    if not numbers:
        return type(here) is type(there) and here == there
    assert isinstance(here, int | float)
    assert isinstance(there, int | float)
    if math.isnan(here) or math.isnan(there):
        return math.isnan(here) and math.isnan(there)
    rounding = 1e-15 if 0.0 in (here, there) else 0.0
    return here == there or abs(here - there) <= rel * max(abs(here), abs(there), scale) + rounding


def moved(name: str, figures: Mapping[str, Any], *, rel: float = SUMS) -> list[str]:
    """Return which figures are no more what the file holds; write them there where `HOLD` is set.

    Args:
        name: Name of the file, without its ending.
        figures: Nested mappings and sequences of numbers, words and arrays.
        rel: Share of its size that a number may differ by.
    """
    path = FOLDER / f"{name}.yaml"
    now = plain(figures)
    gone = _moved(path, now, rel)
    if gone and os.environ.get("HOLD"):
        path.parent.mkdir(parents=True, exist_ok=True)
        text = yaml.dump(now, sort_keys=False, allow_unicode=True, width=120, default_flow_style=None)
        path.write_text(text, encoding="utf-8")
        return []
    return gone


def _moved(path: Path, now: Any, rel: float) -> list[str]:
    text = path.read_text(encoding="utf-8") if path.exists() else ""
    held, found = dict(leaves(yaml.load(text, Loader=LOADER) or {})), dict(leaves(now))
    return [
        f"{key}: held {held.get(key, 'nothing')}, now {found.get(key, 'nothing')}"
        for key in {**held, **found}
        if key not in held or key not in found or not same(held[key], found[key], rel, _scale(held, key))
    ]


def _scale(held: Mapping[str, Plain], key: str) -> float:
    """Return the root mean square of the array whose mean a figure is, in its digest; 0 for any other figure."""
    of, _, place = key.rpartition(".")
    size, known, rms = (held.get(f"{of}.{name}") for name in ("#", "0", "2"))
    is_mean = place in ("1", "3") and size == 4 and type(known) is int
    return abs(rms) if is_mean and isinstance(rms, int | float) else 0.0
