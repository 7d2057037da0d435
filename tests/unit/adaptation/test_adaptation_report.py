"""The report of a dark-adaptation fit says the break with its interval, or that none is claimed."""

from __future__ import annotations

import re

import numpy as np
import pytest
from matplotlib.figure import Figure

from radiometer.adaptation.adaptation_fit import AdaptationFit, FitRequest, fit_adaptation
from radiometer.adaptation.report import curve_csv, report_html
from radiometer.adaptation.rod_intercept import InterceptRule
from radiometer.adaptation.threshold_series import ThresholdSeries
from testing.report_checks import HOSTILE

TIMES = np.linspace(0.5, 25.0, 45)
TRUE_BREAK_MIN, TRUE_S2 = 9.0, -0.23


def _fit(*, rods: bool = True, facts: dict[str, str] | None = None, **request: object) -> AdaptationFit:
    noise = np.random.default_rng(3).normal(0.0, 0.08, TIMES.size)
    cones = -1.0 + 2.5 * np.exp(-np.minimum(TIMES, TRUE_BREAK_MIN) / 1.6)
    curve = cones + TRUE_S2 * np.maximum(TIMES - TRUE_BREAK_MIN, 0.0) if rods else -4.0 + 3.0 * np.exp(-TIMES / 6.0)
    series = ThresholdSeries(TIMES, curve + noise, None, facts or {}, ("minutes were taken from seconds",))
    asked = FitRequest(bootstrap_draws=20, **request)  # type: ignore[arg-type]
    return fit_adaptation(series, asked, np.random.default_rng(0))


@pytest.fixture(scope="module")
def broken() -> AdaptationFit:
    """Return the fit of a curve with a break at 9 min."""
    return _fit()


@pytest.mark.usefixtures("unrendered")
def test_the_break_is_reported_with_its_interval(broken):
    """Break and S2 with half their 95 % intervals, which hold the true ones."""
    page = report_html(broken, "eye")
    text = re.search(
        r"class='outcome'>Rod–cone break at ([\d.]+)\u00a0±\u00a0([\d.]+) min, then S2 of "
        r"−([\d.]+)\u00a0±\u00a0([\d.]+) "
        r"log₁₀ units per min \(95\u00a0% intervals\)\.",
        page,
    )
    assert text is not None
    time, half, slope, half_slope = map(float, text.groups())
    interval = broken.estimates["break_min"].profile
    assert interval is not None
    assert half == pytest.approx((interval.high - interval.low) / 2, rel=0.05)
    assert abs(time - TRUE_BREAK_MIN) < 1.5 * half
    assert abs(slope + TRUE_S2) < 1.5 * half_slope


@pytest.mark.usefixtures("unrendered")
def test_published_values_are_shown_with_their_source_and_what_has_none_is_named(broken):
    """Final threshold: 0.08 log₁₀ units a decade (Jackson and Owsley 2000); no intercept was fitted: none is shown."""
    page = report_html(broken, "eye")
    assert "0.08 log₁₀ units higher for each decade" in page
    assert "Jackson and Owsley 2000" in page
    assert "Rod–cone break and S2 slope: no norm by age is known." in page
    assert "Owsley et al. 2014" not in page


def test_the_picture_shows_what_the_sentence_claims(broken, monkeypatch):
    """A line at the break, a band over its interval, the plateau, the fitted curve, and after the break cones alone."""
    figures = []
    monkeypatch.setattr(Figure, "savefig", lambda one, stream, **_: figures.append(one) or stream.write(b"<svg/>"))
    report_html(broken, "eye")
    axes, interval = figures[0].axes[0], broken.estimates["break_min"].profile
    assert [(band.get_x(), band.get_width()) for band in axes.patches] == [
        (pytest.approx(interval.low), pytest.approx(interval.high - interval.low))
    ]
    lines = [np.array(line.get_data(), dtype=float) for line in axes.lines]
    assert any(set(x) == {broken.estimates["break_min"].value} for x, _ in lines)
    assert any(set(y) == {broken.chosen.values["plateau"]} for _, y in lines)
    long = [(x, y) for x, y in lines if x.size > TIMES.size]
    assert any(y == pytest.approx(broken.chosen.threshold(x)) for x, y in long)
    (later,) = [x for x, y in long if y != pytest.approx(broken.chosen.threshold(x))]
    assert later.min() >= broken.estimates["break_min"].value > later.min() - 1.0


@pytest.mark.slow
def test_the_curve_in_a_file_is_thresholds_and_what_is_left_of_them(broken):
    """A line for each threshold: its time, itself, the curve within the noise of the true one, the rest, its weight."""
    head, *lines = curve_csv(broken).splitlines()
    assert head == "time_min,log10_threshold,fitted,residual,weight"
    time, threshold, fitted, residual, weight = np.array([line.split(",") for line in lines], dtype=float).T
    assert time == pytest.approx(TIMES, rel=1e-5)
    assert threshold == pytest.approx(fitted + residual, abs=2e-5)
    truth = -1.0 + 2.5 * np.exp(-np.minimum(TIMES, TRUE_BREAK_MIN) / 1.6)
    truth += TRUE_S2 * np.maximum(TIMES - TRUE_BREAK_MIN, 0)
    assert np.sqrt(np.mean((fitted - truth) ** 2)) < 0.05
    assert np.std(residual) == pytest.approx(0.08, rel=0.3)
    assert weight.min() > 0.0
    assert weight.max() <= 1.0


@pytest.mark.slow
def test_what_is_not_claimed_says_so():
    """One branch: no break in the sentence's words, and the time from which on one would have been seen."""
    found = _fit(rods=False)
    page = report_html(found, "eye")
    assert not found.has_break
    assert "class='outcome'>No rod–cone break is claimed: one branch, falling to −" in page
    assert f"break after {found.evidence.earliest_visible_min:.1f} min would have been seen" in page
    assert "Rod–cone break at" not in page
    assert "grey is the best curve with a break" in page


@pytest.mark.slow
def test_the_rod_intercept_stands_only_where_its_protocol_has_it(broken):
    """Without the protocol's rule no word of it; with it its time with ± and its limit."""
    assert "intercept" not in report_html(broken, "eye").casefold()
    found = _fit(intercept=InterceptRule(-2.3, 12.3, source="a source", bleach_s=2.5e-4))
    page = report_html(found, "eye")
    met = found.estimates["rod_intercept_min"].value
    assert re.search(f"after {met:.1f} min; [a-z ]+ the limit of 12.3 min \\(a source\\)", page)
    assert re.search(rf"The time is {met:.1f}\d*\u00a0±\u00a0[\d.]+ min \(95\u00a0%\)", page)
    missed = report_html(_fit(intercept=InterceptRule(-7.0, 12.3, source="a source")), "eye")
    assert "not reached within 25.0 min" in missed


@pytest.mark.slow
def test_flags_and_assumptions_stand_before_the_tables(broken):
    """What was taken of the file's form, and that the stimulus has no uncertainty."""
    page = report_html(broken, "eye")
    assert page.index("minutes were taken from seconds") < page.index("<h2>Estimates")
    assert "No uncertainty of the stimulus" in page
    assert "No uncertainty of the stimulus" not in report_html(_fit(stimulus_u_log10=0.05), "eye")


@pytest.mark.slow
def test_no_name_of_a_subject_is_markup():
    """A hostile file name and a hostile subject are shown as they are written."""
    page = report_html(_fit(facts={"subject": HOSTILE}), HOSTILE)
    assert "<script" not in page
    assert page.count("&lt;script&gt;") == 4
