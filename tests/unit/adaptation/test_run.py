"""Running a test: thresholds, catches, absence, crashes, pauses, and checks of fixation."""

import datetime as dt
import math
import os
import resource
from functools import partial

import numpy as np
import pytest

from radiometer.adaptation.checks import Finding, judge_room
from radiometer.adaptation.outcome import RunJournal, Verdict
from radiometer.adaptation.protocol import read_protocol
from radiometer.adaptation.request import Controls, RunRequest
from radiometer.adaptation.run import run_test
from radiometer.adaptation.run_facts import facts_of
from radiometer.adaptation.session import prompts_after
from radiometer.adaptation.visits import visit_at
from radiometer.data.event_journal import read_events
from radiometer.errors import DeviceLost, InputError, MeasurementError, OutputError, UsageError
from testing.scripted_adaptation import ScriptedStage, eye, threshold


@pytest.fixture(autouse=True)
def _no_waiting_for_the_disk(monkeypatch):
    monkeypatch.setattr(os, "fsync", lambda handle: None)


def _run(path, stage, controls=None, **changes):
    """Run a test on a stage; return its outcome and its journal."""
    options = {"subject": "A1", "seed": 3, "controls": controls} | changes
    with RunJournal(path) as journal:
        return run_test(stage.protocol, stage, journal, **options), journal


def _begun(path, stage, **changes):
    """Run a test until its device dies."""
    stage.dies_after = 125.0
    with pytest.raises(DeviceLost):
        _run(path, stage, **changes)


@pytest.fixture
def classic():
    return read_protocol("classic")


@pytest.mark.parametrize(
    ("name", "tolerance", "verdict", "lasts_min", "last"),
    [
        ("classic", 0.11, Verdict.COMPLETE, (39.0, 40.5), (-9.0, -3.0)),
        ("quick", 0.35, Verdict.CRITERION_REACHED, (10.0, 40.0), (-9.0, -3.0)),
        ("screen-only", 0.11, Verdict.FLOOR_REACHED, (10.0, 40.0), (-4.0, -3.7)),
    ],
)
def test_thresholds_follow_the_eye_until_the_protocol_ends(tmp_path, name, tolerance, verdict, lasts_min, last):
    """Limits overshoot by a step (0.1) at most, the 4-2 dB staircase by its first; time, criterion or floor ends it."""
    outcome, _ = _run(tmp_path / "j", ScriptedStage(eye, read_protocol(name)))
    assert outcome.can_be_fitted
    assert len(outcome.times_min) > 30
    errors = [v - threshold(60 * t) for t, v in zip(outcome.times_min[3:], outcome.thresholds_log10[3:], strict=True)]
    assert max(map(abs, errors)) < tolerance + 0.1  # the curve itself moves by up to 0.1 within a trial
    assert outcome.verdict is verdict
    assert lasts_min[0] < outcome.times_min[-1] < lasts_min[1]
    assert last[0] < min(outcome.thresholds_log10) < last[1]
    assert verdict is not Verdict.CRITERION_REACHED or outcome.thresholds_log10[-1] <= -3 < outcome.thresholds_log10[-2]


def test_thresholds_do_not_share_one_grid_of_levels(tmp_path, classic):
    """An eye of constant, sharp threshold: what limits find is spread evenly over one step above it, from 0 to 0.1."""
    sharp = ScriptedStage(lambda level, _: level is not None and level >= -1.0, classic)
    outcome, _ = _run(tmp_path / "j", sharp)
    above = np.array(outcome.thresholds_log10) + 1.0
    assert above.min() >= 0.0
    assert above.max() < 0.1
    count = above.size
    assert abs(above.mean() - 0.05) < 4 * 0.1 / math.sqrt(12 * count)
    assert abs(np.corrcoef(above[:-1], above[1:])[0, 1]) < 4 / math.sqrt(count)


