"""Reconciles tables: of a light meter, and of light over drive.

The meter equation N²/t = L·S/K gives K for every row. Rows of one source must agree; where printed stops were taken
at face value they scatter by up to a tenth, and with the exact stops behind them they do not.

ln(light/drive) of each channel is constant where its light is proportional. A LED makes it a smooth curve of the
channel's drive. A meter that changes its range makes it jump where the reading passes a threshold, in all channels at
one reading and by one ratio. Both are fitted by least squares. Every name must predict drives held out better.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import numpy as np
from scipy.ndimage import uniform_filter1d

from radiometer.analysis.flux.drive_law import LEAST_DRIVE, DriveLaw, columns_of, fit_drive_law
from radiometer.data.storage import write_text_atomic, write_yaml_atomic
from radiometer.importing.light_tables import ChannelDrive, DriveTable, MeterRow, read_drive_table, read_meter_table
from radiometer.numbers import with_u
from radiometer.reconciliation.result import ByHand, FittedParameter, FoundEffect, Limit, ReconcileResult, Verdict
from radiometer.reconciliation.thresholds import NAMED_NATS, is_open
from radiometer.reporting.origin import Origin
from radiometer.reporting.page import listed, page, paragraph, section, table
from radiometer.typing import Array
from radiometer.units import exact_f_number

_GAP_UNIT: Final = "standard deviation of ln K within a source"
_COINCIDENCE: Final = 2e-3  # rows that agree to this, though printed values scatter by more, are no chance
_FEWEST_FREE: Final = 2  # readings beyond one for each source and stop, to show that a stop is off
_STEP_OF_A_METER: Final = math.log(2.0) / 3.0  # meters and cameras run in thirds of a stop


@dataclass(frozen=True, slots=True)
class MeterReconciled(ByHand):
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
        head = (
            "source",
            "luminance in cd·m⁻²",
            "f-number",
            "time in s",
            "K as printed in cd·s·m⁻²",
            "K of exact stops",
        )
        parts = [*(paragraph(text) for text in self.result.extra.get("remarks", [])), table(head, rows)]
        origin = Origin("", further=(("table", self.origin),))
        write_text_atomic(
            path, page("Readings of a light meter", self.result.sentence, parts, kind="reconcile", origin=origin)
        )
        return str(path)


def reconcile_meter_table(path: Path) -> MeterReconciled:
    """Return whether the readings agree, and whether the rounding of printed stops is why not."""
    begun = time.monotonic()
    rows = read_meter_table(path)
    result = _judge(rows)
    return MeterReconciled(replace(result, seconds=time.monotonic() - begun), rows, str(path))


def _judge(rows: Sequence[MeterRow]) -> ReconcileResult:
    printed, exact = (_spread(_by_source(rows, exact=way)) for way in (False, True))
    widest = min(exact_f_number(row.f_number) for row in rows)
    closed = [row for row in rows if exact_f_number(row.f_number) > widest]
    inner = tuple(_spread(_by_source(closed, exact=way)) for way in (False, True))
    # By which rows the rounding shows: those of closed stops first.
    rounded = next((pair for pair in (inner, (printed, exact)) if pair[1] < _COINCIDENCE < pair[0]), None)
    stops, left, freedom = _by_stop(rows)
    rest = stops[widest]
    effects, verdict, remarks = list[FoundEffect](), Verdict.AGREES, list[str]()
    extra: dict[str, Any] = {"constants": [_as_mapping(row) for row in rows], "remarks": remarks}
    if rounded is not None:
        before, after = rounded
        nats = 10.0 * math.log(max(before, 1e-12) / max(after, 1e-6))
        share = {"share": FittedParameter(1.0, None, "1")}
        effects.append(
            FoundEffect("nominal_settings", share, "exposure_s", before, after, gain_nats=nats, block=_BLOCK)
        )
        verdict = Verdict.EFFECTS_FOUND if abs(rest) <= _STEP_OF_A_METER / 2 * 1.01 else Verdict.INCOMPLETE
        where = f" (f/{widest:.2g} left out)" if inner[1] < _COINCIDENCE <= exact else ""
        remarks.append(
            f"K scatters by {100 * before:.2f} % within a source{where} because printed stops were treated as exact; "
            f"with the exact stops behind them (1/60 s is 1/64 s, f/5.6 is f/5.657) by {100 * after:.2f} %."
        )
        if abs(rest) > _COINCIDENCE:
            remarks.append(_rest_in_words(rest, widest))
            extra["rest"] = {
                "where": "f_number", "f_number": widest, "stops": rest / math.log(2.0),
                "alternatives": ["fnumber_tstop_error", "meter_resolution"], "next_capture": {"description": _NEXT},
            }  # fmt: skip
            if verdict is Verdict.INCOMPLETE:
                effects.append(FoundEffect("unnamed", {}, "f_number", exact, exact, ("fnumber_tstop_error",)))
    elif printed >= _COINCIDENCE and freedom >= _FEWEST_FREE and left < _COINCIDENCE < exact:
        effects, verdict = [_of_stops(stops, exact, left, freedom)], Verdict.EFFECTS_FOUND
    elif printed >= _COINCIDENCE:
        effects = [FoundEffect("unnamed", {}, _likely_axis(rows), printed, printed, block=_BLOCK)]
        verdict = Verdict.UNNAMED
    of_stops = Limit(_COINCIDENCE if freedom >= _FEWEST_FREE else None, "errors_rel", "1")
    dials = "times and f-numbers run in thirds or halves of a stop"
    if all(row.exact_time_s == row.time_s for row in rows):
        dials = "times are as written, for one is on no dial; f-numbers run in thirds or halves of a stop"
    return ReconcileResult(
        verdict=verdict,
        effects=tuple(effects),
        gap_before=effects[0].gap_before if effects else printed,
        gap_after=effects[0].gap_after if effects else printed,
        limits={"nominal_settings": Limit(_COINCIDENCE, "share", "1"), "fnumber_tstop_error": of_stops},
        captures=len(rows),
        assumptions=(dials,),
        gap_unit=_GAP_UNIT,
        extra=extra,
    )


_BLOCK: Final = "meter constant"
_NEXT: Final = (
    "read the meter in tenths of a stop, or measure the light at the widest aperture and one stop below it with the "
    "same exposure on a camera"
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


def _by_stop(rows: Sequence[MeterRow]) -> tuple[dict[float, float], float, int]:
    """Return ln K at each exact stop beyond that at the middle one, the standard deviation left, and its freedom."""
    k = np.log([row.k_exact for row in rows])
    sources, source = np.unique([row.source for row in rows], return_inverse=True)
    stops, stop = np.unique([exact_f_number(row.f_number) for row in rows], return_inverse=True)
    columns = np.hstack([np.eye(sources.size)[source], np.eye(stops.size)[stop]])
    level, _, rank, _ = np.linalg.lstsq(columns, k)
    freedom = k.size - int(rank) if rank == sources.size + stops.size - 1 else 0
    left = float(np.linalg.norm(k - columns @ level)) / math.sqrt(max(freedom, 1))
    own = level[sources.size :]
    return dict(zip(stops.tolist(), (own - np.sort(own)[(own.size - 1) // 2]).tolist(), strict=True)), left, freedom


def _of_stops(stops: Mapping[float, float], before: float, left: float, freedom: int) -> FoundEffect:
    errors = {n: math.expm1(-more) for n, more in stops.items() if abs(more) > _COINCIDENCE}
    found = {f"errors_rel at f/{n:.2g}": FittedParameter(error, _COINCIDENCE, "1") for n, error in errors.items()}
    nats, rivals = freedom * math.log(before / _COINCIDENCE), ("meter_resolution",)
    return FoundEffect("fnumber_tstop_error", found, "f_number", before, left, rivals, gain_nats=nats, block=_BLOCK)


def _likely_axis(rows: Sequence[MeterRow]) -> str:
    *axes, k = np.log([(row.f_number, row.time_s, row.luminance_cd_m2, row.k_exact) for row in rows]).T
    alike = [abs(float(np.corrcoef(axis, k)[0, 1])) if np.ptp(axis) > 0 else 0.0 for axis in axes]
    return ("f_number", "exposure_s", "signal")[int(np.argmax(alike))]


def _by_source(rows: Sequence[MeterRow], *, exact: bool) -> dict[str, Array]:
    found: dict[str, list[float]] = {}
    for row in rows:
        found.setdefault(row.source, []).append(row.k_exact if exact else row.k_printed)
    return {name: np.array(values) for name, values in found.items()}


def _spread(constants: Mapping[str, Array]) -> float:
    deviations = [np.log(k) - np.mean(np.log(k)) for k in constants.values()]
    freedom = sum(d.size - 1 for d in deviations)
    return float(np.sqrt(sum(float(np.sum(d**2)) for d in deviations) / freedom)) if freedom else 0.0


def _as_mapping(row: MeterRow) -> dict[str, Any]:
    own = {name: getattr(row, name) for name in ("source", "f_number", "time_s")}
    return own | {"K_printed": row.k_printed, "K_exact": row.k_exact}


# ---- light over drive -----------------------------------------------------------------------------------------------
GAP_UNIT: Final = "reduced chi-square on held-out drives"
DROOP, STEP = "led_droop", "meter_range_step"
_FOLDS: Final = 5  # every fifth drive is held out: neighbours of it stay
_MOST_STEPS: Final = 3  # ranges of a meter within one table
_FEWEST_OTHERS: Final = 4  # readings on each side of a step: fewer fit any jump
_LEAST_DEVIATION: Final = 0.005  # a law that moves half drive by less is no finding to act upon
_NEIGHBOURS: Final = 12  # readings that give the noise at one of them to a fifth
_SIGMAS: Final = 3.0
_FLOOR: Final = 1e-6  # relative noise of a table without any


@dataclass(frozen=True, slots=True, eq=False)
class _Data:
    """All channels in one: ln of light over drive above onset, drive, reading and number of the channel, shape (n,)."""

    target: Array
    drive: Array
    reading: Array
    channel: Array

    @property
    def channels(self) -> int:
        return int(self.channel.max()) + 1

    def per_channel(self, columns: Array) -> Array:
        """Return columns of each channel, 0 in the others, shape (n, channels·columns)."""
        own = self.channel[:, None] == np.arange(self.channels)[None, :]
        return np.asarray((own[:, :, None] * columns[:, None, :]).reshape(self.target.size, -1))


@dataclass(frozen=True, slots=True, eq=False)
class DriveFit(ByHand):
    """The outcome for a table; write_model, write_report and write_plan are those of every reconciled source."""

    result: ReconcileResult
    data: DriveTable
    laws: dict[str, DriveLaw | None]
    origin: str

    def write_model(self, path: Path, *, provisional: bool = False) -> str:
        """Write the laws and what was found; a light engine is no camera."""
        effects = [
            {"name": one.name, "enabled": True, "parameters": {n: p.value for n, p in one.parameters.items()}}
            for one in self.result.effects
        ]
        laws = {name: None if one is None else one.to_mapping() for name, one in self.laws.items()}
        write_yaml_atomic(path, {"format": "radiometer-light-engine/1", "drive_laws": laws, "effects": effects})
        return str(path)

    def write_report(self, path: Path) -> str:
        """Write the laws of all channels and what was found as HTML."""
        rows = [(name, "too few lit drives" if one is None else str(one)) for name, one in self.laws.items()]
        found = [
            f"{one.name}: "
            + ", ".join(f"{n} {with_u(p.value, 2 * (p.u or 0.0), p.unit, k=2)}" for n, p in one.parameters.items())
            for one in self.result.effects
        ]
        parts = [
            section("What was found", listed(found)),
            section("Laws of the channels", table(("channel", "law"), rows, words=(1,))),
            section("Assumptions", listed(self.result.assumptions)),
        ]
        origin = Origin(further=(("table", self.origin),))
        write_text_atomic(path, page(self.origin, self.result.sentence, parts, kind="light engine", origin=origin))
        return str(path)


def reconcile_drive_table(path: Path) -> DriveFit:
    """Return what makes the light of a table other than proportional to its drive.

    Raises:
        InputError: If the table cannot be read.
    """
    begun = time.monotonic()
    known = read_drive_table(path)
    data = _pooled(known.channels, {})
    steps = _range_steps(data)
    laws = {
        one.name: fit_drive_law(
            one.drive, one.light, np.searchsorted(steps, one.reading).astype(np.float64) if steps else None
        )
        for one in known.channels
    }
    onsets = {name: law.onset for name, law in laws.items() if law is not None and law.onset > 0.0}
    effects, gaps = _named(data, steps, laws)
    if onsets and _verdict(effects, gaps[-1], data.target.size) is not Verdict.EFFECTS_FOUND:
        data = _pooled(known.channels, onsets)
        effects, gaps = _named(data, _range_steps(data), laws)
    else:
        onsets = {}
    five_sigma = 10.0 * float(np.median(_sigma(data, _smooth(data)))) / math.sqrt(data.target.size)
    limits = {
        DROOP: Limit(five_sigma * math.sqrt(data.channels), "deviation_at_half_drive", "1"),
        STEP: Limit(five_sigma, "ratio", "1"),
    }
    result = ReconcileResult(
        verdict=_verdict(effects, gaps[-1], data.target.size),
        effects=effects,
        gap_before=gaps[0],
        gap_after=gaps[-1],
        limits={one: limit for one, limit in limits.items() if one not in {effect.name for effect in effects}},
        captures=int(data.target.size),
        assumptions=(
            *known.taken,
            f"drives below {100 * LEAST_DRIVE:g} % of full are left out: a LED's onset and noise decide there",
            "relative noise of each channel is the same at all its drives",
            *(
                f"channel {name} gives no light below {100 * onset:.2g} % of full drive"
                for name, onset in onsets.items()
            ),
        ),
        seconds=time.monotonic() - begun,
        gap_unit=GAP_UNIT,
        extra={"drive_laws": {name: None if one is None else one.to_mapping() for name, one in laws.items()}},
    )
    return DriveFit(result, known, laws, path.name)


def _pooled(channels: Sequence[ChannelDrive], onsets: Mapping[str, float]) -> _Data:
    parts = []
    for number, one in enumerate(channels):
        k = (one.drive >= LEAST_DRIVE) & (one.light > 0.0)
        target = np.log(one.light[k] / (one.drive[k] - onsets.get(one.name, 0.0)))
        parts.append((target, one.drive[k], one.reading[k], np.full(target.size, number)))
    return _Data(*map(np.concatenate, zip(*parts, strict=True)))


def _smooth(data: _Data) -> Array:
    """Return the columns of a smooth law of each channel, freer than a LED's: no bend of a LED counts as a step."""
    d = data.drive
    return data.per_channel(np.column_stack([columns_of(d), d**2, d**3]))


