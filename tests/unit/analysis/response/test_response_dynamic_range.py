"""The dynamic-range procedure: absolute values from regions brought to one reference value."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from radiometer.analysis.response.dynamic_range import RangePoint, dynamic_range, with_dynamic_range
from radiometer.analysis.response.mitsunaga1999 import recover_response_mitsunaga1999
from radiometer.cli.main import run
from radiometer.data import Bracket, Calibration, ResponseCurve
from radiometer.errors import InputError, MeasurementError

REFERENCE_DN, REFERENCE_S = 127.0, 1 / 125


def exposure_of(dn: float) -> float:
    """Return H over that of white of the simulated camera, M = 255·H^(1/2.2)."""
    return float((dn / 255.0) ** 2.2)


def point(dn: float) -> RangePoint:
    """Return the region at `dn` with the time that puts it on the reference value."""
    return RangePoint(dn, REFERENCE_S * exposure_of(REFERENCE_DN) / exposure_of(dn))


@pytest.fixture(scope="module")
def stretched(make_stack) -> ResponseCurve:
    """Return a Mitsunaga–Nayar curve from frames two-fold apart whose times were stated as 2.3-fold apart."""
    frames = [
        replace(frame, settings=replace(frame.settings, exposure_s=1e-3 * 2.3**index))
        for index, frame in enumerate(make_stack("gamma", bit_depth=8).light)
    ]
    return recover_response_mitsunaga1999(Bracket.from_frames(frames)).curve


def test_white_and_black_regions_put_the_exponent_right(stretched):
    """Times stated 2.3-fold for 2-fold stretch ln H by ln 2.3/ln 2; M=1 and M=254 take that out, within 2 u.

    The uncertainty is under a tenth of what was to be taken out.
    """
    found = dynamic_range(stretched, [point(1), point(254)], REFERENCE_S, REFERENCE_DN)
    assert abs(found.exponent - math.log(2.0) / math.log(2.3)) < 2 * found.u_exponent
    assert found.u_exponent < 0.1 * (1.0 - math.log(2.0) / math.log(2.3))
    wrong, right = (
        np.array([curve.log_exposure[dn] - curve.log_exposure[127] for dn in (30, 60, 200, 254)])
        for curve in (stretched, with_dynamic_range(stretched, found))
    )
    truth = np.array([math.log(exposure_of(dn) / exposure_of(127)) for dn in (30, 60, 200, 254)])
    assert np.max(np.abs(right - truth)) < 0.02
    assert np.min(np.abs(wrong - truth)) > 0.1


@pytest.mark.slow
def test_errors_lie_within_the_stated_uncertainty(stretched):
    """Over readings rounded to whole numbers the mean squared error of γ in units of u lies between 0.3 and 1.7."""
    rng = np.random.default_rng(4)
    # Only what the reading brings is drawn anew, so the curve is the true one, twice too steep.
    dn = np.arange(256.0)
    truth = ResponseCurve(4.4 * np.log(np.maximum(dn, 0.5) / 128), np.full(256, 1e-6), valid_dn=(1, 254))
    squares = []
    for _ in range(200):
        real = [rng.uniform(3.5, 9.5), rng.uniform(230.0, 250.0)]
        read = [replace(point(value), dn=float(np.round(value))) for value in real]
        # The time is set so that the region lands somewhere near the reference value, and where is read as well.
        landed = rng.uniform(120.0, 134.0, 2)
        read = [
            replace(one, exposure_s=REFERENCE_S * exposure_of(at) / exposure_of(value), landed_dn=float(np.round(at)))
            for one, at, value in zip(read, landed, real, strict=True)
        ]
        found = dynamic_range(truth, read, REFERENCE_S, REFERENCE_DN)
        squares.append(((found.exponent - 0.5) / found.u_exponent) ** 2)
    assert 0.3 < np.mean(squares) < 1.7


def test_the_ends_run_to_the_measured_exposures(stretched):
    """At M = 1, where a polynomial says nothing, ln H is the measured one; it rises all the way and stays flagged."""
    found = dynamic_range(stretched, [point(1), point(254)], REFERENCE_S, REFERENCE_DN)
    curve = with_dynamic_range(stretched, found)
    at_one = curve.log_exposure[1] - curve.log_exposure[127]
    assert at_one == pytest.approx(math.log(exposure_of(1) / exposure_of(127)), abs=0.02)
    assert np.all(np.diff(curve.log_exposure) >= 0)
    assert curve.u_log_exposure[1] < 0.5 * stretched.u_log_exposure[1]
    assert curve.valid_dn == stretched.valid_dn
    assert any("dynamic range of 2 regions" in text for text in curve.provenance.assumptions)


def test_where_a_region_landed_counts(stretched):
    """A region that lands on 140 instead of 127 gives the same exponent once that is stated."""
    exact = dynamic_range(stretched, [point(250)], REFERENCE_S, REFERENCE_DN)
    time = REFERENCE_S * exposure_of(140) / exposure_of(250)
    neighbour = dynamic_range(stretched, [RangePoint(250, time, 140.0)], REFERENCE_S, REFERENCE_DN)
    assert neighbour.exponent == pytest.approx(exact.exponent, abs=2 * exact.u_exponent)
    assert neighbour.log_steps[0] == pytest.approx(exact.log_steps[0], abs=2 * exact.u_log_steps[0] + 0.01)
    assert exact.reduced_chi2 is None


@pytest.mark.parametrize(
    ("points", "error", "message"),
    [
        ([], InputError, "at least one region"),
        ([RangePoint(254, 1 / 30)], MeasurementError, "shorter time"),
        ([RangePoint(130, 1 / 130)], MeasurementError, "too near"),
        ([RangePoint(300, 1 / 500)], InputError, "below 255"),
        ([RangePoint(254, -1.0)], InputError, "above 0"),
    ],
)
def test_what_contradicts_the_procedure_is_refused(stretched, points, error, message):
    """The message says what does not fit and the way out."""
    with pytest.raises(error, match=message):
        dynamic_range(stretched, points, REFERENCE_S, REFERENCE_DN)


def test_calibrate_takes_regions_and_gives_absolute_exposures(stretched, tmp_path, capsys):
    """With K, the reference photograph and two regions, H at M = 30 … 254 is right in J/m² to within 2 u."""
    stretched.write(tmp_path / "curve.yaml")
    words = [f"{one.dn:g},{one.exposure_s!r}" for one in (point(1), point(254))]
    command = ["calibrate", "--response", str(tmp_path / "curve.yaml"), "--luminance-meter-k", "16.5"]
    command += ["--f-number", "16", "--exposure", repr(REFERENCE_S), "--iso", "136", "--reference-dn", "127"]
    command += ["--as-printed", "--json", "-o", str(tmp_path / "cal.yaml")]
    for word in words:
        command += ["--dynamic-range", word]
    assert run(command) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["dynamic_range"]["exponent"] == pytest.approx(math.log(2.0) / math.log(2.3), rel=0.01)
    calibration = Calibration.read(tmp_path / "cal.yaml")
    reference = report["metered"]["radiance"]["value"] * math.pi / 4 / 16**2 * REFERENCE_S
    assert calibration.response is not None
    for dn in (30, 60, 200, 254):
        found = math.log(calibration.scale.value) + calibration.response.log_exposure[dn]
        expected = math.log(reference * exposure_of(dn) / exposure_of(127))
        assert abs(found - expected) < 2 * math.hypot(calibration.response.u_log_exposure[dn], 0.005)


@pytest.mark.parametrize("word", ["254", "254,x", "a,1/500", "254,1/500,1,2"])
def test_a_region_of_another_form_is_a_misuse(stretched, tmp_path, capsys, word):
    """Exit code 2, and the message shows the form."""
    stretched.write(tmp_path / "curve.yaml")
    command = ["calibrate", "--response", str(tmp_path / "curve.yaml"), "--luminance-meter-k", "16.5", "--f-number"]
    command += ["16", "--exposure", "1/125", "--iso", "136", "--dynamic-range", word, "-o", str(tmp_path / "c.yaml")]
    assert run(command) == 2
    assert "expected" in capsys.readouterr().err
