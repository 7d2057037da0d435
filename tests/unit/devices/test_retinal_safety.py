"""Retinal exposure limits against the standard's own figures."""

from __future__ import annotations

import math

import numpy as np
import pytest

from radiometer.devices.exposure_ledger import ExposureLedger
from radiometer.devices.retinal_safety import (
    ChannelOptics,
    HazardFractions,
    blue_light_weight,
    hazard_fractions,
    refuse_unsafe,
    thermal_weight,
    weighted_fractions,
)
from radiometer.errors import UnsafeStimulus

NARROW = ChannelOptics(437.5, 0.5, 1.5, 1.0)  # B = 1 and R = 10 over its whole line


@pytest.mark.parametrize(
    ("wavelength_nm", "blue"),
    [(380, 0.01), (400, 0.1), (435, 1.0), (440, 1.0), (460, 0.8), (490, 0.22), (500, 0.1), (550, 0.01), (650, 0.001)],
)
def test_blue_light_function_at_tabulated_wavelengths(wavelength_nm, blue):
    """B(λ) of table 4.2."""
    assert float(blue_light_weight(np.array([float(wavelength_nm)]))[0]) == pytest.approx(blue, rel=1e-9)


@pytest.mark.parametrize(("wavelength_nm", "burn"), [(400, 1.0), (440, 10.0), (600, 1.0), (800, 10**-0.2), (1100, 0.2)])
def test_burn_function_at_tabulated_wavelengths(wavelength_nm, burn):
    """R(λ) of table 4.2."""
    assert float(thermal_weight(np.array([float(wavelength_nm)]))[0]) == pytest.approx(burn, rel=1e-3)


def test_blue_light_limit_of_a_large_source_is_a_dose_of_1e6():
    """L_B = 100 W/(sr m²) for 10⁴ s is the limit; twice the radiance for half the time too; longer counts as 10⁴ s."""
    for radiance, bright_s in ((100.0, 1e4), (200.0, 5e3), (100.0, math.inf)):
        assert hazard_fractions(NARROW, radiance, bright_s).blue_light == pytest.approx(1.0, rel=1e-3)


def test_small_source_is_limited_by_irradiance():
    """Below 11 mrad: E_B·t = 100 J/m² up to 100 s, E_B = 1 W/m² beyond."""
    small = ChannelOptics(437.5, 0.5, math.degrees(0.01), 1.0)
    radiance = 1.0 / (math.pi * 0.01**2 / 4)  # E = 1 W/m²
    assert hazard_fractions(small, radiance, 100.0).blue_light == pytest.approx(1.0, rel=1e-3)
    assert hazard_fractions(small, radiance, 1e4).blue_light == pytest.approx(1.0, rel=1e-3)
    assert hazard_fractions(small, radiance, 10.0).blue_light == pytest.approx(0.1, rel=1e-3)


def test_thermal_limit_of_a_one_second_exposure():
    """L_R = 50 000/(0.05 · 1) W/(sr m²) at 50 mrad and 1 s is the limit."""
    source = ChannelOptics(600.0, 1.0, math.degrees(0.05), 1.0)
    assert hazard_fractions(source, 1e6, 1.0).thermal == pytest.approx(1.0, rel=1e-6)


@pytest.mark.parametrize(("bright_s", "smallest_rad"), [(1e-3, 1.7e-3), (0.25, 1.7e-3), (1.0, 3.4e-3), (20.0, 0.011)])
def test_a_point_counts_as_wide_as_the_eye_smears_it(bright_s, smallest_rad):
    """4.3.5: 1.7 mrad up to 0.25 s, growing by the root of the time, 11 mrad from 10 s on."""
    point = ChannelOptics(600.0, 1.0, math.degrees(1e-4), 1.0)
    limit = 50_000.0 / (smallest_rad * min(bright_s, 10.0) ** 0.25)
    assert hazard_fractions(point, limit, bright_s).thermal == pytest.approx(1.0, rel=1e-6)


def test_thermal_angle_is_capped_at_100_mrad():
    """A wider source than 100 mrad counts as 100 mrad."""
    wide, cap = (ChannelOptics(600.0, 1.0, math.degrees(alpha), 1.0) for alpha in (0.8, 0.1))
    assert hazard_fractions(wide, 1e4, 1.0) == hazard_fractions(cap, 1e4, 1.0)


def test_white_is_weighted_between_red_and_blue():
    """A white LED has less blue hazard than a blue one and far more than a red one."""
    white, _ = weighted_fractions(ChannelOptics(None, 0.0, 10.0, 1.0))
    blue, _ = weighted_fractions(ChannelOptics(453.0, 22.0, 10.0, 1.0))
    red, _ = weighted_fractions(ChannelOptics(640.0, 18.0, 10.0, 1.0))
    assert 100 * red < white < blue


def test_refusal_states_fraction_limit_and_way_out():
    """The message says how much of which limit and what to do."""
    with pytest.raises(UnsafeStimulus, match=r"spot: 20 % of the blue-light .* 10 % is allowed .* Lower the radiance"):
        refuse_unsafe("spot", HazardFractions(0.2, 0.0), 0.1)
    refuse_unsafe("spot", HazardFractions(0.1, 0.1), 0.1)


def test_not_a_number_is_refused():
    """A hazard that cannot be computed is not let through."""
    with pytest.raises(UnsafeStimulus):
        refuse_unsafe("spot", HazardFractions(math.nan, 0.0), 0.1)


class Clock:
    """A clock that the test turns."""

    now_s = 0.0

    def __call__(self) -> float:
        return self.now_s


def ledger(clock: Clock) -> ExposureLedger:
    """Return an account of two large sources with B = 1, a tenth of the limit allowed."""
    return ExposureLedger({"a": NARROW, "b": NARROW}, clock)


def test_repeated_pulses_add_up_over_ten_thousand_seconds():
    """Nine pulses of one per cent each and a second one go through, the eleventh does not, until time has passed."""
    clock = Clock()
    account = ledger(clock)
    for _ in range(10):
        account.refuse_unsafe("a", 1000.0, 9.99)
        account.shine("a", 1000.0, 9.99)
        clock.now_s += 20.0
        account.darken("a")
    with pytest.raises(UnsafeStimulus):
        account.refuse_unsafe("a", 1000.0, 9.99)
    clock.now_s += 1e4 + 200
    account.refuse_unsafe("a", 1000.0, 9.99)


def test_channels_that_shine_together_add_up():
    """Two channels at 6 % each exceed a tenth."""
    account = ledger(Clock())
    account.refuse_unsafe("a", 6.0, math.inf)
    account.shine("a", 6.0, math.inf)
    with pytest.raises(UnsafeStimulus):
        account.refuse_unsafe("b", 6.0, math.inf)
    account.darken("a")
    account.refuse_unsafe("b", 6.0, math.inf)


def test_light_ended_early_counts_only_for_its_time():
    """A steady light of 8 % per 10⁴ s that is darkened after 10 s leaves next to nothing."""
    clock = Clock()
    account = ledger(clock)
    account.shine("a", 8.0, math.inf)
    clock.now_s = 10.0
    account.refuse_unsafe("a", 9.9, math.inf)
