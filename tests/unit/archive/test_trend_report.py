"""The report of trends says what drifts and by how much, what is not claimed, and where readings are missing."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from radiometer.archive.history import read_histories
from radiometer.archive.trend import MONTH_S, fit_trend
from radiometer.archive.trend_report import advice, outcome, trend_report
from testing.report_checks import HOSTILE

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
        r"lamp drifts: its radiance falls, \((-[\d.]+) ± ([\d.]+)\) % per month, k = 2\.", outcome([trend])
    )
    assert found is not None
    assert float(found[1]) == pytest.approx(100 * trend.drift_per_month, abs=0.006)
    assert float(found[2]) == pytest.approx(200 * trend.u_drift_per_month, rel=0.05)
    assert abs(float(found[1]) + 1.0 / (1 - 0.01 * 9)) < 1.5 * float(found[2])  # of the level in the middle
    assert "rises" in outcome([_history("lamp", 0.01)])


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
        r"lamp changes, \(\+?0\.[45]\d* ± [\d.]+\) % per month, k = 2, if on a straight line. A season", text
    )
    assert "lamp: measure until 2025-05-15" in advice([trend])[0]  # 1.5 years from 2023-11-14
    page = trend_report([trend], "t")
    assert "<span class='tag'>season or drift</span>" in page
    assert re.search(r"Without any season it would be \(\+?0\.[45]\d*\s±\s[\d.]+\)\s% per month\.", page)
    assert ">a season or a drift<" in page
    both = outcome([trend, _history("wall", 0.0, months=6.0)])
    assert both.startswith("lamp changes (1 of 2 patches)")


@pytest.mark.slow
@pytest.mark.usefixtures("unrendered")
def test_of_several_the_clearest_comes_first():
    """Two of three drift; the fastest is named and its section stands first."""
    trends = [_history("still", 0.0, seed=3), _history("slow", -0.003, seed=4), _history("fast", -0.02, seed=5)]
    page = trend_report(trends, "t")
    assert "2 of 3 patches drift, fast most clearly" in page
    places = [page.index(f"<h2>{name}<") for name in ("fast", "slow", "still")]
    assert places == sorted(places)
    assert "Not all patches change alike (slow, still apart from fast)" in page


@pytest.mark.slow
@pytest.mark.usefixtures("unrendered")
def test_patches_that_change_alike_point_at_what_they_share():
    """Two patches of one drift: the instrument is named before the sources."""
    one = _history("a", -0.01, seed=6)
    other = replace(one, patch="b", drift_per_month=one.drift_per_month + 2.5 * one.u_drift_per_month)
    page = trend_report([one, other], "t")
    assert "All patches change alike" in page  # 2.5 of either's u apart are 1.8 of both's


def test_recalibration_is_asked_for_when_the_drift_equals_the_stated_uncertainty():
    """0.5 % stated and 1 % per month: half a month."""
    trend = _history("lamp", -0.01)
    months = 0.005 / abs(trend.drift_per_month)
    assert months == pytest.approx(0.5, rel=0.1)
    assert f"lamp: in {months:.2g} months the drift is as large" in advice([trend])[0]


@pytest.mark.usefixtures("unrendered")
def test_gaps_are_found():
    """One pause of 30 days among daily readings is one gap."""
    days = np.concatenate([np.arange(40.0), np.arange(70.0, 110.0)])
    trend = fit_trend(_START_S + 86400 * days, 1 + 1e-3 * np.sin(days), np.full(80, 0.01), patch="p", quantity="q")
    assert "1 gaps, the longest of 31 days" in trend_report([trend], "t")


@pytest.mark.slow
def test_no_name_of_a_patch_is_markup_or_a_formula():
    """A hostile name is shown, in the page and in the picture."""
    page = trend_report([replace(_history("x", -0.01), patch=HOSTILE)], HOSTILE)
    assert "<script" not in page
    assert "&lt;script&gt;" in page


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
