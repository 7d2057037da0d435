"""Columns that differ from each other."""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import numpy as np

from simulators.effects.base import ELECTRONS, Stage, parameter
from simulators.effects.catalogue import CatalogueEffect
from simulators.effects.context import ExposureContext, Signal
from simulators.effects.tile_moments import TileMoments


@dataclass(frozen=True)
class ColumnPattern(CatalogueEffect):
    """Adds a fixed offset to each column, normal with standard deviation s.

    Source: column amplifiers of CMOS sensors; typical 0.1 to 1 e-.
    """

    name = "column_pattern"
    stage = Stage.READOUT
    unit_in = ELECTRONS
    unit_out = ELECTRONS
    where = "image_x"
    block = "columns"
    acts_by_square = True
    trials = (
        {"sigma_e": 0.3},
        {"sigma_e": 1.0},
    )
    fitted = ("sigma_e",)
    settles = "an average of many dark frames"
    sigma_e: float = parameter(0.0, "e-", 0.0, 1000.0, source="engineering prior; refined on a real rig")

    def mean(self, signal: Signal, context: ExposureContext) -> Signal:
        """Return the signal unchanged: the pattern averages to zero."""
        return signal

    def slope(self, signal: Signal, context: ExposureContext) -> float:
        """Return 1."""
        return 1.0

    def sample(self, signal: Signal, context: ExposureContext, rng: np.random.Generator) -> Signal:
        """Return the signal with this camera's column pattern."""
        pattern = context.fixed_rng(self.name).standard_normal((1, signal.shape[1]), dtype=np.float32)
        return cast(Signal, signal + self.sigma_e * pattern)

    def spatial_variance(self, signal: Signal, context: ExposureContext) -> float:
        """Return s² in e-² for a lone pixel."""
        return self.sigma_e**2

    def tile(self, after: TileMoments, before: TileMoments, context: ExposureContext) -> TileMoments:
        """Return the moments with the pattern booked as one of columns."""
        columns = before.fixed_column_variance + self.sigma_e**2
        return after.changed(spatial_variance=before.spatial_variance, fixed_column_variance=columns)