def _rss(data: _Data, design: Array) -> tuple[Array, Array]:
    found = np.linalg.lstsq(design, data.target, rcond=None)[0]
    residual = (data.target - design @ found) ** 2
    sums = np.array([float(residual[data.channel == n].sum()) for n in range(data.channels)])
    counts = np.array([int(np.sum(data.channel == n)) for n in range(data.channels)])
    return np.maximum(sums, counts * _FLOOR**2), counts


def _gain(data: _Data, before: Array, after: Array) -> float:
    (old, counts), (new, _) = _rss(data, before), _rss(data, after)
    return float(np.sum(0.5 * counts * np.log(old / new)))


def _range_steps(data: _Data) -> tuple[float, ...]:
    thresholds, found = np.unique(data.reading), list[float]()
    design = _smooth(data)
    for _ in range(_MOST_STEPS):
        best, gain = None, 0.0
        for low, high in pairwise(thresholds.tolist()):
            edge = math.sqrt(low * high) if low > 0.0 else 0.5 * (low + high)
            above = data.reading > edge
            if min(int(above.sum()), int((~above).sum())) < _FEWEST_OTHERS:
                continue
            more = _gain(data, design, np.column_stack([design, above]))
            if more > gain:
                best, gain = edge, more
        # Two parameters cost ln(n)/2 each (Schwarz 1978); the threshold was chosen among all readings.
        price = math.log(data.target.size) + math.log(max(1, thresholds.size)) + NAMED_NATS
        if best is None or gain < price:
            break
        stepped = np.column_stack([design, data.reading > best])
        if _gain_by_place(data, design, stepped) < price:
            break  # scatter that grows towards low readings, no jump
        found.append(best)
        design = stepped
    return tuple(sorted(found))


