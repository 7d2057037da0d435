"""Readings: the documented JSON form."""

from __future__ import annotations

import json
import math

from radiometer.data import Flag, Patch, Quantity, Reading


def test_a_reading_speaks_the_documented_json():
    """Keys, units and numbers of the exchange form; u is k = 1, U_rel is k = 2."""
    reading = Reading(
        radiance=Quantity(1.234, 0.011, "W sr-1 m-2"),
        patch=Patch(0, 0, 10, 10),
        instrument="22500001",
        luminance=Quantity(842.0, 7.5, "cd m-2"),
        flags=(Flag.NONUNIFORM,),
        exposures_s=(0.001, 0.004),
        sequence=17,
        time="2026-11-20T12:00:00.000000Z",
    )
    assert json.loads(reading.to_json()) == {
        "time": "2026-11-20T12:00:00.000000Z",
        "instrument": "22500001",
        "patch": {"x": 0, "y": 0, "width": 10, "height": 10},
        "radiance": {"value": 1.234, "u": 0.011, "unit": "W sr-1 m-2"},
        "luminance": {"value": 842.0, "u": 7.5, "unit": "cd m-2"},
        "coverage_factor": 2.0,
        "U_rel": 2 * 0.011 / 1.234,
        "flags": ["nonuniform"],
        "degrees_of_freedom": None,
        "exposures_s": [0.001, 0.004],
        "sequence": 17,
    }


def test_what_is_not_finite_becomes_null():
    """JSON knows no infinity; a reader must not choke on one."""
    reading = Reading(Quantity(0.0, math.inf, "relative"), Patch(0, 0, 1, 1), "x", flags=(Flag.UNCALIBRATED,))
    spoken = json.loads(reading.to_json())
    assert spoken["U_rel"] is None
    assert spoken["radiance"]["u"] is None


def test_flags_are_the_documented_words():
    """Nothing else may appear in `flags`."""
    assert sorted(Flag) == [
        "below_noise",
        "dark_assumed",
        "drift",
        "exposure_unconfirmed",
        "extrapolated",
        "falloff_assumed",
        "few_frames",
        "flicker",
        "gain",
        "lens_changed",
        "linearity",
        "nonuniform",
        "other_tap",
        "polarisation",
        "repeated_frame",
        "saturated",
        "short_exposure",
        "small_patch",
        "spectrum_assumed",
        "stale_calibration",
        "stray_light",
        "temperature",
        "uncalibrated",
    ]


def test_the_expanded_uncertainty_follows_the_stated_factor():
    """U = k·u: at k = 4.53 (two degrees of freedom) it is 4.53 u, and the JSON says both."""
    reading = Reading(
        Quantity(2.0, 0.1, "W sr-1 m-2"), Patch(0, 0, 1, 1), "x", coverage_factor=4.53, degrees_of_freedom=2.0
    )
    spoken = json.loads(reading.to_json())
    assert spoken["U_rel"] == 4.53 * 0.05
    assert (spoken["coverage_factor"], spoken["degrees_of_freedom"]) == (4.53, 2.0)
