"""A simulated subject's thresholds, fitted: what went in comes out."""

import numpy as np
import pytest

from radiometer.adaptation.adaptation_fit import AdaptationFit, FitRequest, fit_adaptation
from radiometer.adaptation.threshold_series import ThresholdSeries
from simulators.observers.eye_kinetics import Eye, eye_after_bleach
from simulators.observers.observer import Observer

QUICK = FitRequest(bootstrap_draws=0)
STEP_LOG10 = 0.1
BLINK_S = 1.0


def limits_run(observer: Observer, wavelength_nm: float, duration_min: float = 30.0) -> ThresholdSeries:
    """Return thresholds by ascending limits: 0.1 log10 per blink of 1 s until seen, anew 0.5 below, every 20 s.

    An ascent that is answered at its first blink began too high: it counts for nothing, the next begins 1.0 lower.
    """
    times, thresholds, start, time_s = [], [], 3.0, 30.0
    while time_s < 60 * duration_min:
        level, begun_s = start, time_s
        if observer.answer(level, time_s, wavelength_nm) is not None:
            start, time_s = start - 1.0, time_s + 2 * BLINK_S
            continue
        while observer.answer(level, time_s, wavelength_nm) is None and level < 5.0:
            level, time_s = level + STEP_LOG10, time_s + BLINK_S
        times.append((begun_s + time_s) / 120)
        thresholds.append(level)
        start, time_s = level - 0.5, begun_s + 20.0
    return ThresholdSeries(np.array(times), np.array(thresholds))


def fitted(observer: Observer, wavelength_nm: float) -> AdaptationFit:
    """Return the fit of a run."""
    return fit_adaptation(limits_run(observer, wavelength_nm), QUICK, np.random.default_rng(0))


@pytest.mark.slow
def test_breaks_of_eyes_are_found_and_other_bends_are_none():
    """At 453 nm within three u; where S2 gives way to S3 no cones settle."""
    eye = Eye(s3_slope_per_min=-0.04)
    found = fitted(Observer(eye, rng=np.random.default_rng(0)), 453.0)
    assert found.has_break
    estimate = found.estimates["break_min"]
    assert abs(estimate.value - eye.break_min(453.0)) < 3 * estimate.u + 0.1
    assert found.estimates["s2_slope_per_min"].value == pytest.approx(-0.24, abs=0.03)
    eye = eye_after_bleach(Eye(), 300.0, 120.0)
    assert eye.break_min(453.0) < 1.0
    found = fitted(Observer(eye, rng=np.random.default_rng(6)), 453.0)
    assert not found.has_break, found.verdict
