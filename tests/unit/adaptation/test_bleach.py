"""Bleach: kinetics, pupil, trolands against worked numbers."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from radiometer.adaptation.bleach import (
    KINETICS,
    bleached_fraction,
    bleached_range,
    pupil_diameter_mm,
    retinal_illuminance_td,
)
from radiometer.data.bleaching_constants import CONE_HALF_BLEACH, CONE_REGENERATION, CONSTANTS
from simulators.observers import eye_kinetics


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


def test_trolands_are_luminance_times_pupil_area() -> None:
    """300 cd/m² through 4 mm are 3770 td."""
    assert retinal_illuminance_td(300.0, 4.0) == pytest.approx(3769.9, rel=1e-4)


def test_pupil_spans_its_known_range_and_shrinks_with_light() -> None:
    """Dark 7.75 mm, 10^6 cd/m² near 2 mm at the reference age; the old have smaller pupils in the dark."""
    assert pupil_diameter_mm(0.0) == pytest.approx(7.75)
    assert 2.0 < pupil_diameter_mm(1e6) < 2.3
    assert pupil_diameter_mm(100.0) < pupil_diameter_mm(1.0)
    assert pupil_diameter_mm(0.0, age_years=70) < 6


def test_cones_are_half_bleached_at_twenty_thousand_trolands() -> None:
    """Rushton and Henry 1968 as given by CVRL: 4.3 log td; 120 s of regeneration make it 2.4·10⁶ td·s."""
    assert KINETICS["cones"].half_bleach_td == pytest.approx(10**4.3, rel=0.01)
    assert KINETICS["cones"].td_s == pytest.approx(2.4e6)


def test_range_spans_the_published_constants() -> None:
    """10⁵ td for 600 s: rods lie between those of 1.6·10⁷ td·s with 360 s and of 10⁷ td·s with 450 s."""
    low, high = bleached_range(1e5, 600.0)
    least, most = 1e5 / 1.6e7, 1e5 / 1e7
    assert low == pytest.approx(least / (least + 1 / 360) * (1 - math.exp(-(least + 1 / 360) * 600)))
    assert high == pytest.approx(most / (most + 1 / 450) * (1 - math.exp(-(most + 1 / 450) * 600)))
    assert low < bleached_fraction(1e5, 600.0) <= high


def test_calculator_eye_and_docs_share_one_table(project_root: Path) -> None:
    """Each value of the table stands in the docs with its spread; the simulated eye bleaches by the same ones."""
    page = (project_root / "docs" / "reference" / "adaptation-test.md").read_text(encoding="utf-8")
    for constant in CONSTANTS:
        assert f"| {constant.name} | {constant.value:g} | {constant.low:g} to {constant.high:g} |" in page
        assert constant.low <= constant.value <= constant.high
    assert KINETICS["cones"].half_bleach_td == eye_kinetics.CONE_EXPOSURE_TD_S / eye_kinetics.CONE_REGENERATION_S
    assert KINETICS["rods"].td_s == eye_kinetics.ROD_EXPOSURE_TD_S


def test_range_of_cones_spans_their_own_constants() -> None:
    """I0 and τ of cones are published apart: the extremes are those of I0 with τ, whatever Q they make together."""
    half, back = CONE_HALF_BLEACH, CONE_REGENERATION
    ends = []
    for half_td in (half.low, half.high):
        for time_s in (back.low, back.high):
            rate = (1.0 + 1e4 / half_td) / time_s
            ends.append(1e4 / (1e4 + half_td) * (1.0 - math.exp(-rate * 60.0)))
    assert bleached_range(1e4, 60.0, "cones") == pytest.approx((min(ends), max(ends)))
