"""Pauses, stops and long presses: who asks for them, what is journalled, and that the eye's time goes on."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from radiometer.adaptation.controls import Controls
from radiometer.adaptation.journal import Event, RunJournal
from radiometer.adaptation.outcome import Outcome, Verdict
from radiometer.adaptation.protocol import AdaptationProtocol, read_protocol
from radiometer.adaptation.run import run_test
from testing.scripted_adaptation import ScriptedStage, eye


@pytest.fixture(autouse=True)
def _no_waiting_for_the_disk(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "fsync", lambda handle: None)


@pytest.fixture
def protocol() -> AdaptationProtocol:
    return read_protocol("classic")


@pytest.fixture
def stage(protocol: AdaptationProtocol) -> ScriptedStage:
    return ScriptedStage(eye, protocol)


def _run(path: Path, stage: ScriptedStage, controls: Controls | None = None) -> tuple[Outcome, RunJournal]:
    with RunJournal(path) as journal:
        return run_test(stage.protocol, stage, journal, subject="A1", seed=3, controls=controls), journal


def test_pause_stops_the_blinks_and_the_eye_adapts_on(tmp_path: Path, stage: ScriptedStage) -> None:
    """From 300 s to 360 s nothing is shown; the test still ends 40 min after the bleach."""
    controls = Controls()
    stage.at = {300.0: controls.pause, 360.0: controls.resume}
    outcome, journal = _run(tmp_path / "j", stage, controls)
    (pause,), (resume,) = journal.of_kind("pause"), journal.of_kind("resume")
    assert pause["by"] == resume["by"] == "operator"
    assert pause["time_s"] == pytest.approx(
        300.0, abs=4.0
    )  # what is under way, a blink or the rest after it, ends first
    assert resume["paused_s"] == pytest.approx(resume["time_s"] - pause["time_s"], abs=1e-3)
    assert not [b for b in journal.of_kind("blink") if pause["time_s"] <= b["onset_s"] < resume["time_s"]]
    assert outcome.verdict is Verdict.COMPLETE
    assert 39 < outcome.times_min[-1] < 40.5


def _undisturbed(path: Path, stage: ScriptedStage, number: int) -> Event:
    """Return a trial of an undisturbed run: the first that is no catch from a number on."""
    _, journal = _run(path, ScriptedStage(eye, stage.protocol))
    return next(trial for trial in journal.of_kind("trial")[number:] if not trial["catch"])


@pytest.mark.slow
def test_trial_that_a_pause_cuts_is_begun_anew(tmp_path: Path, stage: ScriptedStage) -> None:
    """Its blinks before the pause count for nothing: the threshold has moved meanwhile."""
    cut_s = _undisturbed(tmp_path / "whole", stage, 5)["time_s"] - 1.5
    controls = Controls()
    stage.at = {cut_s: controls.pause, cut_s + 60.0: controls.resume}
    _, journal = _run(tmp_path / "j", stage, controls)
    pause, resume = journal.of_kind("pause")[0]["sequence"], journal.of_kind("resume")[0]["sequence"]
    trial = next(trial for trial in journal.of_kind("trial") if trial["sequence"] > resume)
    assert journal.events[pause - 1]["kind"] == "blink"
    assert trial["blinks"] == trial["sequence"] - resume - 1


def test_long_press_pauses_and_the_next_press_goes_on(tmp_path: Path, stage: ScriptedStage) -> None:
    """The subject's own pause, without anybody at the keyboard."""
    stage.at = {300.0: lambda: setattr(stage, "held_since", 301.0)}
    stage.presses_in_pause = [330.0]
    _, journal = _run(tmp_path / "j", stage)
    assert [event["by"] for event in journal.of_kind("pause")] == ["subject"]
    assert journal.of_kind("resume")[0]["time_s"] == pytest.approx(330.0, abs=0.5)


@pytest.mark.slow
def test_press_that_became_a_long_one_is_no_answer(tmp_path: Path, stage: ScriptedStage) -> None:
    """The trial that it ended is void: its threshold is not among the results."""
    trial = _undisturbed(tmp_path / "whole", stage, 2)
    stage.at = {trial["time_s"] + 2.0: lambda: setattr(stage, "held_since", trial["time_s"] - 0.6)}
    stage.presses_in_pause = [trial["time_s"] + 20.0]
    outcome, journal = _run(tmp_path / "j", stage)
    assert journal.of_kind("pause")[0]["voids"] == trial["sequence"]
    assert trial["minutes"] not in outcome.times_min


def test_operators_pause_is_not_ended_by_a_press(tmp_path: Path, stage: ScriptedStage) -> None:
    """Only the operator knows why."""
    controls = Controls()
    stage.at = {300.0: controls.pause, 400.0: controls.resume}
    stage.presses_in_pause = [330.0]
    _, journal = _run(tmp_path / "j", stage, controls)
    assert journal.of_kind("resume")[0]["time_s"] == pytest.approx(400.0, abs=0.5)


