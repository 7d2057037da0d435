"""Running a test: thresholds are found, catches and absence noticed, a crash costs nothing."""

from __future__ import annotations

import math
import os
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from radiometer.adaptation.checks import Finding, judge_room
from radiometer.adaptation.journal import RunJournal
from radiometer.adaptation.outcome import Outcome, Verdict
from radiometer.adaptation.protocol import AdaptationProtocol, read_protocol
from radiometer.adaptation.run import run_test
from radiometer.errors import DeviceLost, MeasurementError, UsageError
from testing.scripted_adaptation import Eye, ScriptedStage, eye, threshold


@pytest.fixture(autouse=True)
def _no_waiting_for_the_disk(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "fsync", lambda handle: None)


def _run(tmp_path: Path, stage: ScriptedStage, name: str = "j") -> Outcome:
    with RunJournal(tmp_path / name) as journal:
        return run_test(stage.protocol, stage, journal, subject="A1", seed=3)


@pytest.fixture
def classic() -> AdaptationProtocol:
    return read_protocol("classic")


@pytest.mark.slow
@pytest.mark.parametrize(("name", "tolerance"), [("classic", 0.11), ("quick", 0.35)])
def test_thresholds_follow_the_eye(tmp_path: Path, name: str, tolerance: float) -> None:
    """Ascending limits overshoot by at most a step (0.1); the 4-2 dB staircase stays within its first step."""
    protocol = read_protocol(name)
    outcome = _run(tmp_path, ScriptedStage(eye, protocol))
    assert outcome.can_be_fitted
    assert len(outcome.times_min) > 30
    errors = [v - threshold(60 * t) for t, v in zip(outcome.times_min[3:], outcome.thresholds_log10[3:], strict=True)]
    assert max(map(abs, errors)) < tolerance + 0.1  # the curve itself moves by up to 0.1 within a trial


def test_thresholds_do_not_share_one_grid_of_levels(tmp_path: Path) -> None:
    """An eye of constant, sharp threshold: what limits find is spread evenly over one step above it, from 0 to 0.1."""
    outcome = _run(
        tmp_path, ScriptedStage(lambda level, _: level is not None and level >= -1.0, read_protocol("classic"))
    )
    above = np.array(outcome.thresholds_log10) + 1.0
    assert above.min() >= 0.0
    assert above.max() < 0.1
    count = above.size
    assert abs(above.mean() - 0.05) < 4 * 0.1 / math.sqrt(12 * count)
    assert abs(np.corrcoef(above[:-1], above[1:])[0, 1]) < 4 / math.sqrt(count)


def test_classic_runs_its_whole_time_and_quick_ends_at_its_criterion(tmp_path: Path) -> None:
    """40 min, and the moment when the threshold is below -3."""
    whole = _run(tmp_path, ScriptedStage(eye, read_protocol("classic")), "a")
    quick = _run(tmp_path, ScriptedStage(eye, read_protocol("quick")), "b")
    assert whole.verdict is Verdict.COMPLETE
    assert 39 < whole.times_min[-1] < 40.5
    assert quick.verdict is Verdict.CRITERION_REACHED
    assert quick.thresholds_log10[-1] <= -3 < quick.thresholds_log10[-2]


@pytest.mark.parametrize(
    ("subject", "verdict"),
    [
        (lambda level, seconds: False, Verdict.NO_RESPONSE),
        (lambda level, seconds: True, Verdict.UNRELIABLE),
        (lambda level, seconds: seconds < 600 and eye(level, seconds), Verdict.LEFT),
    ],
)
@pytest.mark.parametrize("name", ["classic", "quick"])
def test_absent_and_careless_subjects_get_a_verdict_and_no_fit(
    tmp_path: Path, name: str, subject: Eye, verdict: Verdict
) -> None:
    """Never pressing, always pressing and leaving are distinguished, each in words, by limits and by the staircase."""
    outcome = _run(tmp_path, ScriptedStage(subject, read_protocol(name)))
    assert outcome.verdict is verdict
    assert not outcome.can_be_fitted
    assert "nothing is fitted" in outcome.explanation


def test_hasty_presses_count_as_false(tmp_path: Path, classic: AdaptationProtocol) -> None:
    """Presses 50 ms after each onset are faster than a human; after 15 trials no one has to sit on for 40 min."""
    stage = ScriptedStage(eye, classic, latency_s=0.05)
    outcome = _run(tmp_path, stage)
    assert stage.time < 600
    assert outcome.verdict is Verdict.UNRELIABLE
    assert outcome.thresholds_log10 == ()


