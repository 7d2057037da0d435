"""Steps of the threshold methods on a simulated stage."""

import math
import os
import sys

import numpy as np
import pytest
from scipy.stats import chi2
from scipy.stats import t as student

from radiometer.adaptation.adaptation_fit import FitRequest, fit_adaptation, intercept_verdict
from radiometer.adaptation.intervals import InterceptRule, rod_intercept
from radiometer.adaptation.outcome import RunJournal, Verdict
from radiometer.adaptation.protocol import (
    AdaptationProtocol,
    DownUpMethod,
    LimitsMethod,
    QuestPlusMethod,
    Spot,
    StaircaseMethod,
    read_protocol,
)
from radiometer.adaptation.run import Ascent, QuestPlusSearch, Staircase, begin, run_test
from radiometer.adaptation.run_facts import facts_of, intercept_of, method_bias
from radiometer.adaptation.threshold_series import ThresholdSeries
from radiometer.data.validation import validate
from radiometer.errors import ConfigurationError, DeviceLost, MissingLibrary
from testing.scripted_adaptation import ScriptedStage, eye, threshold

SPOT = Spot(device="light_box", channel="spot", peak_nm=453, lowest_log10=-3.0, highest_log10=1.0)


def levels_of(method, answers):
    """Return the levels asked for, by answers: y for seen, n for not."""
    asked = []
    for answer in answers:
        asked.append(round(method.level, 9))
        method.answer(seen=answer == "y")
    return asked


def test_a_staircase_takes_large_steps_until_its_first_turn():
    """0.4 until the first turn, 0.2 after it, the mean of all turns but the first; none at the end of the levels."""
    rules = StaircaseMethod(kind="staircase", first_step_log10=0.4, step_log10=0.2, start_below_log10=0.0, reversals=3)
    staircase = Staircase(SPOT, rules, last=-1.0)
    assert levels_of(staircase, "nnyn") == [-1.0, -0.6, -0.2, -0.4]
    turns = [-0.2, -0.4]
    assert levels_of(staircase, "yyn") == [-0.2, -0.4, -0.6]
    turns += [-0.2, -0.6]
    assert staircase.threshold == pytest.approx(sum(turns[1:]) / 3)
    rules = StaircaseMethod(kind="staircase", first_step_log10=0.4, step_log10=0.2, start_below_log10=0.0, reversals=3)
    for last, answers in ((0.9, "nn"), (-2.9, "yy")):
        staircase = Staircase(SPOT, rules, last=last)
        assert levels_of(staircase, answers)[1] == (1.0 if "n" in answers else -3.0)
        assert staircase.exhausted
        assert staircase.threshold is None


def test_an_ascent_climbs_until_it_is_seen_and_begins_lower_where_it_is_seen_at_once():
    """0.3 below the last threshold and half a step more; seen at once it begins 0.3 lower still."""
    rules = LimitsMethod(step_log10=0.1, start_below_log10=0.3)
    ascent = Ascent(SPOT, rules, last=-1.0, shift=0.5)
    assert levels_of(ascent, "ynny") == [-1.35, -1.65, -1.55, -1.45]
    assert ascent.threshold == pytest.approx(-1.45)
    floor = Ascent(SPOT, rules, last=-2.95)
    assert levels_of(floor, "y") == [-3.0]
    assert floor.exhausted
    ceiling = Ascent(SPOT, rules, last=1.2)
    assert levels_of(ceiling, "nn") == [0.9, 1.0]
    assert ceiling.exhausted


def test_a_spot_whose_levels_are_reversed_is_refused():
    """Nothing lies between them, nor where both are the same."""
    for highest in (-3.0, -3.1):
        with pytest.raises(ValueError, match="must be above"):
            Spot(device="light_box", channel="spot", peak_nm=453, lowest_log10=-3.0, highest_log10=highest)


QUEST_SPOT = Spot(device="light_box", channel="spot", peak_nm=453)

METHOD = QuestPlusMethod(kind="questplus")


def seen_probability(level, alpha):
    """Return the chance of an answer: Weibull of exponent 3.5, 1 % false alarms, 2 % lapses."""
    return 0.01 + 0.97 * (1 - math.exp(-(10 ** (3.5 * (level - alpha)))))


@pytest.mark.slow
def test_threshold_lies_within_its_stated_uncertainty():
    """Over 24 subjects drawn from the prior, the squared errors in units of u are chi-squared (2 in 1000 outside)."""
    rng = np.random.default_rng(2)
    squares = []
    for _ in range(24):
        alpha = -3.0 + METHOD.prior_sd_log10 * rng.standard_normal()
        search = QuestPlusSearch(QUEST_SPOT, METHOD, last=-3.0)
        while search.threshold is None and not search.exhausted:
            search.answer(seen=rng.random() < seen_probability(search.level, alpha))
        assert search.u_log10 <= METHOD.stop_sd_log10
        squares.append(((search.threshold - alpha) / search.u_log10) ** 2)
    assert chi2.ppf(0.001, 24) < sum(squares) < chi2.ppf(0.999, 24)