@pytest.mark.parametrize(
    ("subject", "verdict"),
    [
        (lambda level, seconds: False, Verdict.NO_RESPONSE),
        (lambda level, seconds: True, Verdict.UNRELIABLE),
        (lambda level, seconds: seconds < 600 and eye(level, seconds), Verdict.LEFT),
    ],
)
@pytest.mark.parametrize("name", ["classic", "quick"])
def test_absent_and_careless_subjects_get_a_verdict_and_no_fit(tmp_path, name, subject, verdict):
    """Never pressing, always pressing and leaving are distinguished, each in words, by limits and by the staircase."""
    outcome, _ = _run(tmp_path / "j", ScriptedStage(subject, read_protocol(name)))
    assert outcome.verdict is verdict
    assert not outcome.can_be_fitted
    assert "nothing is fitted" in outcome.explanation


def test_hasty_presses_count_as_false(tmp_path, classic):
    """Presses 50 ms after each onset are faster than a human; after 15 trials no one has to sit on for 40 min."""
    stage = ScriptedStage(eye, classic, latency_s=0.05)
    outcome, _ = _run(tmp_path / "j", stage)
    assert stage.time < 600
    assert outcome.verdict is Verdict.UNRELIABLE
    assert outcome.thresholds_log10 == ()


@pytest.mark.slow
@pytest.mark.parametrize("dies_after_s", [125.0, 700.0, 1500.0])
def test_run_taken_up_after_a_crash_has_the_same_events(tmp_path, classic, dies_after_s):
    """A device that dies in any trial: after resuming the journal equals that of an undisturbed run."""
    _run(tmp_path / "whole", ScriptedStage(eye, classic))
    broken = ScriptedStage(eye, classic)
    broken.dies_after = dies_after_s
    with pytest.raises(DeviceLost):
        _run(tmp_path / "broken", broken)
    _run(tmp_path / "broken", ScriptedStage(eye, classic))
    assert (tmp_path / "broken").read_text() == (tmp_path / "whole").read_text()


class _Described(ScriptedStage):
    """A stage with a screen of one calibration."""

    calibrated = "2026-01-01"

    def facts(self):
        return {"screen": "desk", "calibrated": self.calibrated, "warnings": self.calibrated}

    def health(self):
        return {}


def test_a_run_is_taken_up_only_as_it_was_begun(tmp_path, classic):
    """Not of another subject or age, on a screen calibrated anew, or with coarser steps under the protocol's name."""
    begun = {"age_years": 31.0}
    _begun(tmp_path / "j", _Described(eye, classic), visit=begun)
    for age_years, pupil_mm, words in (
        (31.0, None, []),
        (40.0, 7.0, ["--age 40 is not used", "--pupil 7 is not used"]),
    ):
        request = RunRequest(classic, "A1", seed=3, age_years=age_years, pupil_mm=pupil_mm)
        visit = visit_at(tmp_path / "j", request, dt.datetime.now(dt.UTC))
        assert [remark[: len(one)] for remark, one in zip(visit.remarks, words, strict=True)] == words
        assert (visit.request.age_years, visit.request.pupil_mm) == (31.0, None)
    anew = _Described(eye, classic)
    anew.calibrated = "2026-02-02"
    method = classic.method.model_copy(update={"step_log10": 3 * classic.method.step_log10})
    coarser = _Described(eye, classic.model_copy(update={"method": method}))
    for stage, changes, reason in (
        (_Described(eye, classic), {"subject": "B2"}, "belongs to subject 'A1'"),
        (_Described(eye, classic), {"visit": {"age_years": 70.0}}, r"age_years 31\.0, not 70\.0"),
        (anew, {}, "begun with calibrated '2026-01-01'"),
        (coarser, {}, "has changed since this run began"),
    ):
        with pytest.raises(UsageError, match=reason):
            _run(tmp_path / "j", stage, **{"visit": begun} | changes)
    _run(tmp_path / "j", _Described(eye, classic), visit=begun | {"pupil_mm": 7.0})


