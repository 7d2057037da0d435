"""Reconciles a light-meter table: is K constant, and if not, is it the rounding of printed stops?

The meter equation N²/t = L·S/K gives K for every row. Rows of one source must agree; where printed stops were taken
at face value they scatter by up to a tenth, and with the exact stops behind them they do not.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from radiometer.data.reader_limits import bounded_reader
from radiometer.data.storage import write_text_atomic, write_yaml_atomic
from radiometer.data.text_table import TextTable, finite, read_table
from radiometer.errors import InputError
from radiometer.reconciliation.result import FittedParameter, FoundEffect, Limit, ReconcileResult, Verdict
from radiometer.reporting.origin import Origin
from radiometer.reporting.page import page, paragraph, table
from radiometer.typing import Array
from radiometer.units import exact_exposure_s, exact_f_number

_GAP_UNIT: Final = "standard deviation of ln K within a source"
_COINCIDENCE: Final = 2e-3  # rows that agree to this, though printed values scatter by more, are no chance
_STEP_OF_A_METER: Final = math.log(2.0) / 3.0  # meters and cameras run in thirds of a stop
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
    """One reading: luminance in cd·m⁻², printed f-number and time in s, ISO speed, and the source's name."""

    source: str
    luminance_cd_m2: float
    f_number: float
    time_s: float
    iso: float

    @property
    def k_printed(self) -> float:
        """Return the meter constant from the printed values."""
        return self.luminance_cd_m2 * self.time_s * self.iso / self.f_number**2

    @property
    def k_exact(self) -> float:
        """Return the meter constant from the exact stops behind them."""
        time_s, f_number = exact_exposure_s(self.time_s), exact_f_number(self.f_number)
        return self.luminance_cd_m2 * time_s * self.iso / f_number**2


@dataclass(frozen=True, slots=True)
class MeterReconciled:
    """The result for a light-meter table, with its rows."""

    result: ReconcileResult
    rows: tuple[MeterRow, ...]
    origin: str

    def write_model(self, path: Path, *, provisional: bool = False) -> str:
        """Write what was found; a light meter is no camera, so the file holds the effect and the constants only."""
        constants = {name: float(np.exp(np.mean(np.log(k)))) for name, k in _by_source(self.rows, exact=True).items()}
        effects = [{"name": effect.name, "enabled": True, "parameters": {}} for effect in self.result.effects]
        mapping = {"format": "radiometer-light-meter/1", "meter_constant_K": constants, "effects": effects}
        write_yaml_atomic(path, mapping)
        return str(path)

    def write_report(self, path: Path) -> str:
        """Write the table with K from printed and from exact stops as HTML."""
        rows = [
            (row.source, f"{row.luminance_cd_m2:g}", f"{row.f_number:g}", f"{row.time_s:.6g}", f"{row.k_printed:.4f}",
             f"{row.k_exact:.4f}")
            for row in self.rows
        ]  # fmt: skip
        head = ("source", "luminance in cd·m⁻²", "f-number", "time in s", "K as printed", "K of exact stops")
        parts = [*(paragraph(text) for text in self.result.extra.get("remarks", [])), table(head, rows)]
        outcome = f"Verdict: {self.result.verdict}."
        origin = Origin("", further=(("table", self.origin),))
        write_text_atomic(path, page("Readings of a light meter", outcome, parts, kind="reconcile", origin=origin))
        return str(path)

    def write_plan(self, path: Path) -> bool:
        """Write nothing: a light meter is read by hand; the remarks say which readings would help."""
        return False


@bounded_reader(error=InputError)
def read_meter_table(path: Path) -> tuple[MeterRow, ...]:
    """Return the rows of a CSV with columns luminance, f_number, time (1/125 or s) and iso, and maybe a source's name.

    Raises:
        InputError: If a column is missing or a value is no positive number; the message gives the line.
    """
    table = read_table(path, f"the columns {_NEEDS}", named=True)
    columns = {fact: _column(table, fact) for fact in _NAMES}
    named = next(
        (i for i, name in enumerate(table.plain) if name in ("screen", "source", "scene", "target", "name")), None
    )
    rows = []
    for (line, cells), *figures in zip(table.rows, *columns.values(), strict=True):
        if min(figures) <= 0:
            raise InputError(f"{table.where(line)}: expected positive numbers, times as 0.004 or 1/250")
        source = cells[named].strip() if named is not None else f"{figures[0]:g} cd·m⁻²"
        rows.append(MeterRow(source, *figures))
    if len(rows) < 2:
        raise InputError(f"{path}: holds {len(rows)} reading; two of one source are the least that can disagree")
    return tuple(rows)