@pytest.mark.parametrize("seen", [False, True])
def test_answers_of_one_kind_only_are_no_threshold(seen):
    """Who never or always presses gives a bound from one side; the prior is no measurement."""
    search = QuestPlusSearch(QUEST_SPOT, METHOD.model_copy(update={"most_blinks": 12}), last=-3.0)
    while not search.exhausted:
        search.answer(seen=seen)
    assert search.threshold is None


def test_absent_library_is_named_with_the_way_to_get_it(monkeypatch):
    """`questplus` is an extra; without it the protocol says so instead of failing at the first threshold."""
    monkeypatch.setitem(sys.modules, "questplus", None)
    with pytest.raises(MissingLibrary, match=r"radiometer\[eye\]"):
        QuestPlusSearch(QUEST_SPOT, METHOD)


@pytest.fixture
def protocol(monkeypatch):
    """Return the shipped protocol, cut to 2 min, with the disk's waiting left out."""
    monkeypatch.setattr(os, "fsync", lambda handle: None)
    whole = read_protocol("questplus")
    end, watch = (
        part.model_copy(update=change)
        for part, change in ((whole.end, {"duration_min": 2.0}), (whole.watch, {"blind_min": 0.0}))
    )
    return whole.model_copy(update={"end": end, "watch": watch})


def _run(path, stage):
    with RunJournal(path) as journal:
        return run_test(stage.protocol, stage, journal, subject="A1", seed=3)


@pytest.mark.slow
def test_run_taken_up_in_the_middle_of_a_search_has_the_same_events(tmp_path, protocol):
    """The answers before the crash are taken from the journal, not asked for again."""
    whole = _run(tmp_path / "whole", ScriptedStage(eye, protocol))
    broken = ScriptedStage(eye, protocol)
    broken.dies_after = 212.4
    with pytest.raises(DeviceLost):
        _run(tmp_path / "broken", broken)
    assert '"kind": "blink"' in (tmp_path / "broken").read_text().splitlines()[-1]
    _run(tmp_path / "broken", ScriptedStage(eye, protocol))
    assert (tmp_path / "broken").read_text() == (tmp_path / "whole").read_text()
    assert whole.verdict is Verdict.COMPLETE
    errors = [v - threshold(60 * t) for t, v in zip(whole.times_min, whole.thresholds_log10, strict=True)]
    assert max(map(abs, errors)) < 0.3  # 3 u; this eye is a step, 0.1 log10 wide with the levels
    assert whole.to_csv().startswith("time_min,log10_threshold,u_log10_threshold\n")


# Rod intercepts, and the bias of methods.


TIMES = np.arange(0.5, 12.0, 0.25)
RULE = InterceptRule(-2.301, 6.5, source="J")


def falling(times=TIMES):
    """Return cones at −1.5 until 3 min, then −0.24 per min: −2.301 is met at 6.3375 min."""
    return -1.5 - 0.24 * np.maximum(times - 3.0, 0.0)


def test_intercept_is_where_the_line_meets_the_criterion():
    """Without noise exactly, shifted by 1/0.24 min per log10 unit; a curve above, below, or rising has none."""
    met = rod_intercept(ThresholdSeries(TIMES, falling()), RULE, 0.03)
    assert met.time_min == pytest.approx(3 + 0.801 / 0.24, abs=0.02)
    assert met.u_min == pytest.approx(0.03 / 0.24, rel=0.05)
    for levels in (falling() + 3.0, falling() - 3.0, -falling() - 4.0):
        assert rod_intercept(ThresholdSeries(TIMES, levels), RULE) is None


def test_its_interval_holds_the_truth():
    """Of 200 noisy series (0.12 log10 units) 95 % ± 4.6 % hold it, and wild presses hardly move it."""
    rng, truth = np.random.default_rng(8), 3 + 0.801 / 0.24
    held = []
    for _ in range(200):
        noisy = falling() + rng.normal(0, 0.12, TIMES.size)
        held.append(rod_intercept(ThresholdSeries(TIMES, noisy), RULE).interval.holds(truth))
    assert 0.90 <= np.mean(held) <= 1.0
    wild = falling()
    wild[[10, 20, 28]] -= 1.5
    assert rod_intercept(ThresholdSeries(TIMES, wild), RULE).time_min == pytest.approx(truth, abs=0.1)


