"""The whole calibration of a screen: checks, levels, drift, curves."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final, Protocol

import numpy as np

from radiometer.data import Provenance
from radiometer.devices import Display, DisplayPatch
from radiometer.screen.calibration import ScreenCalibration
from radiometer.screen.checks import Flicker, Uniformity, additivity, as_mapping, wait_until_steady
from radiometer.screen.exports.chromaticity import ASSUMPTION
from radiometer.screen.meter import ScreenReading
from radiometer.screen.plan import make_plan
from radiometer.screen.run import Light, Measured, Progress, curves_of, measure_steps

_WHITE: Final = DisplayPatch((1.0, 1.0, 1.0))
_PILOTS: Final = 8  # a scatter from eight is known to a quarter
_WANTED_SCATTER_REL: Final = 0.004  # of the mean: well below the 1 % of a calibration
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
    progress: Progress | None = None,
    waiting: Callable[[float, float], None] | None = None,
) -> ScreenCalibration:
    """Warm the screen up, check it, measure its levels and return its calibration.

    Args:
        bench: An open display and what looks at it.
        lights: Light of every channel.
        progress: Called after every patch.
        waiting: Called while the screen warms up with the time so far and the longest time, both in s.

    Raises:
        UsageError: If a channel is unknown.
        DeviceError: If display or camera fail.
        MeasurementError: If a reading clips, white is hardly brighter than black, or too few levels were asked for.
    """
    channels = tuple(dict.fromkeys(("grey", *options.channels)))
    plan = make_plan(options.levels, channels, np.random.default_rng(options.seed))
    # White and black come first: what clips, or is no screen, is refused before the minutes of the warm-up.
    measure_steps(bench.display, bench, plan[:2], patch_size=options.patch_size)
    bench.display.show(_WHITE)
    warm_up = wait_until_steady(bench, bench.sleep, limit_s=options.warm_up_limit_s, progress=waiting)
    flicker = bench.check_flicker()
    uniformity = bench.check_uniformity()
    repeats = _repeats(bench, options.repeats) if flicker.found else options.repeats
    measured = measure_steps(
        bench.display, bench, plan, repeats=repeats, patch_size=options.patch_size, progress=progress
    )
    curves, drift = curves_of(measured, lights, unsettled_rel=warm_up.drift_rel)
    checks: dict[str, Any] = {
        "warm_up": as_mapping(warm_up),
        "flicker": as_mapping(flicker),
        "uniformity": as_mapping(uniformity),
        "repeats": repeats,
        "drift_rel": drift.range_rel,
        "drift_u_rel": drift.u_rel,
        "additivity_rel": _additivity(measured),
    }
    assumptions = [f"{name}: spectrum {lights[name].spectrum}" for name in channels]
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


def _repeats(bench: Instrumented, least: int) -> int:
    """Return how many readings of flickering light it takes for a mean of the requested scatter; white is shown."""
    values = np.array([bench.read().radiance for _ in range(_PILOTS)])
    scatter = float(values.std(ddof=1) / values.mean())
    return int(np.clip(np.ceil((scatter / _WANTED_SCATTER_REL) ** 2), least, _MOST_REPEATS))


def _additivity(measured: list[Measured]) -> float | None:
    """Return how far the primaries' sum is from white in radiance; the black counts once in each."""
    tops: dict[str, float] = {}
    blacks = [m.mean.radiance for m in measured if m.step.level == 0]
    for entry in measured:
        if entry.step.purpose == "level" and entry.step.level == max(m.step.level for m in measured):
            tops[entry.step.channel] = entry.mean.radiance
    return additivity(tops, float(np.mean(blacks)) if blacks else 0.0)
