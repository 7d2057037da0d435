"""Trends and cycles of readings over time."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from radiometer.archive.cycles import near_the_season, slow_cycles
from radiometer.archive.trend import MONTH_S, fit_trend, read_histories
from radiometer.archive.trend_report import advice, outcome, trend_report
from radiometer.errors import InputError

U_REL = 0.005


def history(rng, drift_per_month, readings=120, scatter=0.002):
    """Return 12 months of readings whose scatter is smaller than their stated u (most of it is shared)."""
    time_s = np.sort(rng.uniform(0, 12 * MONTH_S, readings))
    value = 5.0 * (1 + drift_per_month * time_s / MONTH_S) * (1 + scatter * rng.standard_normal(readings))
    return time_s, value, np.full(readings, 5.0 * U_REL)


@pytest.mark.parametrize("archives", [40, pytest.param(200, marks=pytest.mark.long)])
def test_the_stated_uncertainty_of_the_drift_is_honest(archives):
    """Errors of n archives scatter by at most the stated sigma (known to 1/√(2n)), which is at most twice too wide."""
    pulls = []
    for seed in range(archives):
        trend = fit_trend(*history(np.random.default_rng(seed), 0.001, readings=60))
        pulls.append((trend.drift_per_month - 0.001 / (1 + 0.001 * 6)) / trend.u_drift_per_month)
    assert 0.5 < np.std(pulls) < 1.1


@pytest.mark.parametrize(("archives", "most"), [(30, 2), pytest.param(300, 4, marks=pytest.mark.long)])
def test_no_drift_is_claimed_where_there_is_none(archives, most):
    """Of 300 archives without a drift at most 4 false claims at three sigmas (0.8 expected), of 30 at most 2 (0.08)."""
    claims = [fit_trend(*history(np.random.default_rng(seed), 0.0, readings=60)).drifts for seed in range(archives)]
    assert sum(claims) <= most


def test_outliers_are_named_and_do_not_bend_the_line():
    """One reading 5 % too high moves no drift, a quarter leave the fit; 2 % of scatter are √(2² − 0.5²) too many."""
    time_s, value, u = history(np.random.default_rng(3), 0.0)
    without = fit_trend(time_s, value, u)
    value = value.copy()
    value[-1] *= 1.05
    trend = fit_trend(time_s, value, u)
    assert trend.outlier.nonzero()[0].tolist() == [value.size - 1]
    assert abs(trend.drift_per_month - without.drift_per_month) < without.u_drift_per_month
    time_s, value, u = history(np.random.default_rng(6), 0.0)
    value = value[:40].copy()
    value[1:31:2] *= 1.0 + 8.0 ** np.arange(15)
    assert fit_trend(time_s[:40], value, u[:40]).outlier.sum() == 11
    trend = fit_trend(*history(np.random.default_rng(4), 0.0, scatter=0.02))
    assert trend.excess_rel == pytest.approx(np.sqrt(0.02**2 - U_REL**2), rel=0.2)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda t, v, u: (t[:5], v[:5], u[:5]), "too few for a trend"),
        (lambda t, v, u: (t * 0, v, u), "all readings are of one time"),
        (lambda t, v, u: (t, v * 0, u), "must be above 0"),
        (lambda t, v, u: (t, v, u * 0), "must be above 0"),
    ],
)
def test_what_has_no_trend_is_refused(change, message):
    """Too few, one time only, nothing to be relative to."""
    with pytest.raises(InputError, match=message):
        fit_trend(*change(*history(np.random.default_rng(5), 0.0)))


def correlated(seed, rho=0.8, days=7.0, count=104, sigma=0.003):
    """Return two years of weekly readings whose errors are AR(1), without a drift."""
    rng = np.random.default_rng(seed)
    errors = np.empty(count)
    errors[0] = rng.normal(0, sigma)
    for i in range(1, count):
        errors[i] = rho * errors[i - 1] + np.sqrt(1 - rho**2) * rng.normal(0, sigma)
    return np.arange(count) * days * 86400.0, 5.0 * (1 + errors), np.full(count, 5.0 * sigma)


@pytest.mark.parametrize(("archives", "most"), [(30, 2), pytest.param(300, 6, marks=pytest.mark.long)])
def test_correlated_errors_are_no_drift(archives, most):
    """300 archives of AR(1) errors, ρ = 0.8: at most 6 false claims (1 % are 3); u is no smaller than the scatter."""
    trends = [fit_trend(*correlated(seed)) for seed in range(archives)]
    assert sum(trend.drifts for trend in trends) <= most
    assert np.median([trend.correlation for trend in trends]) == pytest.approx(0.8, abs=0.1)
    drifts = np.array([trend.drift_per_month for trend in trends])
    stated = float(np.median([trend.u_drift_per_month for trend in trends]))
    assert 0.4 < drifts.std() / stated < 1.25  # long correlation times cannot be excluded: u leans to the wide side


def weekly(seed, weeks, *, drift=0.0, amplitude=0.0, period_weeks=52.18, sigma=0.003):
    """Return weekly readings with noise, a drift per month and a cycle of any phase."""
    rng = np.random.default_rng(seed)
    turns = np.arange(weeks) / period_weeks + rng.random()
    value = 1.0 + amplitude * np.sin(2 * np.pi * turns) + rng.normal(0, sigma, weeks)
    time_s = np.arange(weeks) * 7 * 86400.0
    return time_s, 5.0 * (value + drift * time_s / MONTH_S), np.full(weeks, 0.025)


def test_half_a_year_shows_a_change_and_no_drift():
    """0.5 % per month, which a season would show too, is a verdict apart; over 79 weeks a season has its amplitude."""
    trend = fit_trend(*weekly(1, 26, drift=0.005))
    assert trend.verdict == "season_or_drift"
    assert not trend.drifts
    assert trend.season_rel is None
    assert trend.straight_per_month == pytest.approx(0.005 / (1 + 0.005 * 3), abs=3 * trend.u_straight_per_month)
    assert trend.decided_from_s == pytest.approx(1.5 * 365.25 * 86400.0)
    assert trend.to_mapping()["verdict"] == "season_or_drift"
    trends = [fit_trend(*weekly(seed, 79, amplitude=0.01, sigma=0.001)) for seed in range(10)]
    assert {trend.verdict for trend in trends} == {"no_drift"}
    assert [trend.season_rel for trend in trends] == pytest.approx([0.01] * 10, rel=0.15)
    short = fit_trend(*weekly(1, 26, drift=0.005))
    assert replace(short, time_s=1.04 * 3.0 * short.time_s).verdict == "season_or_drift"  # of 75 weeks
    assert replace(short, time_s=1.1 * 3.0 * short.time_s).verdict == "no_drift"  # of 82


def test_half_a_year_of_a_season_claims_no_drift_and_of_a_fast_fall_does():
    """Seasons of 1 % and 5 % at any phase are none; 3 % per month is more than the 1 % (k = 1) that a season makes."""
    trends = [fit_trend(*weekly(seed, 26, amplitude=size)) for size in (0.01, 0.05) for seed in range(10)]
    assert not any(trend.drifts for trend in trends)
    assert {"season_or_drift"} < {trend.verdict for trend in trends} | {"no_drift"}
    fall = fit_trend(*weekly(2, 26, drift=-0.03))
    assert fall.verdict == "drift"
    assert 0.002 < fall.u_drift_per_month < 0.01
    noise = 2e-3 * np.random.default_rng(3).standard_normal(200)
    month = fit_trend(np.linspace(0.0, MONTH_S, 200), 5.0 * (1 + noise), np.full(200, 0.025))
    assert month.u_drift_per_month == pytest.approx(0.02 * 2 * np.pi / 12, rel=0.05)
    assert month.verdict == "no_drift"


@pytest.mark.parametrize(
    ("weeks", "period_weeks"), [*((52, p) for p in (26.0, 40.0, 46.0, 60.0)), *((104, p) for p in (26.0, 40.0, 7.3))]
)
def test_a_cycle_of_another_period_is_no_drift(weeks, period_weeks):
    """1 % at any phase, also nearly a year's: hardly ever claimed; over two years period and amplitude are found."""
    trends = [fit_trend(*weekly(seed, weeks, amplitude=0.01, period_weeks=period_weeks)) for seed in range(10)]
    assert sum(trend.drifts for trend in trends) <= 1
    for (period_s, amplitude), *_ in (trend.cycles for trend in trends if weeks == 104):
        assert period_s == pytest.approx(period_weeks * 7 * 86400.0, rel=0.05)
        assert amplitude == pytest.approx(0.01, rel=0.25)


