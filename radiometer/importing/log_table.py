"""A log of a camera under auto exposure and a reference meter: the columns, their units, and the nights."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from radiometer.data.reader_limits import bounded_reader
from radiometer.data.statements import UNKNOWN
from radiometer.data.text_table import TextTable, read_table, stamp_s
from radiometer.errors import InputError, UnsettledError, UsageError
from radiometer.typing import Array
from radiometer.units import heading_parts, read_number, unit_of

CD_M2_AT_0_MAG: Final = 10.8e4
"""Luminance in cd·m⁻² of 0 mag/arcsec².

Source: Unihedron, "Convert visual mags/arcsecond² to cd/m²" (unihedron.com/projects/darksky/magconv.php): after
discussions of 2005, uncertain by at least 1 %; a constant factor, which the camera's responsivity takes up here.
"""
_MAGNITUDES: Final = ("mag", "sqm", "mpsas", "msas")
_DARKEST_MAG: Final = 30.0  # per arcsec²: the darkest sky has 22, the noise of meters 25
_NO_READING: Final = f"0 or above {_DARKEST_MAG:g} mag is no reading"
_GAP_S: Final = 3.0 * 3600.0  # without a reading: another night
_DAY_S: Final = 86400.0  # a day
_APART_S: Final = 300.0  # by which readings of a reference in a separate file may differ in time from the camera's
_FEWEST_NIGHTS: Final = 3  # one is held out, and two show what repeats
_FEWEST_ROWS: Final = 12  # fewer fit any model of a log
_MOST_PER_NIGHT: Final = 300  # evenly thinned: more are correlated and only cost time
_NEEDS: Final = (
    "a camera's value, its exposure and a reference (gain, temperature, time and colour where there are any)"
)

_ALIASES: Final[Mapping[str, tuple[str, ...]]] = {
    "value": ("value", "value_dn", "dn", "adu", "mean_adu", "mean", "mean_dn", "signal", "signal_dn",
              "counts", "adu_roi"),
    "exposure": (
        "exposure_s", "exposure", "exptime", "exposure_time_s", "exposure_time", "exp", "exposure_ms",
        "exposure_us", "t_s",
    ),
    "gain": ("gain_db", "gain_x", "gain_linear", "gain_01db", "gain", "iso"),
    "temperature": (
        "temperature_c", "temperature", "temp", "temp_c", "sensor_temperature_c", "sensor_temp", "ccd_temp", "ccdtemp",
    ),
    "time": ("time", "timestamp", "time_s", "timestamp_s", "datetime", "date_time", "utc", "utc_date_time",
             "createdate", "zeit", "date", "datum"),
    "reference": (
        "reference", "reference_mag", "mag_arcsec2", "mpsas", "sqm_mag", "msas", "reference_cd_m2", "luminance_cd_m2",
        "luminance", "cd_m2", "mcd_m2", "lux", "radiance", "irradiance", "sqm",
    ),
    "colour": ("colour", "color", "b_v", "bv", "colour_index", "color_index", "cct", "cct_k", "colour_temperature_k"),
    "night": ("night", "session", "run", "day"),
    "black": ("black", "black_dn", "black_level_dn", "bias"),
    "u_reference": ("u_reference", "u_reference_rel", "u_mag"),
}  # fmt: skip
_TEXT: Final = ("night",)
_WITH_UNITS: Final = ("exposure", "gain", "temperature")
_SATURATED_FROM_BITS: Final = range(8, 17)  # converters whose highest code the values may end at


@dataclass(frozen=True, slots=True, eq=False)
class LogTable:
    """Readings of a camera and a reference meter; arrays of one entry per reading."""

    value: Array  # camera value in DN, the stated black level taken off
    exposure_s: Array  # exposure time in s
    gain_db: Array  # gain in dB; zeros where none is stated
    reference: Array  # reference in a linear unit
    night: NDArray[np.intp]  # number of the night, from 0
    time_s: Array | None = None  # time in s from the first reading; None where unknown
    temperature_c: Array | None = None  # sensor temperature in °C; None where unknown
    colour: Array | None = None  # colour as it was written (mired for a colour temperature); None where unknown
    u_reference_rel: Array | None = None  # relative standard uncertainty of the reference; zeros where none is stated
    taken: tuple[str, ...] = ()  # what was taken from which column, in words
    assumptions: tuple[str, ...] = ()  # what was assumed, in words
    units: Mapping[str, str] | None = None  # unit of "reference" and of "colour"

    @property
    def size(self) -> int:
        """Return the number of readings."""
        return int(self.value.size)

    @property
    def nights(self) -> int:
        """Return the number of nights."""
        return int(self.night.max()) + 1

    def take(self, rows: NDArray[Any]) -> LogTable:
        """Return some of the rows."""
        arrays = {n: v[rows] for n in self.__slots__ if isinstance(v := getattr(self, n), np.ndarray)}
        return replace(self, **arrays)


@dataclass(frozen=True, slots=True)
class LogColumns:
    """What is stated of the columns in addition to their names."""

    # Column by quantity ("value", "reference", …), where the names do not state it
    chosen: Mapping[str, str] | None = None
    gain_unit: str | None = None  # "db", "x", "0.1db" or "iso"; None where the column's name states it
    black_dn: float = 0.0  # black level in DN to take off


@bounded_reader(error=InputError)
def read_log(path: Path, stated: LogColumns | None = None, reference: Path | None = None) -> LogTable:
    """Return the readings of a table.

    Args:
        path: CSV of the camera, the reference among its columns or in a separate file.
        reference: File of the reference meter with its own times; the nearest readings are interpolated.

    Raises:
        InputError: If columns are missing, a value is unusable, or the nights are too few.
    """
    stated = stated or LogColumns()
    table = read_table(path, _NEEDS, named=True)
    places = _places(table, stated, needed=("value", "exposure", *(() if reference else ("reference",))))
    if reference is not None:
        places.pop("reference", None)
    assumed: list[str] = []
    columns = {key: _cells(table, at, key) for key, at in places.items()}
    table, columns = _usable(table, places, columns, assumed)
    taken = [f"{key} from {table.header[at]!r}" for key, at in places.items()]
    taken += [f"not used: {line}" for line in table.not_used(list(places.values()))]
    found = _assembled(table, places, columns, stated, assumed)
    if reference is not None:
        found, more = _joined_by_time(
            found, columns, table, read_table(reference, "the times and readings of a reference meter", named=True)
        )
        taken += more
    return _checked(replace(found, taken=tuple(taken)), path, assumed)


def _places(table: TextTable, stated: LogColumns, needed: Sequence[str]) -> dict[str, int]:
    chosen, places = dict(stated.chosen or {}), dict[str, int]()
    for key, names in _ALIASES.items():
        if key in chosen:
            if chosen[key] not in table.header:
                raise UsageError(f"{table.path}: no column {chosen[key]!r}; it has {', '.join(table.header)}")
            places[key] = table.header.index(chosen[key])
        else:
            at = table.find([n for n in names if not _is_taken(table, n, chosen)])
            at = _with_unit(table, key, names) if at is None else at
            if at is not None:
                places[key] = at
    missing = [key for key in needed if key not in places]
    if missing:
        raise InputError(
            f"{table.path}: no column for {missing[0]}; the table needs {_NEEDS}. It has {', '.join(table.header)}: "
            f"name the one with --{missing[0]} COLUMN"
        )
    return places


def _with_unit(table: TextTable, key: str, names: Sequence[str]) -> int | None:
    """Return the one column of a name with any unit behind it, such as `temp (F)`; None where there is none."""
    if key not in _WITH_UNITS:
        return None
    bare = [heading_parts(heading, key)[0] for heading in table.header]
    at = [n for n, name in enumerate(bare) if name in names]
    return at[0] if len(at) == 1 else None


def _is_taken(table: TextTable, name: str, chosen: Mapping[str, str]) -> bool:
    return name in table.plain and table.header[table.plain.index(name)] in chosen.values()


def _cells(table: TextTable, at: int, key: str) -> list[Any]:
    read: Callable[[str], Any] = str if key in _TEXT else stamp_s if key == "time" else _number
    found = []
    for line, cells in table.rows:
        try:
            found.append(read(cells[at]))
        except (ValueError, IndexError, ZeroDivisionError) as error:
            raise InputError(
                f"{table.where(line)}: {table.header[at]}: {error}; leave the row out, or correct it"
            ) from error
    return found


def _usable(
    table: TextTable, places: Mapping[str, int], columns: Mapping[str, list[Any]], assumed: list[str]
) -> tuple[TextTable, dict[str, list[Any]]]:
    """Return the rows whose values are known and not saturated, and their cells.

    A meter writes 0 or 99.99 mag/arcsec² where it has no reading, and −999 or the like where a temperature is unknown.
    """
    value = np.array(columns["value"], dtype=np.float64)
    top = float(value.max(initial=0.0))
    full = top in {2.0**bits - 1.0 for bits in _SATURATED_FROM_BITS} and np.count_nonzero(value == top) > 1
    reasons = {f"{top:g} DN is saturated": (value == top) & full}
    if "reference" in columns and any(sign in table.plain[places["reference"]] for sign in _MAGNITUDES):
        reasons[f"a reference of {_NO_READING}"] = ~_is_reading(np.array(columns["reference"], dtype=np.float64))
    for key in ("exposure", "gain", "temperature"):
        if key in columns:
            written, known = np.array(columns[key], dtype=np.float64), UNKNOWN[key]
            unit = heading_parts(table.header[places[key]], key)[1]
            base = written if unit is None else np.array([unit.to_base(one) for one in written])
            is_word = np.isin(written, list(known.numbers))
            beyond = (base < known.low) | (base > known.high)
            # Steps of a gain may be any numbers; without a unit exposures are in s, temperatures in °C.
            reasons[f"the {key} is unknown"] = is_word | (beyond & (unit is not None or key != "gain"))
    out = np.zeros(value.size, dtype=np.bool_)
    for reason, there in reasons.items():
        if there.any():
            assumed.append(f"{np.count_nonzero(there)} rows are left out: {reason}")
        out |= there
    kept = np.flatnonzero(~out)
    return (
        replace(table, rows=tuple(table.rows[n] for n in kept)),
        {key: [cells[n] for n in kept] for key, cells in columns.items()},
    )


def _is_reading(magnitudes: Array) -> NDArray[np.bool_]:
    return np.asarray((magnitudes > 0.0) & (magnitudes <= _DARKEST_MAG))


def _degrees(table: TextTable, places: Mapping[str, int]) -> tuple[float, float]:
    """Return factor and offset from the temperature's unit into °C, which a heading without a unit means."""
    unit = heading_parts(table.header[places["temperature"]], "temperature")[1]
    return (1.0, 0.0) if unit is None else (unit.to_base(1.0) - unit.to_base(0.0), unit.to_base(0.0))


