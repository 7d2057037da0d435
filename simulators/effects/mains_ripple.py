"""A source that flickers with the mains."""

from __future__ import annotations

from dataclasses import dataclass

from simulators.effects.base import PRIOR, parameter
from simulators.effects.flicker import Flicker


@dataclass(frozen=True)
class MainsRipple(Flicker):
    """Modulates light at twice the mains frequency: L' = L·(1 + m·sin(2π·f·t + φ)), φ new in every frame.

    Zero for exposures of whole periods (10 ms at 100 Hz, 8.33 ms at 120 Hz).

    Source: rectified mains, 100 or 120 Hz.
    """

    name = "mains_ripple"
    trials = ({"modulation": 0.02, "frequency_hz": 100.0}, {"modulation": 0.02, "frequency_hz": 120.0})
    fitted = ("modulation",)
    settles = "exposures of 9, 10 and 11 ms"
    modulation: float = parameter(0.0, "1", 0.0, 3.0, source=PRIOR)
    frequency_hz: float = parameter(100.0, "Hz", 20.0, 1000.0, source="100 or 120 Hz")
