"""A log of a camera under auto exposure and a reference meter: the columns, their units, and the nights."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from radiometer.data.reader_limits import bounded_reader
from radiometer.data.statements import UNKNOWN, StatementMap, Unknown
from radiometer.data.text_table import TextTable, read_table, stamp_s
from radiometer.errors import InputError, UnsettledError
from radiometer.moments import UNIX_S
from radiometer.typing import Array
from radiometer.units import CD_M2_AT_0_MAG, heading_parts, read_number, unit_of

_LEAST_MAG: Final = 1e-6  # 0 is no reading; the moonlit sky has 17
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

# Names of columns without their units, the best first.
_NAMES: Final[Mapping[str, tuple[str, ...]]] = {
    "value": ("value", "value_dn", "dn", "adu", "mean_adu", "mean", "mean_dn", "signal", "signal_dn",
              "counts", "adu_roi"),
    "exposure": ("exposure", "exptime", "exposure_time", "exp", "t"),
    "gain": ("gain", "iso"),
    "temperature": ("temperature", "temp", "sensor_temperature", "sensor_temp", "ccd_temp", "ccdtemp"),
    "timestamp": ("time", "timestamp", "datetime", "date_time", "utc", "utc_date_time", "createdate", "zeit", "date",
                  "datum"),
    "reference": ("reference", "sqm", "luminance", "radiance", "irradiance", "illuminance"),
    "colour": ("colour", "color", "b_v", "bv", "colour_index", "color_index", "cct", "cct_k", "colour_temperature_k"),
    "night": ("night", "session", "run", "day"),
    "black_level": ("black", "black_dn", "black_level_dn", "bias"),
    "u_reference": ("u_reference", "u_mag"),
}  # fmt: skip
_ZONE: Final = re.compile(r"(?!UTC?$|GMT$|ISO)[A-Z]{2,5}")  # of letters, such as CET or PST
_PROPORTIONAL: Final = ("luminance", "radiance", "irradiance", "illuminance")  # linear by their name, in any unit
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


@bounded_reader(error=InputError)
def read_log(
    path: Path, mapped: StatementMap | None = None, reference: Path | None = None, *, black_dn: float = 0.0
) -> LogTable:
    """Return the readings of a table.

    Args:
        path: CSV of the camera, the reference among its columns or in a separate file.
        mapped: Columns and units that the tables do not state.
        reference: File of the reference meter with its own times; the nearest readings are interpolated.
        black_dn: Black level in DN to take off, where the table has none.

    Raises:
        InputError: If columns are missing, a value is unusable, or the nights are too few.
        UnsettledError: If a unit is not stated.
    """
    known = mapped or StatementMap()
    table = read_table(path, _NEEDS, named=True)
    needed = ("value", "exposure", *(() if reference else ("reference",)))
    places = _places(table, known, needed, without=("reference",) if reference else ())
    table.refuse_mixed(list(places.values()))
    assumed: list[str] = []
    columns = {fact: _column(table, at, fact, known) for fact, at in places.items()}
    table, columns = _usable(table, columns, assumed)
    taken = [f"{_WORDS.get(fact, fact)} from {table.header[at]!r}" for fact, at in places.items()]
    taken += [f"not used: {line}" for line in table.not_used(list(places.values()))]
    found = _assembled(columns, black_dn, assumed)
    if reference is not None:
        meter = read_table(reference, "the times and readings of a reference meter", named=True)
        found, more = _joined_by_time(found, columns, table, meter, known)
        taken += more
    return _checked(replace(found, taken=tuple(taken)), path, assumed)


_WORDS: Final = {"timestamp": "time", "black_level": "black"}


def _places(
    table: TextTable, mapped: StatementMap, needed: Sequence[str], without: Sequence[str] = ()
) -> dict[str, int]:
    """Return the column of each fact. Raises InputError that names the option where a needed one is missing."""
    found = {
        fact: table.find_fact(fact, names, mapped, unit_alone=fact == "reference")
        for fact, names in _NAMES.items()
        if fact not in without
    }
    places = {fact: at for fact, at in found.items() if at is not None}
    missing = [fact for fact in needed if fact not in places]
    if missing:
        raise InputError(
            f"{table.path}: no column for {_WORDS.get(missing[0], missing[0])}; the table needs {_NEEDS}. It has "
            f"{', '.join(table.header)}: name the one with --map {missing[0]}=COLUMN:UNIT"
        )
    return places


@dataclass(frozen=True, slots=True, eq=False)
class _Column:
    """A column in the base unit of its quantity; cells of nights are text."""

    cells: list[Any]  # NaN where a number means "unknown"
    name: str  # its plain name
    unit: str = ""  # its unit as stated


def _column(table: TextTable, at: int, fact: str, mapped: StatementMap) -> _Column:
    name = table.plain[at]
    if fact == "night":
        return _Column([cells[at] for _, cells in table.rows], name)
    if fact == "timestamp" and _is_local(table.header[at]):
        raise UnsettledError(
            f"{table.path}: {table.header[at]!r} states a zone that its times do not: write them as "
            "2026-11-20T22:15:00+01:00, or in UTC"
        )
    stamped = fact == "timestamp" and any(_is_stamp(cells[at]) for _, cells in table.rows)
    written = [_read(table, line, cells[at], at, stamp_s if stamped else _number) for line, cells in table.rows]
    if stamped or fact in ("value", "colour", "black_level"):
        return _Column(written, name)
    is_stated = any(place.unit for place in mapped.places.get(fact, ()))
    if fact == "reference" and not is_stated and name in _PROPORTIONAL:
        return _Column(written, name, "linear")
    if fact == "timestamp" and not is_stated and all(UNIX_S[0] < one < UNIX_S[1] for one in written):
        return _Column(written, name)  # the documented form; as ms or days they would be before 1971 or after 5000
    if fact == "gain" and len(set(written)) == 1 and heading_parts(table.header[at], fact)[1] is None:
        return _Column([0.0] * len(written), name)  # a gain that never changes is part of the responsivity
    unit, unknown = table.unit(at, fact, mapped), UNKNOWN.get(fact, Unknown())
    base = [unit.to_base(one) for one in written]
    cells = [
        math.nan if own in unknown.numbers or not unknown.low <= one <= unknown.high else one
        for own, one in zip(written, base, strict=True)
    ]
    return _Column(cells, name, unit.name)


def _is_local(heading: str) -> bool:
    """Return whether a heading states another zone than UTC: in words, or in brackets as a unit would be."""
    _, unit, spelling = heading_parts(heading, "time")
    return "local" in heading.lower() or (unit is None and bool(_ZONE.fullmatch(spelling)))


def _is_stamp(cell: str) -> bool:
    return bool(re.search(r"[:T]|\d-\d", cell))


def _read(table: TextTable, line: int, cell: str, at: int, read: Callable[[str], float]) -> float:
    try:
        return read(cell)
    except (ValueError, IndexError, ZeroDivisionError) as error:
        raise InputError(
            f"{table.where(line)}: {table.header[at]}: {error}; leave the row out, or correct it"
        ) from error


def _usable(
    table: TextTable, columns: Mapping[str, _Column], assumed: list[str]
) -> tuple[TextTable, dict[str, _Column]]:
    """Return the rows whose values are known and not saturated, and their cells.

    A meter writes 0 or 99.99 mag/arcsec² where it has no reading, and −999 or the like where a temperature is unknown.
    """
    value = np.array(columns["value"].cells, dtype=np.float64)
    top = float(value.max(initial=0.0))
    full = top in {2.0**bits - 1.0 for bits in _SATURATED_FROM_BITS} and np.count_nonzero(value == top) > 1
    reasons = {f"{top:g} DN is saturated": (value == top) & full}
    meter = columns.get("reference")
    if meter is not None and _is_magnitude(meter.unit):
        reasons[f"a reference of {_NO_READING}"] = ~_is_reading(np.array(meter.cells, dtype=np.float64))
    for fact in ("exposure", "gain", "temperature"):
        if fact in columns:
            reasons[f"the {fact} is unknown"] = np.isnan(np.array(columns[fact].cells, dtype=np.float64))
    out = np.zeros(value.size, dtype=np.bool_)
    for reason, there in reasons.items():
        if there.any():
            assumed.append(f"{np.count_nonzero(there)} rows are left out: {reason}")
        out |= there
    kept = np.flatnonzero(~out)
    if not kept.size:
        raise InputError(f"{table.path}: no row can be used: {'; '.join(assumed)}; look at the units of the columns")
    return (
        replace(table, rows=tuple(table.rows[n] for n in kept)),
        {fact: replace(one, cells=[one.cells[n] for n in kept]) for fact, one in columns.items()},
    )


def _is_magnitude(unit: str) -> bool:
    found = unit_of(unit, "reference")
    return found is not None and found.to_base(2.5) != 2.5 * found.to_base(1.0)  # logarithms are not proportional


def _is_reading(luminance_cd_m2: Array) -> NDArray[np.bool_]:
    """Return which readings of a sky meter are any: above 0 mag/arcsec² and below the darkest sky."""
    with np.errstate(divide="ignore"):  # of 999 mag nothing remains
        magnitudes = -2.5 * np.log10(luminance_cd_m2 / CD_M2_AT_0_MAG)
    return np.asarray((magnitudes > _LEAST_MAG) & (magnitudes <= _DARKEST_MAG))


def _number(text: str) -> float:
    value, unit = read_number(text)
    if unit:
        raise ValueError(f"{text!r} has a unit in the cell; state it in the name of the column")
    return value


def _assembled(columns: Mapping[str, _Column], black_dn: float, assumed: list[str]) -> LogTable:
    def column(fact: str) -> Array | None:
        return np.array(columns[fact].cells, dtype=np.float64) if fact in columns else None

    black, value = column("black_level"), np.array(columns["value"].cells, dtype=np.float64)
    value = value - (black_dn if black is None else black)
    gain_db = column("gain")
    reference, unit = np.ones(value.size), "1"
    if "reference" in columns:
        reference, unit = np.array(columns["reference"].cells, dtype=np.float64), _linear_unit(columns, assumed)
    colour, kind = column("colour"), columns["colour"].name if "colour" in columns else ""
    warm = "cct" in kind or "temperature" in kind
    times = column("timestamp")
    night = _nights(columns["night"].cells if "night" in columns else None, times, value.size, assumed)
    return LogTable(
        value, np.array(columns["exposure"].cells, dtype=np.float64),
        np.zeros(value.size) if gain_db is None else gain_db, reference, night,
        None if times is None else times - times.min(), column("temperature"),
        1e6 / colour if colour is not None and warm else colour, column("u_reference"),
        assumptions=tuple(assumed), units={"reference": unit, "colour": "mired" if warm else "1"},
    )  # fmt: skip


def _linear_unit(columns: Mapping[str, _Column], assumed: list[str]) -> str:
    """Return the unit in which a reference is kept; magnitudes per square arcsecond have become cd·m⁻²."""
    unit = columns["reference"].unit
    if _is_magnitude(unit):
        assumed.append("magnitudes per square arcsecond m are 10.8e4·10^(−0.4·m) cd·m⁻² (Unihedron)")
        return "cd m-2"
    if unit_of(unit, "luminance") is not None:
        return "cd m-2"
    return "lx" if unit.lower() in ("lx", "lux", "klx") else "as written"


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
    log: LogTable, columns: Mapping[str, _Column], own: TextTable, other: TextTable, mapped: StatementMap
) -> tuple[LogTable, list[str]]:
    """Return the log with a reference from a separate file, interpolated in time, without rows that have none."""
    if log.time_s is None:
        raise InputError(
            f"{own.path}: has no column of times, so {other.path} cannot be matched to it; name it with "
            "--map timestamp=COLUMN"
        )
    places = _places(other, _known_there(other, mapped), ("timestamp", "reference"))
    meter, stamps = (_column(other, places[fact], fact, mapped) for fact in ("reference", "timestamp"))
    assumed: list[str] = []
    values = np.array(meter.cells, dtype=np.float64)
    read = _is_reading(values) if _is_magnitude(meter.unit) else np.ones(values.size, dtype=np.bool_)
    if not read.all():
        assumed.append(f"{int((~read).sum())} readings of {other.path.name} are left out: {_NO_READING}")
    unit = _linear_unit({"reference": meter}, assumed)
    values, times = values[read], np.array(stamps.cells, dtype=np.float64)[read]
    order = np.argsort(times)
    times, values = times[order], values[order]
    needed = np.array(columns["timestamp"].cells, dtype=np.float64)
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
        f"{_WORDS.get(fact, fact)} from {other.header[places[fact]]!r} of {other.path.name}"
        for fact in ("timestamp", "reference")
    ]
    more = (*log.assumptions, *assumed, *([f"{int((~near).sum())} rows without a reference at their time are left out"]
            if not near.all() else []))  # fmt: skip
    units = {**(log.units or {}), "reference": unit}
    return replace(replace(log, reference=there, units=units).take(near), assumptions=more), lines


def _known_there(other: TextTable, mapped: StatementMap) -> StatementMap:
    """Return a map whose places of the camera's table are not demanded of the meter's."""
    return replace(mapped, demanded=mapped.demanded & {"reference"})


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
