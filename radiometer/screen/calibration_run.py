"""The whole calibration of a screen: checks, levels, drift, curves; taken up where it was interrupted; verified.

Events of its journal after `start`: `warm_up` of each part, `checks` (flicker, uniformity, readings of each patch) and
`patch` after every patch. Its `number` is the place in the plan, null for a reference that a new part begins with.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any, Final, Protocol

import numpy as np

from radiometer.data import Provenance, Quantity
from radiometer.data.event_journal import START, Event, EventJournal
from radiometer.devices import Display, DisplayPatch
from radiometer.errors import UsageError
from radiometer.screen.calibration import RADIANCE, ScreenCalibration
from radiometer.screen.exports import ASSUMPTION
from radiometer.screen.run import (
    CHANNELS,
    REFERENCES,
    Flicker,
    Light,
    Measured,
    Progress,
    ScreenReading,
    ScreenStep,
    Uniformity,
    additivity,
    as_mapping,
    curves_of,
    make_plan,
    measure_steps,
    wait_until_steady,
)

_WHITE: Final = DisplayPatch((1.0, 1.0, 1.0))
_PILOTS: Final = 8  # a scatter from eight is known to a quarter
_REQUIRED_SCATTER_REL: Final = 0.004  # of the mean: well below the 1 % of a calibration
_MOST_REPEATS: Final = 64  # bounds the time that one patch takes


class Instrumented(Protocol):
    """A display with what measures it."""

    @property
    def display(self) -> Display:
        """Return the open display."""

    @property
    def sleep(self) -> Callable[[float], None]:
        """Return what waits for a number of seconds."""

    def read(self) -> ScreenReading:
        """Return a reading of the middle. Raises DeviceError, MeasurementError."""

    def check_flicker(self) -> Flicker:
        """Return whether the light changes quickly. Raises DeviceError."""

    def check_uniformity(self) -> Uniformity:
        """Return white over the screen. Raises DeviceError, MeasurementError."""


@dataclass(frozen=True, slots=True)
class Options:
    """What is to be measured."""

    name: str  # what the screen is called
    levels: tuple[int, ...]  # ascending levels
    channels: tuple[str, ...] = ("grey",)  # channels, "grey" among them
    repeats: int = 1  # readings of every patch; more where the light flickers, until their mean is good to 0.4 %
    patch_size: float = 1.0  # patch as a share of the screen's width and height
    warm_up_limit_s: float = 900.0  # longest wait for the screen to settle in s
    seed: int = 1  # seed of the random order
    pixel_mm: float | None = None  # distance of two pixels in mm; None where it was not measured
    # CIE 1931 (x, y) by channel, as a colorimeter measured them
    chromaticities: Mapping[str, tuple[float, float]] = field(default_factory=dict)


def calibrate_screen(
    bench: Instrumented,
    options: Options,
    lights: Mapping[str, Light],
    *,
    journal: EventJournal | None = None,
    progress: Progress | None = None,
    waiting: Callable[[float, float], None] | None = None,
    wall_s: Callable[[], float] = time.time,
) -> ScreenCalibration:
    """Warm the screen up, check it, measure its levels and return its calibration.

    Args:
        bench: An open display and what looks at it.
        lights: Light of every channel.
        journal: Open journal that keeps every patch; patches in it are not measured again.
        progress: Called after every patch.
        waiting: Called while the screen warms up with the time so far and the longest time, both in s.
        wall_s: Unix time in s, by which the parts of an interrupted calibration follow each other.

    Raises:
        UsageError: If a channel is unknown.
        DeviceError: If display or camera fail.
        MeasurementError: If a reading clips, white is hardly brighter than black, or too few levels were asked for.
    """
    channels = tuple(dict.fromkeys(("grey", *options.channels)))
    plan = make_plan(options.levels, channels, np.random.default_rng(options.seed))
    run = _Run(bench, options, EventJournal(None) if journal is None else journal, wall_s)
    measured = run.measure(plan, progress, waiting)
    warm_ups, seen = run.journal.of_kind("warm_up"), run.journal.of_kind("checks")[0]
    curves, drift = curves_of(measured, lights, unsettled_rel=max(one["drift_rel"] for one in warm_ups))
    checks: dict[str, Any] = {
        "warm_up": {name: warm_ups[-1][name] for name in ("waited_s", "drift_rel", "steady")},
        "flicker": seen["flicker"],
        "uniformity": seen["uniformity"],
        "repeats": seen["repeats"],
        "interruptions": len(warm_ups) - 1,
        "drift_rel": drift.range_rel,
        "drift_u_rel": drift.u_rel,
        "additivity_rel": _additivity(measured),
    }
    assumptions = [f"{name}: {lights[name].in_words()}" for name in channels]
    assumptions += [] if set(channels) <= set(options.chromaticities) else [f"exports: {ASSUMPTION}"]
    return ScreenCalibration(
        options.name,
        curves,
        checks=checks,
        provenance=Provenance(
            "patches in random order against white and black references, drift taken out",
            assumptions=tuple(assumptions),
            parameters={"patch_size": options.patch_size, "seed": options.seed},
        ),
        pixel_mm=options.pixel_mm,
        chromaticities=options.chromaticities,
    )


@dataclass(slots=True)
class _Run:
    """One part of a calibration: from its beginning, or from an interruption, to its end or the next interruption."""

    bench: Instrumented
    options: Options
    journal: EventJournal
    wall_s: Callable[[], float]
    shift_s: float = 0.0  # added to the meter's clock, which begins anew with every part

    def measure(
        self, plan: Sequence[ScreenStep], progress: Progress | None, waiting: Callable[[float, float], None] | None
    ) -> list[Measured]:
        """Return all patches of the plan, those of earlier parts from the journal."""
        known = self.journal.of_kind("patch")
        begins = max((one["number"] + 1 for one in known if one["number"] is not None), default=0)
        if begins < len(plan):
            size = self.options.patch_size
            # White and black come first: what clips, or is no screen, is refused before the minutes of the warm-up.
            first = measure_steps(self.bench.display, self.bench, plan[:2], patch_size=size)
            self._set_clock(first[-1].readings[-1].time_s, known)
            self._warm_up_and_check(waiting)
            repeats = self.journal.of_kind("checks")[0]["repeats"]
            if begins:  # the screen may have changed meanwhile: its drift is known from references on both sides
                measure_steps(
                    self.bench.display, self.bench, plan[:2], repeats=repeats, patch_size=size,
                    keep=lambda one: self._keep(one, None),
                )  # fmt: skip
            numbers = iter(range(begins, len(plan)))
            measure_steps(
                self.bench.display, self.bench, plan[begins:], repeats=repeats, patch_size=size,
                progress=progress and (lambda done, _total, step: progress(begins + done, len(plan), step)),
                keep=lambda one: self._keep(one, next(numbers)),
            )  # fmt: skip
        return [_measured_of(one) for one in self.journal.of_kind("patch")]

    def _set_clock(self, now_s: float, known: Sequence[Event]) -> None:
        """Let the times of this part follow those of the parts before, by as much as passed in between."""
        if known:
            started = self.journal.of_kind(START)
            passed_s = self.wall_s() - float(started[0]["unix_s"]) if started else 0.0
            self.shift_s = max(float(known[0]["time_s"]) + passed_s, float(known[-1]["time_s"])) - now_s

    def _warm_up_and_check(self, waiting: Callable[[float, float], None] | None) -> None:
        bench = self.bench
        bench.display.show(_WHITE)
        warm_up = wait_until_steady(bench, bench.sleep, limit_s=self.options.warm_up_limit_s, progress=waiting)
        self.journal.write("warm_up", self.shift_s, **as_mapping(warm_up))
        if not self.journal.of_kind("checks"):
            flicker = bench.check_flicker()
            uniformity = bench.check_uniformity()
            repeats = _repeats(bench, self.options.repeats) if flicker.found else self.options.repeats
            self.journal.write(
                "checks", self.shift_s, flicker=as_mapping(flicker), uniformity=as_mapping(uniformity), repeats=repeats
            )

    def _keep(self, one: Measured, number: int | None) -> None:
        readings = [replace(reading, time_s=reading.time_s + self.shift_s) for reading in one.readings]
        self.journal.write(
            "patch", readings[-1].time_s, number=number, step=asdict(one.step), readings=list(map(asdict, readings))
        )


def _measured_of(event: Event) -> Measured:
    readings = (ScreenReading(**{**one, "flags": tuple(one["flags"])}) for one in event["readings"])
    return Measured(ScreenStep(**event["step"]), tuple(readings))


def _repeats(bench: Instrumented, least: int) -> int:
    """Return how many readings of flickering light it takes for a mean of the requested scatter; white is shown."""
    values = np.array([bench.read().radiance for _ in range(_PILOTS)])
    scatter = float(values.std(ddof=1) / values.mean())
    return int(np.clip(np.ceil((scatter / _REQUIRED_SCATTER_REL) ** 2), least, _MOST_REPEATS))


def _additivity(measured: list[Measured]) -> float | None:
    """Return how far the primaries' sum is from white in radiance; the black counts once in each."""
    top = max(one.step.level for one in measured)
    tops = [one for one in measured if one.step.purpose == "level" and one.step.level == top]
    blacks = [one.mean.radiance for one in measured if one.step.level == 0]
    return additivity({one.step.channel: one.mean.radiance for one in tops}, float(np.mean(blacks)) if blacks else 0.0)


