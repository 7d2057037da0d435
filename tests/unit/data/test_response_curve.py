"""Response curves: files round trip to the last bit; what is no curve is refused."""

from __future__ import annotations

import numpy as np
import pytest

from radiometer.data import ResponseCurve
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


@pytest.mark.parametrize("text", ["", "dn,g\n0,1\n", "dn,log_exposure,u_log_exposure\n0,0,0\n2,1,0\n"])
def test_a_csv_that_is_no_curve_is_refused(tmp_path, text):
    """Wrong header, gaps, emptiness."""
    (tmp_path / "c.csv").write_text(text)
    with pytest.raises(InputError, match=r"c\.csv"):
        ResponseCurve.read(tmp_path / "c.csv")