def test_readings_of_two_days_years_apart_show_no_cycle():
    """They tell a change, and nothing of a season or a cycle between."""
    rng = np.random.default_rng(2)
    time_s = np.concatenate([np.arange(30) * 60.0, 5e8 + np.arange(30) * 60.0])
    trend = fit_trend(time_s, 5.0 + 0.01 * rng.standard_normal(60), np.full(60, 0.01))
    assert trend.cycles == ()
    assert trend.season_rel is None
    assert trend.degrees_of_freedom > 0


@pytest.mark.parametrize("archives", [25, pytest.param(100, marks=pytest.mark.long)])
def test_steady_readings_show_no_cycle(archives):
    """Many archives of noise alone: one cycle by chance at most."""
    shown = [fit_trend(*history(np.random.default_rng(seed), 0.0, readings=40)).cycles for seed in range(archives)]
    assert sum(map(bool, shown)) <= 1


def test_a_drift_under_season_and_correlation_is_found():
    """0.2 % per month next to noise, and next to both: found in a year, and right within 3 u."""
    time_s, value, u = correlated(5, sigma=0.001)
    months = time_s / MONTH_S
    value = value * (1 + 0.002 * months) * (1 + 0.005 * np.sin(2 * np.pi * months / 12 + 1.0))
    trend = fit_trend(time_s, value, u)
    assert trend.drifts
    assert abs(trend.drift_per_month - 0.002 / (1 + 0.002 * months.mean())) < 3 * trend.u_drift_per_month
    trends = [fit_trend(*weekly(seed, 52, drift=0.002)) for seed in range(10)]
    assert sum(trend.drifts for trend in trends) >= 9


