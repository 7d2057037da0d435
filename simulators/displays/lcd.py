"""A liquid-crystal monitor by sRGB's curve: 250 cd·m⁻² white, 0.1 cd·m⁻² black, a backlight that warms up."""

from __future__ import annotations

from typing import Final

from simulators.displays.base import DisplayModel, MuraSpot

# Radiance that stands for 250 and 0.1 cd/m² at some 340 lm/W, the efficacy of an LED-lit white.
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
