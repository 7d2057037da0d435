"""Checks before and between the levels: warm-up, flicker, uniformity, additivity of the primaries."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Final

import numpy as np

from radiometer.numbers import rounded
from radiometer.screen.run import Meter, ScreenReading

STEADY_REL: Final = 0.002  # change over the window that counts as warmed up: the size of white's repeatability
_PAUSE_S: Final = 60.0  # between two readings: a backlight settles in some ten minutes
_WINDOW: Final = 5  # readings: a drift of 0.2 % is seen over five


@dataclass(frozen=True, slots=True)
class WarmUp:
    """What was seen while the display warmed up."""

    waited_s: float  # how long white was shown
    drift_rel: float  # relative change over the last readings
    steady: bool  # whether that was below the limit before the time was up
    readings: tuple[ScreenReading, ...] = ()  # of white meanwhile

    @property
    def drift_s(self) -> float:
        """Return the time in s that the change was seen over."""
        return self.readings[-1].time_s - self.readings[-_WINDOW:][0].time_s


def wait_until_steady(
    meter: Meter,
    sleep: Callable[[float], None],
    *,
    limit_s: float,
    progress: Callable[[float, float], None] | None = None,
) -> WarmUp:
    """Read white until five readings in a row agree within 0.2 % (or their noise), or the time is up.

    Args:
        sleep: Waits for a number of seconds.
        limit_s: Longest time to wait in s; 0 takes a single set of readings.
        progress: Called after every reading with the time so far and the limit, both in s.
    """
    readings = [meter.read()]
    while True:
        drift, noise = _drift_of(readings[-_WINDOW:])
        waited = readings[-1].time_s - readings[0].time_s
        if progress is not None:
            progress(waited, limit_s)
        steady = len(readings) >= _WINDOW and drift <= max(STEADY_REL, 3.0 * noise)
        if steady or waited >= limit_s:
            return WarmUp(waited, drift, steady, tuple(readings))
        sleep(_PAUSE_S)
        readings.append(meter.read())


def _drift_of(readings: Sequence[ScreenReading]) -> tuple[float, float]:
    values = np.array([r.radiance for r in readings])
    noise = float(np.mean([r.u_independent for r in readings])) / values.mean()
    return float(np.ptp(values) / values.mean()), float(noise)


@dataclass(frozen=True, slots=True)
class Flicker:
    """Whether the display's light changes within fractions of a second (PWM dimming, scanning)."""

    exposure_s: float  # exposure of the test frames in s
    scatter_rel: float  # relative scatter from frame to frame
    noise_rel: float  # what noise alone would give
    found: bool  # whether the scatter exceeds noise beyond doubt (five sigmas of its estimate)


def judge_flicker(values: Sequence[float], noise_rel: float, exposure_s: float) -> Flicker:
    """Return whether readings of many short exposures scatter more than noise.

    Args:
        values: Mean signal of each frame, at least 3.
        noise_rel: Relative standard uncertainty of each by noise.
        exposure_s: Their exposure in s.
    """
    signal = np.asarray(values, dtype=np.float64)
    scatter = float(signal.std(ddof=1) / signal.mean())
    limit = noise_rel * math.sqrt(1 + 5 * math.sqrt(2 / (signal.size - 1)))
    return Flicker(exposure_s, scatter, noise_rel, found=scatter > max(limit, 5e-4))


@dataclass(frozen=True, slots=True)
class Uniformity:
    """White over a grid of places relative to the middle."""

    grid: tuple[tuple[float, ...], ...]  # rows of values relative to the middle
    lowest: float  # the lowest of them
    highest: float  # the highest of them
    u_rel: float  # the largest standard uncertainty of one of them

    @classmethod
    def of(cls, values: Sequence[Sequence[float]], u_rel: float) -> Uniformity:
        """Return the figures of a grid of radiances with odd numbers of rows and columns.

        Args:
            values: The radiances, in any unit.
            u_rel: The largest standard uncertainty of their ratios to the middle.
        """
        table = np.asarray(values, dtype=np.float64)
        relative = table / table[table.shape[0] // 2, table.shape[1] // 2]
        rows = tuple(tuple(float(v) for v in row) for row in relative)
        return cls(rows, float(relative.min()), float(relative.max()), u_rel)


def additivity(whites: Mapping[str, float], blacks: float) -> float | None:
    """Return (red + green + blue − 2·black) / white − 1 of the highest levels; None unless all were measured."""
    if not {"grey", "red", "green", "blue"} <= set(whites):
        return None
    return (whites["red"] + whites["green"] + whites["blue"] - 2.0 * blacks) / whites["grey"] - 1.0


def as_mapping(check: WarmUp | Flicker | Uniformity) -> dict[str, Any]:
    """Return a check as it is written to the file."""
    return {key: list(value) if isinstance(value, tuple) else value for key, value in asdict(check).items()}


def checks_in_words(checks: Mapping[str, Any]) -> dict[str, str]:
    """Return what the checks of a calibration found, by name, as every face states it.

    Args:
        checks: As its file holds them; those that were not made, or that the file states otherwise, are left out.
    """
    warm = _part(checks, "warm_up", "steady", "waited_s")
    flicker = _part(checks, "flicker", "found", "scatter_rel", "exposure_s")
    grid = _part(checks, "uniformity", "lowest", "highest")
    drift, u_drift, additive, repeats = (
        value if isinstance(value := checks.get(name), float | int) else None
        for name in ("drift_rel", "drift_u_rel", "additivity_rel", "repeats")
    )
    found = {}
    if warm:
        state = "steady" if warm["steady"] else "still drifting"
        found["warm-up"] = f"{state} after {warm['waited_s']:.0f} s"
    if drift is not None:
        found["drift"] = f"{100 * drift:.2g} % while measuring, taken out"
        found["drift"] += "" if u_drift is None else f"; {100 * u_drift:.2g} % (k = 1) remains"
    if flicker and flicker["found"]:
        found["flicker"] = (
            f"light changes by {100 * flicker['scatter_rel']:.2g} % between frames of "
            f"{1e3 * flicker['exposure_s']:.3g} ms (PWM dimming?): {repeats} readings are averaged"
        )
    if grid:
        u = grid.get("u_rel", math.nan)  # files of earlier versions do not state it
        (lowest, each), (highest, _) = (rounded(100 * grid[end], 200 * u) for end in ("lowest", "highest"))
        found["uniformity"] = f"{lowest} to {highest} % of the middle, each ± {each} % (k = 2)"
    if additive is not None:
        found["additivity"] = f"primaries add up to white within {100 * additive:.2g} %"
    return found


def _part(checks: Mapping[str, Any], name: str, *keys: str) -> Mapping[str, Any]:
    """Return a check that holds numbers under all keys, or nothing."""
    part = checks.get(name)
    known = isinstance(part, Mapping) and all(isinstance(part.get(key), float | int) for key in keys)
    return part if isinstance(part, Mapping) and known else {}