YEAR_S = 365.25 * 86400.0


def record(years: float, readings: int, period_s: float) -> tuple[np.ndarray, ...]:
    """Return a level and a line, values with a cycle of 1 % and noise of 0.2 %, their sigma and their times."""
    time_s = np.linspace(0.0, years * YEAR_S, readings)
    noise = 0.002 * np.random.default_rng(7).standard_normal(readings)
    relative = 0.01 * np.sin(2 * np.pi * time_s / period_s + 0.4) + noise
    return np.column_stack([np.ones(readings), time_s / time_s[-1] - 0.5]), relative, np.full(readings, 0.002), time_s


def likeliest(found: list[tuple[float, float]]) -> float:
    return max(found, key=lambda one: one[1])[0]


@pytest.mark.parametrize("more", [-0.5, -0.375, -0.25, -0.125, 0.125, 0.25, 0.375, 0.5])
def test_a_cycle_nearly_as_long_as_the_season_is_the_likeliest_in_its_place(more: float) -> None:
    """Three years hold three seasons: of a cycle that comes 3 ± 1/8 to 3 ± 1/2 times the period is named."""
    planted_s = 3.0 * YEAR_S / (3.0 + more)
    found = near_the_season(*record(3.0, 160, planted_s), YEAR_S)
    assert likeliest(found) == pytest.approx(planted_s)
    assert all(2.4 < 3.0 * YEAR_S / period_s < 3.6 for period_s, _ in found)


def test_a_slow_cycle_is_named_from_enough_readings_on() -> None:
    """One that comes 1.5 times in the record is the likeliest of the slow ones; of eleven readings none is reported."""
    planted_s = 2.0 * YEAR_S / 1.5
    assert likeliest(slow_cycles(*record(2.0, 100, planted_s), ())) == pytest.approx(planted_s)
    assert slow_cycles(*record(2.0, 12, planted_s), ()) != []
    assert slow_cycles(*record(2.0, 11, planted_s), ()) == []
    assert slow_cycles(*record(2.0, 100, planted_s), [2.0 * YEAR_S / n for n in (1.0, 2.0, 3.0, 4.0)]) == []


_START_S = 1.7e9


def _history(patch: str, drift: float, *, seed: int = 1, months: float = 18.0, count: int = 90, scatter: float = 0.004):
    rng = np.random.default_rng(seed)
    time_s = _START_S + np.linspace(0.0, months * MONTH_S, count)
    value = 0.8 * (1 + drift * (time_s - _START_S) / MONTH_S + scatter * rng.standard_normal(count))
    return fit_trend(time_s, value, 0.005 * value, patch=patch, quantity="radiance", unit="W sr-1 m-2")


