"""A simulated subject without a device: its eye is bleached as the protocol's light does it."""

from __future__ import annotations

from pathlib import Path

import pytest

import radiometer as rm
from radiometer.adaptation.journal import RunJournal
from radiometer.adaptation.protocol import read_protocol
from radiometer.adaptation.run import run_test
from radiometer.adaptation.simulated_stage import simulated_stage
from simulators.observers.eye_kinetics import Eye, eye_after_bleach


def test_break_is_that_of_the_eye_after_the_protocols_bleach(tmp_path: Path) -> None:
    """9,000 cd/m² for 180 s through 7 mm: the fit finds the break of that eye, within 1 min (95 % of a run: 0.8)."""
    rm.adapt_run("classic", "S1", tmp_path / "run.jsonl", simulate="steady")
    found = rm.adapt_fit(tmp_path / "run.csv", bootstrap=0).fit.estimates["break_min"].value
    expected = eye_after_bleach(Eye(pupil_mm=7.0), 9000.0, 180.0).break_min(505.0)
    assert expected is not None
    assert found == pytest.approx(expected, abs=1.0)


def test_weak_bleach_of_a_screen_shows_no_break(tmp_path: Path) -> None:
    """120 cd/m² for 5 min bleach a few per cent of the rods, which lead from the first minute on."""
    rm.adapt_run("screen-only", "S1", tmp_path / "run.jsonl", simulate="steady")
    assert not rm.adapt_fit(tmp_path / "run.csv", bootstrap=0).fit.has_break


def test_false_alarms_are_as_rare_as_the_subjects_habit(tmp_path: Path) -> None:
    """A blink without light is answered in 1 % of the cases, whichever trials are drawn as catches."""
    stage = simulated_stage(read_protocol("classic"), "steady", seed=0)
    with RunJournal(tmp_path / "j") as journal:
        run_test(stage.protocol, stage, journal, subject="S1")
        dark = [blink for blink in journal.of_kind("blink") if blink["log10_level"] is None and "of" not in blink]
    pressed = sum(bool(blink["presses_s"]) for blink in dark)
    assert len(dark) > 50
    assert pressed <= 5  # 1 % of about 120: more than 5 in one of 1000 runs
