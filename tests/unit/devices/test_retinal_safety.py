"""Retinal exposure limits against the standard's own figures."""

from __future__ import annotations

import math

import numpy as np
import pytest

from radiometer.devices.retinal_safety import (
    ChannelOptics,
    HazardFractions,
    blue_light_weight,
    hazard_fractions,
    refuse_unsafe,
    relative_spectrum,
    thermal_weight,
    weighted_fractions,
)
from radiometer.errors import UnsafeStimulus

NARROW = ChannelOptics(437.5, 0.5, 1.5, 1.0)  # B = 1 and R = 10 over its whole line


def test_blue_light_limit_of_a_large_source_is_a_dose_of_1e6():
    """L_B = 100 W/(sr m²) for 10⁴ s is the limit; twice the radiance for half the time too; longer counts as 10⁴ s."""
    for radiance, bright_s in ((100.0, 1e4), (200.0, 5e3), (100.0, math.inf)):
        assert hazard_fractions(NARROW, radiance, bright_s).blue_light == pytest.approx(1.0, rel=1e-3)


@pytest.mark.parametrize(("bright_s", "smallest_rad"), [(1e-3, 1.7e-3), (0.25, 1.7e-3), (1.0, 3.4e-3), (20.0, 0.011)])
def test_a_point_counts_as_wide_as_the_eye_smears_it(bright_s, smallest_rad):
    """4.3.5: 1.7 mrad up to 0.25 s, growing by the root of the time, 11 mrad from 10 s on."""
    point = ChannelOptics(600.0, 1.0, math.degrees(1e-4), 1.0)
    limit = 50_000.0 / (smallest_rad * min(bright_s, 10.0) ** 0.25)
    assert hazard_fractions(point, limit, bright_s).thermal == pytest.approx(1.0, rel=1e-6)


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


@pytest.mark.parametrize("bright_s", [1e-6, 1e-5, 0.1, 5.0, 10.0, 1e3])
@pytest.mark.parametrize("alpha_rad", [1e-3, 0.02, 0.5])
def test_hazards_grow_with_the_radiance_and_never_fall_with_time(alpha_rad, bright_s):
    """Twice the light is twice of both limits; a little longer is no less of either; below 10 µs counts as 10 µs."""
    source = ChannelOptics(437.5, 0.5, math.degrees(alpha_rad), 1.0)
    one, two, longer = (
        hazard_fractions(source, *given) for given in ((50.0, bright_s), (100.0, bright_s), (50.0, 1.01 * bright_s))
    )
    assert (two.blue_light, two.thermal) == pytest.approx((2.0 * one.blue_light, 2.0 * one.thermal))
    assert longer.blue_light >= one.blue_light
    assert longer.thermal >= one.thermal * (1.0 - 1e-12)
    if bright_s <= 1e-5:
        assert one.thermal == pytest.approx(hazard_fractions(source, 50.0, 1e-5).thermal)


def test_thermal_fractions_go_with_the_fourth_root_of_time_and_with_the_angle():
    """Sixteen times as long is twice of the limit; twice as wide too, between 11 and 100 mrad; 10 s are the longest."""
    source, wide = (ChannelOptics(600.0, 1.0, math.degrees(a), 1.0) for a in (0.03, 0.06))

    def of(optics, seconds):
        return hazard_fractions(optics, 1e3, seconds).thermal

    assert of(source, 0.16) / of(source, 0.01) == pytest.approx(2.0)
    assert of(wide, 0.01) / of(source, 0.01) == pytest.approx(2.0)
    assert of(source, 10.0) == of(source, 1e4) > of(source, 9.9)


@pytest.mark.parametrize(("alpha_rad", "blue"), [(0.011, 1.0), (0.01099, 0.949)])
def test_a_source_of_eleven_milliradians_is_no_small_one(alpha_rad, blue):
    """From there on L_B·t ≤ 10⁶ holds; just below it E_B ≤ 1 W/m² for 10⁴ s, which is 100·π·α²/4 of 100 W/(sr m²)."""
    source = ChannelOptics(437.5, 0.5, math.degrees(alpha_rad) * (1.0 + 1e-12), 1.0)
    expected = blue if alpha_rad == 0.011 else 100.0 * math.pi * alpha_rad**2 / 4
    assert hazard_fractions(source, 100.0, 1e4).blue_light == pytest.approx(expected, rel=2e-3)


@pytest.mark.parametrize(
    ("wavelength_nm", "blue", "burn"),
    [
        (299.9, 0.0, 0.0), (379.9, None, 0.0), (380.0, 0.01, 0.1), (499.9, 0.1, 1.0), (500.0, 0.1, 1.0),
        (600.0, 0.001, 1.0), (650.0, 0.001, 1.0), (700.0, 0.001, 1.0), (700.1, 0.0, 1.0), (1050.0, 0.0, 0.2),
        (1150.0, 0.0, 0.2), (1150.1, 0.0, 0.0),
    ],
)  # fmt: skip
def test_weights_of_both_hazards_at_their_borders(wavelength_nm, blue, burn):
    """Table 4.2 of IEC 62471: where each function begins, goes over and ends."""
    at = np.array([wavelength_nm])
    if blue is not None:
        assert float(blue_light_weight(at)[0]) == pytest.approx(blue, rel=0.02)
    assert float(thermal_weight(at)[0]) == pytest.approx(burn, rel=0.02)


def test_a_spectrum_is_one_in_all_and_white_has_two_fifths_of_its_power_in_blue():
    """A line falls to half at half its width; of white light 40 % stand around 450 nm."""
    wavelength_nm, line = relative_spectrum(ChannelOptics(600.0, 20.0, 1.0, 1.0))
    assert (line.sum(), wavelength_nm[0], wavelength_nm[-1]) == (pytest.approx(1.0), 380.0, 780.0)
    peak = int(np.argmax(line))
    assert wavelength_nm[peak] == 600.0
    assert line[[peak - 10, peak + 10]] / line[peak] == pytest.approx([0.5, 0.5])
    _, white = relative_spectrum(ChannelOptics(None, 0.0, 1.0, 1.0))
    assert white.sum() == pytest.approx(1.0)
    _, phosphor = relative_spectrum(ChannelOptics(560.0, 120.0, 1.0, 1.0))
    pump = white - 0.6 * phosphor
    assert pump.sum() == pytest.approx(0.4)
    assert pump @ wavelength_nm / 0.4 == pytest.approx(450.0, abs=0.1)
