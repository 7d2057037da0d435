"""Bleach: kinetics, pupil, trolands against worked numbers."""

from __future__ import annotations

import math

import pytest

from radiometer.adaptation.bleach import (
    KINETICS,
    bleached_fraction,
    pupil_diameter_mm,
    retinal_exposure_for,
    retinal_illuminance_td,
)


def test_half_bleach_illuminance_bleaches_half_in_the_end() -> None:
    """At I0 = Q/τ (rods: 25 000 td) the steady state is one half."""
    assert KINETICS["rods"].half_bleach_td == 25_000
    assert bleached_fraction(25_000, 1e5) == pytest.approx(0.5)


def test_short_flash_of_one_q_leaves_one_over_e() -> None:
    """A flash too short for regeneration with 10^7 td·s leaves 1/e of rhodopsin."""
    assert bleached_fraction(1e7 / 1e-3, 1e-3) == pytest.approx(1 - 1 / math.e, rel=1e-5)


def test_dark_regenerates_with_the_time_constant() -> None:
    """400 s of darkness leave 1/e of what was bleached in rods, 120 s in cones."""
    assert bleached_fraction(0.0, 400.0, "rods", before=0.9) == pytest.approx(0.9 / math.e)
    assert bleached_fraction(0.0, 120.0, "cones", before=0.9) == pytest.approx(0.9 / math.e)


@pytest.mark.parametrize("fraction", [0.05, 0.5, 0.98])
def test_exposure_for_a_fraction_bleaches_that_fraction(fraction: float) -> None:
    """The calculator's inverse leads back."""
    exposure = retinal_exposure_for(fraction, 120.0)
    assert bleached_fraction(exposure / 120.0, 120.0) == pytest.approx(fraction)


def test_fractions_out_of_range_are_refused() -> None:
    """All pigment cannot be bleached."""
    with pytest.raises(ValueError, match="between 0 and 1"):
        retinal_exposure_for(1.0, 1.0)


def test_trolands_are_luminance_times_pupil_area() -> None:
    """300 cd/m² through 4 mm are 3770 td."""
    assert retinal_illuminance_td(300.0, 4.0) == pytest.approx(3769.9, rel=1e-4)


def test_pupil_spans_its_known_range_and_shrinks_with_light() -> None:
    """Dark 7.75 mm, 10^6 cd/m² near 2 mm at the reference age; the old have smaller pupils in the dark."""
    assert pupil_diameter_mm(0.0) == pytest.approx(7.75)
    assert 2.0 < pupil_diameter_mm(1e6) < 2.3
    assert pupil_diameter_mm(100.0) < pupil_diameter_mm(1.0)
    assert pupil_diameter_mm(0.0, age_years=70) < 6