def _number(text: str) -> float:
    value, unit = read_number(text)
    if unit:
        raise ValueError(f"{text!r} has a unit in the cell; state it in the name of the column")
    return value


def _assembled(
    table: TextTable,
    places: Mapping[str, int],
    columns: Mapping[str, list[Any]],
    stated: LogColumns,
    assumed: list[str],
) -> LogTable:
    def column(key: str) -> Array | None:
        return np.array(columns[key], dtype=np.float64) if key in columns else None

    name = {key: table.plain[at] for key, at in places.items()}
    seconds = heading_parts(table.header[places["exposure"]], "exposure")[1]
    if seconds is None:
        assumed.append(f"the exposure {table.header[places['exposure']]!r} has no unit: s is assumed")
    black = column("black")
    value = np.array(columns["value"], dtype=np.float64) - (stated.black_dn if black is None else black)
    exposure = np.array(columns["exposure"], dtype=np.float64) * (seconds.to_base(1.0) if seconds else 1.0)
    gain = column("gain")
    gain_db = (
        np.zeros(value.size)
        if gain is None
        else _decibels(gain, table.header[places["gain"]], stated.gain_unit, table.path)
    )
    reference, unit = (np.ones(value.size), "1")
    if "reference" in columns:
        reference, unit = linear(np.array(columns["reference"], dtype=np.float64), name["reference"], assumed)
    colour = column("colour")
    if colour is not None and ("cct" in name["colour"] or "temperature" in name["colour"]):
        colour = 1e6 / colour
    celsius = column("temperature")
    if celsius is not None:
        factor, offset_c = _degrees(table, places)
        celsius = celsius * factor + offset_c
    times = column("time")
    night = _nights(columns.get("night"), times, value.size, assumed)
    own = column("u_reference")
    if own is not None and "mag" in name["u_reference"]:
        own = own * 0.4 * math.log(10.0)
    return LogTable(
        value, exposure, gain_db, reference, night,
        None if times is None else times - times.min(), celsius, colour, own,
        assumptions=tuple(assumed), units={"reference": unit, "colour": _colour_unit(name.get("colour", ""))},
    )  # fmt: skip


