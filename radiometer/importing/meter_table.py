"""Table of a light meter: luminance, f-number, time and ISO speed of every reading."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from radiometer.data.reader_limits import bounded_reader
from radiometer.data.text_table import TextTable, finite, read_table
from radiometer.errors import InputError, UnsettledError
from radiometer.units import exact_exposures_s, exact_f_number

_NAMES: Final[Mapping[str, tuple[str, ...]]] = {
    "luminance": ("luminance", "l_v", "lv", "luminance_cd_per_m2"),
    "f_number": ("f_number", "fnumber", "f", "aperture", "n"),
    "exposure": ("time", "exposure", "t", "exposure_time", "shutter"),
    "iso": ("iso", "s", "speed", "iso_speed"),
}
# What the documented table means where a heading has no unit.
_UNITS: Final = {"luminance": "cd/m2", "f_number": "1", "exposure": "s", "iso": "ISO"}
# ISO 2720 recommends 10.6 to 13.4; meters in use go from 10 to 17. Far from it a column has another unit.
_METER_CONSTANTS: Final = (3.0, 50.0)
_NEEDS: Final = "luminance, f_number, time and iso"


@dataclass(frozen=True, slots=True)
class MeterRow:
    """One reading: luminance in cd·m⁻², f-number and time in s as printed, ISO speed, the source's name, exact time."""

    source: str
    luminance_cd_m2: float
    f_number: float
    time_s: float
    iso: float
    exact_time_s: float  # behind the printed one, by the dial that all rows together show

    @property
    def k_printed(self) -> float:
        """Return the meter constant from the printed values."""
        return self.luminance_cd_m2 * self.time_s * self.iso / self.f_number**2

    @property
    def k_exact(self) -> float:
        """Return the meter constant from the exact stops behind them."""
        return self.luminance_cd_m2 * self.exact_time_s * self.iso / exact_f_number(self.f_number) ** 2


@bounded_reader(error=InputError)
def read_meter_table(path: Path) -> tuple[MeterRow, ...]:
    """Return the rows of a CSV with columns luminance, f_number, time (1/125 or s) and iso, and maybe a source's name.

    Raises:
        InputError: If a column is missing or a value is no positive number; the message gives the line.
        UnsettledError: If a column states no unit, or its numbers can be none of a meter.
    """
    table = read_table(path, f"the columns {_NEEDS}", named=True)
    columns = {fact: _column(table, fact) for fact in _NAMES}
    named = next(
        (i for i, name in enumerate(table.plain) if name in ("screen", "source", "scene", "target", "name")), None
    )
    for (line, _), *figures in zip(table.rows, *columns.values(), strict=True):
        if min(figures) <= 0:
            raise InputError(f"{table.where(line)}: expected positive numbers, times as 0.004 or 1/250")
    rows = []
    exact = exact_exposures_s(columns["exposure"])
    for (_, cells), *figures in zip(table.rows, *columns.values(), exact, strict=True):
        source = cells[named].strip() if named is not None else f"{figures[0]:g} cd·m⁻²"
        rows.append(MeterRow(source, *figures))
    if len(rows) < 2:
        raise InputError(f"{path}: holds {len(rows)} reading; two of one source are the least that can disagree")
    middle = float(np.median([row.k_exact for row in rows]))
    if not _METER_CONSTANTS[0] < middle < _METER_CONSTANTS[1]:
        raise UnsettledError(
            f"{path}: K is {middle:.3g}, and that of meters is 10.6 to 13.4 (ISO 2720): a column has another unit than "
            "cd/m2, s and ISO; state it in the heading, such as luminance (fL) or time (ms)"
        )
    return tuple(rows)


def _column(table: TextTable, fact: str) -> list[float]:
    """Return a column in cd·m⁻², s or ISO, in the unit that its heading or its cells state."""
    at = table.find_fact(fact, _NAMES[fact])
    if at is None:
        raise InputError(f"{table.path}: no column {_NAMES[fact][0]!r}; the first line must name {_NEEDS}")
    return finite(table.values(at, fact, [], defined=_UNITS[fact]), table, at)
