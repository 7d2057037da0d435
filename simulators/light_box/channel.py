"""One channel of the simulated light box: its LED, and what it does from millisecond to millisecond.

Independent of the code that calibrates or drives a box.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

AMBIENT_C: Final = 25.0  # at which datasheets state LEDs


@dataclass(frozen=True, slots=True)
class LedParameters:
    """One LED channel."""

    peak_nm: float | None  # peak wavelength at 25 °C in nm; None for white
    fwhm_nm: float  # full width of the line at half maximum in nm
    full_radiance_w_sr_m2: float  # radiance at full duty and high current, cold
    low_current_ratio: float = 1 / 256  # low current over high current
    # Efficiency at the low current over that at the high one; InGaN LEDs are more efficient at low current density
    # (efficiency droop)
    low_efficacy_gain: float = 1.15
    heating_kelvin: float = 30.0  # rise of the junction above ambient at full duty and high current, settled
    heating_tau_s: float = 45.0  # time constant of that rise
    efficiency_per_kelvin: float = -0.002  # relative change of the efficiency per kelvin
    peak_shift_nm_per_kelvin: float = 0.04  # shift of the peak per kelvin
    turn_on_s: float = 20e-9  # time constant with which the light rises in each PWM pulse
    pwm_period_s: float = 64e-6  # period of the timer behind the channel
    duty_steps: int = 8192  # duty steps
    dither_periods: int = 8  # timer periods over which a duty is dithered


@dataclass(frozen=True, slots=True)
class Emission:
    """What a channel emits, averaged over its PWM: radiance in W·sr⁻¹·m⁻² and peak wavelength in nm."""

    radiance_w_sr_m2: float
    peak_nm: float | None


_WHITE = LedParameters(None, 0.0, 3.0, pwm_period_s=128e-6, duty_steps=1024, dither_periods=4)
_BLUE = LedParameters(453.0, 22.0, 2.0)
_RED = LedParameters(
    640.0, 18.0, 1.0, low_efficacy_gain=0.9, efficiency_per_kelvin=-0.006, peak_shift_nm_per_kelvin=0.13
)
REFERENCE_LEDS: Final = {
    "bleach": _WHITE,
    "spot": _BLUE,
    "spot_red": _RED,
    "fixation": replace(_RED, full_radiance_w_sr_m2=0.5, pwm_period_s=128e-6, duty_steps=1024, dither_periods=4),
    "spot_green": replace(_BLUE, peak_nm=505.0, fwhm_nm=30.0),
    # A chip-on-board field of a few W behind a diffuser: some 12 000 cd/m² cold at full duty; slow and hot.
    "field": replace(_WHITE, full_radiance_w_sr_m2=38.0, heating_kelvin=40.0, heating_tau_s=90.0),
}


@dataclass(slots=True)
class LedState:
    """One LED with its temperature; time only runs forwards."""

    parameters: LedParameters  # what LED it is
    _duty: float = 0.0
    _high: bool = False
    _rise_kelvin: float = 0.0
    _time_s: float = field(default=0.0)

    def drive(self, duty: float, *, high: bool, time_s: float) -> None:
        """Set duty (0 to 1) and current range from `time_s` on."""
        self._settle(time_s)
        self._duty, self._high = duty, high

    def emission(self, time_s: float) -> Emission:
        """Return what it emits at `time_s`, averaged over its PWM."""
        self._settle(time_s)
        led = self.parameters
        radiance = self._peak_radiance() * effective_duty(led, self._duty)
        peak_nm = None if led.peak_nm is None else led.peak_nm + led.peak_shift_nm_per_kelvin * self._rise_kelvin
        return Emission(radiance, peak_nm)

    def waveform(self, times_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the radiance in W·sr⁻¹·m⁻² at instants within one moment of constant temperature.

        Args:
            times_s: Times in s, any shape; period 0 starts at 0.
        """
        led = self.parameters
        period = np.floor(times_s / led.pwm_period_s)
        within_s = times_s - period * led.pwm_period_s
        on_s = _pulse_widths(led, self._duty)[(period % led.dither_periods).astype(np.int64)]
        rising = 1.0 - np.exp(-within_s / led.turn_on_s)
        return np.where(within_s < on_s, self._peak_radiance() * rising, 0.0)

    def _peak_radiance(self) -> float:
        led = self.parameters
        current = 1.0 if self._high else led.low_current_ratio * led.low_efficacy_gain
        return led.full_radiance_w_sr_m2 * current * (1.0 + led.efficiency_per_kelvin * self._rise_kelvin)

    def _settle(self, time_s: float) -> None:
        led = self.parameters
        power = self._duty * (1.0 if self._high else led.low_current_ratio)
        final_kelvin = led.heating_kelvin * power
        elapsed_s = max(time_s - self._time_s, 0.0)
        self._rise_kelvin = final_kelvin + (self._rise_kelvin - final_kelvin) * math.exp(-elapsed_s / led.heating_tau_s)
        self._time_s = max(time_s, self._time_s)


