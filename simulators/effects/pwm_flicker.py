"""A source that is dimmed by switching it on and off."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Self

import numpy as np

from simulators.effects.base import PRIOR, parameter
from simulators.effects.context import ExposureContext
from simulators.effects.flicker import Flicker

_FREQUENCIES_HZ: Final = np.geomspace(60.0, 4000.0, 36)
_DUTIES: Final = (0.1, 0.25, 0.4, 0.5, 0.6, 0.75, 0.9)  # the usual dimming steps
_COMB: Final = np.geomspace(0.94, 1.06, 9)  # from halfway to one neighbour to halfway to the other


@dataclass(frozen=True)
class PwmFlicker(Flicker):
    """Modulates light: L' = L·(1 + m·flicker(f·t + φ)), φ new in every frame.

    A duty of 0 is a sine; otherwise a square wave of that duty. Over an exposure t sinc(f·t) of it is left.

    Source: LED and backlight dimming, 100 Hz to some kHz.
    """

    name = "pwm_flicker"
    trials = tuple(
        {"modulation": 0.02, "frequency_hz": float(f), "duty": d} for d in (0.0, 0.5, 0.25) for f in _FREQUENCIES_HZ
    )
    fitted = ("modulation", "frequency_hz")
    settles = "many frames at the shortest exposures"
    modulation: float = parameter(0.0, "1", 0.0, 3.0, source=PRIOR)
    frequency_hz: float = parameter(200.0, "Hz", 20.0, 100000.0, source=PRIOR)
    duty: float = parameter(0.0, "1", 0.0, 0.95, source="0 for a sine")

    def between(self) -> tuple[Self, ...]:
        """Return a dense comb of frequencies.

        Over many periods the light of an exposure depends on the frequency to a small part of a period.
        """
        return tuple(self.with_parameters(frequency_hz=float(self.frequency_hz * factor)) for factor in _COMB)

    def loosened(self, context: ExposureContext) -> tuple[Self, ...]:
        return tuple(self.with_parameters(duty=duty) for duty in _DUTIES if duty != self.duty)