def test_a_drift_is_reported_with_its_size_and_uncertainty():
    """The sentence holds the fitted drift in per cent per month and its U (k = 2), and the true one lies within."""
    trend = _history("lamp", -0.01)
    found = re.fullmatch(
        r"lamp drifts: its radiance falls, \((-[\d.]+) ± ([\d.]+)\) % per month of the mean, k = 2\.", outcome([trend])
    )
    assert found is not None
    assert float(found[1]) == pytest.approx(100 * trend.drift_per_month, abs=0.006)
    assert float(found[2]) == pytest.approx(200 * trend.u_drift_per_month, rel=0.05)
    assert abs(float(found[1]) + 1.0 / (1 - 0.01 * 9)) < 1.5 * float(found[2])  # of the level in the middle
    assert "rises" in outcome([_history("lamp", 0.01)])
    months = 0.005 / abs(trend.drift_per_month)  # until the drift equals the stated uncertainty
    assert months == pytest.approx(0.5, rel=0.1)
    assert f"lamp: in {months:.2g} months the drift is as large" in advice([trend])[0]


@pytest.mark.usefixtures("unrendered")
def test_a_drift_that_is_not_claimed_says_so_and_from_when_on_it_would_be():
    """No word of drifting; the size that would have been claimed is the trend's own."""
    trend = _history("wall", 0.0)
    assert not trend.drifts
    assert outcome([trend]).startswith("No drift of wall is shown: (")
    bound = 100 * trend.claim_sigmas * trend.u_drift_per_month
    assert f"a drift of {bound:.2g} % per month or more would have been shown" in advice([trend])[0]
    page = trend_report([trend], "table.csv")
    assert "<span class='tag'>not claimed</span>" in page
    assert "No drift is claimed" in page
    assert ">drifts<" not in page


@pytest.mark.usefixtures("unrendered")
def test_a_change_that_a_season_may_be_is_no_drift_and_no_silence():
    """Half a year at 0.5 % per month: the sentence says both, the advice from when on the record will tell."""
    trend = _history("lamp", 0.005, months=6.0)
    text = outcome([trend])
    assert re.match(
        r"lamp changes, \(\+?0\.[45]\d* ± [\d.]+\) % per month of the mean, k = 2, if on a straight line. A season",
        text,
    )
    assert "lamp: measure until 2025-05-15" in advice([trend])[0]  # 1.5 years from 2023-11-14
    page = trend_report([trend], "t")
    assert "<span class='tag'>season or drift</span>" in page
    assert re.search(r"Without any season it would be \(\+?0\.[45]\d*\s±\s[\d.]+\)\s% per month of the mean\.", page)
    assert ">a season or a drift<" in page
    both = outcome([trend, _history("wall", 0.0, months=6.0)])
    assert both.startswith("lamp changes (1 of 2 patches)")


@pytest.mark.slow
@pytest.mark.usefixtures("unrendered")
def test_of_several_the_clearest_comes_first():
    """Two of three drift: the fastest stands first. Two of one drift point at what they share, the instrument."""
    trends = [_history("still", 0.0, seed=3), _history("slow", -0.003, seed=4), _history("fast", -0.02, seed=5)]
    page = trend_report(trends, "t")
    assert "2 of 3 patches drift, fast most clearly" in page
    places = [page.index(f"<h2>{name}<") for name in ("fast", "slow", "still")]
    assert places == sorted(places)
    assert "Not all patches change alike (slow, still apart from fast)" in page
    one = _history("a", -0.01, seed=6)
    other = replace(one, patch="b", drift_per_month=one.drift_per_month + 2.5 * one.u_drift_per_month)
    assert "All patches change alike" in trend_report([one, other], "t")  # 2.5 of either's u are 1.8 of both's


@pytest.mark.usefixtures("unrendered")
def test_gaps_are_found():
    """One pause of 30 days among daily readings is one gap."""
    days = np.concatenate([np.arange(40.0), np.arange(70.0, 110.0)])
    trend = fit_trend(_START_S + 86400 * days, 1 + 1e-3 * np.sin(days), np.full(80, 0.01), patch="p", quantity="q")
    assert "1 gaps, the longest of 31 days" in trend_report([trend], "t")


@pytest.mark.slow
@pytest.mark.parametrize("span_h", [1.9, 60.0, 112.0])
def test_a_report_of_any_span_finds_ticks_of_its_time_axis(span_h: float):
    """Spans that half-hours, half-days or days divide into too many ticks: no warning of matplotlib, an error here."""
    time_s = _START_S + 3600 * np.linspace(0.0, span_h, 30)
    found = fit_trend(time_s, 1 + 1e-3 * np.sin(time_s), np.full(30, 0.01), patch="p", quantity="q")
    assert "<img" in trend_report([found], "t")


