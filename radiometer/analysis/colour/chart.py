"""Charts of known lights: a table of X, Y, Z or of places in the frame, and a table of spectra."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from radiometer.analysis.photometry.photometry import Spectrum, spectral_columns
from radiometer.data import Patch
from radiometer.data.text_table import TextTable, finite, read_table
from radiometer.errors import InputError
from radiometer.typing import Array

_NEEDS: Final = "the columns name, X, Y, Z (in cd/m2), and as needed u_rel, kind, left, top, width, height, capture"
_NAMES: Final = ("name", "patch", "light", "colour", "color")
_PLACE: Final = ("left", "top", "width", "height")


@dataclass(frozen=True, slots=True, eq=False)
class KnownLight:
    """One light of a chart."""

    name: str  # its name
    kind: str  # kind of light; empty where the chart does not state it
    xyz: Array | None  # X, Y, Z in cd·m⁻²; None where the chart does not state them
    u_rel: float  # relative standard uncertainty of X, Y, Z
    patch: Patch | None  # where it is; None where the chart does not state it
    capture: Path | None  # frames that show it; None where the chart does not state them


def read_chart(path: Path) -> list[KnownLight]:
    """Return the lights of a table. Captures are relative to its folder, places are pixels of a colour's plane.

    Raises InputError if it cannot be read, a column of a group is missing, or a number is no number, and UnsettledError
    if a column's unit is not known.
    """
    table = read_table(path, _NEEDS, named=True)
    at = table.find(_NAMES)
    if at is None:
        raise InputError(f"{path}: no column is called name; it needs {_NEEDS}")
    names = [cells[at].strip() for _, cells in table.rows]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise InputError(f"{path}: the light {twice[0]!r} occurs twice; rename one")
    xyz = _group(table, ("x", "y", "z"), "luminance", "cd/m2")
    u_rel = _group(table, ("u_rel",), "number", "1")
    places = _group(table, _PLACE, "number", "1")
    kinds, captures = _words(table, "kind"), _words(table, "capture")
    return [
        KnownLight(
            name, kinds[n], None if xyz is None else xyz[n], 0.0 if u_rel is None else float(u_rel[n, 0]),
            None if places is None else Patch(*(int(one) for one in places[n])),
            path.parent / captures[n] if captures[n] else None,
        )
        for n, name in enumerate(names)
    ]  # fmt: skip


def _group(table: TextTable, names: Sequence[str], fact: str, unit: str) -> Array | None:
    """Return the columns of a group, shape (rows, columns); None where the table has none of them."""
    found = [table.find_fact(fact, (name,)) if fact == "luminance" else table.find((name,)) for name in names]
    if all(at is None for at in found):
        return None
    missing = [name for name, at in zip(names, found, strict=True) if at is None]
    if missing:
        raise InputError(f"{table.path}: has no column {missing[0]}; {', '.join(names)} belong together")
    doubts = list[str]()
    columns = [finite(table.values(at, fact, doubts, defined=unit), table, at) for at in found if at is not None]
    if doubts:
        raise InputError(f"{table.path}: {doubts[0]}")
    return np.array(columns, dtype=np.float64).T


def _words(table: TextTable, name: str) -> list[str]:
    at = table.find((name,))
    return ["" if at is None else cells[at].strip() for _, cells in table.rows]


def read_spectra(path: Path) -> dict[str, Spectrum]:
    """Return spectra by plain name of a table with one column each next to the wavelength in nm.

    Raises InputError if it cannot be read, or a spectrum holds a value below 0.
    """
    table = read_table(path, "the columns wavelength_nm and one per spectrum", named=True)
    names = table.plain[1:]
    wavelength_nm, columns = spectral_columns(path, {name: (name,) for name in names})
    for name, power in columns.items():
        if np.any(power < 0.0) or not power.any():
            raise InputError(f"{path}: {name}: powers must be 0 or more, not all 0")
    return {name: Spectrum(name, wavelength_nm, power, is_sampled=True) for name, power in columns.items()}