def _gain_by_place(data: _Data, before: Array, after: Array) -> float:
    """Return the gain in log likelihood with noise as it is at each reading: among its neighbours in reading."""
    old, new = (data.target - one @ np.linalg.lstsq(one, data.target, rcond=None)[0] for one in (before, after))
    order = np.argsort(data.reading, kind="stable")
    width = max(_NEIGHBOURS, data.target.size // 10)
    variance = np.empty(data.target.size)
    variance[order] = uniform_filter1d(new[order] ** 2, width, mode="nearest")
    return float(0.5 * np.sum((old**2 - new**2) / np.maximum(variance, _FLOOR**2)))


def _named(
    data: _Data, steps: tuple[float, ...], laws: Mapping[str, DriveLaw | None]
) -> tuple[tuple[FoundEffect, ...], tuple[float, ...]]:
    flat = data.per_channel(np.ones((data.target.size, 1)))
    law = data.per_channel(columns_of(data.drive))
    jumps = np.column_stack([data.reading > edge for edge in steps]).astype(float) if steps else None

    def stepped(base: Array) -> Array:
        return base if jumps is None else np.column_stack([base, jumps])

    sigma = _sigma(data, stepped(_smooth(data)))
    gaps = [_held_out(data, flat, sigma)]
    effects = []
    with_steps = stepped(flat)
    if jumps is not None:
        gaps.append(_held_out(data, with_steps, sigma))
        effects.append(_step_effect(data, steps, stepped(_smooth(data)), sigma, (gaps[-2], gaps[-1])))
    curved = stepped(law)
    drooping, after = _drooping(laws), _held_out(data, curved, sigma)
    gain = _gain(data, with_steps, curved)
    price = data.channels * math.log(max(2, data.target.size / data.channels)) + NAMED_NATS
    if gain > price and after < gaps[-1]:
        name, found = (DROOP, drooping) if drooping else ("unnamed", {})
        effects.append(FoundEffect(name, found, "drive", gaps[-1], after, gain_nats=gain, block="mean"))
        gaps.append(after)
    return tuple(effects), tuple(gaps)


def _drooping(laws: Mapping[str, DriveLaw | None]) -> dict[str, FittedParameter]:
    """Return deviation at half drive of the channel that droops most, and how many do; nothing where none does."""
    above = (replace(law, onset=0.0).parameters["deviation_at_half_drive"] for law in laws.values() if law is not None)
    seen = [one for one in above if math.log1p(one.value) > max(_SIGMAS * one.u, _LEAST_DEVIATION)]
    if not seen:
        return {}
    most = max(seen, key=lambda one: one.value)
    size = FittedParameter(most.value, most.u, "1")
    return {"deviation_at_half_drive": size, "channels": FittedParameter(float(len(seen)), None, "1")}


def _step_effect(
    data: _Data, steps: tuple[float, ...], design: Array, sigma: Array, gaps: tuple[float, float]
) -> FoundEffect:
    rows = design / sigma[data.channel][:, None]
    every = np.linalg.lstsq(rows, data.target / sigma[data.channel], rcond=None)[0]
    found, u = every[-len(steps) :], np.sqrt(np.diag(np.linalg.pinv(rows.T @ rows)))[-len(steps) :]
    parameters: dict[str, FittedParameter] = {}
    for n, (edge, size) in enumerate(zip(steps, found.tolist(), strict=True), 1):
        tail = "" if len(steps) == 1 else f"_{n}"
        below, above = data.reading[data.reading <= edge].max(), data.reading[data.reading > edge].min()
        parameters[f"ratio{tail}"] = FittedParameter(math.exp(size), math.exp(size) * float(u[n - 1]), "1")
        # The threshold is anywhere between two readings: a rectangle.
        parameters[f"reading{tail}"] = FittedParameter(edge, float(above - below) / math.sqrt(12.0), "reading")
    gain = _gain(data, _smooth(data), design)
    return FoundEffect(STEP, parameters, "reading", *gaps, gain_nats=gain, block="mean")


def _sigma(data: _Data, design: Array) -> Array:
    sums, counts = _rss(data, design)
    freedom = np.maximum(1.0, counts - design.shape[1] / data.channels)
    return np.asarray(np.maximum(np.sqrt(sums / freedom), _FLOOR))


def _held_out(data: _Data, design: Array, sigma: Array) -> float:
    total, place = 0.0, np.arange(data.target.size)
    for fold in range(_FOLDS):
        out = place % _FOLDS == fold
        weights = (1.0 / sigma[data.channel])[~out]
        found = np.linalg.lstsq(design[~out] * weights[:, None], data.target[~out] * weights, rcond=None)[0]
        total += float(np.sum(((data.target[out] - design[out] @ found) / sigma[data.channel[out]]) ** 2))
    return total / data.target.size


def _verdict(effects: Sequence[FoundEffect], gap: float, readings: int) -> Verdict:
    names = {one.name for one in effects}
    if not names:
        return Verdict.AGREES
    if names == {"unnamed"}:
        return Verdict.UNNAMED
    return Verdict.INCOMPLETE if "unnamed" in names or is_open(gap, readings) else Verdict.EFFECTS_FOUND
