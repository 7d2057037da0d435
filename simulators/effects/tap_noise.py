"""Quarters of the sensor whose amplifiers have different read noise."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, cast

import numpy as np

from simulators.effects.base import ELECTRONS, PRIOR, KeepsMean, Stage, parameter
from simulators.effects.context import ExposureContext, Signal
from simulators.effects.quarters import OfTaps, trials


@dataclass(frozen=True)
class TapNoise(KeepsMean, OfTaps):
    """Adds normal noise that is even within each quarter: σ² = D − min D, D = a·s_x + b·s_y + c·s_x·s_y.

    The quietest quarter has the noise that is stated; more noise in all of them is `excess_read_noise`. A table holds
    what each tap adds to the stated noise: which tap is the quietest is not assumed while they are fitted.

    Source: Janesick (2001), Scientific Charge-Coupled Devices, ch. 2: each output amplifier has its own noise.
    """

    name = "tap_noise"
    stage = Stage.READOUT
    unit_in = unit_out = ELECTRONS
    where = "image_x"
    block = "variance"
    trials = trials((4.0, -4.0), ("across_e2", "along_e2", "corner_e2"))
    fitted = ("across_e2", "along_e2", "corner_e2")
    table = "taps_e2"
    table_start = 4.0
    first_fitted = 0
    settles = "many frames of no exposure"
    across_e2: float = parameter(0.0, "e-2", -1e5, 1e5, source=PRIOR)
    along_e2: float = parameter(0.0, "e-2", -1e5, 1e5, source=PRIOR)
    corner_e2: float = parameter(0.0, "e-2", -1e5, 1e5, source=PRIOR)
    taps_e2: tuple[float, ...] = parameter((), "e-2", -100000.0, 100000.0, source="of every tap")

    def reach(self, parameter: str, full_scale_dn: float) -> tuple[float, float]:
        """Return the bounds of a fit; those of a table begin at no noise."""
        low, high = super().reach(parameter, full_scale_dn)
        return (0.0, high) if parameter == self.table else (low, high)

    def sample(self, signal: Signal, context: ExposureContext, rng: np.random.Generator) -> Signal:
        sigma = np.sqrt(self.variance(signal, context))
        return cast(Signal, (signal + sigma * rng.standard_normal(signal.shape)).astype(signal.dtype))

    def variance(self, signal: Signal, context: ExposureContext) -> Any:
        if self.taps_e2:
            return self.sizes(context) + np.mean(self.taps_e2) - min(0.0, *self.taps_e2)
        a, b, c = self.across_e2, self.along_e2, self.corner_e2
        return self.sizes(context) - min(a + b + c, a - b - c, b - a - c, c - a - b)
