"""Response curves: files round trip to the last bit; what is no curve is refused."""

from __future__ import annotations

import numpy as np
import pytest

from radiometer.data import Provenance, ResponseCurve
from radiometer.errors import InputError


def curve():
    """Return a gamma curve at 8 bit, zero at its middle, undefined at black."""
    dn = np.arange(256)
    log_exposure = np.full(256, -np.inf)
    log_exposure[1:] = 2.2 * np.log(dn[1:] / 128.0)
    return ResponseCurve(log_exposure, np.full(256, 0.01))


@pytest.mark.parametrize("name", ["curve.csv", "curve.yaml"])
def test_a_curve_survives_the_disk_bit_for_bit(tmp_path, name):
    """Both forms hold every digit."""
    curve().write(tmp_path / name)
    read = ResponseCurve.read(tmp_path / name)
    np.testing.assert_array_equal(read.log_exposure, curve().log_exposure)
    np.testing.assert_array_equal(read.u_log_exposure, curve().u_log_exposure)
    assert read.absolute is False


def test_the_csv_has_the_documented_header(tmp_path):
    """Other programs read this form."""
    curve().write(tmp_path / "c.csv")
    lines = (tmp_path / "c.csv").read_text().splitlines()
    assert lines[0] == "dn,log_exposure,u_log_exposure"
    assert lines[129].startswith("128,0.0,")
    assert len(lines) == 257


def test_a_falling_curve_is_refused():
    """More light never gives a lower digital number."""
    values = curve().log_exposure.copy()
    values[100] = 5.0
    with pytest.raises(InputError, match="must not fall"):
        ResponseCurve(values, np.zeros(256))


def test_the_curve_cannot_be_written_into():
    """Results are frozen."""
    with pytest.raises(ValueError, match="read-only"):
        curve().log_exposure[0] = 1.0


@pytest.mark.parametrize(
    "text",
    ["", "dn,g\n0,1\n", *(f"dn,log_exposure,u_log_exposure\n{rows}\n" for rows in (
        "0,0,0\n2,1,0", "0,0,0", "0,0,0\n1,1,0\n2,2,0", "0,1,0\n1,0,0", "0,a,0\n1,1,0", "0,0\n1,1"))],
)  # fmt: skip
def test_a_csv_that_is_no_curve_is_refused(tmp_path, text):
    """Wrong header, gaps, emptiness, a size that is none, a fall, a word, two columns: the file is always named."""
    (tmp_path / "c.csv").write_text(text)
    with pytest.raises(InputError, match=r"c\.csv"):
        ResponseCurve.read(tmp_path / "c.csv")


@pytest.mark.parametrize(("size", "bits"), [(2, 1), (4, 2), (256, 8), (65536, 16)])
def test_a_curve_has_a_value_for_every_number_of_its_bits(size, bits):
    """Powers of two from 2 to 65536; the middle one is that above half of them."""
    one = ResponseCurve(np.linspace(-4.0, 4.0, size), np.zeros(size))
    assert (one.bit_depth, one.mid_dn) == (bits, size // 2)


@pytest.mark.parametrize("size", [0, 1, 3, 255, 65535, 131072])
def test_other_sizes_are_no_curve(size):
    """Nor a table of two columns, nor one uncertainty for many values; equal neighbours are one."""
    with pytest.raises(InputError, match="2, 4, … 65536 values"):
        ResponseCurve(np.arange(float(size)), np.zeros(size))
    with pytest.raises(InputError, match="2, 4, … 65536 values"):
        ResponseCurve(np.zeros((4, 2)), np.zeros((4, 2)))
    with pytest.raises(InputError, match="one uncertainty per value"):
        ResponseCurve(np.arange(4.0), np.zeros(2))
    assert ResponseCurve(np.zeros(4), np.zeros(4)).bit_depth == 2


@pytest.mark.parametrize(("known", "taken"), [([0.0, 1.0], True), ([1.0], False), ([], False)])
def test_a_curve_says_something_of_two_numbers_at_least(known, taken):
    """What is not finite is left aside; a fall across it counts."""
    values = np.full(4, np.nan)
    values[1 : 1 + len(known)] = known
    if taken:
        assert ResponseCurve(values, np.zeros(4)).log_exposure[2] == 1.0
    else:
        with pytest.raises(InputError, match="must not fall"):
            ResponseCurve(values, np.zeros(4))
    with pytest.raises(InputError, match="must not fall"):
        ResponseCurve(np.array([1.0, np.nan, np.nan, 0.5]), np.zeros(4))


def test_a_file_keeps_all_that_is_known_of_a_curve(tmp_path):
    """Range, channel, gauge and where it is from; a table reports by its middle whether it is absolute."""
    whole = ResponseCurve(
        np.arange(4.0), np.full(4, 0.1), absolute=True, valid_dn=(1, 2), channel="red",
        provenance=Provenance("by hand", ("a.png",), ("none",), {"x": 1}),
    )  # fmt: skip
    whole.write(tmp_path / "c.yaml")
    read = ResponseCurve.read(tmp_path / "c.yaml")
    assert (read.absolute, read.valid_dn, read.channel, read.provenance) == (True, (1, 2), "red", whole.provenance)
    assert whole.to_mapping()["unit"] == "ln(J m-2)"
    assert curve().to_mapping()["unit"] == "ln(relative exposure)"
    for middle, absolute in ((0.0, False), (0.9e-9, False), (-0.9e-9, False), (1.1e-9, True), (-1.1e-9, True)):
        one = ResponseCurve(np.array([-2.0, -1.0, middle, 1.0]), np.zeros(4), absolute=absolute)
        one.write(tmp_path / "c.CSV")
        assert ResponseCurve.read(tmp_path / "c.CSV").absolute is absolute


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"format": "radiometer-response/0"}, "expected 'radiometer-response/1'"),
        ({"log_exposure": None}, "c.yaml: a response curve needs 2"), ({"u_log_exposure": ["x"]}, "c.yaml: could not"),
        ({"valid_dn": [1, "x"]}, "c.yaml: invalid"), ({"valid_dn": 3}, "c.yaml: 'int'"),
    ],
)  # fmt: skip
def test_a_mapping_that_is_no_curve_is_refused_by_its_place(change, message):
    """The file is named, and the key that is missing."""
    whole = curve().to_mapping()
    with pytest.raises(InputError, match=message):
        ResponseCurve.from_mapping({**whole, **change}, "c.yaml")
    for key in ("log_exposure", "u_log_exposure"):
        with pytest.raises(InputError, match=f"c.yaml: key '{key}' is missing"):
            ResponseCurve.from_mapping({name: one for name, one in whole.items() if name != key}, "c.yaml")
    least = {"format": whole["format"], "log_exposure": [0.0, 1.0], "u_log_exposure": [0.0, 0.0]}
    found = ResponseCurve.from_mapping(least, "c.yaml")
    assert (found.absolute, found.valid_dn, found.channel) == (False, None, "mono")