COVERAGE: Final = 2.0


@dataclass(frozen=True, slots=True)
class VerifiedLevel:
    """A level as calibrated and as measured now, in W·sr⁻¹·m⁻² with standard uncertainties."""

    channel: str
    level: int
    calibrated: Quantity
    measured: Quantity
    # Relative standard uncertainty that both share: the scale of one camera under one calibration; 0 of two cameras
    shared_u_rel: float = 0.0

    @property
    def difference(self) -> Quantity:
        """Return measured minus calibrated, with the standard uncertainty of both; what they share drops out."""
        covariance = self.calibrated.value * self.measured.value * self.shared_u_rel**2
        u = math.sqrt(max(self.calibrated.u**2 + self.measured.u**2 - 2.0 * covariance, 0.0))
        return Quantity(self.measured.value - self.calibrated.value, u, RADIANCE)

    @property
    def agrees(self) -> bool:
        """Return whether the two differ by at most the expanded uncertainty of the difference (k = 2)."""
        return abs(self.difference.value) <= COVERAGE * self.difference.u


@dataclass(frozen=True, slots=True)
class Verified:
    """Levels of a screen measured again."""

    levels: tuple[VerifiedLevel, ...]

    @property
    def holds(self) -> bool:
        """Return whether the calibration holds at every level."""
        return all(one.agrees for one in self.levels)