def test_refused_check_is_journalled_and_keeps_the_bleach_away(tmp_path, stage):
    """No one is dazzled for nothing, and the journal says why; the next try begins with the checks again."""
    findings = [Finding("check", {"what": "safety"}), judge_room(0.5, 0.01, stage.protocol)]
    with pytest.raises(MeasurementError, match=r"0\.500 ± 0\.020 cd·m⁻²"):
        _run(tmp_path / "j", stage, checks=[partial(lambda f: f, f) for f in findings])
    assert stage.time == 0.0
    assert [event["kind"] for event in read_events(tmp_path / "j")] == ["start", "check", "room", "refused"]
    _, journal = _run(tmp_path / "j", stage)
    assert [event["kind"] for event in journal.events[4:6]] == ["bleach", "dark"]


def test_catches_are_about_a_tenth_of_all_trials(tmp_path, stage):
    """Their number is binomial with the protocol's share (4 sigmas); the fit reads minutes and log10 threshold."""
    outcome, journal = _run(tmp_path / "j", stage)
    trials = journal.of_kind("trial")
    share, n = np.mean([t["catch"] for t in trials]), len(trials)
    assert share == pytest.approx(0.1, abs=4 * math.sqrt(0.1 * 0.9 / n))
    head, first, *_ = outcome.to_csv().splitlines()
    assert head == "time_min,log10_threshold"
    assert len(first.split(",")) == 2


def test_without_a_seed_catches_are_those_of_seed_nought(tmp_path, classic):
    """A run that states none can be done again, and another seed's trials are others."""

    def lines(name, **seed):
        stage = ScriptedStage(lambda level, seconds: seconds < 300 and eye(level, seconds), classic)
        with RunJournal(tmp_path / name) as journal:
            run_test(classic, stage, journal, subject="A1", **seed)
        return (tmp_path / name).read_text().splitlines()[1:]

    assert lines("none") == lines("nought", seed=0)
    assert lines("none again") != lines("one", seed=1)


@pytest.fixture
def stage(classic):
    return ScriptedStage(eye, classic)


def test_pause_stops_the_blinks_and_the_eye_adapts_on(tmp_path, stage):
    """From 300 s to 360 s nothing is shown, whatever is pressed; the test still ends 40 min after the bleach."""
    controls = Controls()
    stage.at = {300.0: controls.pause, 360.0: controls.resume}
    stage.presses_in_pause = [330.0]
    outcome, journal = _run(tmp_path / "j", stage, controls)
    (pause,), (resume,) = journal.of_kind("pause"), journal.of_kind("resume")
    assert pause["by"] == resume["by"] == "operator"
    assert pause["time_s"] == pytest.approx(300.0, abs=4.0)  # a blink under way, or the rest after it, ends first
    assert resume["time_s"] == pytest.approx(360.0, abs=0.5)
    assert resume["paused_s"] == pytest.approx(resume["time_s"] - pause["time_s"], abs=1e-3)
    assert not [b for b in journal.of_kind("blink") if pause["time_s"] <= b["onset_s"] < resume["time_s"]]
    assert outcome.verdict is Verdict.COMPLETE
    assert 39 < outcome.times_min[-1] < 40.5


def _undisturbed(path, stage, number):
    """Return a trial of an undisturbed run: the first that is no catch from a number on."""
    _, journal = _run(path, ScriptedStage(eye, stage.protocol))
    return next(trial for trial in journal.of_kind("trial")[number:] if not trial["catch"])


@pytest.mark.slow
def test_trial_that_a_pause_cuts_is_begun_anew(tmp_path, stage):
    """Its blinks before the pause count for nothing: the threshold has moved meanwhile."""
    cut_s = _undisturbed(tmp_path / "whole", stage, 5)["time_s"] - 1.5
    controls = Controls()
    stage.at = {cut_s: controls.pause, cut_s + 60.0: controls.resume}
    _, journal = _run(tmp_path / "j", stage, controls)
    pause, resume = journal.of_kind("pause")[0]["sequence"], journal.of_kind("resume")[0]["sequence"]
    trial = next(trial for trial in journal.of_kind("trial") if trial["sequence"] > resume)
    assert journal.events[pause - 1]["kind"] == "blink"
    assert trial["blinks"] == trial["sequence"] - resume - 1


