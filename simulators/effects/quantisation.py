"""Rounding to the codes of the output."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from simulators.effects.base import DIGITAL_NUMBER, Effect, Moments, Stage
from simulators.effects.context import ExposureContext, Signal
from simulators.effects.rounding import rounded


@dataclass(frozen=True)
class Quantisation(Effect):
    """Scales native DN to those of the output's bit depth and rounds to the nearest code.

    `mean` is the unrounded value and the added variance 1/12 DN². With normal noise σ (in codes) before it the true
    mean is at most exp(−2π²σ²)/π codes off (0.002 at σ = 0.5); `moments` is exact with less noise than that too. The
    converter is taken to deliver the output's bits directly (16-bit output is finer than 12-bit output, not shifted).

    Source: EMVA Standard 1288, release 4.0, equation (12).
    """

    name = "quantisation"
    stage = Stage.DIGITAL
    unit_in = unit_out = DIGITAL_NUMBER

    def mean(self, signal: Signal, context: ExposureContext) -> Signal:
        return signal * context.output_scale

    def sample(self, signal: Signal, context: ExposureContext, rng: np.random.Generator) -> Signal:
        codes: Signal = np.rint(signal * context.output_scale)
        return codes

    def variance(self, signal: Signal, context: ExposureContext) -> float:
        return 1.0 / 12.0

    def moments(self, before: Moments, context: ExposureContext) -> Moments:
        return rounded(before.passed(self.mean(before.mean, context), self.slope(before.mean, context)))

    def slope(self, signal: Signal, context: ExposureContext) -> float:
        return context.output_scale
