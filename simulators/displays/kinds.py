"""Kinds of display: an sRGB LCD, an LCD dimmed by pulses, and an organic light-emitting one with true black."""

from __future__ import annotations

from typing import Final

from simulators.displays.base import DisplayModel, MuraSpot

# Radiance of 250 and 0.1 cd/m² at some 340 lm/W, the efficacy of an LED-lit white.
WHITE: Final = 250.0 / 340.0
BLACK: Final = 0.1 / 340.0  # 0.1 cd/m² of white at 340 lm/W


def srgb_transfer(drive: float) -> float:
    """Return the relative light of a drive 0..1. Source: IEC 61966-2-1, equation of the decoding."""
    return drive / 12.92 if drive <= 0.04045 else float(((drive + 0.055) / 1.055) ** 2.4)


# Falls off to the side and shines through when dark, as twisted and in-plane panels do; one dark spot of 1.5 %.
LCD: Final = DisplayModel(
    "sRGB LCD", srgb_transfer, WHITE, BLACK, warm_up_rel=0.03, edge_falloff=0.08, halation_rel=5e-4,
    angle_exponent=1.5, angle_leak=4.0, mura=(MuraSpot(0.22, 0.72, 0.045, -0.015),),
)  # fmt: skip


def power_transfer(drive: float) -> float:
    """Return the relative light of a drive 0..1: a power law of 2.2."""
    return float(drive**2.2)


# Nearly as bright from the side; a bright spot of 1 % next to the right edge.
OLED: Final = DisplayModel(
    "OLED", power_transfer, 0.6 * WHITE, 0.0, warm_up_rel=-0.004, warm_up_s=300.0, angle_exponent=0.4,
    mura=(MuraSpot(0.94, 0.30, 0.05, 0.01),),
)  # fmt: skip

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