def _colour_unit(name: str) -> str:
    return "mired" if "cct" in name or "temperature" in name else "1"


def _decibels(gain: Array, heading: str, chosen: str | None, path: Path) -> Array:
    """Return gains in dB by the unit that the user or the heading states; a gain that never changes counts as 0 dB."""
    unit = unit_of(chosen, "gain") if chosen else heading_parts(heading, "gain")[1]
    if chosen and unit is None:
        raise UsageError(f"--gain-unit {chosen}: choose db, 0.1db, x or iso")
    if unit is None:
        if np.ptp(gain) == 0:
            return np.zeros_like(gain)
        raise UnsettledError(f"{path}: the gain {heading!r} has no unit; say --gain-unit db, 0.1db, x or iso")
    found = np.array([unit.to_base(float(value)) for value in gain])
    if not np.isfinite(found).all():
        raise InputError(f"a gain of {gain.min():g} is no factor; say --gain-unit db or 0.1db")
    return found


def linear(reference: Array, name: str, assumed: list[str]) -> tuple[Array, str]:
    """Return a reference in a linear unit, and the unit; magnitudes per square arcsecond become cd·m⁻².

    Args:
        assumed: Lines to which is added what was assumed.
    """
    if any(sign in name for sign in _MAGNITUDES):
        assumed.append("magnitudes per square arcsecond m are 10.8e4·10^(−0.4·m) cd·m⁻² (Unihedron)")
        return np.asarray(CD_M2_AT_0_MAG * 10.0 ** (-0.4 * reference)), "cd m-2"
    for sign, unit in (
        ("mcd_m2", "mcd m-2"), ("kcd_m2", "kcd m-2"), ("cd_m2", "cd m-2"), ("luminance", "cd m-2"), ("lux", "lx"),
    ):  # fmt: skip
        if sign in name:
            return reference, unit
    return reference, "as written"