def reconcile_meter_table(path: Path) -> MeterReconciled:
    """Return whether the readings agree, and whether the rounding of printed stops is why not."""
    begun = time.monotonic()
    rows = read_meter_table(path)
    result = _judge(rows)
    return MeterReconciled(_timed(result, begun), rows, str(path))


def _timed(result: ReconcileResult, begun: float) -> ReconcileResult:
    return replace(result, seconds=time.monotonic() - begun)


def _judge(rows: Sequence[MeterRow]) -> ReconcileResult:
    printed, exact = _spread(_by_source(rows, exact=False)), _spread(_by_source(rows, exact=True))
    widest = min(exact_f_number(row.f_number) for row in rows)
    closed = [row for row in rows if exact_f_number(row.f_number) > widest]
    inner_printed = _spread(_by_source(closed, exact=False))
    inner_exact = _spread(_by_source(closed, exact=True))
    by_rounding = (inner_exact < _COINCIDENCE < inner_printed) or (exact < _COINCIDENCE < printed)
    rest = _rest(rows, widest)
    effects: tuple[FoundEffect, ...] = ()
    verdict = Verdict.AGREES if printed < _COINCIDENCE else Verdict.UNNAMED
    remarks: list[str] = []
    if by_rounding:
        before, after = (inner_printed, inner_exact) if inner_exact < _COINCIDENCE else (printed, exact)
        effects = (_nominal(before, after),)
        verdict = Verdict.EFFECTS_FOUND if abs(rest) <= _STEP_OF_A_METER / 2 * 1.01 else Verdict.INCOMPLETE
        remarks.append(_rounding_in_words(before, after, widest if inner_exact < _COINCIDENCE <= exact else None))
    elif verdict is Verdict.UNNAMED:
        effects = (FoundEffect("unnamed", {}, _likely_axis(rows), printed, printed, block="meter constant"),)
    extra: dict[str, Any] = {"constants": _table(rows)}
    middle = float(np.median([row.k_exact for row in rows]))
    if not _METER_CONSTANTS[0] < middle < _METER_CONSTANTS[1]:
        remarks.append(f"K is {middle:.3g}, and that of meters is 10.6 to 13.4 (ISO 2720): a column has another unit")
    if by_rounding and abs(rest) > _COINCIDENCE:
        remarks.append(_rest_in_words(rest, widest))
        extra["rest"] = {
            "where": "f_number",
            "f_number": widest,
            "stops": rest / math.log(2.0),
            "alternatives": ["fnumber_tstop_error", "meter_resolution"],
            "next_capture": {"description": _NEXT},
        }
        if verdict is Verdict.INCOMPLETE:
            effects = (*effects, FoundEffect("unnamed", {}, "f_number", exact, exact, ("fnumber_tstop_error",)))
    extra["remarks"] = remarks
    blind = {"fnumber_tstop_error": Limit(None, "error_per_stop", "1")}
    return ReconcileResult(
        verdict=verdict,
        effects=effects,
        gap_before=effects[0].gap_before if by_rounding else printed,
        gap_after=effects[0].gap_after if by_rounding else printed,
        limits={"nominal_settings": Limit(_COINCIDENCE, "share", "1")} | blind,
        captures=len(rows),
        assumptions=("times run in thirds of a stop, f-numbers in thirds or halves",),
        gap_unit=_GAP_UNIT,
        extra=extra,
    )


_NEXT: Final = (
    "read the meter in tenths of a stop, or measure the light at the widest aperture and one stop below it with the "
    "same exposure on a camera"
)


