"""Channels of the source for which the camera responds differently than assumed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from simulators.effects.base import PRIOR, RADIANCE, Stage, parameter
from simulators.effects.catalogue import Scaling
from simulators.effects.context import ExposureContext

CHANNELS: Final = ("red", "green", "blue")


@dataclass(frozen=True)
class SpectralMismatch(Scaling):
    """Scales the light of each channel shown alone: L' = L·(1 + e_c) for the patterns named red, green and blue.

    Light of all channels together is what the responsivity was stated for and stays.

    Source: a responsivity stated for one spectrum and used for another.
    """

    name = "spectral_mismatch"
    stage = Stage.SOURCE
    unit_in = unit_out = RADIANCE
    where = "pattern"
    block = "mean"
    trials = tuple(
        {"red_rel": red, "green_rel": 0.0, "blue_rel": blue}
        for red, blue in ((0.02, -0.02), (0.02, 0.02), (-0.02, 0.02), (-0.02, -0.02))
    )
    fitted = ("red_rel", "green_rel", "blue_rel")
    settles = "each channel of the source alone"
    red_rel: float = parameter(0.0, "1", -0.9, 5.0, source=PRIOR)
    green_rel: float = parameter(0.0, "1", -0.9, 5.0, source=PRIOR)
    blue_rel: float = parameter(0.0, "1", -0.9, 5.0, source=PRIOR)

    def factor(self, context: ExposureContext) -> Any:
        shown = np.asarray(context.settings.pattern)
        errors = (self.red_rel, self.green_rel, self.blue_rel)
        return 1.0 + sum(np.where(shown == c, e, 0.0) for c, e in zip(CHANNELS, errors, strict=True))

    @classmethod
    def usable(cls, context: ExposureContext) -> bool:
        """Return whether each channel is shown alone, and something else as well."""
        shown = set(np.unique(np.asarray(context.settings.pattern)).tolist())
        return shown.issuperset(CHANNELS) and len(shown) > len(CHANNELS)
