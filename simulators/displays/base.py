"""What a simulated display is: a curve, primaries, a black, a backlight that warms up and may be pulsed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from radiometer.devices import DisplayPatch
from radiometer.devices.opening import Opened
from radiometer.errors import DeviceError, SettingOutOfRange
from simulators.clock import SimulatedClock


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

    def open(self) -> None:
        """Switch it on. Raises DeviceError if it is on already."""
        if self._open:
            raise DeviceError(f"{self.model.name}: is on already; close it first")
        self._open, self._on_since_s = True, self.clock.now_s()

    def close(self) -> None:
        """Switch it off; closing twice does nothing."""
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
        """Return the radiance in W·sr⁻¹·m⁻² of a drive when warm, averaged over the dimming."""
        steps = 2**self.model.bits - 1
        light = sum(
            share * self.model.transfer(round(drive * steps) / steps)
            for share, drive in zip(self.model.primary_shares, rgb, strict=True)
        )
        return self.model.black_radiance + (self.model.white_radiance - self.model.black_radiance) * light

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
