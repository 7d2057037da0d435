"""Curves for other programs: their numbers, their layout, and the real file of a peer as a measure."""

from __future__ import annotations

import numpy as np
import pytest

from radiometer.analysis.exports.curves import polynomial, read_curves, write_curves
from radiometer.data import ResponseCurve
from radiometer.errors import InputError, UsageError


def gamma_curve(power=2.2, size=256):
    """Return M/M_max to a power, nothing at 0."""
    with np.errstate(divide="ignore"):
        return ResponseCurve(power * np.log(np.arange(size) / (size // 2)), np.zeros(size))


def test_pfstools_reads_ratios_back(tmp_path):
    """Three named matrices; columns two and three are the number and a response in proportion to exposure."""
    write_curves(tmp_path / "c.m", {"mono": gamma_curve()})
    text = (tmp_path / "c.m").read_text()
    assert [line.split()[-1] for line in text.splitlines() if line.startswith("# name")] == ["IR", "IG", "IB"]
    rows = np.array([[float(v) for v in line.split()] for line in text.splitlines() if line and line[0] != "#"])
    first = rows[:256]
    assert rows.shape == (768, 3)
    np.testing.assert_array_equal(first[:, 1], np.arange(256))
    np.testing.assert_allclose(first[200, 2] / first[100, 2], 2**2.2, rtol=1e-6)
    np.testing.assert_allclose(10 ** first[50:, 0], first[50:, 2], rtol=1e-6)
    assert first[0, 0] == -6.0


def test_hdrgen_s_polynomial_follows_the_curve(tmp_path):
    """Three lines; the polynomial, highest power first, is 1 at full scale and within 0.2 % of it elsewhere."""
    write_curves(tmp_path / "c.rsp", {"mono": gamma_curve()})
    lines = (tmp_path / "c.rsp").read_text().splitlines()
    assert len(lines) == 3
    order, *coefficients = (float(v) for v in lines[0].split())
    assert order == len(coefficients) - 1
    x = np.linspace(0, 1, 256)
    found = np.polyval(coefficients, x)
    assert found[-1] == pytest.approx(1.0, abs=1e-9)
    assert np.all(np.diff(found) >= 0)
    np.testing.assert_allclose(found, x**2.2, atol=3e-3)


def test_a_true_polynomial_comes_out_as_it_is():
    """x² + 0: order 2, coefficients 1, 0, 0."""
    np.testing.assert_allclose(polynomial(gamma_curve(2.0)), [1.0, 0.0, 0.0], atol=1e-9)


def test_channels_keep_their_own_curves(tmp_path):
    """Red, green and blue in that order."""
    write_curves(tmp_path / "c.rsp", {"blue": gamma_curve(3.0), "red": gamma_curve(1.0), "green": gamma_curve(2.0)})
    orders = [int(line.split()[0]) for line in (tmp_path / "c.rsp").read_text().splitlines()]
    assert orders == [1, 2, 3]


def test_missing_channels_are_refused(tmp_path):
    """Two curves are neither one nor three."""
    with pytest.raises(UsageError, match="blue"):
        write_curves(tmp_path / "c.m", {"red": gamma_curve(), "green": gamma_curve()})


def test_the_layout_is_that_of_the_peer_s_file(shared_data):
    """The .rsp of the Canon set has a first number that is its order, and sums to 1, as ours do."""
    file = shared_data / "stacks/canon5d2_fisheye_calibrated/example/response_function_files/Response_function.rsp"
    for line in file.read_text().splitlines():
        order, *coefficients = (float(v) for v in line.split())
        assert order == len(coefficients) - 1
        assert sum(coefficients) == pytest.approx(1.0, abs=1e-5)


@pytest.mark.parametrize("ending", [".m", ".rsp"])
def test_what_we_write_for_others_we_read_back(tmp_path, ending):
    """Three channels come back within the polynomial's error over the middle, with an assumed u that is stated."""
    curves = {name: gamma_curve(power) for name, power in (("red", 1.8), ("green", 2.0), ("blue", 2.2))}
    write_curves(tmp_path / f"c{ending}", curves)
    found = read_curves(tmp_path / f"c{ending}")
    assert list(found) == ["red", "green", "blue"]
    for name, curve in found.items():
        expected = curves[name].log_exposure
        assert np.max(np.abs(curve.log_exposure[60:250] - expected[60:250])) < 0.02
        assert curve.log_exposure[128] == 0.0
        assert np.median(curve.u_log_exposure[10:250]) == pytest.approx(0.03)
        assert "states none" in curve.provenance.assumptions[0]


def test_a_csv_file_is_of_the_channel_in_its_name(tmp_path):
    """`curve-red.csv` is red's; any other name is of no colour."""
    gamma_curve().write(tmp_path / "curve-red.csv")
    gamma_curve().write(tmp_path / "plain.csv")
    assert list(read_curves(tmp_path / "curve-red.csv")) == ["red"]
    assert list(read_curves(tmp_path / "plain.csv")) == ["mono"]


@pytest.mark.parametrize(
    ("name", "text"), [("a.m", "1 2\n3 4\n"), ("a.rsp", "3 1 0\n"), ("b.m", "x y z\n"), ("inf.rsp", "inf 1 0\n")]
)
def test_what_is_no_curve_is_refused(tmp_path, name, text):
    """With the file named, and no traceback."""
    (tmp_path / name).write_text(text)
    with pytest.raises(InputError, match=name):
        read_curves(tmp_path / name)