def effective_duty(led: LedParameters, duty: float) -> float:
    """Return the duty less the light lost while each pulse rises: mean of on − τ(1 − e^(−on/τ)) over the dithering."""
    on_s = _pulse_widths(led, duty)
    lost_s = led.turn_on_s * (1.0 - np.exp(-on_s / led.turn_on_s))
    return float(np.mean(on_s - lost_s) / led.pwm_period_s)


def _pulse_widths(led: LedParameters, duty: float) -> NDArray[np.float64]:
    """Return the width of the pulse in each period of the dithering cycle, in s."""
    steps = round(duty * led.duty_steps)
    base, extra = divmod(steps, led.dither_periods)
    counts = np.full(led.dither_periods, float(base))
    counts[np.floor(np.arange(extra) * led.dither_periods / max(extra, 1)).astype(np.int64)] += 1.0
    count_s = led.pwm_period_s * led.dither_periods / led.duty_steps
    return counts * count_s


@dataclass(frozen=True, slots=True)
class ChannelLimits:
    """What the box says of a channel: name, peak in nm (0: white), duty steps, level limits, energy bucket."""

    name: str
    peak_nm: int
    steps: int
    low_limit: int
    high_limit: int
    bucket: int
    refill: int


REFERENCE_CHANNELS = (
    ChannelLimits("bleach", 0, 1024, 65535, 60000, 47_000_000, 78),
    ChannelLimits("spot", 453, 8192, 65535, 60000, 846_000_000, 1410),
    ChannelLimits("spot_red", 640, 8192, 65535, 60000, 846_000_000, 1410),
    ChannelLimits("fixation", 640, 1024, 65535, 20000, 846_000_000, 1410),
    ChannelLimits("spot_green", 505, 8192, 65535, 60000, 846_000_000, 1410),
    ChannelLimits("field", 0, 1024, 65535, 60000, 70_500_000, 118),
)
CHANNELS_OF_VERSION = {1: 4, 2: 6}
PARTNERS = {"bleach": "field", "field": "bleach", "spot_red": "spot_green", "spot_green": "spot_red"}


PARTS = 64  # as the firmware
SOON_MS, AHEAD_MS = 256, 512  # as the firmware
PARTS_BEFORE_RAISING = 4  # as the firmware: EEPROM cells wear out