def verify_screen(
    bench: Instrumented,
    calibration: ScreenCalibration,
    levels: Sequence[int],
    *,
    warm_up_limit_s: float = 900.0,
    patch_size: float = 1.0,
    same_meter: bool = False,
    progress: Progress | None = None,
    waiting: Callable[[float, float], None] | None = None,
) -> Verified:
    """Return levels of every calibrated channel as they are measured now.

    Args:
        bench: An open display and what looks at it.
        calibration: The calibration.
        levels: Levels to measure, as far as the calibration covers them.
        warm_up_limit_s: Longest wait for the screen to settle in s.
        patch_size: Patch as a share of the screen's width and height.
        same_meter: The camera, its lens and its calibration are those of the screen's calibration.
        progress: Called after every patch.
        waiting: Called while the screen warms up with the time so far and the longest time, both in s.

    Raises:
        UsageError: If the calibration covers none of the levels.
        DeviceError: If display or camera fail.
        MeasurementError: If a reading clips, or white is hardly brighter than black.
    """
    steps = [
        ScreenStep(name, level)
        for name, curve in calibration.channels.items()
        if name in CHANNELS
        for level in levels
        if curve.levels[0] <= level <= curve.levels[-1]
    ]
    if not steps:
        raise UsageError(
            f"the calibration of {calibration.name} covers none of the levels {', '.join(map(str, levels))}"
        )
    measure_steps(bench.display, bench, REFERENCES, patch_size=patch_size)
    bench.display.show(_WHITE)
    warm_up = wait_until_steady(bench, bench.sleep, limit_s=warm_up_limit_s, progress=waiting)
    measured = measure_steps(bench.display, bench, steps, patch_size=patch_size, progress=progress)
    found = []
    for entry in measured:
        one, name, level = entry.mean, entry.step.channel, entry.step.level
        u = math.hypot(
            one.u_independent, one.radiance * one.u_common_rel, one.radiance * warm_up.drift_rel / np.sqrt(3.0)
        )
        curve = calibration.channel(name)
        shared = min(curve.u_common_rel, one.u_common_rel) if same_meter else 0.0
        found.append(VerifiedLevel(name, level, curve.radiance_at(level), Quantity(one.radiance, u, RADIANCE), shared))
    return Verified(tuple(found))
