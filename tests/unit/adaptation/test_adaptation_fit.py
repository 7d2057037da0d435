"""Branch fits of dark-adaptation thresholds."""

from __future__ import annotations

import json

import numpy as np
import pytest

from radiometer.adaptation.adaptation_fit import FitRequest, fit_adaptation, makes_sense
from radiometer.adaptation.branch_fit import fit_model
from radiometer.adaptation.branch_models import CONE_S2, CONE_S2_S3, MODELS, ONE_BRANCH
from radiometer.adaptation.intervals import profile_interval
from radiometer.adaptation.threshold_series import ThresholdSeries
from radiometer.cli.main import run
from radiometer.errors import InputError, MeasurementError

TIMES = np.arange(0.5, 30.0, 0.5)
QUICK = FitRequest(bootstrap_draws=0)


def curve(times: np.ndarray, rod_rod: float = 1e9) -> np.ndarray:
    """Return an eye's thresholds: cones to -1 (amplitude 2, 1.6 min), break at 9 min, S2 -0.24, S3 -0.03 per min."""
    found = []
    for time in times:
        if time <= 9.0:
            found.append(-1 + 2 * np.exp(-time / 1.6))
        else:
            fast = min(time, rod_rod) - 9.0
            slow = max(time - rod_rod, 0.0)
            found.append(-1 + 2 * np.exp(-9.0 / 1.6) - 0.24 * fast - 0.03 * slow)
    return np.array(found)


def series(sigma: float, seed: int = 1, rod_rod: float = 1e9, times: np.ndarray = TIMES) -> ThresholdSeries:
    """Return that eye's thresholds with noise."""
    return ThresholdSeries(times, curve(times, rod_rod) + np.random.default_rng(seed).normal(0, sigma, times.size))


@pytest.mark.slow
def test_seven_parameters_are_chosen_where_there_is_an_s3():
    """AICc takes the full model with S3 present, five parameters without, one branch for cones alone."""
    rng = np.random.default_rng(0)
    with_s3 = fit_adaptation(series(0.08, rod_rod=18.0), QUICK, rng)
    without = fit_adaptation(series(0.08, times=TIMES[TIMES < 20]), QUICK, rng)
    cones = fit_adaptation(series(0.08, times=np.arange(0.25, 8.5, 0.25)), QUICK, rng)
    assert [one.chosen.model for one in (with_s3, without, cones)] == [CONE_S2_S3, CONE_S2, ONE_BRANCH]
    second = with_s3.estimates["rod_rod_break_min"]
    assert abs(second.value - 18.0) < 3 * second.u
    assert not cones.has_break


def test_outliers_hardly_move_the_break():
    """Four wild presses of 1.5 log units shift the break by less than its own interval's half width."""
    clean = series(0.08)
    wild = clean.log_threshold.copy()
    wild[[5, 20, 30, 45]] += 1.5
    before = fit_model(clean, CONE_S2)
    after = fit_model(ThresholdSeries(clean.time_min, wild), CONE_S2)
    half = profile_interval(before, "break_min").high - before.values["break_min"]
    assert abs(after.values["break_min"] - before.values["break_min"]) < half
    assert after.weights[[5, 20, 30, 45]].max() < 0.3


def test_profile_interval_shrinks_with_the_noise():
    """Half the noise gives half the interval (the same draws)."""
    wide = profile_interval(fit_model(series(0.10), CONE_S2), "s2_slope_per_min")
    narrow = profile_interval(fit_model(series(0.05), CONE_S2), "s2_slope_per_min")
    assert (narrow.high - narrow.low) / (wide.high - wide.low) == pytest.approx(0.5, abs=0.05)


@pytest.mark.slow
def test_bootstrap_and_profile_agree():
    """Both intervals of the break have about the same width."""
    found = fit_adaptation(series(0.08), FitRequest(bootstrap_draws=150), np.random.default_rng(3))
    estimate = found.estimates["break_min"]
    ratio = (estimate.bootstrap.high - estimate.bootstrap.low) / (estimate.profile.high - estimate.profile.low)
    assert 0.6 < ratio < 1.5


@pytest.mark.slow
def test_rod_intercept_of_one_branch_is_where_it_crosses_a_stated_criterion():
    """A quick test shows the rods alone: -4 + 3·exp(-t/6) meets -3 at 6·ln 3 min; -5 is met never, and not stated."""
    times = np.arange(0.2, 7.0, 0.2)
    noise = np.random.default_rng(3).normal(0, 0.1, times.size)
    rods = ThresholdSeries(times, -4 + 3 * np.exp(-times / 6) + noise)
    found = fit_adaptation(rods, FitRequest(criterion=-3.0, bootstrap_draws=60), np.random.default_rng(0))
    assert not found.has_break
    met = found.estimates["criterion_min"]
    assert abs(met.value - 6 * np.log(3)) < 3 * met.u
    assert met.u < 0.5
    never = fit_adaptation(rods, FitRequest(criterion=-5.0, bootstrap_draws=0), np.random.default_rng(0))
    assert "criterion_min" not in never.estimates