def test_long_press_pauses_and_the_next_press_goes_on(tmp_path, stage):
    """The subject's own pause, without anybody at the keyboard."""
    stage.at = {300.0: lambda: setattr(stage, "held_since", 301.0)}
    stage.presses_in_pause = [330.0]
    _, journal = _run(tmp_path / "j", stage)
    assert [event["by"] for event in journal.of_kind("pause")] == ["subject"]
    assert journal.of_kind("resume")[0]["time_s"] == pytest.approx(330.0, abs=0.5)


@pytest.mark.slow
def test_press_that_became_a_long_one_is_no_answer(tmp_path, stage):
    """The trial that it ended is void: its threshold is not among the results."""
    trial = _undisturbed(tmp_path / "whole", stage, 2)
    stage.at = {trial["time_s"] + 2.0: lambda: setattr(stage, "held_since", trial["time_s"] - 0.6)}
    stage.presses_in_pause = [trial["time_s"] + 20.0]
    outcome, journal = _run(tmp_path / "j", stage)
    assert journal.of_kind("pause")[0]["voids"] == trial["sequence"]
    assert trial["minutes"] not in outcome.times_min


def test_pause_without_an_end_ends_the_test(tmp_path, stage):
    """After the protocol's 10 min the subject counts as gone."""
    controls = Controls()
    stage.at = {300.0: controls.pause}
    outcome, journal = _run(tmp_path / "j", stage, controls)
    assert outcome.verdict is Verdict.LEFT
    assert journal.events[-1]["time_s"] - journal.of_kind("pause")[0]["time_s"] == pytest.approx(600.0, abs=0.5)


@pytest.mark.parametrize("paused", [False, True])
def test_stop_ends_the_test_at_once_and_for_good(tmp_path, stage, paused):
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


@pytest.mark.parametrize("when", [500.0, 0.0])
def test_a_test_whose_lights_were_switched_off_ends(tmp_path, stage, when):
    """By `light off` of another program, in the bleach or later: it is stopped, and the journal states by whom."""
    stage.at = {when: lambda: setattr(stage, "switched_off", True)}
    if not when:
        stage.switched_off = True
    outcome, journal = _run(tmp_path / "j", stage, Controls())
    assert outcome.verdict is Verdict.STOPPED
    assert journal.of_kind("stop")[0]["by"] == "light off"
    assert len(journal.of_kind("blink")) == (0 if not when else pytest.approx(400, abs=400))
    assert journal.events[-1]["time_s"] < 502.0


def test_restart_ends_a_pause_that_a_crash_met(tmp_path, classic):
    """Whoever starts the program again wants to go on; the time away has passed for the eye too."""

    def crash():
        raise KeyboardInterrupt

    first, controls = ScriptedStage(eye, classic), Controls()
    first.unix, first.at = 1e9, {300.0: controls.pause, 330.0: crash}
    with pytest.raises(KeyboardInterrupt):
        _run(tmp_path / "j", first, controls)
    second = ScriptedStage(eye, classic)
    second.unix = 1e9 + 390.0  # Unix time of the new stage's zero: 90 s after the pause began
    outcome, journal = _run(tmp_path / "j", second)
    taken_up, resume = journal.of_kind("taken_up")[0], journal.of_kind("resume")[0]
    assert taken_up["time_s"] == pytest.approx(390.0)
    assert resume["by"] == "restart"
    assert outcome.verdict is Verdict.COMPLETE


def test_controls_keep_the_first_who_asked():
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
def test_operators_wishes_are_lived_through_again(tmp_path, stage, stopped):
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


