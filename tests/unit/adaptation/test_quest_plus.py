"""QUEST+: a simulated subject's threshold comes out within the uncertainty that is stated with it."""

from __future__ import annotations

import math
import os
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import chi2

from radiometer.adaptation.journal import RunJournal
from radiometer.adaptation.outcome import Outcome, Verdict
from radiometer.adaptation.protocol import AdaptationProtocol, QuestPlusMethod, Spot, read_protocol
from radiometer.adaptation.quest_plus import QuestPlusSearch
from radiometer.adaptation.run import run_test
from radiometer.errors import DeviceLost, MissingLibrary
from testing.scripted_adaptation import ScriptedStage, eye, threshold

SPOT = Spot(device="light_box", channel="spot", peak_nm=453)
METHOD = QuestPlusMethod(kind="questplus")


def seen_probability(level: float, alpha: float) -> float:
    """Return the chance of an answer: Weibull of exponent 3.5, 1 % false alarms, 2 % lapses."""
    return 0.01 + 0.97 * (1 - math.exp(-(10 ** (3.5 * (level - alpha)))))


@pytest.mark.slow
def test_threshold_lies_within_its_stated_uncertainty() -> None:
    """Over 24 subjects drawn from the prior, the squared errors in units of u are chi-squared (2 in 1000 outside)."""
    rng = np.random.default_rng(2)
    squares = []
    for _ in range(24):
        alpha = -3.0 + METHOD.prior_sd_log10 * rng.standard_normal()
        search = QuestPlusSearch(SPOT, METHOD, last=-3.0)
        while search.threshold is None and not search.exhausted:
            search.answer(seen=rng.random() < seen_probability(search.level, alpha))
        assert search.threshold is not None
        assert search.u_log10 is not None
        assert search.u_log10 <= METHOD.stop_sd_log10
        squares.append(((search.threshold - alpha) / search.u_log10) ** 2)
    assert chi2.ppf(0.001, 24) < sum(squares) < chi2.ppf(0.999, 24)


@pytest.mark.parametrize("seen", [False, True])
def test_answers_of_one_kind_only_are_no_threshold(seen: bool) -> None:
    """Who never or always presses gives a bound from one side; the prior is no measurement."""
    search = QuestPlusSearch(SPOT, METHOD.model_copy(update={"most_blinks": 12}), last=-3.0)
    while not search.exhausted:
        search.answer(seen=seen)
    assert search.threshold is None


def test_same_answers_give_the_same_levels() -> None:
    """A search that is lived through again after a crash goes on at the level where it was."""
    first, second = QuestPlusSearch(SPOT, METHOD, last=-2.0), QuestPlusSearch(SPOT, METHOD, last=-2.0)
    for seen in (True, False, True):
        assert first.level == second.level
        first.answer(seen=seen)
        second.answer(seen=seen)


def test_absent_library_is_named_with_the_way_to_get_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """`questplus` is an extra; without it the protocol says so instead of failing at the first threshold."""
    monkeypatch.setitem(sys.modules, "questplus", None)
    with pytest.raises(MissingLibrary, match=r"radiometer\[eye\]"):
        QuestPlusSearch(SPOT, METHOD)


@pytest.fixture
def protocol(monkeypatch: pytest.MonkeyPatch) -> AdaptationProtocol:
    """Return the shipped protocol, cut to 2 min, with the disk's waiting left out."""
    monkeypatch.setattr(os, "fsync", lambda handle: None)
    whole = read_protocol("questplus")
    end, watch = (
        part.model_copy(update=change)
        for part, change in ((whole.end, {"duration_min": 2.0}), (whole.watch, {"blind_min": 0.0}))
    )
    return whole.model_copy(update={"end": end, "watch": watch})


def _run(path: Path, stage: ScriptedStage) -> Outcome:
    with RunJournal(path) as journal:
        return run_test(stage.protocol, stage, journal, subject="A1", seed=3)


@pytest.mark.slow
def test_run_taken_up_in_the_middle_of_a_search_has_the_same_events(
    tmp_path: Path, protocol: AdaptationProtocol
) -> None:
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