def _nominal(before: float, after: float) -> FoundEffect:
    rounding = {"share": FittedParameter(1.0, None, "1")}
    gain = math.log(max(before, 1e-12) / max(after, 1e-6))
    return FoundEffect(
        "nominal_settings", rounding, "exposure_s", before, after, gain_nats=gain * 10.0, block="meter constant"
    )


def _rounding_in_words(before: float, after: float, left_out: float | None) -> str:
    where = "" if left_out is None else f" (f/{left_out:.2g} left out)"
    return (
        f"K scatters by {100 * before:.2f} % within a source{where} because printed stops were treated as exact; "
        f"with the exact stops behind them (1/60 s is 1/64 s, f/5.6 is f/5.657) by {100 * after:.2f} %."
    )


def _rest_in_words(rest: float, widest: float) -> str:
    stops = rest / math.log(2.0)
    whole = abs(stops) < 0.6 and abs(1 / stops - round(1 / stops)) < 0.1
    fraction = f"1/{round(1 / abs(stops))}" if whole else f"{abs(stops):.2f}"
    return (
        f"At f/{widest:.2g} K stays {'higher' if rest > 0 else 'lower'} by {fraction} stop: with these data the "
        "resolution of a third-stop meter (±1/6 stop) cannot be separated from light lost at full aperture "
        "(fnumber_tstop_error)."
    )


def _rest(rows: Sequence[MeterRow], widest: float) -> float:
    """Return by how much ln K at the widest aperture exceeds the rest of its source, averaged over sources."""
    found = []
    for source in dict.fromkeys(row.source for row in rows):
        own = [row for row in rows if row.source == source]
        wide = [math.log(row.k_exact) for row in own if exact_f_number(row.f_number) <= widest]
        others = [math.log(row.k_exact) for row in own if exact_f_number(row.f_number) > widest]
        if wide and others:
            found.append(float(np.mean(wide) - np.mean(others)))
    return float(np.mean(found)) if found else 0.0


def _likely_axis(rows: Sequence[MeterRow]) -> str:
    """Return the setting along which K changes most."""
    k = np.array([math.log(row.k_exact) for row in rows])
    axes = {
        "f_number": np.array([math.log(row.f_number) for row in rows]),
        "exposure_s": np.array([math.log(row.time_s) for row in rows]),
        "signal": np.array([math.log(row.luminance_cd_m2) for row in rows]),
    }
    varying = {name: values for name, values in axes.items() if np.ptp(values) > 0}
    if not varying or np.ptp(k) == 0:
        return "exposure_s"
    return max(varying, key=lambda name: abs(float(np.corrcoef(varying[name], k)[0, 1])))


def _by_source(rows: Sequence[MeterRow], *, exact: bool) -> dict[str, Array]:
    found: dict[str, list[float]] = {}
    for row in rows:
        found.setdefault(row.source, []).append(row.k_exact if exact else row.k_printed)
    return {name: np.array(values) for name, values in found.items()}


def _spread(constants: Mapping[str, Array]) -> float:
    """Return the standard deviation of ln K within sources."""
    deviations = [np.log(k) - np.mean(np.log(k)) for k in constants.values()]
    freedom = sum(d.size - 1 for d in deviations)
    return float(np.sqrt(sum(float(np.sum(d**2)) for d in deviations) / freedom)) if freedom else 0.0


def _table(rows: Sequence[MeterRow]) -> list[dict[str, Any]]:
    return [
        {
            "source": row.source,
            "f_number": row.f_number,
            "time_s": row.time_s,
            "K_printed": row.k_printed,
            "K_exact": row.k_exact,
        }
        for row in rows
    ]


def _column(table: TextTable, fact: str) -> list[float]:
    """Return a column in cd·m⁻², s or ISO, in the unit that its heading or its cells state."""
    at = table.find_fact(fact, _NAMES[fact])
    if at is None:
        raise InputError(f"{table.path}: no column {_NAMES[fact][0]!r}; the first line must name {_NEEDS}")
    return finite(table.values(at, fact, [], defined=_UNITS[fact]), table, at)