class StageWithBlindSpot(ScriptedStage):
    """A scripted stage with a light in the blind spot."""

    def __init__(self, sees, protocol, *, has_one=True):
        super().__init__(eye, protocol)
        self.sees, self.checks_fixation, self.shown_min = sees, has_one, list[float]()
        self.dies_at_check = -1

    def blink_blind_spot(self, trial, number):
        self.shown_min.append((self.time - self.dark_since) / 60)
        seen = self.sees(len(self.shown_min))
        self.pass_time(self.protocol.spot.cycle_s)
        return [0.4] if seen else []

    def long_press(self, at_least_s):
        if len(self.shown_min) == self.dies_at_check:
            self.dies_at_check = -1
            raise DeviceLost("the box went away")
        return super().long_press(at_least_s)


@pytest.fixture
def short(classic):
    return classic.model_copy(update={"end": classic.end.model_copy(update={"duration_min": 25.0})})


def test_light_is_shown_in_its_share_of_the_trials_once_the_cones_are_back(tmp_path, short):
    """6 % of the trials from 4 min on (within four sigmas), none before; who never sees it looks at the mark."""
    stage = StageWithBlindSpot(lambda _: False, short)
    outcome, journal = _run(tmp_path / "j", stage, eye="left")
    trials = [t for t in journal.of_kind("trial") if t.get("minutes", 0) > 4]
    expected = 0.06 * len(trials)
    assert abs(len(stage.shown_min) - expected) < 4 * expected**0.5
    assert min(stage.shown_min) >= 4.0
    assert outcome.reliability.fixation.of == len(stage.shown_min)
    assert outcome.reliability.rates["fixation_losses"].value == 0.0
    assert (outcome.verdict, journal.of_kind("fixation")) == (Verdict.COMPLETE, [])
    assert facts_of(short, None, outcome.reliability)["seen_at_blind_spot"] == f"0/{len(stage.shown_min)}"
    assert journal.events[0]["eye"] == "left"
    lost, _ = _run(tmp_path / "k", StageWithBlindSpot(lambda _: True, short), eye="left")
    assert (lost.verdict, lost.can_be_fitted, "mark" in lost.explanation) == (Verdict.FIXATION_LOST, False, True)


@pytest.mark.slow
def test_without_a_place_nothing_is_checked(tmp_path, short):
    """Neither by a stage that cannot, nor by one that could but has none, nor where the protocol does not want it."""
    no_check = short.model_copy(update={"fixation_check": None})
    for name, stage in (
        ("a", ScriptedStage(eye, short)),
        ("b", StageWithBlindSpot(lambda _: True, short, has_one=False)),
        ("c", StageWithBlindSpot(lambda _: True, no_check)),
    ):
        outcome, _ = _run(tmp_path / name, stage, eye="left")
        assert "fixation_losses" not in outcome.reliability.rates
        assert outcome.verdict is Verdict.COMPLETE


def test_loss_is_announced_when_two_of_three_are_seen_and_counted_anew_then(tmp_path, short):
    """Seen at the 2nd, 4th, 5th and 6th: reported after the 4th (2, 4 of 2–4) and after the 6th (5, 6 of 5–6)."""
    outcome, journal = _run(tmp_path / "j", StageWithBlindSpot(lambda n: n in (2, 4, 5, 6), short), eye="left")
    checks = [t["sequence"] for t in journal.of_kind("trial") if t.get("of") == "blind_spot"]
    reported = journal.of_kind("fixation")
    assert [(event["sequence"] - 1, event["lost"], event["of"]) for event in reported] == [
        (checks[3], 2, 3),
        (checks[5], 2, 2),
    ]
    assert prompts_after(reported[0]) == ("mark",)
    assert outcome.verdict is Verdict.COMPLETE


