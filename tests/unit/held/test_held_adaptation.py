"""Files of thresholds in all their forms, whole runs event by event, the box as a stage, and what is read from YAML."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from radiometer.adaptation.box_stage import BoxLights, BoxStage
from radiometer.adaptation.break_evidence import earliest_visible_break
from radiometer.adaptation.controls import Controls
from radiometer.adaptation.journal import Event, RunJournal
from radiometer.adaptation.live import LiveState, running_fit
from radiometer.adaptation.prompts import Prompter
from radiometer.adaptation.protocol import AdaptationProtocol, read_protocol
from radiometer.adaptation.run import run_test
from radiometer.adaptation.threshold_files import read_table
from radiometer.adaptation.threshold_series import ThresholdSeries
from radiometer.devices.light_box import ButtonEvent, Radiance
from radiometer.errors import DeviceLost, RadiometerError
from testing.scripted_adaptation import ScriptedStage, eye
from tests.unit.held.figures import moved

# What people's files look like: separators, decimals, units said or guessed, gaps, R, OPI, trials, and what is refused.
FILES = {
    "plain": "time_min,log10_threshold\n0.5,-0.25\n3,-1.5\n1.25,-0.75\n",
    "no header, three columns": "1 -0.5 0.1\n2 -1.0 0.2\n3 -1.5 0.05\n",
    "one column": "time_min,log10_threshold\n1\n",
    "semicolons and decimal commas": "Zeit min;threshold log;sd\n0,5;-0,25;0,1\n1,5;-0,75;0,2\n",
    "tabs": "t\tthr\n10\t-1\n130\t-2\n",
    "seconds by their size": "time,threshold\n30,0.5\n121,0.1\n",
    "minutes by their size": "time,threshold\n30,0.5\n120.9,0.1\n",
    "milliseconds by their size": "time,threshold\n30000,0.5\n36000,0.1\n",
    "seconds by their name": "time_s,threshold\n6,0.5\n12,0.1\n",
    "milliseconds by their name": "time (ms),threshold\n60000,0.5\n120000,0.1\n",
    "hours by a fact": "# time unit: hours\ntime,threshold\n0.1,0.5\n0.2,0.1\n",
    "minutes by a fact": "# Time Unit = min\ntime,threshold\n200,0.5\n400,0.1\n",
    "linear by a fact, with u": "# unit: cd/m2\ntime_min,threshold,u\n1,10,1\n2,0.1,0.02\n",
    "linear by its span": "time_min,threshold\n1,100\n2,3.3\n",
    "no linear by its span": "time_min,threshold\n1,100\n2,3.4\n",
    "linear and zero": "time_min,threshold_td\n1,100\n2,0\n",
    "decibels": "time_min,threshold_db,sd\n1,10,2\n2,5,1\n3,-5,1\n4,-20,1\n5,-20,1\n",
    "decibels that rise": "time_min,threshold_db\n1,10\n2,15\n3,20\n4,25\n5,30\n6,35\n7,40\n8,45\n",
    "sensitivity in decibels": "time_min,sensitivity_db\n1,10\n2,5\n3,1\n",
    "decibels of a known zero": "# max_cd_m2: 318 cd/m2\ntime_min,attenuation_db\n1,10\n2,20\n",
    "decibels of OPI": "# made by: OPI 2.9\ntime_min,level_db\n1,10\n2,20\n",
    "gaps": "time_min,log10_threshold\n1,-1\n2,NA\n3,\n4,-2\n",
    "a comment as header": "# time_min,log10_threshold\n1,-1\n2,-2\n",
    "row names of R": '"time" "thrs"\n"1" 0.5 -1\n"2" 1.5 -1.25\n',
    "dput": "list(time = c(1L, 2, 3.5), thrs = c(-1, -1.5, -2))",
    "dput with a span": "structure(list(time = 2:4, thrs = c(-1, -1.5, -2)))",
    "dput of two lengths": "list(time = c(1, 2), thrs = c(-1))",
    "trials": "onset_s,level,seen\n10,-1,TRUE\n20,-1.1,TRUE\n30,-1.2,FALSE\n40,-1.1,TRUE\n50,-1.9,FALSE\n60,-1.8,yes\n",
    "trials of a reaction time": "time,level,seen\n410,-1,1\n380,-1.1,0\n395,-1,1\n",
    "trials without change": "onset_s,level,seen\n10,-1,0\n20,-1.1,0\n",
    "trials without level": "onset_s,strength,seen\n10,-1,0\n20,-1.1,1\n",
    "trials with a gap": "onset_s,level,seen\n10,-1,0\n20,NA,1\n30,-1,1\n",
    "trials in words": "onset_s,level,seen\n10,-1,maybe\n20,-1.1,1\n",
    "a word among numbers": "time_min,log10_threshold\n1,-1\n2,low\n",
    "a short line": "time_min,log10_threshold\n1,-1\n2\n",
    "no threshold": "time_min,colour\n1,-1\n",
    "no time": "colour,threshold\n1,-1\n",
    "u of nought": "time_min,log10_threshold,u\n1,-1,0.1\n2,-1,0\n",
    "nothing": "\n\n",
    "no numbers": "time_min,log10_threshold\nNA,NA\n",
}


def outcome_of(work: Callable[[], Any]) -> Any:
    """Return what work gives, or the kind and words of the error that it ends in."""
    try:
        return work()
    except RadiometerError as error:
        return f"{type(error).__name__}: {error}"


def test_files_of_thresholds_are_read_as_they_were(tmp_path, monkeypatch):
    """Minutes, log10 thresholds and u, what the file says of itself, what was made of it, or why it is refused."""
    monkeypatch.chdir(tmp_path)  # messages name the file, not the folder
    told: dict[str, Any] = {}

    def taken() -> dict[str, Any]:
        table = read_table(Path("file.csv"))
        return {"rows": table.rows.T.tolist(), "facts": table.facts, "taken": list(table.taken)}

    for name, text in FILES.items():
        Path("file.csv").write_text(text, encoding="utf-8")
        told[name] = outcome_of(taken)
    for encoding in ("utf-16", "latin-1", "utf-8-sig"):
        Path("file.csv").write_text("# Gerät: Goldmann\ntime_min;threshold\n1;-1\n2;-2\n", encoding=encoding)
        told[encoding] = outcome_of(taken)
    Path("file.csv").unlink()
    told["missing"] = outcome_of(taken)
    assert not moved("adaptation/files", told)


def test_what_shows_a_recovery_is_as_it_was():
    """Series that are too short, flat, rising or noisy are refused in words; others pass."""
    rng = np.random.default_rng(8)
    minutes = np.arange(1.0, 21.0)
    shapes = {
        "seven": (minutes[:7], -0.3 * minutes[:7]),
        "eight": (minutes[:8], -0.3 * minutes[:8]),
        "flat": (minutes, np.full(20, 0.5)),
        "rising": (minutes, 0.1 * minutes),
        "by the least": (minutes, np.where(minutes < 10, 0.151, 0.0)),
        "by less": (minutes, np.where(minutes < 10, 0.149, 0.0)),
        "noisy": (minutes, -0.02 * minutes + 0.4 * rng.standard_normal(20)),
        "noisy and falling": (minutes, -0.15 * minutes + 0.4 * rng.standard_normal(20)),
        "not a number": (minutes, np.where(minutes < 10, 1.0, np.nan)),
        "descending": (minutes[::-1], -minutes),
        "of two lengths": (minutes, minutes[1:]),
        "an odd edge": (minutes, np.array([3.0, 0.2, 0.2, 0.2, 0.2, *([0.1] * 10), 0.0, 0.0, 0.0, 0.0, -3.0])),
    }
    told = {
        name: outcome_of(lambda shape=shape: ThresholdSeries(*shape).require_recovery())
        for name, shape in shapes.items()
    }
    seen = {
        f"{count} in {last} min, scatter {sigma}, fall {fall}": earliest_visible_break(
            np.linspace(0.5, last, count), sigma, fall
        )
        for count, last, sigma, fall in (
            (40, 40, 0.05, 4.0), (40, 40, 0.2, 4.0), (40, 15, 0.1, 1.0), (12, 30, 0.1, 3.0), (8, 30, 0.6, 0.3),
        )
    }  # fmt: skip
    assert not moved("adaptation/recovery", {"recovery": told, "earliest break": seen})


class Placed(ScriptedStage):
    """A stage with a light in the blind spot, that tells what it is and shows levels of a twentieth."""

    checks_fixation = True

    def facts(self) -> dict[str, Any]:
        return {"box": "17"}

    def health(self) -> dict[str, str]:
        return {"box": "well"}

    def shown_log10(self, log10_level: float) -> float:
        return round(20.0 * log10_level) / 20.0

    def blink_blind_spot(self, trial: int, number: int) -> list[float]:
        self.pass_time(self.protocol.spot.cycle_s)
        return [0.3] if 200.0 < self.time < 340.0 else []  # looks beside the mark for a while


def short_protocol(name: str = "led-only", minutes: float = 5.0, **watch: Any) -> AdaptationProtocol:
    """Return a protocol of a few minutes with many catches of all kinds."""
    protocol = read_protocol(name)
    seen = {"catch_share": 0.2, "lapse_share": 0.15, **watch}
    checked = None if protocol.fixation_check is None else protocol.fixation_check.model_copy(
        update={"share": 0.25, "from_min": 0.5}
    )  # fmt: skip
    return protocol.model_copy(
        update={
            "watch": protocol.watch.model_copy(update=seen),
            "end": protocol.end.model_copy(update={"duration_min": minutes}),
            "fixation_check": checked,
        }
    )


def line(event: Event) -> str:
    """Return an event as a line, without what every event has."""
    facts = {key: value for key, value in event.items() if key not in ("sequence", "kind", "time_s")}
    return f"{event['time_s']:g} {event['kind']} {json.dumps(facts, ensure_ascii=False)}"


def tells_fast(level: float | None, seconds: float) -> bool:
    return eye(level, 4.0 * seconds)


RUNS: dict[str, tuple[AdaptationProtocol, Callable[[Any, Controls], None], Any]] = {
    "plain": (short_protocol(), lambda stage, controls: None, tells_fast),
    "paused and stopped": (
        short_protocol(),
        lambda stage, controls: stage.at.update(
            {200.0: controls.pause, 231.0: controls.resume, 290.0: lambda: setattr(stage, "held_since", 280.0),
             380.0: lambda: controls.stop("key")}
        ),
        tells_fast,
    ),
    "left in a pause": (
        short_protocol(longest_pause_min=0.5), lambda stage, controls: stage.at.update({200.0: controls.pause}),
        tells_fast,
    ),
    "never pressed": (
        short_protocol(minutes=30.0, blind_min=0.5, most_blinks=12),
        lambda stage, controls: None, lambda level, seconds: False,
    ),
    "always pressed": (
        short_protocol(minutes=30.0), lambda stage, controls: None, lambda level, seconds: True,
    ),
    "presses at once": (
        short_protocol(minutes=30.0), lambda stage, controls: setattr(stage, "latency_s", 0.1),
        lambda level, seconds: level is not None,
    ),
    "leaves": (
        short_protocol(minutes=30.0, blind_min=0.5, most_blinks=12), lambda stage, controls: None,
        lambda level, seconds: seconds < 60.0 and tells_fast(level, seconds),
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", RUNS)
def test_a_run_is_journalled_as_it_was(name, tmp_path, monkeypatch):
    """Every event of a run with its time; what the page shows at the end; sounds; the outcome."""
    monkeypatch.setattr(os, "fsync", lambda handle: None)
    protocol, before, subject = RUNS[name]
    stage, controls, live = Placed(subject, protocol), Controls(), LiveState(protocol)
    before(stage, controls)
    sounds: list[str] = []
    phases: list[str] = []
    with RunJournal(tmp_path / "j") as journal:
        prompter = Prompter(journal, lambda event: sounds.append(f"{event['time_s']:g} {event['say']}"))

        def watch(event: Event) -> None:
            live.take(event)
            prompter.after(event)
            if not phases or phases[-1].split()[1] != live.phase:
                phases.append(f"{live.phase_since_s:g} {live.phase}")

        ended = run_test(
            protocol, stage, journal, subject="A1", seed=5, watch=watch, controls=controls, eye="left"
        )  # fmt: skip
        events = [line(event) for event in journal.events if event["kind"] not in ("blink", "prompt")]
        blinks = [
            [e["trial"], e["onset_s"], e["log10_level"], e["presses_s"], e.get("of", "")]
            for e in journal.of_kind("blink")
        ]
    told = {
        "events": events,
        "blinks": [str(blink) for blink in blinks[:60]],
        "ended": str(ended),
        "shown": live.to_mapping(),
        "phases": phases,
        "sounds": sounds,
        "fit": running_fit(live.points).to_mapping() if name == "plain" else None,
    }
    assert not moved(f"adaptation/run_{name.replace(' ', '_')}", told, rel=1e-4)


def test_a_run_is_taken_up_after_a_crash_as_it_was(tmp_path, monkeypatch):
    """The box goes away twice, in a simulated world and in one with a clock; one is lived through again."""
    monkeypatch.setattr(os, "fsync", lambda handle: None)
    protocol, told = short_protocol(minutes=3.0), {}
    for kind, unix in (("simulated", None), ("with a clock", 1e9)):
        path, events = tmp_path / kind, []
        for attempt in range(3):
            stage = Placed(tells_fast, protocol)
            stage.unix = None if unix is None else unix + 150.0 * attempt
            stage.dies_after = 200.0 + 60.0 * attempt if attempt < 2 else 1e9
            with RunJournal(path) as journal:
                try:
                    run_test(protocol, stage, journal, subject="A1", seed=5)
                except DeviceLost as lost:
                    events.append(str(lost))
                events.append(f"{len(journal.events)} events, {stage.time:g} s")
        kept = [json.loads(row) for row in path.read_text().splitlines()]
        told[kind] = [*events, *(line(event) for event in kept if event["kind"] not in ("blink",))]
    path = tmp_path / "simulated"
    rows = path.read_text().splitlines(keepends=True)
    path.write_text("".join(rows[:40]) + rows[40][:10])  # a line that was not finished
    with RunJournal(path, relive=True) as journal:
        run_test(protocol, Placed(tells_fast, protocol), journal, subject="A1", seed=5)
        told["lived through again"] = [line(event) for event in journal.of_kind("trial")]
    for name, changes in {"another subject": {"subject": "B"}, "another seed": {"seed": 6}}.items():
        with RunJournal(path, relive=name == "another seed") as journal:
            asked = {"subject": "A1", "seed": 5, **changes}
            said = outcome_of(lambda journal=journal, asked=asked: run_test(
                protocol, Placed(tells_fast, protocol), journal, **asked
            ))  # fmt: skip
            told[name] = str(said).replace(str(tmp_path), "")
    path.write_text('{"sequence": 0}\n{"sequence": 2}\n')
    told["out of order"] = str(outcome_of(lambda: RunJournal(path).events)).replace(str(tmp_path), "")
    path.write_text('{"sequence": 0}\nnonsense\n')
    told["damaged"] = str(outcome_of(lambda: RunJournal(path).events)).replace(str(tmp_path), "")
    told["a folder"] = str(outcome_of(lambda: RunJournal(tmp_path).events)).replace(str(tmp_path), "")
    told["not open"] = str(outcome_of(lambda: RunJournal(tmp_path / "n").write("x", 0.0))).replace(str(tmp_path), "")
    assert not moved("adaptation/taken_up", told)


class Box:
    """A light box with a clock that notes what it is asked; its button is pressed as it was laid down."""

    def __init__(self, presses: list[tuple[float, float]]) -> None:
        self.time, self.presses, self.asked = 50.0, presses, list[str]()
        self.identity = SimpleNamespace(serial="17", firmware="2.1")

    def pulse(self, channel: str, level: Radiance, duration_s: float) -> None:
        self.asked.append(f"{self.time:.6g} pulse {channel} {level.radiance_w_sr_m2:.8g} {duration_s:g}")

    def set_level(self, channel: str, level: Radiance) -> None:
        self.asked.append(f"{self.time:.6g} level {channel} {level.radiance_w_sr_m2:.8g}")

    def status(self) -> Any:
        return SimpleNamespace(supply_v=11.987, temperature_celsius=31.6, darkened=2)

    def buttons(self, timeout_s: float) -> Iterator[ButtonEvent]:
        begun = self.time
        self.time += timeout_s
        changes = [(down, True) for down, _ in self.presses] + [(up, False) for _, up in self.presses]
        for number, (at, pressed) in enumerate(sorted(changes)):
            if begun < at <= self.time:
                yield ButtonEvent(pressed, at, 1e-4, at, number)

    def wait(self, seconds: float) -> None:
        self.time += seconds

    def now(self) -> float:
        return self.time


class FlashingBox(Box):
    """A box with a photographic flash."""

    flash_exposure_j_sr_m2 = 3.0

    def fire_flash(self) -> None:
        self.asked.append(f"{self.time:.6g} flash")

    def flash_state(self) -> None:
        """Nobody asks."""


def test_the_box_as_a_stage_is_as_it_was():
    """Bleaches of three kinds, blinks, lights in the blind spot, rests, long presses, facts and health."""
    told: dict[str, Any] = {}
    protocols = ("classic", "quick", "led-only")
    flashed = read_protocol("quick")
    flashed = flashed.model_copy(update={"bleach": flashed.bleach.model_copy(update={"source": "flash"})})
    tried = [*((name, read_protocol(name)) for name in protocols), ("no flash", flashed), ("flash", flashed)]
    for name, protocol in tried:
        box = (FlashingBox if name == "flash" else Box)([(51.0, 51.1), (60.4, 63.0), (70.25, 70.3), (75.0, 99.0)])
        shown = (2e-4, "old") if name != "quick" else (0.0, "")
        lights = BoxLights(protocol, 320.0, 750.0, 1400.0, shown[0], 0.0123456, 7e-4, shown[1])
        stage = BoxStage(box, lights, box.now, box.wait)  # type: ignore[arg-type]
        if name == "classic":
            stage.wall_clock = lambda box=box: 1e9 + box.now()
        said: list[Any] = [stage.facts(), stage.health(), stage.wall_s(), stage.now_s()]
        said.append(outcome_of(lambda stage=stage, protocol=protocol: stage.bleach(protocol)))
        box.time = 60.0
        for level in (-2.0, None, -3.5):
            said.append([round(press, 6) for press in stage.blink(level, 0, 0)])
        said.append(stage.long_press(2.0))
        said.append([stage.rest(9.0), stage.now_s(), stage.long_press(2.0), stage.long_press(2.0)])
        said.append(outcome_of(lambda stage=stage: stage.blink_blind_spot(0, 0)))
        stage.wait(5.0)
        said += [stage.long_press(2.5), stage.long_press(1.5), stage.long_press(1.5), stage.checks_fixation]
        stage.resume_at(1000.0)
        told[name] = {"said": said, "asked": box.asked, "now": stage.now_s()}
    lights = BoxLights(flashed, 320.0, 750.0, 1400.0)
    told["flashes"] = [lights.flashes(j) for j in (0.001, 0.3, 3.0, 100.0)]
    assert not moved("adaptation/box", told)
