"""Light of the output amplifier, which reaches the pixels near its corner."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from simulators.effects.base import ELECTRONS, Stage, parameter
from simulators.effects.catalogue import Offset, dark_exposures_vary
from simulators.effects.context import ExposureContext


@dataclass(frozen=True)
class AmplifierGlow(Offset):
    """Adds electrons that fall off from a corner: n' = n + g·t·exp(−(r/d)^p), r the distance in diagonals.

    p is 1 for light that scatters in the silicon, and up to 2 where it leaves through a window.

    They gather as long as the exposure lasts, in darkness as well, and carry shot noise; temperature hardly matters.

    Source: Janesick (2001), Scientific Charge-Coupled Devices, ch. 7: luminescence of the output transistor.
    """

    name = "amplifier_glow"
    stage = Stage.ELECTRONS
    unit_in = unit_out = ELECTRONS
    before = "shot_noise"
    where = "image_x"
    block = "mean"
    also = ("slope", "variance")
    is_steep = True
    signal_power = 0
    log_prior_odds = -0.5
    prior_reason = "cameras for long exposures switch the amplifier off"
    trials = tuple(
        {"rate_e_per_s": rate, "decay_share": 0.15, "from_right": right, "from_below": below}
        for rate in (20.0, 500.0)
        for right in (0.0, 1.0)
        for below in (0.0, 1.0)
    )
    fitted = ("rate_e_per_s", "decay_share")
    bends = ("power",)
    settles = "dark frames of long exposure"
    rate_e_per_s: float = parameter(0.0, "e-/s", 0.0, 1e6, source="at the corner: 1 to 1000 e⁻/s")
    decay_share: float = parameter(0.15, "1", 0.02, 0.5, source="share of the diagonal; a longer one is an even leak")
    power: float = parameter(1.0, "1", 0.5, 3.0, source="1 by scattering to 2 for a bell")
    from_right: float = parameter(0.0, "1", 0.0, 1.0, source="1 where the amplifier is on the right")
    from_below: float = parameter(0.0, "1", 0.0, 1.0, source="1 where the amplifier is at the last rows")

    @classmethod
    def covers(cls, context: ExposureContext) -> tuple[Self, ...]:
        """Return a bell at each corner."""
        corners = [(right, below) for right in (0.0, 1.0) for below in (0.0, 1.0)]
        return tuple(cls(100.0, 0.2, 2.0, right, below) for right, below in corners)

    @classmethod
    def usable(cls, context: ExposureContext) -> bool:
        """Return whether there are dark frames of two exposures: only they show what grows with exposure."""
        return dark_exposures_vary(context)

    def offset(self, context: ExposureContext) -> Any:
        geometry = context.geometry
        x, y = self.from_right * (geometry.sensor_width - 1), self.from_below * (geometry.sensor_height - 1)
        away = np.hypot(geometry.x_px - x, geometry.y_px - y) / np.hypot(geometry.sensor_width, geometry.sensor_height)
        return self.rate_e_per_s * context.settings.exposure_s * np.exp(-((away / self.decay_share) ** self.power))
