"""Retinal exposure limits against the standard's own figures."""

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
)
from radiometer.errors import UnsafeStimulus
from testing.relatively import relatively

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


def test_refusal_states_fraction_limit_and_way_out():
    """The message says how much of which limit and what to do; what cannot be computed is not let through."""
    with pytest.raises(UnsafeStimulus):
        refuse_unsafe("spot", HazardFractions(math.nan, 0.0), 0.1)
    with pytest.raises(UnsafeStimulus, match=r"spot: 20 % of the blue-light .* 10 % is allowed .* Lower the radiance"):
        refuse_unsafe("spot", HazardFractions(0.2, 0.0), 0.1)
    with pytest.raises(UnsafeStimulus, match=r"counts for 10000 s\. Lower the radiance, or .*`light pulse`"):
        refuse_unsafe("spot", HazardFractions(0.2, 0.0), 0.1, endless=True)
    refuse_unsafe("spot", HazardFractions(0.1, 0.1), 0.1)


@pytest.mark.parametrize("bright_s", [1e-6, 1e-5, 0.1, 5.0, 10.0, 1e3])
@pytest.mark.parametrize("alpha_rad", [1e-3, 0.02, 0.5])
def test_hazards_grow_with_the_radiance_and_never_fall_with_time(alpha_rad, bright_s):
    """Twice the light is twice of both limits; a little longer is no less of either; below 10 µs counts as 10 µs."""
    source = ChannelOptics(437.5, 0.5, math.degrees(alpha_rad), 1.0)
    one, two, longer = (
        hazard_fractions(source, *given) for given in ((50.0, bright_s), (100.0, bright_s), (50.0, 1.01 * bright_s))
    )
    assert (two.blue_light, two.thermal) == relatively((2.0 * one.blue_light, 2.0 * one.thermal))
    assert longer.blue_light >= one.blue_light
    assert longer.thermal >= one.thermal * (1.0 - 1e-12)
    if bright_s <= 1e-5:
        assert one.thermal == pytest.approx(hazard_fractions(source, 50.0, 1e-5).thermal)


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


# IEC 62471:2006, table 4.2: wavelength, B(λ), R(λ).
TABLE_4_2 = """380 0.01 0.1|385 0.013 0.13|390 0.025 0.25|395 0.05 0.5|400 0.1 1|405 0.2 2|410 0.4 4|415 0.8 8|420 0.9 9
425 0.95 9.5|430 0.98 9.8|435 1 10|440 1 10|445 0.97 9.7|450 0.94 9.4|455 0.9 9|460 0.8 8|465 0.7 7|470 0.62 6.2
475 0.55 5.5|480 0.45 4.5|485 0.4 4|490 0.22 2.2|495 0.16 1.6|500 0.1 1"""
ROWS = np.array([[float(v) for v in row.split()] for row in TABLE_4_2.replace("\n", "|").split("|")])
GRID = np.linspace(380.0, 780.0, 4001)


def table_b(nm: float) -> float:
    if nm <= 500.0:
        return float(np.exp(np.interp(nm, ROWS[:, 0], np.log(ROWS[:, 1]))))
    return max(10 ** ((450 - nm) / 50), 0.001) if nm <= 700 else 0.0


def table_r(nm: float) -> float:
    if nm <= 500.0:
        return float(np.exp(np.interp(nm, ROWS[:, 0], np.log(ROWS[:, 2]))))
    return 1.0 if nm <= 700 else 10 ** ((700 - nm) / 500)


def light(peak_nm: float | None, fwhm_nm: float) -> np.ndarray:
    """Return a relative spectrum on GRID of integral 1: a line, or 0.4 of a pump at 450 nm and 0.6 of phosphor."""

    def line(peak: float, fwhm: float) -> np.ndarray:
        shape = 0.5 ** (4 * ((GRID - peak) / fwhm) ** 2)
        return shape / np.trapezoid(shape, GRID)

    return 0.4 * line(450.0, 20.0) + 0.6 * line(560.0, 120.0) if peak_nm is None else line(peak_nm, fwhm_nm)


def weighted(peak_nm: float | None, fwhm_nm: float) -> tuple[float, float]:
    shape = light(peak_nm, fwhm_nm)
    blue, red = (np.array([table(nm) for nm in GRID]) for table in (table_b, table_r))
    return float(np.trapezoid(shape * blue, GRID)), float(np.trapezoid(shape * red, GRID))


def thermal_limit(subtense_rad: float, time_s: float) -> float:
    """Return the limit of L_R in W·sr⁻¹·m⁻²: equation 4.12, 10 µs to 10 s, α from 1.7 (later 11) to 100 mrad."""
    smallest = 0.0017 if time_s <= 0.25 else min(0.0017 * (time_s / 0.25) ** 0.5, 0.011)
    alpha = min(max(subtense_rad, smallest), 0.1)
    return 50_000 / (alpha * min(time_s, 10.0) ** 0.25)


LIGHTS = {
    "bleach": (None, 0.0, 60.0, 6.0),
    "field": (None, 0.0, 40.0, 36.6),
    "spot": (453.0, 22.0, 1.5, 4.0),
    "spot_green": (505.0, 30.0, 2.0, 4.0),
    "spot_red": (640.0, 18.0, 1.0, 2.0),
    "fixation": (640.0, 18.0, 0.3, 1.0),
}


@pytest.mark.parametrize("name", LIGHTS)
@pytest.mark.parametrize("time_s", [0.0005, 0.003, 0.2, 1.0, 30.0, 180.0, 2400.0])
def test_fractions_agree_with_the_second_hand(name: str, time_s: float) -> None:
    """Blue-light and thermal fractions of every channel agree within 1 % (the grids differ), for pulses and long."""
    peak_nm, fwhm_nm, subtense_deg, radiance = LIGHTS[name]
    blue, red = weighted(peak_nm, fwhm_nm)
    ours = hazard_fractions(ChannelOptics(peak_nm, fwhm_nm, subtense_deg, radiance), radiance, time_s)
    alpha = math.radians(subtense_deg)
    if alpha >= 0.011:
        assert ours.blue_light == relatively(time_s * blue * radiance / 1e6, rel=0.01)
    else:  # a small source: E_B·t ≤ 100 J·m⁻², E_B = L_B·π·α²/4, at most 1 W·m⁻²
        irradiance = blue * radiance * math.pi * alpha**2 / 4
        assert ours.blue_light == relatively(min(irradiance * time_s / 100, irradiance), rel=0.01)
    assert ours.thermal == relatively(red * radiance / thermal_limit(alpha, time_s), rel=0.01)


def test_the_hazard_functions_are_the_standard_s_at_every_wavelength_of_its_table() -> None:
    """B(λ) and R(λ) of table 4.2, its formulae above 500 nm, and between two rows the logarithm's straight line."""
    nm = np.array([*ROWS[:, 0], 387.5, 452.5, 550.0, 620.0, 700.0, 800.0, 1000.0])
    assert blue_light_weight(nm) == pytest.approx([table_b(one) for one in nm], rel=1e-9)
    assert thermal_weight(nm) == pytest.approx([table_r(one) for one in nm], rel=1e-9)
