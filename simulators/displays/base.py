"""Simulated displays: a curve, primaries, a black, a backlight that warms up or is pulsed, light over the screen."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radiometer.devices import DisplayPatch
from radiometer.devices.opening import Opened
from radiometer.errors import DeviceError, SettingOutOfRange
from simulators.clock import SimulatedClock

_STEEPEST_DEG: Final = 80.0  # beyond it a screen is seen as a line


@dataclass(frozen=True, slots=True)
class MuraSpot:
    """A round spot whose light differs from its surroundings, with a Gaussian profile."""

    x: float  # its middle from the left edge as a share of the width
    y: float  # its middle from the upper edge as a share of the height
    sigma: float  # its standard deviation as a share of the height
    depth_rel: float  # relative change of light in its middle; below 0 for a dark spot


@dataclass(frozen=True, slots=True)
class DisplayModel:
    """The truth about a display."""

    name: str  # its name
    transfer: Callable[[float], float]  # relative light 0..1 of a drive 0..1, before black and warm-up
    white_radiance: float  # radiance of white in W·sr⁻¹·m⁻² when warm
    black_radiance: float  # radiance of black in W·sr⁻¹·m⁻² when warm: leaks in proportion to the backlight
    primary_shares: tuple[float, float, float] = (0.25, 0.45, 0.30)  # share of red, green and blue in white's radiance
    bits: int = 8  # bits per channel that it resolves
    warm_up_rel: float = 0.0  # relative excess of the cold backlight, gone with `warm_up_s`
    warm_up_s: float = 600.0  # time constant of warming up in s
    pwm_hz: float = 0.0  # frequency of its dimming in Hz; 0 for none
    pwm_duty: float = 1.0  # share of the period in which it is lit
    edge_falloff: float = 0.0  # relative loss of light in the corners
    mura: tuple[MuraSpot, ...] = ()  # spots of other light
    halation_rel: float = 0.0  # share of the picture's mean radiance that the panel's glass spreads over the screen
    angle_exponent: float = 0.0  # light above black falls with cos(angle) to this power
    angle_leak: float = 0.0  # relative growth of black at 90°, in proportion to sin²(angle)


class SimulatedDisplay(Opened):
    """A Display whose radiance is known.

    Args:
        clock: Simulated time; switching on counts from when it is opened.
        settling_s: Time until a new patch is on screen.
    """

    def __init__(self, model: DisplayModel, clock: SimulatedClock | None = None, *, settling_s: float = 0.1) -> None:
        self.model, self.clock = model, clock or SimulatedClock()
        self._settling_s, self._open, self._on_since_s = settling_s, False, 0.0
        self.shown = DisplayPatch((0.0, 0.0, 0.0))
        self.angle_deg = 0.0  # between its normal and whoever looks at it

    def turn(self, angle_deg: float) -> None:
        """Turn it so that it is seen at an angle from its normal. Raises SettingOutOfRange beyond ±80°."""
        if not abs(angle_deg) <= _STEEPEST_DEG:
            raise SettingOutOfRange(self.model.name, "angle", angle_deg, -_STEEPEST_DEG, _STEEPEST_DEG, "°")
        self.angle_deg = angle_deg

    def open(self) -> None:
        """Switch it on. Raises DeviceError if it is on already."""
        if self._open:
            raise DeviceError(f"{self.model.name}: is on already; close it first")
        self._open, self._on_since_s = True, self.clock.now_s()

    def close(self) -> None:
        self._open = False

    def show(self, patch: DisplayPatch) -> None:
        """Show a patch; the clock moves on until it is on screen. Raises DeviceError, SettingOutOfRange."""
        if not self._open:
            raise DeviceError(f"{self.model.name}: is off; open it first")
        for drive in patch.rgb:
            if not 0.0 <= drive <= 1.0:
                raise SettingOutOfRange(self.model.name, "drive", drive, 0.0, 1.0, "")
        self.shown = patch
        self.clock.advance(self._settling_s)

    def radiance(self, rgb: tuple[float, float, float]) -> float:
        """Return the radiance in W·sr⁻¹·m⁻² of a drive in the middle when warm, averaged over the dimming."""
        steps = 2**self.model.bits - 1
        light = sum(
            share * self.model.transfer(round(drive * steps) / steps)
            for share, drive in zip(self.model.primary_shares, rgb, strict=True)
        )
        angle = np.radians(self.angle_deg)
        black = self.model.black_radiance * (1.0 + self.model.angle_leak * np.sin(angle) ** 2)
        range_ = (self.model.white_radiance - self.model.black_radiance) * np.cos(angle) ** self.model.angle_exponent
        return float(black + range_ * light)

    def picture(self, width: int, height: int) -> NDArray[np.float64]:
        """Return the radiance in W·sr⁻¹·m⁻² of what is shown over the screen when warm, shape (height, width)."""
        model, shown = self.model, self.shown
        y, x = np.mgrid[:height, :width]
        across, down = (x + 0.5) / width, (y + 0.5) / height
        u, v = 2 * across - 1, 2 * down - 1
        if shown.checkers is not None:
            columns, rows = shown.checkers
            inside = (np.floor(across * columns) + np.floor(down * rows)) % 2 == 0
        else:
            inside = (np.abs(u) <= shown.width_fraction) & (np.abs(v) <= shown.height_fraction)
        level = np.where(inside, self.radiance(shown.rgb), self.radiance(shown.surround_rgb))
        level = level * (1.0 - model.edge_falloff * (u**2 + v**2) / 2)
        for spot in model.mura:
            away = (((across - spot.x) * width / height) ** 2 + (down - spot.y) ** 2) / spot.sigma**2
            level = level * (1.0 + spot.depth_rel * np.exp(-away / 2))
        return np.asarray(level + model.halation_rel * level.mean())

    def backlight(self, start_s: float, duration_s: float) -> float:
        """Return the mean output of the backlight over a window of time, 1 when warm and not dimmed."""
        warm = self.model.warm_up_rel * float(np.exp(-(start_s - self._on_since_s) / self.model.warm_up_s))
        return (1.0 + warm) * self._pulsed(start_s, duration_s)

    def _pulsed(self, start_s: float, duration_s: float) -> float:
        """Return the lit share of a window of time over the duty: 1 over whole periods."""
        hz, duty = self.model.pwm_hz, self.model.pwm_duty
        if hz == 0.0 or duty >= 1.0:
            return 1.0
        first, last = start_s * hz, (start_s + duration_s) * hz
        return float((_lit_periods(last, duty) - _lit_periods(first, duty)) / (last - first) / duty)


def _lit_periods(phase: float, duty: float) -> float:
    """Return the lit time in periods since phase 0."""
    whole = np.floor(phase)
    return float(whole * duty + min(phase - whole, duty))


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
