"""Verifies a screen's calibration: some of its levels are measured again and compared with what it states."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from radiometer.data import Quantity
from radiometer.errors import UsageError
from radiometer.screen.calibration import RADIANCE, ScreenCalibration
from radiometer.screen.calibration_run import Instrumented
from radiometer.screen.checks import WarmUp, wait_until_steady
from radiometer.screen.plan import CHANNELS, ScreenStep
from radiometer.screen.run import Progress, measure_steps

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
    """Levels of a screen measured again, and how it warmed up."""

    levels: tuple[VerifiedLevel, ...]
    warm_up: WarmUp

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
    references = [ScreenStep("grey", 255, "white"), ScreenStep("grey", 0, "black")]
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
    measure_steps(bench.display, bench, references, patch_size=patch_size)
    bench.display.show(references[0].patch())
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
    return Verified(tuple(found), warm_up)
