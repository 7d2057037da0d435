"""A liquid-crystal monitor whose backlight is dimmed by switching it 240 times a second."""

from __future__ import annotations

from typing import Final

from simulators.displays.base import DisplayModel
from simulators.displays.lcd import BLACK, WHITE

# γ 2.4 with a little light lost near black, as many panels have it: no formula of the trade fits it exactly.
_TOE: Final = 0.02


def toe_transfer(drive: float) -> float:
    """Return the relative light of a drive 0..1: a power law whose start is held down."""
    return float(((drive**2.4) * (drive + _TOE) / (1.0 + _TOE)) if drive < 0.1 else _joined(drive))


def _joined(drive: float) -> float:
    """Continue the toe without a step at 0.1."""
    at_joint = (0.1 + _TOE) / (1.0 + _TOE)
    return float(drive**2.4 * (at_joint + (1.0 - at_joint) * (1.0 - ((1.0 - drive) / 0.9) ** 4)))


PWM_LCD: Final = DisplayModel(
    "PWM-dimmed LCD", toe_transfer, 0.4 * WHITE, 0.4 * BLACK, warm_up_rel=0.02, pwm_hz=240.0, pwm_duty=0.4
)
