"""Drift by references, warm-up, flicker, uniformity and the limit of detection."""

from __future__ import annotations

import numpy as np
import pytest

from radiometer.devices import DisplayPatch
from radiometer.errors import MeasurementError
from radiometer.screen.calibration_run import Options, calibrate_screen
from radiometer.screen.checks import Uniformity, additivity, judge_flicker, wait_until_steady
from radiometer.screen.drift import Drift
from radiometer.screen.meter import ScreenReading
from radiometer.screen.plan import ScreenStep, make_plan
from radiometer.screen.run import Light, Measured, curves_of, measure_steps


def _reading(value: float, time_s: float = 0.0, u: float = 1e-4) -> ScreenReading:
    return ScreenReading(value, u, 0.01, time_s)


class _Warming:
    """White that settles with 100 s."""

    def __init__(self, excess: float) -> None:
        self.excess, self.now = excess, 0.0

    def read(self) -> ScreenReading:
        return _reading(1 + self.excess * float(np.exp(-self.now / 100)), self.now)

    def sleep(self, seconds: float) -> None:
        self.now += seconds


def test_linear_drift_is_taken_out_to_rounding() -> None:
    """A level measured while the lamp fades linearly comes out as at its mean output."""
    whites = [Measured(ScreenStep("grey", 255, "white"), (_reading(1 - 0.001 * t, t),)) for t in (0.0, 10.0, 20.0)]
    levels = [
        Measured(ScreenStep("grey", n), (_reading(n / 255 * (1 - 0.001 * t), t),))
        for n, t in ((0, 2), (128, 7), (255, 15))
    ]
    curves, drift = curves_of([*whites, *levels], {"grey": Light(320, 700, "x")})
    assert curves["grey"].radiance == pytest.approx((0.0, 128 / 255 * 0.99, 0.99), rel=1e-12)
    assert drift.range_rel == pytest.approx(0.02 / 0.99)


def test_scatter_of_references_is_the_drifts_uncertainty() -> None:
    """White that scatters by 0.5 % gives levels between references √0.5 times that, within 4 sigmas of its estimate."""
    rng = np.random.default_rng(3)
    whites = [_reading(1 + 0.005 * rng.standard_normal(), 10.0 * t, u=0.0) for t in range(400)]
    expected, sigma = 0.005 * np.sqrt(0.5), 0.005 * np.sqrt(0.5) / np.sqrt(2 * 400 / 2)
    assert Drift.of(whites).u_rel == pytest.approx(expected, abs=4 * sigma)


def test_warm_up_waits_until_steady() -> None:
    """A lamp 5 % too bright is watched until its change over five readings is below 0.2 %."""
    lamp = _Warming(0.05)
    seen = wait_until_steady(lamp, lamp.sleep, limit_s=1000)
    assert seen.steady
    assert seen.drift_rel <= 0.002
    assert 0.05 * np.exp(-(lamp.now - 240) / 100) <= 0.0022


def test_warm_up_gives_up_in_time_and_says_so() -> None:
    """A lamp that never settles within the limit is reported as drifting."""
    lamp = _Warming(2.0)
    seen = wait_until_steady(lamp, lamp.sleep, limit_s=120)
    assert not seen.steady
    assert seen.waited_s == pytest.approx(120)


@pytest.mark.parametrize(("scatter", "found"), [(0.001, False), (0.01, True)])
def test_flicker_is_scatter_beyond_noise(scatter: float, found: bool) -> None:
    """Noise of 0.1 % is no flicker; ten times that is."""
    rng = np.random.default_rng(5)
    assert judge_flicker((1 + scatter * rng.standard_normal(16)).tolist(), 0.001, 1e-3).found is found


def test_false_alarms_of_the_flicker_check_are_rare() -> None:
    """Of 2000 steady lights with 0.1 % noise fewer than 0.5 % are called flickering."""
    rng = np.random.default_rng(6)
    alarms = sum(judge_flicker((1 + 0.001 * rng.standard_normal(16)).tolist(), 0.001, 1e-3).found for _ in range(2000))
    assert alarms < 10


def test_uniformity_is_relative_to_the_middle() -> None:
    """Corners at 90 % show as such."""
    seen = Uniformity.of([[0.9, 1.8, 0.9], [1.9, 2.0, 1.9], [1.8, 2.1, 1.8]])
    assert (seen.lowest, seen.highest) == (0.45, 1.05)


def test_additivity_takes_the_black_out() -> None:
    """Three primaries each with the black in it add up to white when two blacks are taken away."""
    assert additivity({"grey": 1.0, "red": 0.31, "green": 0.41, "blue": 0.3}, 0.01) == pytest.approx(0.0)
    assert additivity({"grey": 1.0}, 0.0) is None


def test_black_that_is_not_seen_becomes_a_limit() -> None:
    """Black readings around zero give a detection limit of three standard uncertainties of their mean."""
    whites = [Measured(ScreenStep("grey", 255, "white"), (_reading(1.0, t),)) for t in (0.0, 10.0)]
    blacks = [Measured(ScreenStep("grey", 0, "black"), (_reading(v, 1.0, u=1e-3),)) for v in (1e-4, -1e-4)]
    levels = [Measured(ScreenStep("grey", n), (_reading(n / 255, 2.0, u=1e-3),)) for n in (0, 128, 255)]
    curve = curves_of([*whites, *blacks, *levels], {"grey": Light(320, 700, "x")})[0]["grey"]
    assert curve.detection_limit == pytest.approx(3 * 1e-3 / np.sqrt(3))
    assert curve.radiance_is_lost(0)
    assert not curve.radiance_is_lost(128)


def test_without_references_there_is_no_curve() -> None:
    """The drift must be known."""
    with pytest.raises(MeasurementError, match="white references"):
        curves_of([Measured(ScreenStep("grey", 0), (_reading(0.0),))], {})


def test_camera_that_looks_elsewhere_is_found_out_at_once() -> None:
    """White and black that read alike end the measurement after these two, with the way out."""
    shown: list[DisplayPatch] = []

    class Elsewhere:
        def show(self, patch: DisplayPatch) -> None:
            shown.append(patch)

        def read(self) -> ScreenReading:
            return _reading(0.3)

    looked, plan = Elsewhere(), make_plan((0, 128, 255), ("grey",), np.random.default_rng(1))
    with pytest.raises(MeasurementError, match="does not see the patches"):
        measure_steps(looked, looked, plan)  # type: ignore[arg-type]
    assert len(shown) == 2


def test_impossible_screen_is_refused_before_it_warms_up() -> None:
    """White that is no brighter than black ends the calibration without any wait."""
    waits: list[float] = []

    class Elsewhere:
        display = property(lambda self: self)
        sleep = property(lambda self: waits.append)

        def show(self, patch: DisplayPatch) -> None:
            """Show nothing that is seen."""

        def read(self) -> ScreenReading:
            return _reading(0.3)

    with pytest.raises(MeasurementError, match="does not see the patches"):
        calibrate_screen(Elsewhere(), Options("x", (0, 128, 255)), {})  # type: ignore[arg-type]
    assert waits == []
