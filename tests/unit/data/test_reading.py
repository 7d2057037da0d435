"""Readings, brackets, serial numbers and provenance as data."""

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from radiometer.data import Bracket, Contribution, Flag, Frame, FrameSettings, Patch, Quantity, Reading
from radiometer.data.capture_header import other_notation, same_serial, serial_shown
from radiometer.data.provenance import Provenance, source_hash
from radiometer.errors import InputError


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
    few = json.loads(replace(reading, coverage_factor=4.53, degrees_of_freedom=2.0).to_json())  # U = k·u
    assert (few["U_rel"], few["coverage_factor"], few["degrees_of_freedom"]) == (4.53 * 0.011 / 1.234, 4.53, 2.0)


def test_flags_are_the_documented_words_and_bounds_have_limits() -> None:
    """What clips in every frame has a lower one."""
    words = (
        "below_noise dark_assumed drift exposure_unconfirmed extrapolated falloff_assumed few_frames flicker gain "
        "lens_changed linearity nonuniform other_tap polarisation repeated_frame saturated short_exposure "
        "small_patch spectrum_assumed stale_calibration stray_light temperature uncalibrated"
    )
    assert " ".join(sorted(Flag)) == words
    budget = (Contribution("scale", 0.1), Contribution("clipping", 1.0))
    reading = Reading(
        Quantity(2.0, 2.01, "W sr-1 m-2"), Patch(0, 0, 9, 9), "4711", flags=(Flag.SATURATED,), budget=budget
    )
    limit = reading.to_mapping()["lower_limit"]
    assert (limit["probability"], limit["unit"]) == (0.95, "W sr-1 m-2")
    assert limit["value"] == pytest.approx(2.0 * (1 - 1.645 * 0.1))
    assert "upper_limit" not in reading.to_mapping()
    assert not {"lower_limit", "upper_limit"} & replace(reading, flags=()).to_mapping().keys()


def bracket() -> Bracket:
    settings = (FrameSettings(2.0), FrameSettings(1.0), FrameSettings(2.0, shutter="closed"))
    return Bracket.from_frames([Frame(np.zeros((4, 5), np.uint16), 12, one) for one in settings], origin="here")


def test_light_and_dark_frames_are_apart():
    """Light ones ascend in exposure; new light frames keep the dark ones; whoever loops must say over which."""
    one = bracket()
    assert [frame.settings.exposure_s for frame in one.light] == [1.0, 2.0]
    assert [frame.settings.is_dark for frame in one.every_frame] == [True, False, False]
    assert one.with_light(one.light[:1]).dark == one.dark
    with pytest.raises(TypeError, match=r"bracket\.light, bracket\.dark"):
        list(one)


@pytest.mark.parametrize(
    ("one", "other", "same"),
    [
        ("0138C343", "20497219", True),
        ("20497219", "0138c343", True),
        ("0138C343", "0138c343", True),
        ("22500001", "22500001", True),
        ("0138C343", "20497220", False),
        ("138C343", "20497219", False),
        ("GV77", "GV78", False),
    ],
)
def test_both_notations_mean_one_number(one, other, same):
    """0138C343 is 20497219 in hexadecimal; seven digits are no USB serial number."""
    assert same_serial(one, other) is same


@pytest.mark.parametrize(
    ("serial", "other"), [("0138C343", "20497219"), ("22500001", ""), ("01575361", "22500193"), ("GV77", "")]
)
def test_a_plainly_hexadecimal_number_is_shown_in_decimal_too(serial, other):
    """Zeros in front or letters show that it is hexadecimal; a decimal number stands alone."""
    assert other_notation(serial) == other
    assert serial_shown(serial) == (f"{serial} ({other})" if other else serial)


@pytest.mark.parametrize("emptied", ["inputs", "assumptions", "parameters", "method", "created", "software"])
def test_an_entry_left_empty_holds_nothing(emptied: str) -> None:
    """What is written reads back; a key with nothing behind it, as an editor leaves it, is as good as none."""
    made = Provenance("debevec1997", ("a.png", "b.png"), ("no flicker",), {"groups": 350}, "2026-01-02", "radiometer 1")
    assert Provenance.from_mapping(made.to_mapping(), "file") == made
    nothing = {"method": "unknown", "inputs": (), "assumptions": (), "parameters": {}, "created": "", "software": ""}
    expected = replace(made, **{emptied: nothing[emptied]})
    assert Provenance.from_mapping({**made.to_mapping(), emptied: None}, "file") == expected
    assert Provenance.from_mapping(None, "file").method == "unknown"


@pytest.mark.parametrize(
    ("stated", "named"),
    [
        ("by hand", "provenance is 'by hand', not a mapping"),
        ({"inputs": 5}, r"provenance\.inputs is '5', not a list"),
        ({"assumptions": "none"}, r"provenance\.assumptions is 'none', not a list"),
        ({"parameters": [1, 2]}, r"provenance\.parameters is .*, not a mapping"),
    ],
)
def test_another_shape_is_refused_by_name(stated: Any, named: str) -> None:
    """The message says which file and which key."""
    with pytest.raises(InputError, match=f"cal.yaml: {named}"):
        Provenance.from_mapping(stated, "cal.yaml")


def test_a_hash_over_no_source_is_refused() -> None:
    """A folder that was renamed has no source: its hash would never change, and stored results would never age."""
    with pytest.raises(ValueError, match="no source"):
        source_hash("analysis", "no_such_room")
