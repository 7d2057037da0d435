"""Running a test: thresholds are found, catches and absence noticed, a crash costs nothing."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from radiometer.adaptation.journal import Journal
from radiometer.adaptation.protocol import AdaptationProtocol, read_protocol
from radiometer.adaptation.run import Outcome, Verdict, run_test
from radiometer.errors import DeviceLost, MeasurementError, UsageError

Eye = Callable[[float | None, float], bool]


class ScriptedStage:
    """A stage in simulated time whose subject follows a rule: (log10 level or None, seconds in the dark) -> presses."""

    def __init__(self, eye: Eye, protocol: AdaptationProtocol, *, latency_s: float = 0.4) -> None:
        self.eye, self.protocol, self.latency_s = eye, protocol, latency_s
        self.time, self.dark_since, self.dies_after, self.room = 0.0, 0.0, math.inf, 1e-5

    def now_s(self) -> float:
        return self.time

    def room_luminance_cd_m2(self) -> float | None:
        return self.room

    def bleach(self, protocol: AdaptationProtocol) -> None:
        self.time += protocol.bleach.duration_s
        self.dark_since = self.time

    def blink(self, log10_level: float | None, trial: int, number: int) -> list[float]:
        if self.time > self.dies_after:
            raise DeviceLost("the box went away")
        seen = self.eye(log10_level, self.time - self.dark_since)
        self.time += self.protocol.spot.cycle_s
        return [self.latency_s] if seen else []

    def wait(self, seconds: float) -> None:
        self.time += seconds

    def resume_at(self, time_s: float) -> None:
        self.time = time_s
        self.dark_since = self.protocol.bleach.duration_s


def threshold(seconds: float) -> float:
    """Return a textbook curve: cones to -1, rods from about 9 min on, -0.24 log per min."""
    minutes = seconds / 60
    cones = -1 + 1.5 * math.exp(-minutes / 1.5)
    return max(min(cones, -1 - 0.24 * (minutes - 9)), -4.2) if minutes > 9 else cones


def eye(level: float | None, seconds: float) -> bool:
    """See whatever is above the curve."""
    return level is not None and level >= threshold(seconds)


def _run(tmp_path: Path, stage: ScriptedStage, name: str = "j") -> Outcome:
    with Journal(tmp_path / name) as journal:
        return run_test(stage.protocol, stage, journal, subject="A1", seed=3)


@pytest.fixture
def classic() -> AdaptationProtocol:
    return read_protocol("classic")


@pytest.mark.parametrize(("name", "tolerance"), [("classic", 0.11), ("quick", 0.35)])
def test_thresholds_follow_the_eye(tmp_path: Path, name: str, tolerance: float) -> None:
    """Ascending limits overshoot by at most a step (0.1); the 4-2 dB staircase stays within its first step."""
    protocol = read_protocol(name)
    outcome = _run(tmp_path, ScriptedStage(eye, protocol))
    assert outcome.can_be_fitted
    assert len(outcome.times_min) > 30
    errors = [v - threshold(60 * t) for t, v in zip(outcome.times_min[3:], outcome.thresholds_log10[3:], strict=True)]
    assert max(map(abs, errors)) < tolerance + 0.1  # the curve itself moves by up to 0.1 within a trial


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
def test_absent_and_careless_subjects_get_a_verdict_and_no_fit(
    tmp_path: Path, classic: AdaptationProtocol, subject: Eye, verdict: Verdict
) -> None:
    """Never pressing, always pressing and leaving are told apart, each in words."""
    outcome = _run(tmp_path, ScriptedStage(subject, classic))
    assert outcome.verdict is verdict
    assert not outcome.can_be_fitted
    assert "nothing is fitted" in outcome.explanation


def test_hasty_presses_count_as_false(tmp_path: Path, classic: AdaptationProtocol) -> None:
    """Presses 50 ms after each onset are faster than a human and make the run unreliable."""
    outcome = _run(tmp_path, ScriptedStage(eye, classic, latency_s=0.05))
    assert outcome.verdict is Verdict.UNRELIABLE
    assert outcome.thresholds_log10 == ()


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


def test_journal_of_another_subject_is_refused(tmp_path: Path, classic: AdaptationProtocol) -> None:
    """No two subjects in one file."""
    stage = ScriptedStage(eye, classic)
    _run(tmp_path, stage)
    with Journal(tmp_path / "j") as journal, pytest.raises(UsageError, match="belongs to subject 'A1'"):
        run_test(classic, ScriptedStage(eye, classic), journal, subject="B2", seed=3)


def test_bright_room_is_refused_before_the_bleach(tmp_path: Path, classic: AdaptationProtocol) -> None:
    """Nobody is dazzled for nothing."""
    stage = ScriptedStage(eye, classic)
    stage.room = 0.5
    with pytest.raises(MeasurementError, match=r"0\.5 cd/m²"):
        _run(tmp_path, stage)
    assert stage.time == 0.0


def test_catches_are_about_a_tenth_of_all_trials(tmp_path: Path, classic: AdaptationProtocol) -> None:
    """Their number is binomial with the protocol's share (4 sigmas)."""
    _run(tmp_path, ScriptedStage(eye, classic))
    with Journal(tmp_path / "j") as journal:
        trials = journal.of_kind("trial")
    share, n = np.mean([t["catch"] for t in trials]), len(trials)
    assert share == pytest.approx(0.1, abs=4 * math.sqrt(0.1 * 0.9 / n))


def test_csv_is_what_the_fit_reads(tmp_path: Path, classic: AdaptationProtocol) -> None:
    """Two columns, minutes and log10 threshold."""
    text = _run(tmp_path, ScriptedStage(eye, classic)).to_csv()
    head, first, *_ = text.splitlines()
    assert head == "time_min,log10_threshold"
    assert len(first.split(",")) == 2
