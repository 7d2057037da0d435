"""Tables of light: the readings of a light meter, and a light engine's light at every drive tested."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from radiometer.data.reader_limits import bounded_reader
from radiometer.data.text_table import TextTable, finite, read_export, read_table
from radiometer.errors import InputError, UnsettledError
from radiometer.typing import Array
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


_CHANNELS: Final = ("primary", "channel", "led", "primaries", "colour", "color")
_DRIVES: Final = ("setting", "drive", "level", "duty", "current_ma", "current", "dac", "input")
_LIGHTS: Final = ("light", "radiance", "luminance", "irradiance", "illuminance", "flux", "power", "reading", "counts",
                  "signal", "lux", "cd_m2")  # fmt: skip
_NEEDS_OF_DRIVES: Final = (
    "a drive (setting, level), the light (one column, or one per wavelength in nm) and perhaps a channel"
)
_WAVELENGTH: Final = re.compile(r"([,;\t]\s*)(\d+(?:\.\d+)?)(?=\s*(?:[,;\t\r]|$))")
_IN_NM: Final = re.compile(r"(?:nm)?\s*(\d+(?:\.\d+)?)\s*(?:nm)?")
_WAVELENGTHS_NM: Final = (150.0, 3000.0)  # headings that are numbers within it are wavelengths
_FEWEST_BANDS: Final = 5  # fewer numbers as headings are no spectrum
_MOST_BELOW_ZERO: Final = 0.01  # of the most light: what noise and zero of a meter may be below it
_FEWEST: Final = 6  # drives above 0 of a channel: a law of three parameters and some residuals


@dataclass(frozen=True, slots=True, eq=False)
class ChannelDrive:
    """One channel: drive over the largest of the table, light, and what the meter's range follows; shape (n,)."""

    name: str
    drive: Array
    light: Array
    reading: Array


@dataclass(frozen=True, slots=True)
class DriveTable:
    """Channels of a light engine, and how the table was read."""

    channels: tuple[ChannelDrive, ...]
    taken: tuple[str, ...]
    full: float  # its largest drive, in its own unit


def is_drive_table(path: Path) -> bool:
    """Return whether a CSV has a column of drives and one or more of light. Raises InputError if it is no table."""
    return _columns(_table(path)) is not None


@bounded_reader(error=InputError)
def read_drive_table(path: Path) -> DriveTable:
    """Return the channels of a table.

    Light at drive 0, where the table has it, is taken off. The reading that a meter's range follows is the light, or
    the largest value of a spectrum. Raises InputError if a column is missing, a value is no number, or a channel has
    fewer than six lit drives.
    """
    table = _table(path)
    columns = _columns(table)
    if columns is None:
        shown = f"its columns are {', '.join(table.header[:6])}" if table.header else "no line names its columns"
        raise InputError(f"{path}: {shown}; it needs {_NEEDS_OF_DRIVES}")
    channel, drive, lights = columns
    names = [row[channel].strip() if channel is not None else "light" for _, row in table.rows]
    settings = np.array(table.numbers(drive))
    values = np.array([table.numbers(at) for at in lights]).T
    top = float(settings.max())
    if settings.min() < 0.0 or top <= 0.0:
        raise InputError(f"{path}: drives go from {settings.min():g} to {top:g}; expected 0 and above")
    found = tuple(_channel(path, one, names, settings / top, values) for one in dict.fromkeys(names))
    dark = [
        f"{one.name}: no light at drive {', '.join(f'{top * at:g}' for at in one.drive[one.light <= 0.0])}: left out"
        for one in found
        if np.any(one.light <= 0.0)
    ]
    kind = f"sum of {len(lights)} wavelengths" if len(lights) > 1 else f"column {table.header[lights[0]]!r}"
    taken = (f"light: {kind}", f"drive: column {table.header[drive]!r} over its largest value {top:g}")
    return DriveTable(found, (*taken, *dark), top)


def _table(path: Path) -> TextTable:
    """Return a table; its wavelengths, which are numbers, count as names of columns."""
    first, end, rest = read_export(path).partition("\n")
    if first[:1].isalpha():
        first = _WAVELENGTH.sub(r"\1nm\2", first)
    return read_table(path, _NEEDS_OF_DRIVES, first + end + rest)


def _channel(path: Path, name: str, names: Sequence[str], drive: Array, values: Array) -> ChannelDrive:
    own = np.array([one == name for one in names])
    dark, lit = own & (drive == 0.0), own & (drive > 0.0)
    if int(lit.sum()) < _FEWEST:
        raise InputError(f"{path}: channel {name} has {int(lit.sum())} drives above 0; measure {_FEWEST} or more")
    net = values[lit] - (values[dark].mean(axis=0) if dark.any() else 0.0)
    least, most = float(values[lit].min()), float(values[lit].max())
    if least < -_MOST_BELOW_ZERO * abs(most):
        raise InputError(f"{path}: channel {name} has the light {least:g}; no light is below 0: correct the row")
    order = np.argsort(drive[lit], kind="stable")
    light = net.sum(axis=1)[order]
    return ChannelDrive(name, drive[lit][order], light, net.max(axis=1)[order])


def _columns(table: TextTable) -> tuple[int | None, int, tuple[int, ...]] | None:
    """Return the columns of channel, drive and light; None where the last two are not there."""
    drive = table.find(_DRIVES)
    if drive is None:
        return None
    bands = tuple(n for n, name in enumerate(table.header) if n != drive and _is_wavelength(name))
    if len(bands) >= _FEWEST_BANDS:
        return table.find(_CHANNELS), drive, bands
    light = next((n for n, name in enumerate(table.plain) if n != drive and name.startswith(_LIGHTS)), None)
    return None if light is None else (table.find(_CHANNELS), drive, (light,))


def _is_wavelength(name: str) -> bool:
    stated = _IN_NM.fullmatch(name.lower())
    return stated is not None and _WAVELENGTHS_NM[0] <= float(stated[1]) <= _WAVELENGTHS_NM[1]
