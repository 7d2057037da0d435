"""What a reading's elements say over SCPI."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from radiometer.daemon.scpi.formats import reading_elements
from radiometer.daemon.scpi.measure_commands import ELEMENTS
from radiometer.data import Flag, Quantity


@pytest.fixture
def reading(make_reading):
    """Two frames that disagree: one degree of freedom, k = 13.97."""
    return replace(
        make_reading(),
        radiance=Quantity(2.0, 0.05, "W sr-1 m-2"),
        luminance=Quantity(300.0, 9.0, "cd m-2"),
        coverage_factor=13.97,
        flags=frozenset({Flag.FLICKER}),
        sequence=7,
    )


def reply_of(reading, function):
    return dict(zip(ELEMENTS, reading_elements(reading, function, ELEMENTS).split(","), strict=True))


@pytest.mark.parametrize(("function", "value", "u"), [("RADiance", 2.0, 0.05), ("LUMinance", 300.0, 9.0)])
def test_expanded_is_k_times_u(reading, function, value, u):
    """Value, u, U and k of the asked quantity, in the order of the list."""
    elements = reply_of(reading, function)
    assert float(elements["READing"]) == value
    assert float(elements["UNCertainty"]) == u
    assert float(elements["COVerage"]) == 13.97
    assert float(elements["EXPanded"]) == pytest.approx(13.97 * u)
    assert (elements["SEQuence"], elements["FLAGs"]) == ("7", '"flicker"')


def test_what_is_not_known_is_no_number(reading):
    """Near-infrared has no luminance: SCPI's not-a-number for it, its u and its U."""
    elements = reply_of(replace(reading, luminance=None), "LUMinance")
    assert {elements[name] for name in ("READing", "UNCertainty", "EXPanded")} == {"9.91E+37"}
    assert math.isfinite(float(elements["COVerage"]))
