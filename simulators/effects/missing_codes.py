"""An output that leaves out codes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import cast

import numpy as np

from simulators.effects.base import DIGITAL_NUMBER, Moments, Stage, parameter
from simulators.effects.catalogue import CatalogueEffect
from simulators.effects.context import ExposureContext, Signal
from simulators.effects.tile_moments import TileMoments


def _harmonics(u: Signal, variance: Signal, step: float) -> tuple[Signal, Signal, Signal]:
    """Return Σ sin/k, Σ cos and Σ cos/k² of the sawtooth's harmonics, each damped by the noise."""
    sines, cosines, cosines2 = np.zeros_like(u), np.zeros_like(u), np.zeros_like(u)
    for k in range(1, 9):
        damped = np.exp(-2.0 * np.square(np.pi * k / step) * variance)
        angle = 2.0 * np.pi * k * u / step
        sines += damped * np.sin(angle) / k
        cosines += damped * np.cos(angle)
        cosines2 += damped * np.cos(angle) / k**2
    return sines, cosines, cosines2


@dataclass(frozen=True)
class MissingCodes(CatalogueEffect):
    """Keeps only every q-th code: y' = q·⌊y/q⌋.

    Moments are those of a quantised normal variable, exact also where the noise is below the step.

    Source: reduced bit depth behind a wider output; missing codes of a converter.
    """

    name = "missing_codes"
    stage = Stage.DIGITAL
    unit_in = DIGITAL_NUMBER
    unit_out = DIGITAL_NUMBER
    where = "signal"
    block = "comb"
    trials = (
        {"step_codes": 2.0},
        {"step_codes": 3.0},
        {"step_codes": 4.0},
        {"step_codes": 5.0},
        {"step_codes": 6.0},
        {"step_codes": 8.0},
        {"step_codes": 10.0},
        {"step_codes": 12.0},
        {"step_codes": 16.0},
        {"step_codes": 32.0},
        {"step_codes": 64.0},
    )
    fitted = ()
    settles = "any capture with noise above three steps"
    step_codes: float = parameter(1.0, "1", 1.0, 4096.0, source="spacing of the codes that occur")

    def mean(self, signal: Signal, context: ExposureContext) -> Signal:
        """Return the code that stands for a value."""
        return cast(Signal, self.step_codes * np.floor((signal + 1e-6) / self.step_codes))

    def moments(self, before: Moments, context: ExposureContext) -> Moments:
        """Return the moments of the coarser code."""
        q = self.step_codes
        # Until here the value was rounded to whole codes; half a code is what rounding and cutting differ by.
        narrow2 = np.maximum(before.variance - 1.0 / 12.0, 1e-6)
        spread2 = narrow2 + before.spatial_variance
        u = before.mean + 0.5
        sines, cosines, cosines2 = _harmonics(u, spread2, q)
        error = q / 2.0 - q / np.pi * sines
        square = q**2 / 3.0 + (q / np.pi) ** 2 * cosines2 - q**2 / np.pi * sines
        variance = narrow2 + square - error**2 + 4.0 * narrow2 * cosines
        after = replace(before, mean=u - error, variance=np.maximum(variance, 0.0))
        return replace(after, comb_step=q) if isinstance(after, TileMoments) else after