@pytest.mark.slow
@pytest.mark.parametrize("dies_after_s", [125.0, 700.0, 1500.0])
def test_run_taken_up_after_a_crash_has_the_same_events(
    tmp_path: Path, classic: AdaptationProtocol, dies_after_s: float
) -> None:
    """A device that dies in any trial: after resuming the journal equals that of an undisturbed run."""
    _run(tmp_path, ScriptedStage(eye, classic), "whole")
    broken = ScriptedStage(eye, classic)
    broken.dies_after = dies_after_s
    with pytest.raises(DeviceLost):
        _run(tmp_path, broken, "broken")
    _run(tmp_path, ScriptedStage(eye, classic), "broken")
    assert (tmp_path / "broken").read_text() == (tmp_path / "whole").read_text()


def test_spot_that_goes_no_dimmer_ends_the_test_with_what_is_known(tmp_path: Path) -> None:
    """A darkest spot at -4: thresholds down to it are a curve, and the verdict says where it ends."""
    outcome = _run(tmp_path, ScriptedStage(eye, read_protocol("screen-only")))
    assert outcome.verdict is Verdict.FLOOR_REACHED
    assert outcome.can_be_fitted
    assert -4.0 < min(outcome.thresholds_log10) < -3.7


def test_journal_of_another_subject_is_refused(tmp_path: Path, classic: AdaptationProtocol) -> None:
    """No two subjects in one file."""
    stage = ScriptedStage(eye, classic)
    _run(tmp_path, stage)
    with RunJournal(tmp_path / "j") as journal, pytest.raises(UsageError, match="belongs to subject 'A1'"):
        run_test(classic, ScriptedStage(eye, classic), journal, subject="B2", seed=3)


def test_a_run_is_not_taken_up_with_another_age_or_pupil(tmp_path: Path, classic: AdaptationProtocol) -> None:
    """Its head states them once; a run that stated none may learn them later."""
    broken = ScriptedStage(eye, classic)
    broken.dies_after = 125.0
    with RunJournal(tmp_path / "j") as journal, pytest.raises(DeviceLost):
        run_test(classic, broken, journal, subject="A1", seed=3, visit={"age_years": 31.0})
    with RunJournal(tmp_path / "j") as journal, pytest.raises(UsageError, match=r"age_years 31\.0, not 70\.0"):
        run_test(classic, ScriptedStage(eye, classic), journal, subject="A1", seed=3, visit={"age_years": 70.0})
    later = {"age_years": 31.0, "pupil_mm": 7.0}
    with RunJournal(tmp_path / "j") as journal:
        run_test(classic, ScriptedStage(eye, classic), journal, subject="A1", seed=3, visit=later)


def test_refused_check_is_journalled_and_keeps_the_bleach_away(tmp_path: Path, classic: AdaptationProtocol) -> None:
    """No one is dazzled for nothing, and the journal says why; the next try begins with the checks again."""
    stage = ScriptedStage(eye, classic)
    findings = [Finding("check", {"what": "safety"}), judge_room(0.5, 0.01, classic)]
    with RunJournal(tmp_path / "j") as journal, pytest.raises(MeasurementError, match=r"0\.500 ± 0\.020 cd·m⁻²"):
        run_test(classic, stage, journal, subject="A1", seed=3, checks=[partial(lambda f: f, f) for f in findings])
    assert stage.time == 0.0
    assert [event["kind"] for event in journal.events] == ["start", "check", "room", "refused"]
    _run(tmp_path, stage)
    with RunJournal(tmp_path / "j") as journal:
        assert [event["kind"] for event in journal.events[4:6]] == ["bleach", "dark"]


def test_catches_are_about_a_tenth_of_all_trials(tmp_path: Path, classic: AdaptationProtocol) -> None:
    """Their number is binomial with the protocol's share (4 sigmas)."""
    _run(tmp_path, ScriptedStage(eye, classic))
    with RunJournal(tmp_path / "j") as journal:
        trials = journal.of_kind("trial")
    share, n = np.mean([t["catch"] for t in trials]), len(trials)
    assert share == pytest.approx(0.1, abs=4 * math.sqrt(0.1 * 0.9 / n))


@pytest.mark.slow
def test_csv_is_what_the_fit_reads(tmp_path: Path, classic: AdaptationProtocol) -> None:
    """Two columns, minutes and log10 threshold."""
    text = _run(tmp_path, ScriptedStage(eye, classic)).to_csv()
    head, first, *_ = text.splitlines()
    assert head == "time_min,log10_threshold"
    assert len(first.split(",")) == 2


def test_without_a_seed_catches_are_those_of_seed_nought(tmp_path: Path, classic: AdaptationProtocol) -> None:
    """A run that states none can be done again, and another seed's trials are others."""

    def lines(name: str, **seed: int) -> list[str]:
        stage = ScriptedStage(lambda level, seconds: seconds < 300 and eye(level, seconds), classic)
        with RunJournal(tmp_path / name) as journal:
            run_test(classic, stage, journal, subject="A1", **seed)
        return (tmp_path / name).read_text().splitlines()[1:]

    assert lines("none") == lines("nought", seed=0)
    assert lines("none again") != lines("one", seed=1)