def test_pause_without_an_end_ends_the_test(tmp_path: Path, stage: ScriptedStage) -> None:
    """After the protocol's 10 min the subject counts as gone."""
    controls = Controls()
    stage.at = {300.0: controls.pause}
    outcome, journal = _run(tmp_path / "j", stage, controls)
    assert outcome.verdict is Verdict.LEFT
    assert journal.events[-1]["time_s"] - journal.of_kind("pause")[0]["time_s"] == pytest.approx(600.0, abs=0.5)


@pytest.mark.parametrize("paused", [False, True])
def test_stop_ends_the_test_at_once_and_for_good(tmp_path: Path, stage: ScriptedStage, paused: bool) -> None:
    """Running or paused; the same command afterwards finds it over."""
    controls = Controls()
    stage.at = {500.0: lambda: controls.stop("subject's wish")}
    if paused:
        stage.at[400.0] = controls.pause
    outcome, journal = _run(tmp_path / "j", stage, controls)
    assert outcome.verdict is Verdict.STOPPED
    assert not outcome.can_be_fitted
    assert journal.of_kind("stop")[0]["by"] == "subject's wish"
    assert journal.events[-1]["time_s"] == pytest.approx(500.0, abs=1.0)
    before = (tmp_path / "j").read_bytes()
    again, _ = _run(tmp_path / "j", ScriptedStage(eye, stage.protocol))
    assert again.verdict is Verdict.STOPPED
    assert (tmp_path / "j").read_bytes() == before


def test_restart_ends_a_pause_that_a_crash_met(tmp_path: Path, protocol: AdaptationProtocol) -> None:
    """Whoever starts the program again wants to go on; the time away has passed for the eye too."""

    def crash() -> None:
        raise KeyboardInterrupt

    first, controls = ScriptedStage(eye, protocol), Controls()
    first.unix, first.at = 1e9, {300.0: controls.pause, 330.0: crash}
    with pytest.raises(KeyboardInterrupt):
        _run(tmp_path / "j", first, controls)
    second = ScriptedStage(eye, protocol)
    second.unix = 1e9 + 390.0  # Unix time of the new stage's zero: 90 s after the pause began
    outcome, journal = _run(tmp_path / "j", second)
    taken_up, resume = journal.of_kind("taken_up")[0], journal.of_kind("resume")[0]
    assert taken_up["time_s"] == pytest.approx(390.0)
    assert resume["by"] == "restart"
    assert outcome.verdict is Verdict.COMPLETE


def test_controls_keep_the_first_who_asked() -> None:
    """A second pause changes nothing; toggling ends it; a stop cannot be taken back."""
    controls = Controls()
    controls.pause("subject")
    controls.pause()
    assert controls.paused_by == "subject"
    controls.toggle()
    assert controls.paused_by is None
    controls.stop()
    controls.resume()
    assert controls.stopped_by == "operator"


@pytest.mark.slow
@pytest.mark.parametrize("stopped", [False, True])
def test_operators_wishes_are_lived_through_again(tmp_path: Path, stage: ScriptedStage, stopped: bool) -> None:
    """A simulated run that is taken up pauses, goes on and stops where it did, without anybody at the keyboard."""
    controls = Controls()
    stage.at = {301.3: controls.pause, 362.2: controls.resume}
    if stopped:
        stage.at[500.0] = controls.stop
    _run(tmp_path / "whole", stage, controls)
    whole = (tmp_path / "whole").read_bytes()
    (tmp_path / "cut").write_bytes(whole if stopped else whole[: whole.index(b'"resume"') + 2000])
    again = ScriptedStage(eye, stage.protocol)
    with RunJournal(tmp_path / "cut", relive=True) as journal:
        run_test(again.protocol, again, journal, subject="A1", seed=3)
    assert (tmp_path / "cut").read_bytes() == whole


@pytest.mark.slow
def test_run_that_died_in_a_pause_goes_on_when_lived_through_again(tmp_path: Path, stage: ScriptedStage) -> None:
    """Whoever starts the program again wants to go on, in simulated time too."""
    controls = Controls()
    stage.at = {301.3: controls.pause, 362.2: controls.resume}
    _run(tmp_path / "whole", stage, controls)
    whole = (tmp_path / "whole").read_bytes()
    cut = whole[: whole.index(b"\n", whole.index(b'"pause"')) + 1]
    (tmp_path / "cut").write_bytes(cut)
    again = ScriptedStage(eye, stage.protocol)
    with RunJournal(tmp_path / "cut", relive=True) as journal:
        outcome = run_test(again.protocol, again, journal, subject="A1", seed=3)
    assert outcome.verdict is Verdict.COMPLETE
    assert (tmp_path / "cut").read_bytes().startswith(cut)
    assert journal.of_kind("resume")[0]["paused_s"] == 0.0


def test_stop_during_the_bleach_lets_nothing_blink(tmp_path: Path, stage: ScriptedStage) -> None:
    """Lights off while the bleach is on ends the test before the first blink."""
    controls = Controls()
    controls.stop("lights off")
    outcome, journal = _run(tmp_path / "j", stage, controls)
    assert outcome.verdict is Verdict.STOPPED
    assert journal.of_kind("stop")[0]["by"] == "lights off"
    assert journal.of_kind("blink") == []