@dataclass(slots=True)
class Channel:
    """State of one channel; `mode` is O, S, R, P or B as on the wire."""

    limits: ChannelLimits  # what is built in
    bucket: int  # energy units left
    # 64ths of the full bucket that the box's memory holds: a reset leaves these. 64 in a box that has rested
    kept: int = PARTS
    mode: str = "O"
    high: bool = False  # whether at the high current
    level: int = 0  # level driven now
    bright: bool = False
    left_ms: int = 0
    on_ms: int = 0
    off_ms: int = 0
    blinks_left: int = 0
    start_level: int = 0
    target: int = 0

    def refusal(self, level: int, high: bool, bright_ms: int) -> int:
        """Return 0, or 5 (level) or 6 (energy) where the box would refuse."""
        if level > (self.limits.high_limit if high else self.limits.low_limit):
            return 5
        return 6 if bright_ms > self.bucket // cost_per_ms(level, high) else 0

    def start(self, mode: str, level: int, high: bool, on_ms: int = 0, off_ms: int = 0, count: int = 0) -> None:
        """Shine steadily (S), for a while (P) or blinking (B)."""
        self.mode = mode if level else "O"
        self.level, self.high, self.bright = level, high, level > 0
        self.left_ms = self.on_ms = on_ms
        self.off_ms, self.blinks_left = off_ms, count
        if level:
            self._lower(self.bucket, cost_per_ms(level, high))

    def start_ramp(self, target: int, high: bool, duration_ms: int) -> None:
        """Move to a level in a straight line."""
        self.start_level = self.level if self.bright else 0
        self.mode, self.high, self.bright = "R", high, True
        self.level, self.target = self.start_level, target
        self.left_ms = self.on_ms = duration_ms
        self._lower(self.bucket, cost_per_ms(max(self.start_level, target), high))

    def restart(self) -> None:
        """Go dark with what the memory holds in the bucket."""
        self.darken()
        self.bucket = self.limits.bucket * self.kept // PARTS

    def darken(self) -> None:
        """Go dark and forget what was planned."""
        self.mode, self.high, self.bright, self.level = "O", False, False, 0

    @property
    def driven_level(self) -> int:
        """Return the level that reaches the LED now."""
        return self.level if self.bright else 0

    def ms_to_change(self) -> int | None:
        """Return after how many ms something changes by itself; None where nothing does."""
        times = []
        if self.mode in "PB":
            times.append(self.left_ms)
        if self.mode == "R":
            times.append(1)
        if self.bright:
            times.append(self.bucket // cost_per_ms(self.level, self.high) + 1)
        return max(min(times), 1) if times else None

    def advance(self, ms: int) -> bool:
        """Let `ms` milliseconds pass, at most `ms_to_change`; return whether the bucket ran empty."""
        if not self._account(ms):
            return True
        self.left_ms -= ms
        if self.mode == "R":
            self._ramp()
        elif self.mode == "P" and self.left_ms <= 0:
            self.darken()
        elif self.mode == "B" and self.left_ms <= 0:
            self._turn()
        return False

    def _account(self, ms: int) -> bool:
        if not self.bright:
            self.bucket = min(self.limits.bucket, self.bucket + ms * self.limits.refill)
            self._raise()
            return True
        each = cost_per_ms(self.level, self.high)
        before, cost = self.bucket, each * ms
        self.bucket = self.bucket - cost if cost <= self.bucket else self.bucket % each
        while self._lower(before - (before - self._soon(each)) // each * each - each, each):
            pass  # the memory falls at the first ms at which it is due, again and again on the way
        if cost > before:  # the whole milliseconds before the last were bright
            self.darken()
            return False
        return True

    def _soon(self, each: int) -> int:
        """Return the units below which the memory is lowered."""
        return self.limits.bucket * self.kept // PARTS + SOON_MS * each

    def _lower(self, units: int, each: int) -> bool:
        """Lower the memory where a bucket of `units` is due for it, and was reached; return whether it was."""
        if not self.kept or not self.bucket <= units < self._soon(each):
            return False
        self.kept = self._parts(max(units - AHEAD_MS * each, 0))
        return True

    def _raise(self) -> None:
        if self.kept >= PARTS - 1:
            return
        while (there := self._parts(self.bucket)) >= self.kept + PARTS_BEFORE_RAISING:
            self.kept = min(there - 1, self.kept + PARTS_BEFORE_RAISING - 1)
        if self.bucket == self.limits.bucket:
            self.kept = max(self.kept, PARTS - 1)

    def _parts(self, units: int) -> int:
        """Return the 64ths, short of all, that are at most so many units."""
        return min(PARTS - 1, ((units + 1) * PARTS - 1) // self.limits.bucket)

    def _ramp(self) -> None:
        passed = self.on_ms - self.left_ms
        way = abs(self.target - self.start_level) * passed // self.on_ms
        self.level = self.start_level + (way if self.target > self.start_level else -way)
        if self.left_ms <= 0:
            self.mode = "S" if self.target else "O"
            self.level, self.bright = self.target, self.target > 0

    def _turn(self) -> None:
        if self.bright and self.blinks_left:
            self.blinks_left -= 1
            if self.blinks_left == 0:
                self.darken()
                return
        self.bright = not self.bright
        self.left_ms = self.on_ms if self.bright else self.off_ms


def cost_per_ms(level: int, high: bool) -> int:
    """Return the energy units that a bright millisecond takes from the bucket."""
    return (level >> 8) + 1 if high else 1


def steps_of(level: int, steps: int) -> int:
    """Return the duty step nearest to a level; 65535 is all of them."""
    return ((level + (level >= 32768)) * steps + 32768) // 65536