def test_rod_intercept_is_where_s2_meets_the_criterion():
    """At a criterion of -3.0: 9 + (2 + 2·exp(-9/1.6))/0.24 min."""
    found = fit_adaptation(series(0.0), FitRequest(-3.0, bootstrap_draws=0), np.random.default_rng(0))
    expected = 9 + (-3.0 - (-1 + 2 * np.exp(-9 / 1.6))) / -0.24
    assert found.estimates["criterion_min"].value == pytest.approx(expected, rel=2e-3)


@pytest.mark.slow
def test_stimulus_uncertainty_widens_levels_and_not_slopes():
    """A scale uncertainty of 0.05 shifts thresholds, leaves slopes, and moves a stated criterion's time by u/|S2|."""
    data = series(0.05)
    plain = fit_adaptation(data, FitRequest(-3.0, 0.0, 60), np.random.default_rng(1)).estimates
    shared = fit_adaptation(data, FitRequest(-3.0, 0.05, 60), np.random.default_rng(1)).estimates
    assert shared["s2_slope_per_min"].u == plain["s2_slope_per_min"].u
    assert shared["plateau"].u == pytest.approx(np.hypot(plain["plateau"].u, 0.05), rel=1e-6)
    moved = 0.05 / abs(plain["s2_slope_per_min"].value)
    assert shared["criterion_min"].u == pytest.approx(np.hypot(plain["criterion_min"].u, moved), rel=1e-6)


@pytest.mark.slow
def test_rising_rods_make_no_sense():
    """A fit whose "rod branch" does not fall is not physiological."""
    times = np.arange(0.5, 20, 0.5)
    flat = ThresholdSeries(times, -1 + 2 * np.exp(-times / 1.6) + np.random.default_rng(4).normal(0, 0.05, times.size))
    fits = [fit_model(flat, model) for model in MODELS]
    assert makes_sense(fits[0])
    assert fit_adaptation(flat, QUICK, np.random.default_rng(0)).chosen.model is ONE_BRANCH


@pytest.mark.parametrize(
    ("values", "message"),
    [
        (np.full(40, 0.0), "never, or always, pressed"),
        (np.random.default_rng(5).normal(0, 0.3, 40), "no recovery"),
        (np.linspace(2, -3, 5), "too few"),
    ],
)
def test_no_adaptation_is_a_verdict_and_no_fit(values, message):
    """Who never pressed, pressed at random or left gives a clear message."""
    data = ThresholdSeries(np.arange(values.size, dtype=float), values)
    with pytest.raises(MeasurementError, match=message):
        fit_adaptation(data, QUICK, np.random.default_rng(0))


def test_csv_forms(tmp_path):
    """With header, without header, with sigma and in any order of rows."""
    file = tmp_path / "run.csv"
    file.write_text("log10_threshold,time_min,sigma\n-1,2,0.1\n1,0.5,0.2\n")
    read = ThresholdSeries.read(file)
    assert (list(read.time_min), list(read.log_threshold), list(read.sigma)) == ([0.5, 2.0], [1.0, -1.0], [0.2, 0.1])
    file.write_text("0.5,1\n2,-1\n")
    assert ThresholdSeries.read(file).sigma is None


@pytest.mark.parametrize("text", ["", "a,b\n1,2\n", "time_min,log10_threshold\n1,x\n", "1\n2\n"])
def test_wrong_csv_is_named(tmp_path, text):
    """A file of another form is refused with its name."""
    file = tmp_path / "run.csv"
    file.write_text(text)
    with pytest.raises(InputError, match=r"run\.csv"):
        ThresholdSeries.read(file)


@pytest.mark.slow
def test_command_writes_json_page_and_csv(tmp_path, capsys):
    """`adapt fit` prints one JSON object and writes what it is asked for."""
    data = series(0.08)
    file = tmp_path / "run.csv"
    rows = [f"{t},{y}" for t, y in zip(data.time_min, data.log_threshold, strict=True)]
    file.write_text("time_min,log10_threshold\n" + "\n".join(rows))
    page, table = tmp_path / "r.html", tmp_path / "r.csv"
    words = ["adapt", "fit", str(file), "--json", "--bootstrap", "20", "--report", str(page), "--csv", str(table)]
    assert run(words) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["model"] == "cone+S2"
    assert report["estimates"]["break_min"]["value"] == pytest.approx(9.0, abs=0.6)
    assert "Rod–cone break" in page.read_text(encoding="utf-8")
    assert table.read_text().splitlines()[0] == "time_min,log10_threshold,fitted,residual,weight"
