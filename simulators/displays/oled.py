"""An organic light-emitting display: true black, γ 2.2."""

from __future__ import annotations

from typing import Final

from simulators.displays.base import DisplayModel, MuraSpot
from simulators.displays.lcd import WHITE


def power_transfer(drive: float) -> float:
    """Return the relative light of a drive 0..1: a power law of 2.2."""
    return float(drive**2.2)


# Nearly as bright from the side; a bright spot of 1 % next to the right edge.
OLED: Final = DisplayModel(
    "OLED", power_transfer, 0.6 * WHITE, 0.0, warm_up_rel=-0.004, warm_up_s=300.0, angle_exponent=0.4,
    mura=(MuraSpot(0.94, 0.30, 0.05, 0.01),),
)  # fmt: skip
