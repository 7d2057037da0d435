"""LEDs as a light box drives them: level to radiance, self-heating, warm-up, PWM waveform, spectral peak.

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