def _nights(names: Sequence[str] | None, times: Array | None, size: int, assumed: list[str]) -> NDArray[np.intp]:
    if names is not None:
        order = {name: i for i, name in enumerate(dict.fromkeys(names))}
        return np.array([order[name] for name in names], dtype=np.intp)
    if times is None:
        assumed.append("no column states a time: the rows are taken as five nights one after the other")
        return np.asarray(np.arange(size) * 5 // max(size, 1), dtype=np.intp)
    order_of = np.argsort(times, kind="stable")
    breaks = np.diff(times[order_of]) > _GAP_S
    if not breaks.any() and np.ptp(times) > _DAY_S:
        assumed.append("there is no gap of 3 hours between readings: nights are split at noon UTC")
        days = np.floor(times / _DAY_S - 0.5)
        return np.asarray(np.unique(days, return_inverse=True)[1], dtype=np.intp)
    numbers = np.empty(size, dtype=np.intp)
    numbers[order_of] = np.concatenate([[0], np.cumsum(breaks)])
    return numbers


def _joined_by_time(
    log: LogTable, columns: Mapping[str, list[Any]], own: TextTable, other: TextTable
) -> tuple[LogTable, list[str]]:
    """Return the log with a reference from a separate file, interpolated in time, without rows that have none."""
    if log.time_s is None:
        raise InputError(
            f"{own.path}: has no column of times, so {other.path} cannot be matched to it; name it with --time"
        )
    places = _places(other, LogColumns(), needed=("time", "reference"))
    assumed: list[str] = []
    written = np.array(_cells(other, places["reference"], "reference"), dtype=np.float64)
    name = other.plain[places["reference"]]
    read = _is_reading(written) if any(sign in name for sign in _MAGNITUDES) else np.ones(written.size, dtype=np.bool_)
    if not read.all():
        assumed.append(f"{int((~read).sum())} readings of {other.path.name} are left out: {_NO_READING}")
    values, unit = linear(written[read], name, assumed)
    times = np.array(_cells(other, places["time"], "time"), dtype=np.float64)[read]
    order = np.argsort(times)
    times, values = times[order], values[order]
    needed = np.array(columns["time"], dtype=np.float64)
    after = np.clip(np.searchsorted(times, needed), 1, times.size - 1) if times.size > 1 else np.zeros(needed.size, int)
    near = np.minimum(np.abs(times[after] - needed), np.abs(times[after - 1] - needed)) <= _APART_S
    if not near.any():
        raise InputError(
            f"{other.path}: none of its times is within {_APART_S:g} s of the camera's; check that both are in UTC"
        )
    if (values <= 0).any():
        raise InputError(f"{other.path}: a reference of {values.min():g} is no light; leave such rows out")
    there = np.exp(np.interp(needed, times, np.log(values)))
    lines = [
        f"{key} from {other.header[at]!r} of {other.path.name}"
        for key, at in places.items()
        if key in ("time", "reference")
    ]
    more = (*log.assumptions, *assumed, *([f"{int((~near).sum())} rows without a reference at their time are left out"]
            if not near.all() else []))  # fmt: skip
    units = {**(log.units or {}), "reference": unit}
    return replace(replace(log, reference=there, units=units).take(near), assumptions=more), lines


def _checked(log: LogTable, path: Path, assumed: list[str]) -> LogTable:
    for name, values, unit in (("value above black", log.value, "DN"), ("exposure", log.exposure_s, "s"),
                               ("reference", log.reference, "")):  # fmt: skip
        if not (np.isfinite(values).all() and (values > 0).all()):
            bad = int(np.flatnonzero(~(np.isfinite(values) & (values > 0)))[0])
            raise InputError(
                f"{path}: reading {bad + 1}: a {name} of {values[bad]:g} {unit} has no logarithm; leave it out"
            )
    for name in ("temperature_c", "colour", "gain_db"):
        column = getattr(log, name)
        if column is not None and not np.isfinite(column).all():
            raise InputError(f"{path}: {name} is missing in some rows; leave them or the column out")
    numbers = np.asarray(np.unique(log.night, return_inverse=True)[1], dtype=np.intp)
    log = replace(log, night=numbers)
    if log.size < _FEWEST_ROWS or log.nights < _FEWEST_NIGHTS:
        raise InputError(
            f"{path}: {log.size} readings of {log.nights} nights; at least {_FEWEST_ROWS} of {_FEWEST_NIGHTS} are "
            "needed, for each night is predicted from the others"
        )
    return _thinned(log)


def _thinned(log: LogTable) -> LogTable:
    """Return at most so many readings per night, evenly taken."""
    rows = [np.flatnonzero(log.night == night) for night in range(log.nights)]
    if max(map(len, rows)) <= _MOST_PER_NIGHT:
        return log
    kept = [r[np.unique(np.linspace(0, r.size - 1, min(r.size, _MOST_PER_NIGHT)).astype(int))] for r in rows]
    line = f"of nights with more than {_MOST_PER_NIGHT} readings so many are taken, evenly"
    return replace(log.take(np.sort(np.concatenate(kept))), assumptions=(*log.assumptions, line))
