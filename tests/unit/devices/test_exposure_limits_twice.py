"""Exposure limits of IEC 62471 by a second hand: from the standard's tables and equations, no code of the product.

Table 4.2 is typed in here anew, integrals are sums by the trapezium on a grid of its own, limits are solved for time or
radiance instead of fractions.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from radiometer.analysis.photometry.photometry import luminous_efficacy_lm_per_w, spectrum
from radiometer.devices.retinal_safety import ChannelOptics, blue_light_weight, hazard_fractions, thermal_weight

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


def longest_blue_s(blue_radiance: float) -> float:
    """Return t_max = 10⁶ / L_B of equation 4.9 where it lies within 10⁴ s, else infinity."""
    time_s = 1e6 / blue_radiance
    return time_s if time_s <= 1e4 else math.inf


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
        assert ours.blue_light == pytest.approx(time_s * blue * radiance / 1e6, rel=0.01)
    else:  # a small source: E_B·t ≤ 100 J·m⁻², E_B = L_B·π·α²/4, at most 1 W·m⁻²
        irradiance = blue * radiance * math.pi * alpha**2 / 4
        assert ours.blue_light == pytest.approx(min(irradiance * time_s / 100, irradiance), rel=0.01)
    assert ours.thermal == pytest.approx(red * radiance / thermal_limit(alpha, time_s), rel=0.01)


def test_worked_example_of_the_docs() -> None:
    """3 000 cd/m² of white LED for 300 s: 9.5 W·sr⁻¹·m⁻², 3.8 of it blue, 1.2·10³ J of 10⁶: about a thousandth."""
    radiance = 3000.0 / luminous_efficacy_lm_per_w(spectrum("white_led"), "photopic")
    ours = hazard_fractions(ChannelOptics(None, 0.0, 40.0, radiance), radiance, 300.0)
    assert ours.blue_light == pytest.approx(300 * weighted(None, 0.0)[0] * radiance / 1e6, rel=0.01)
    assert 0.0008 < ours.blue_light < 0.0015


def test_ten_thousand_candela_are_beyond_a_tenth_after_hours_only() -> None:
    """10 000 cd/m² reach a tenth of the blue-light limit after 7 800 s; the box's own budget ends below 5 %."""
    radiance = 10_000.0 / luminous_efficacy_lm_per_w(spectrum("white_led"), "photopic")
    blue = weighted(None, 0.0)[0] * radiance
    tenth_s = 0.1 * 1e6 / blue
    field = ChannelOptics(None, 0.0, 40.0, radiance)
    assert (
        hazard_fractions(field, radiance, tenth_s * 1.02).blue_light
        > 0.1
        > hazard_fractions(field, radiance, tenth_s * 0.98).blue_light
    )
    assert 7000 < tenth_s < 8500
    # Energy: 70.5·10⁶ units, 235 per bright ms, 118 back per dark ms: the most that 10⁷ ms can hold.
    bright_ms = (70.5e6 + 118 * 1e7) / (235 + 118)
    assert blue * bright_ms / 1e3 / 1e6 < 0.05
    assert longest_blue_s(blue) > 1e4 or longest_blue_s(blue) * 0.1 < tenth_s * 1.01


def test_the_hazard_functions_are_the_standard_s_at_every_wavelength_of_its_table() -> None:
    """B(λ) and R(λ) of table 4.2, its formulae above 500 nm, and between two rows the logarithm's straight line."""
    nm = np.array([*ROWS[:, 0], 387.5, 452.5, 550.0, 620.0, 700.0, 800.0, 1000.0])
    assert blue_light_weight(nm) == pytest.approx([table_b(one) for one in nm], rel=1e-9)
    assert thermal_weight(nm) == pytest.approx([table_r(one) for one in nm], rel=1e-9)
