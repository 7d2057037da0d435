"""Steps of the threshold methods on a simulated stage."""

import math
import os
import sys

import numpy as np
import pytest
from scipy.stats import chi2

import radiometer as rm
from radiometer.adaptation.journal import RunJournal
from radiometer.adaptation.methods import Ascent, QuestPlusSearch, Staircase
from radiometer.adaptation.outcome import Verdict
from radiometer.adaptation.protocol import LimitsMethod, QuestPlusMethod, Spot, StaircaseMethod, read_protocol
from radiometer.adaptation.run import run_test
from radiometer.errors import DeviceLost, MissingLibrary
from simulators.observers.eye_kinetics import Eye, eye_after_bleach
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
    """0.4 up while nothing is seen, 0.2 either way from the first turn on; the mean of all turns but the first."""
    rules = StaircaseMethod(kind="staircase", first_step_log10=0.4, step_log10=0.2, start_below_log10=0.0, reversals=3)
    staircase = Staircase(SPOT, rules, last=-1.0)
    assert levels_of(staircase, "nnyn") == [-1.0, -0.6, -0.2, -0.4]
    turns = [-0.2, -0.4]
    assert levels_of(staircase, "yyn") == [-0.2, -0.4, -0.6]
    turns += [-0.2, -0.6]
    assert staircase.threshold == pytest.approx(sum(turns[1:]) / 3)


def test_a_staircase_gives_up_at_the_end_of_the_levels():
    """At the highest level not seen, or at the lowest seen, there is no step left."""
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


@pytest.fixture(scope="module")
def classic(tmp_path_factory):
    """Return the journal of a whole run of the classic protocol by the steady observer, its thresholds next to it."""
    journal = tmp_path_factory.mktemp("classic") / "run.jsonl"
    rm.adapt_run("classic", "S1", journal, simulate="steady")
    return journal


def test_break_is_that_of_the_eye_after_the_protocols_bleach(classic):
    """9,000 cd/m² for 180 s through 7 mm: the fit finds the break of that eye, within 1 min (95 % of a run: 0.8)."""
    found = rm.adapt_fit(classic.with_suffix(".csv"), bootstrap=0).fit.estimates["break_min"].value
    expected = eye_after_bleach(Eye(pupil_mm=7.0), 9000.0, 180.0).break_min(505.0)
    assert found == pytest.approx(expected, abs=1.0)


def test_weak_bleach_of_a_screen_shows_no_break(tmp_path):
    """120 cd/m² for 5 min bleach a few per cent of the rods, which lead from the first minute on."""
    rm.adapt_run("screen-only", "S1", tmp_path / "run.jsonl", simulate="steady")
    assert not rm.adapt_fit(tmp_path / "run.csv", bootstrap=0).fit.has_break


def test_false_alarms_are_as_rare_as_the_subjects_habit(classic):
    """A blink without light is answered in 1 % of the cases, whichever trials are drawn as catches."""
    with RunJournal(classic) as journal:
        dark = [blink for blink in journal.of_kind("blink") if blink["log10_level"] is None and "of" not in blink]
    pressed = sum(bool(blink["presses_s"]) for blink in dark)
    assert len(dark) > 50
    assert pressed <= 5  # 1 % of about 120: more than 5 in one of 1000 runs


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


def test_same_answers_give_the_same_levels():
    """A search that is lived through again after a crash goes on at the level where it was."""
    first, second = QuestPlusSearch(QUEST_SPOT, METHOD, last=-2.0), QuestPlusSearch(QUEST_SPOT, METHOD, last=-2.0)
    for seen in (True, False, True):
        assert first.level == second.level
        first.answer(seen=seen)
        second.answer(seen=seen)


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