def test_bright_spots_are_ten_times_above_the_last_threshold_and_missed_ones_are_lapses(tmp_path, short):
    """Some 4 % of the trials; an eye that sees what is above its threshold misses none."""
    outcome, journal = _run(tmp_path / "j", ScriptedStage(eye, short), eye="left")
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
    missed, _ = _run(tmp_path / "k", lazy, eye="left")
    assert missed.reliability.lapses.hits == missed.reliability.lapses.of > 0


def test_check_that_a_crash_has_cut_stays_one(tmp_path, short):
    """The light was shown, the press journalled, then the box went away: the trial is ended as what it was."""
    stage = StageWithBlindSpot(lambda n: n == 3, short)
    stage.dies_at_check = 3
    with pytest.raises(DeviceLost):
        _run(tmp_path / "j", stage, eye="left")
    _, journal = _run(tmp_path / "j", stage, eye="left")
    checks = [t for t in journal.of_kind("trial") if t.get("of") == "blind_spot"]
    assert [t["seen"] for t in checks[:4]] == [False, False, True, False]


def test_half_written_line_is_cut_and_the_next_event_follows(tmp_path):
    """A crash in the middle of a write costs that event only; what was written is what is read, numbered."""
    file = tmp_path / "j"
    with RunJournal(file) as journal:
        journal.write("start", 0.0, subject="A")
        journal.write("trial", 1.0)
    first = {"sequence": 0, "kind": "start", "time_s": 0.0, "subject": "A"}
    assert read_events(file) == [first, {"sequence": 1, "kind": "trial", "time_s": 1.0}]
    file.write_bytes(file.read_bytes()[:-7])
    with RunJournal(file) as journal:
        assert len(journal.events) == 1
        journal.write("trial", 2.0)
    assert [e["time_s"] for e in read_events(file)] == [0.0, 2.0]


def test_two_programs_never_write_one_test(tmp_path):
    """Neither while one runs it, nor after it went on since the other read it."""
    file = tmp_path / "j"
    with RunJournal(file) as running:
        running.write("start", 0.0)
        late = RunJournal(file)
        with pytest.raises(OutputError, match="another program runs this test"):
            late.__enter__()
        running.write("trial", 1.0)
    with pytest.raises(OutputError, match="meanwhile"):
        late.__enter__()
    assert len(read_events(file)) == 2


@pytest.mark.parametrize("damage", [b"{not json}\n", b'{"sequence": 5, "kind": "trial", "time_s": 1}\n'])
def test_damage_in_the_middle_is_refused_with_its_line(tmp_path, damage):
    """A journal with a hole is not taken up."""
    file = tmp_path / "j"
    file.write_bytes(b'{"sequence": 0, "kind": "start", "time_s": 0}\n' + damage + b"{}\n")
    with pytest.raises(InputError, match="line 2"):
        read_events(file)


def test_an_event_is_on_the_disk_unless_it_need_not_last(tmp_path, monkeypatch):
    """Without a word each event waits for the disk; one that need not last only leaves the program."""
    synced = []
    monkeypatch.setattr(os, "fsync", synced.append)
    with RunJournal(tmp_path / "j") as journal:
        journal.write("start", 0.0)
        after_start = len(synced)
        journal.write("blink", 1.0, lasting=False)
        assert len(synced) == after_start
        assert [e["kind"] for e in read_events(tmp_path / "j")] == ["start", "blink"]
        journal.write("trial", 2.0)
        assert len(synced) == after_start + 1
    assert after_start >= 1


def test_a_full_disk_names_the_journal_and_keeps_what_was_measured(tmp_path):
    """The error states the file and that the same command goes on; the events before are read back."""
    file = tmp_path / "j"
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    try:
        with RunJournal(file) as journal:
            journal.write("start", 0.0)
            resource.setrlimit(resource.RLIMIT_FSIZE, (200, before[1]))
            with pytest.raises(OutputError, match=r"cannot write .*/j: .*goes on"):
                journal.write("trial", 1.0, text="x" * 400)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    with RunJournal(file) as journal:
        assert [event["kind"] for event in journal.events] == ["start"]