@pytest.mark.usefixtures("unrendered")
def test_changes_of_the_settings_and_flags_come_from_the_table(tmp_path):
    """Where the fingerprint changes another calibration or other settings begin; flags are counted."""
    time_s = _START_S + 86400.0 * np.arange(20)
    rows = pd.DataFrame(
        {
            "captured": time_s[::-1], "quantity": "radiance", "patch": "lamp", "unit": "1", "status": "ok", "u": 0.01,
            "value": 1.0 + 0.001 * np.arange(20) % 3, "fingerprint": ["b"] * 8 + ["a"] * 12,
            "flags": ["flicker saturated", "flicker", *[""] * 18],
        }
    )  # fmt: skip
    rows.to_csv(tmp_path / "t.csv", index=False)
    (trend,) = read_histories(tmp_path / "t.csv", "radiance")
    assert trend.changes_s == (time_s[12],)
    assert trend.flags == {"flicker": 2, "saturated": 1}
    page = trend_report([trend], "t")
    assert "2 of the readings are flagged flicker." in page
    assert "another calibration, or other settings, from 2023-11-26" in page
    rows.assign(fingerprint="").to_csv(tmp_path / "unmarked.csv", index=False)
    (unmarked,) = read_histories(tmp_path / "unmarked.csv", "radiance")
    assert unmarked.changes_s == ()


@pytest.mark.parametrize(
    ("column", "entry", "reason"),
    [("captured", 0.0, "1990"), ("captured", 3.2e10, "future"), ("flags", "few_frames saturated", "lower bound"),
     ("flags", "below_noise", "upper bound"), ("content_hash", "0", "copies of a capture set"),
     ("u", float("nan"), "no finite number")],
)  # fmt: skip
def test_rows_that_show_nothing_take_no_part_and_are_counted(tmp_path, column, entry, reason):
    """A clock that was wrong once hides no drift; bounds that fall are none, and another unit is a history apart."""
    weeks, rng = np.arange(120), np.random.default_rng(8)
    value = 1.5 * (1.0 + 0.02 * weeks / 52.18) * (1.0 + 0.002 * rng.standard_normal(weeks.size))
    rows = pd.DataFrame({
        "captured": 1.6e9 + 604_800.0 * weeks, "quantity": "radiance", "patch": "lamp", "value": value, "u": 0.003,
        "unit": "W sr-1 m-2", "status": "ok", "flags": "", "job": "measure", "content_hash": weeks.astype(str),
    })  # fmt: skip
    hashes = "later " + rows["content_hash"]
    bad = rows.assign(content_hash=hashes).tail(30).assign(**{"value": 0.1, column: entry})
    other = rows.assign(unit="relative", value=3.0)
    pd.concat([rows, bad, other]).assign(instrument="FLIR BFS 1").to_csv(tmp_path / "t.csv", index=False)
    found = {one.unit: one for one in read_histories(tmp_path / "t.csv", "radiance")}
    assert found["W sr-1 m-2"].time_s.size == 120
    assert found["W sr-1 m-2"].drift_per_month == pytest.approx(0.02 / 12, rel=0.15)
    assert [(reason in why, count) for why, count in found["W sr-1 m-2"].left_out.items()] == [(True, 30)]
    assert found["relative"].verdict == "no_drift"


def test_two_cameras_are_two_histories_and_no_number_is_none(tmp_path):
    """Cameras 10 % apart that take turns, or follow each other, are no drift; a damaged cell is one line."""
    weeks = np.arange(60)
    rows = pd.DataFrame({
        "captured": 1.6e9 + 604_800.0 * weeks, "quantity": "radiance", "patch": "lamp", "unit": "1", "status": "ok",
        "value": 1.0 + 0.001 * weeks % 3 - 0.1 * (weeks >= 30), "u": 0.003, "instrument": np.where(weeks < 30, "A", ""),
    })  # fmt: skip
    rows.to_csv(tmp_path / "t.csv", index=False)
    found = {one.patch: float(np.median(one.value)) for one in read_histories(tmp_path / "t.csv", "radiance")}
    assert found == pytest.approx({"lamp by A": 1.0, "lamp by unnamed": 0.9}, rel=0.05)
    rows.assign(captured="17x0").to_csv(tmp_path / "t.csv", index=False)
    with pytest.raises(InputError, match=r"t\.csv: a time, value or uncertainty is no number"):
        read_histories(tmp_path / "t.csv", "radiance")
