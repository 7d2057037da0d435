"""Simulated subjects before the simulated box, in the bytes of the real protocol."""

from __future__ import annotations

import tempfile
from collections import deque
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from drivers.light_box import box as light_box
from radiometer.adaptation.box_setup import open_box_stage
from radiometer.adaptation.outcome import Outcome, RunJournal
from radiometer.adaptation.protocol import AdaptationProtocol, read_protocol
from radiometer.adaptation.request import RunRequest
from radiometer.adaptation.run import run_test
from radiometer.adaptation.threshold_series import ThresholdSeries
from radiometer.bench.boxes import read_preset
from radiometer.bench.served import places_of
from simulators.observers.eye_kinetics import Eye
from simulators.observers.observer import Habits, Observer, ObserverAtBox


@dataclass(frozen=True, slots=True)
class Visit:
    """What a visit gave: thresholds, the outcome, and the eye as the bleach left it."""

    series: ThresholdSeries
    outcome: Outcome
    eye: Eye


def shortened(name: str, minutes: float) -> AdaptationProtocol:
    """Return a shipped protocol that ends after some minutes."""
    whole = read_protocol(name)
    return whole.model_copy(update={"end": whole.end.model_copy(update={"duration_min": minutes})})


# Fewer looks at the line and fewer comparisons of the clocks kept, so that simulated time passes faster.
CLOCK_SAMPLES = 32
light_box.LISTEN_S = 0.2


def visit(protocol: AdaptationProtocol, eye: Eye, seed: int, habits: Habits | None = None) -> Visit:
    """Run a test on a subject with an eye before the simulated box, its pupil dilated as the protocol wants.

    The journal lies in memory where there is such.
    """
    memory = "/dev/shm" if Path("/dev/shm").is_dir() else None
    with (
        tempfile.TemporaryDirectory(dir=memory) as folder,
        open_box_stage(RunRequest(protocol, box="sim", seed=seed)) as (stage, checks),
        RunJournal(Path(folder) / "visit.jsonl", relive=True) as journal,
    ):
        pupil_mm = protocol.bleach.pupil_mm or eye.pupil_mm
        observer = Observer(replace(eye, pupil_mm=pupil_mm), habits or Habits(), np.random.default_rng([seed, 1]))
        box = stage.box
        assert isinstance(box, light_box.SerialLightBox)
        box.link.clock.samples = deque(box.link.clock.samples, maxlen=CLOCK_SAMPLES)
        twin = box.link.line.twin  # type: ignore[attr-defined]
        places = places_of(read_preset())
        ObserverAtBox(observer, twin, filter_density=protocol.spot.filter_density, places=places).sit_down()
        outcome = run_test(protocol, stage, journal, subject="S", seed=seed, checks=checks)
    series = ThresholdSeries(np.array(outcome.times_min), np.array(outcome.thresholds_log10))
    return Visit(series, outcome, observer.eye)
