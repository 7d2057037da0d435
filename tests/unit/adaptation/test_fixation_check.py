"""The light in the blind spot: when it is shown, what being seen means, and that it is announced."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest

from radiometer.adaptation.journal import RunJournal
from radiometer.adaptation.outcome import Outcome, Verdict
from radiometer.adaptation.prompts import prompts_after
from radiometer.adaptation.protocol import AdaptationProtocol, read_protocol
from radiometer.adaptation.run import run_test
from radiometer.adaptation.run_facts import facts_of
from radiometer.errors import ConfigurationError, DeviceLost
from testing.scripted_adaptation import ScriptedStage, eye, threshold


class StageWithBlindSpot(ScriptedStage):
    """A scripted stage with a light in the blind spot."""

    def __init__(self, sees: Callable[[int], bool], protocol: AdaptationProtocol, *, has_one: bool = True) -> None:
        super().__init__(eye, protocol)
        self.sees, self.checks_fixation, self.shown_min = sees, has_one, list[float]()
        self.dies_at_check = -1

    def blink_blind_spot(self, trial: int, number: int) -> list[float]:
        self.shown_min.append((self.time - self.dark_since) / 60)
        seen = self.sees(len(self.shown_min))
        self.pass_time(self.protocol.spot.cycle_s)
        return [0.4] if seen else []

    def long_press(self, at_least_s: float) -> float | None:
        if len(self.shown_min) == self.dies_at_check:
            self.dies_at_check = -1
            raise DeviceLost("the box went away")
        return super().long_press(at_least_s)


@pytest.fixture(autouse=True)
def _no_waiting_for_the_disk(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "fsync", lambda handle: None)


@pytest.fixture
def short() -> AdaptationProtocol:
    whole = read_protocol("classic")
    return whole.model_copy(update={"end": whole.end.model_copy(update={"duration_min": 25.0})})


def _run(path: Path, stage: ScriptedStage) -> tuple[Outcome, RunJournal]:
    with RunJournal(path) as journal:
        return run_test(stage.protocol, stage, journal, subject="A1", seed=3, eye="left"), journal


def test_light_is_shown_in_its_share_of_the_trials_once_the_cones_are_back(
    tmp_path: Path, short: AdaptationProtocol
) -> None:
    """6 % of the trials from 4 min on (within four sigmas), none before; who never sees it looks at the mark."""
    stage = StageWithBlindSpot(lambda _: False, short)
    outcome, journal = _run(tmp_path / "j", stage)
    trials = [t for t in journal.of_kind("trial") if t.get("minutes", 0) > 4]
    expected = 0.06 * len(trials)
    assert abs(len(stage.shown_min) - expected) < 4 * expected**0.5
    assert min(stage.shown_min) >= 4.0
    assert outcome.reliability.fixation.of == len(stage.shown_min)
    assert outcome.reliability.rates["fixation_losses"].value == 0.0
    assert (outcome.verdict, journal.of_kind("fixation")) == (Verdict.COMPLETE, [])
    assert facts_of(short, None, outcome.reliability)["seen_at_blind_spot"] == f"0/{len(stage.shown_min)}"
    assert journal.events[0]["eye"] == "left"


@pytest.mark.slow
def test_without_a_place_nothing_is_checked(tmp_path: Path, short: AdaptationProtocol) -> None:
    """Neither by a stage that cannot, nor by one that could but has none, nor where the protocol does not want it."""
    no_check = short.model_copy(update={"fixation_check": None})
    for name, stage in (
        ("a", ScriptedStage(eye, short)),
        ("b", StageWithBlindSpot(lambda _: True, short, has_one=False)),
        ("c", StageWithBlindSpot(lambda _: True, no_check)),
    ):
        outcome, _ = _run(tmp_path / name, stage)
        assert "fixation_losses" not in outcome.reliability.rates
        assert outcome.verdict is Verdict.COMPLETE


def test_light_that_is_always_seen_leaves_nothing_to_be_fitted(tmp_path: Path, short: AdaptationProtocol) -> None:
    """The verdict says that fixation was lost."""
    outcome, _ = _run(tmp_path / "j", StageWithBlindSpot(lambda _: True, short))
    assert outcome.verdict is Verdict.FIXATION_LOST
    assert not outcome.can_be_fitted
    assert "mark" in outcome.explanation


def test_loss_is_announced_when_two_of_three_are_seen_and_counted_anew_then(
    tmp_path: Path, short: AdaptationProtocol
) -> None:
    """Seen at the 2nd, 4th, 5th and 6th: reported after the 4th (2, 4 of 2–4) and after the 6th (5, 6 of 5–6)."""
    outcome, journal = _run(tmp_path / "j", StageWithBlindSpot(lambda n: n in (2, 4, 5, 6), short))
    checks = [t["sequence"] for t in journal.of_kind("trial") if t.get("of") == "blind_spot"]
    reported = journal.of_kind("fixation")
    assert [(event["sequence"] - 1, event["lost"], event["of"]) for event in reported] == [
        (checks[3], 2, 3),
        (checks[5], 2, 2),
    ]
    assert prompts_after(reported[0]) == ("mark",)
    assert outcome.verdict is Verdict.COMPLETE


def test_bright_spots_are_ten_times_above_the_last_threshold_and_missed_ones_are_lapses(
    tmp_path: Path, short: AdaptationProtocol
) -> None:
    """Some 4 % of the trials; an eye that sees what is above its threshold misses none."""
    outcome, journal = _run(tmp_path / "j", ScriptedStage(eye, short))
    last, above = None, []
    for event in journal.events:
        if event["kind"] == "blink" and event.get("of") == "bright":
            above.append(event["log10_level"] - last)
        if event["kind"] == "trial" and event["threshold"] is not None:
            last = event["threshold"]
    assert above
    assert all(level == pytest.approx(1.0, abs=1e-3) or 0.5 <= level < 1.0 for level in above)
    assert outcome.reliability.lapses.of == len(above)
    assert outcome.reliability.lapses.hits == 0
    lazy = ScriptedStage(lambda level, s: level is not None and 0 <= level - threshold(s) < 0.7, short)
    missed, _ = _run(tmp_path / "k", lazy)
    assert missed.reliability.lapses.hits == missed.reliability.lapses.of > 0


def test_check_that_a_crash_has_cut_stays_one(tmp_path: Path, short: AdaptationProtocol) -> None:
    """The light was shown, the press journalled, then the box went away: the trial is ended as what it was."""
    stage = StageWithBlindSpot(lambda n: n == 3, short)
    stage.dies_at_check = 3
    with pytest.raises(DeviceLost):
        _run(tmp_path / "j", stage)
    _, journal = _run(tmp_path / "j", stage)
    checks = [t for t in journal.of_kind("trial") if t.get("of") == "blind_spot"]
    assert [t["seen"] for t in checks[:4]] == [False, False, True, False]


@pytest.mark.parametrize("wrong", ["temporal_deg: 10", "below_deg: 8", "size_deg: 5"])
def test_light_next_to_the_blind_spot_is_refused(tmp_path: Path, project_root: Path, wrong: str) -> None:
    """Its place and size are those of the optic disc."""
    text = (project_root / "configs" / "protocols" / "classic.yaml").read_text()
    (tmp_path / "p.yaml").write_text(text.replace("{share: 0.06}", "{" + wrong + "}"))
    with pytest.raises(ConfigurationError, match=wrong.split(":")[0]):
        read_protocol(tmp_path / "p.yaml")