@pytest.mark.parametrize("last", [7.0, 9.0])
def test_its_uncertainty_is_that_of_the_line_read_backwards(last):
    """By the covariance of level and slope and their derivatives, near the middle of the window and near its end."""
    times = np.arange(3.5, last, 0.25)
    levels = falling(times) + 0.05 * (-1.0) ** np.arange(times.size)  # alike in size, so that each counts in full
    found = rod_intercept(ThresholdSeries(times, levels), RULE)
    near = np.abs(times - found.time_min) <= 3.0
    (slope, level), covariance = np.polyfit(times[near], levels[near], 1, cov="unscaled")
    dof = np.count_nonzero(near) - 2
    scatter = np.sum((levels - slope * times - level)[near] ** 2) / dof
    back = np.array([-(-2.301 - level) / slope**2, -1.0 / slope])
    expected = float(np.sqrt(back @ covariance @ back * scatter))
    assert found.time_min == pytest.approx((-2.301 - level) / slope)
    assert found.u_min == pytest.approx(expected, rel=1e-3)
    half = 0.5 * (found.interval.high - found.interval.low)
    assert half == pytest.approx(expected * student.ppf(0.975, dof), rel=1e-3)


def test_a_wild_threshold_counts_less_as_much_as_it_is_off():
    """By Huber: half at twice 1.5 robust standard deviations; pairs above and below leave the line where it was."""
    times = np.repeat(np.arange(3.5, 9.1, 0.5), 2)
    off = np.where(np.isin(np.arange(times.size) // 2, (1, 5, 10)), 1.5 * 1.4826 * 2.0 * 0.05, 0.05)
    found = rod_intercept(ThresholdSeries(times, falling(times) + off * (-1.0) ** np.arange(times.size)), RULE)
    near = np.abs(times - found.time_min) <= 3.0
    weights = np.where(off > 0.05, 0.5, 1.0)[near]
    _, covariance = np.polyfit(times[near], falling(times)[near], 1, w=np.sqrt(weights), cov="unscaled")
    back = np.array([3.0 + 0.801 / 0.24, 1.0]) / 0.24
    scatter = np.sum(weights * off[near] ** 2) / (np.count_nonzero(near) - 2)
    assert found.time_min == pytest.approx(3.0 + 0.801 / 0.24)
    assert found.u_min == pytest.approx(float(np.sqrt(back @ covariance @ back * scatter)), rel=1e-3)


@pytest.mark.parametrize(("count", "read"), [(4, False), (5, True), (6, True)])
def test_five_thresholds_make_a_line(count, read):
    """Fewer have no intercept; of thresholds far apart the five nearest make it, and no further one."""
    times = np.array([0.25, 2.25, 4.25, 6.25, 8.25, 10.25])[-count:]
    levels = RULE.criterion_log10 - 0.24 * (times - 6.3) + np.where(times < 1.0, 0.3, 0.0)
    found = rod_intercept(ThresholdSeries(times, levels), RULE)
    assert (found is not None) == read
    if read:
        assert found.time_min == pytest.approx(6.3)
        assert found.u_min == pytest.approx(0.0, abs=1e-9)


def test_only_a_protocol_with_the_published_conditions_reports_one():
    """`rapid` has one, a bleach through an unknown pupil is refused, classic reports none."""
    rapid = read_protocol("rapid")
    assert rapid.intercept.limit_min == 6.5
    assert 0.76 <= rapid.bleach.rods_bleached() <= 0.82
    assert read_protocol("classic").intercept is None
    assert intercept_of(facts_of(read_protocol("classic"))) is None
    whole = rapid.model_dump()
    without_pupil = {**whole, "bleach": {**whole["bleach"], "pupil_mm": None}}
    with pytest.raises(ConfigurationError, match="its limit holds for"):
        validate(AdaptationProtocol, without_pupil, "x", ConfigurationError)


@pytest.mark.parametrize(
    ("part", "name", "low", "high"),
    [
        ("spot", "size_deg", 1.5, 2.5), ("spot", "peak_nm", 500.0, 510.0), ("spot", "eccentricity_deg", 4.0, 6.0),
        ("intercept", "criterion_log10", np.log10(0.0049), np.log10(0.0051)), ("bleach", "rods_bleached", 0.76, 0.82),
    ],
)  # fmt: skip
def test_the_published_conditions_hold_to_their_bounds(monkeypatch, part, name, low, high):
    """A size, wavelength, place, criterion or bleach just within is taken, one just beyond is refused by its name."""
    rapid = read_protocol("rapid")
    whole, edge = rapid.model_dump(), 0.01 * (high - low)
    for value, taken in ((low - edge, False), (low + edge, True), (high - edge, True), (high + edge, False)):
        if part == "bleach":
            monkeypatch.setattr(type(rapid.bleach), name, lambda self, value=value: value)
            changed = whole
        else:
            changed = {**whole, part: {**whole[part], name: float(value)}}
        if taken:
            assert validate(AdaptationProtocol, changed, "x", ConfigurationError).intercept is not None
        else:
            with pytest.raises(ConfigurationError, match=name.replace("rods_bleached", "bleached rods")):
                validate(AdaptationProtocol, changed, "x", ConfigurationError)


@pytest.mark.slow
def test_facts_of_a_run_lead_to_its_intercept():
    """What stands before the thresholds gives criterion and limit back, and the fit says both."""
    rule = intercept_of(facts_of(read_protocol("rapid"), 0.01))
    assert (rule.criterion_log10, rule.limit_min) == (-2.301, 6.5)
    noise = np.random.default_rng(1).normal(0, 0.05, TIMES.size)
    series = ThresholdSeries(TIMES, falling() + noise)
    fit = fit_adaptation(series, FitRequest(bootstrap_draws=0, intercept=rule), np.random.default_rng(0))
    assert fit.estimates["rod_intercept_min"].value == pytest.approx(6.34, abs=0.3)
    assert "not judged: the limit of 6.5 min" in intercept_verdict(fit)
    assert "the bleach of this run lasted for 38 s" in intercept_verdict(fit)
    plain = fit_adaptation(series, FitRequest(bootstrap_draws=0), np.random.default_rng(0))
    assert "rod_intercept_min" not in plain.estimates
    assert intercept_verdict(plain) is None


@pytest.mark.slow
@pytest.mark.parametrize(
    ("limit_min", "bleach_s", "judgement"),
    [
        (3.0, 0.00025, "later than the limit of 3 min"),
        (9.0, 0.00025, "within the limit of 9 min"),
        (6.34, 0.00025, "cannot be distinguished from the limit of 6.34 min"),
        (3.0, 38.0, "not judged: the limit of 3 min"),
        (3.0, None, "not judged: the limit of 3 min"),
    ],
)
def test_intercept_is_judged_where_its_limit_was_published_for_such_a_bleach(limit_min, bleach_s, judgement):
    """The line falls through the criterion at 6.34 min; a bleach of seconds is no flash, an unknown one is unknown."""
    noise = np.random.default_rng(1).normal(0, 0.05, TIMES.size)
    rule = InterceptRule(-2.301, limit_min, bleach_s=bleach_s)
    series = ThresholdSeries(TIMES, falling() + noise)
    fit = fit_adaptation(series, FitRequest(bootstrap_draws=0, intercept=rule), np.random.default_rng(0))
    assert judgement in intercept_verdict(fit)


def test_classic_bleaches_nine_tenths_and_the_screen_protocols_show_recovery():
    """`classic` bleaches 90 % or more of the rods by the calculator; those that cannot show a break say so."""
    for name in ("classic", "classic-blue"):
        assert read_protocol(name).bleach.rods_bleached() >= 0.9
        assert read_protocol(name).shows == "break"
    assert {read_protocol(name).shows for name in ("steady-low", "screen-only", "quick")} == {"recovery"}
    assert facts_of(read_protocol("quick"))["shows"] == "recovery"


@pytest.mark.parametrize(
    "method", [LimitsMethod(), LimitsMethod(start_below_log10=0.3), DownUpMethod(kind="down_up")], ids=str
)
def test_bias_of_a_method_is_what_it_does(method):
    """2000 searches by a Weibull observer of slope 3.5 with its 63 % point at −2 come out at the stated bias."""
    spot = Spot(device="light_box", channel="spot_green", peak_nm=505.0)
    rng, last, found = np.random.default_rng(5), -2.0, []
    for _ in range(2000):
        search = begin(spot, method, last, float(rng.random()))
        while search.threshold is None:
            search.answer(seen=bool(rng.random() < 1 - np.exp(-(10 ** (3.5 * (search.level + 2.0))))))
        found.append(last := search.threshold)
    u_mean = np.std(found) / np.sqrt(1000)  # neighbours hang together a little
    assert np.mean(found) + 2.0 == pytest.approx(method_bias(method).log10, abs=4 * u_mean + 0.005)


def test_three_down_one_up_goes_down_while_it_is_seen():
    """Seen: 0.3 lower; unseen: 0.1 higher, until it is seen again: that level is the threshold."""
    spot = Spot(device="light_box", channel="spot_green", peak_nm=505.0)
    search = begin(spot, DownUpMethod(kind="down_up"), -1.0)
    levels = []
    for seen in (True, True, False, False, True):
        levels.append(round(search.level, 3))
        search.answer(seen=seen)
    assert levels == [-0.8, -1.1, -1.4, -1.3, -1.2]
    assert search.threshold == pytest.approx(-1.2)
