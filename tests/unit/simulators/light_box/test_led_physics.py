"""The simulated LEDs' physics."""

from __future__ import annotations

import numpy as np
import pytest

from simulators.light_box.led_physics import REFERENCE_LEDS, LedState, effective_duty

BLUE = REFERENCE_LEDS["spot"]


def test_radiance_starts_at_the_cold_value_and_droops_by_the_stated_amount():
    """At full duty the settled radiance is below the cold one by efficiency times heating."""
    led = LedState(BLUE)
    led.drive(1.0, high=True, time_s=0.0)
    cold = led.emission(0.0).radiance_w_sr_m2
    settled = led.emission(20 * BLUE.heating_tau_s).radiance_w_sr_m2
    assert settled / cold == pytest.approx(1 + BLUE.efficiency_per_kelvin * BLUE.heating_kelvin, rel=1e-6)


def test_half_of_the_droop_is_there_after_tau_ln_2():
    """Warm-up is exponential with the stated time constant."""
    led = LedState(BLUE)
    led.drive(1.0, high=True, time_s=0.0)
    cold = led.emission(0.0).radiance_w_sr_m2
    half = led.emission(BLUE.heating_tau_s * np.log(2)).radiance_w_sr_m2
    assert 1 - half / cold == pytest.approx(-BLUE.efficiency_per_kelvin * BLUE.heating_kelvin / 2, rel=1e-6)


def test_mean_of_the_waveform_is_the_emission():
    """What an integrating detector sees over whole dithering cycles is the stated mean."""
    led = LedState(BLUE)
    duty = 1001 / 8192
    led.drive(duty, high=True, time_s=0.0)
    cycle_s = BLUE.pwm_period_s * BLUE.dither_periods
    times_s = (np.arange(800_000) + 0.5) * cycle_s / 800_000
    assert led.waveform(times_s).mean() == pytest.approx(led.emission(0.0).radiance_w_sr_m2, rel=2e-5)


def test_low_current_is_dimmer_by_ratio_and_more_efficient():
    """The ranges' ratio is not exactly that of the currents: it has to be measured."""
    low, high = LedState(BLUE), LedState(BLUE)
    low.drive(0.5, high=False, time_s=0.0)
    high.drive(0.5, high=True, time_s=0.0)
    ratio = low.emission(0.0).radiance_w_sr_m2 / high.emission(0.0).radiance_w_sr_m2
    assert ratio == pytest.approx(BLUE.low_current_ratio * BLUE.low_efficacy_gain, rel=1e-9)


def test_short_pulses_lose_light():
    """At the smallest duties the turn-on takes its share, so that radiance is not proportional to level."""
    assert effective_duty(BLUE, 8 / 8192) / (8 / 8192) < 0.75
    assert effective_duty(BLUE, 0.5) / 0.5 == pytest.approx(1.0, abs=1e-3)


def test_dark_is_dark():
    """Duty 0 emits nothing."""
    assert LedState(BLUE).emission(5.0).radiance_w_sr_m2 == 0.0


def test_peak_shifts_with_temperature():
    """A warm LED is redder by the stated shift."""
    led = LedState(BLUE)
    led.drive(1.0, high=True, time_s=0.0)
    shift_nm = BLUE.peak_shift_nm_per_kelvin * BLUE.heating_kelvin
    assert led.emission(1e4).peak_nm == pytest.approx(BLUE.peak_nm + shift_nm, abs=1e-6)
