"""Dark currents that differ from pixel to pixel."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, cast

import numpy as np

from simulators.effects.base import ELECTRONS, Stage, parameter
from simulators.effects.catalogue import CatalogueEffect, warmer_k
from simulators.effects.context import ExposureContext, Signal


@dataclass(frozen=True)
class DarkCurrentNonuniformity(CatalogueEffect):
    """Adds to each pixel a fixed share of thermal electrons: S grows by p·t·2^((T − T₀)/T_d), p varies by s.

    The pattern is log-normal less its mean: a few pixels leak much more than the others.

    Source: EMVA Standard 1288, release 4.0, DCNU; the tail as seen in CMOS datasheets.
    """

    name = "dark_current_nonuniformity"
    stage = Stage.ELECTRONS
    unit_in = ELECTRONS
    unit_out = ELECTRONS
    before = "shot_noise"
    where = "exposure_s"
    block = "spatial"
    trials = (
        {"sigma_e_per_s": 1.0},
        {"sigma_e_per_s": 10.0},
    )
    fitted = ("sigma_e_per_s",)
    settles = "dark frames at two long exposures"
    sigma_e_per_s: float = parameter(0.0, "e- s-1", 0.0, 100000.0, source="engineering prior; refined on a real rig")
    reference_C: float = parameter(25.0, "°C", -100.0, 150.0, source="temperature that the figure holds at")  # noqa: N815
    doubling_K: float = parameter(7.0, "K", 2.0, 30.0, source="silicon: 6 to 8 K")  # noqa: N815

    def mean(self, signal: Signal, context: ExposureContext) -> Signal:
        """Return the signal unchanged: the pattern averages to zero."""
        return signal

    def slope(self, signal: Signal, context: ExposureContext) -> float:
        """Return 1."""
        return 1.0

    def sample(self, signal: Signal, context: ExposureContext, rng: np.random.Generator) -> Signal:
        """Return the signal with this camera's pattern of leaks; never below zero."""
        shape = 0.5
        tail = np.exp(shape * context.fixed_rng(self.name).standard_normal(signal.shape))
        average, spread = math.exp(shape**2 / 2), math.sqrt((math.exp(shape**2) - 1.0) * math.exp(shape**2))
        pattern = (tail - average) / spread
        leaked = np.maximum(signal + pattern * self.electrons(context), 0.0)
        return cast(Signal, leaked.astype(signal.dtype))

    def spatial_variance(self, signal: Signal, context: ExposureContext) -> Any:
        """Return the pattern's variance in e-²."""
        return np.square(self.electrons(context))

    def electrons(self, context: ExposureContext) -> Any:
        """Return the pattern's standard deviation in electrons."""
        warmer = 2.0 ** (warmer_k(context, self.reference_C) / self.doubling_K)
        return self.sigma_e_per_s * warmer * context.settings.exposure_s
