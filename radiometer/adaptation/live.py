"""The state of a test from its events, for whoever watches: phase, thresholds, catches, the running fit."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

from radiometer.adaptation.adaptation_fit import best_branches
from radiometer.adaptation.protocol import AdaptationProtocol
from radiometer.adaptation.reliability import BLIND_SPOT, BRIGHT
from radiometer.adaptation.run_facts import method_bias
from radiometer.adaptation.threshold_series import FEWEST, ThresholdSeries
from radiometer.data.event_journal import Event
from radiometer.errors import MeasurementError

_CURVE_POINTS: Final = 160  # twice as many as a terminal has columns


@dataclass(slots=True)
class LiveState:
    """What is known of a running test.

    Attributes:
        false_presses: How many presses had no light, or were faster than a human.
    """

    protocol: AdaptationProtocol  # what is done
    phase: str = "starting"  # "starting", "bleach", "fixation", "threshold", "paused" or "over"
    subject: str = ""  # pseudonym
    time_s: float = 0.0  # time of the newest event in s
    phase_since_s: float = 0.0
    dark_since_s: float | None = None  # when the bleach ended; None before
    # Time in min and log10 threshold by the trial's sequence number; None where not seen
    thresholds: dict[int, tuple[float, float | None]] = field(default_factory=dict)
    # Time in min of each catch and whether it was pressed
    catches: dict[int, tuple[float, bool]] = field(default_factory=dict)
    hasty: set[int] = field(default_factory=set)
    fixation: tuple[int, int] = (0, 0)  # lights in the blind spot that were seen, and of how many
    lapses: tuple[int, int] = (0, 0)  # bright spots that were missed, and of how many
    # Whether it was lost of late: since then no light in the blind spot was missed, as it should be
    fixation_lost: bool = False
    blink: Event | None = None  # level of the newest blink (None: a catch, or none yet) and its presses
    outcome: tuple[str, str] | None = None  # verdict and explanation, once over

    def take(self, event: Event) -> None:
        """Take an event of the journal, in order."""
        kind, self.time_s = str(event["kind"]), float(event["time_s"])
        phase = {"bleach": "bleach", "blink": "threshold", "pause": "paused", "end": "over"}.get(kind, "fixation")
        if kind in ("start", "stage", "check", "room", "refused", "prompt", "stop"):
            phase = self.phase
        if phase != self.phase:
            self.phase, self.phase_since_s = phase, self.time_s
        match kind:
            case "start":
                self.subject = str(event["subject"])
            case "dark":
                self.dark_since_s = self.time_s
            case "blink":
                self.blink = event
            case "trial":
                self._trial(event)
            case "fixation":
                self.fixation_lost = True
            case "pause" if event.get("voids") is not None:
                for known in (self.thresholds, self.catches):
                    known.pop(int(event["voids"]), None)
                self.hasty.discard(int(event["voids"]))
            case "end":
                self.outcome = (str(event["verdict"]), str(event["explanation"]))
            case _:
                pass

    def _trial(self, event: Event) -> None:
        number, minutes = int(event["sequence"]), self.minutes
        if event.get("of") == BLIND_SPOT:
            self.fixation_lost = self.fixation_lost and bool(event["seen"])
            self.fixation = (self.fixation[0] + bool(event["seen"]), self.fixation[1] + 1)
            return
        if event.get("of") == BRIGHT:
            self.lapses = (self.lapses[0] + (not event["seen"]), self.lapses[1] + 1)
            return
        if event["catch"]:
            self.catches[number] = (minutes, bool(event["false_press"]))
            return
        found = event["threshold"]
        self.thresholds[number] = (float(event.get("minutes", minutes)), None if found is None else float(found))
        if event["false_press"]:
            self.hasty.add(number)

    @property
    def minutes(self) -> float:
        """Return the time in the dark in min at the newest event; 0 before."""
        return 0.0 if self.dark_since_s is None else (self.time_s - self.dark_since_s) / 60.0

    @property
    def false_presses(self) -> int:
        """Return how many trials had a press without light or faster than a human."""
        return len(self.hasty) + sum(pressed for _, pressed in self.catches.values())

    @property
    def bias_log10(self) -> float:
        """Return the bias of the protocol's method in log10 units; 0 where it has none."""
        bias = method_bias(self.protocol.method)
        return 0.0 if bias is None else bias.log10

    @property
    def points(self) -> list[tuple[float, float]]:
        """Return the thresholds found: minutes and log10."""
        return [(minutes, value) for minutes, value in self.thresholds.values() if value is not None]

    def to_mapping(self) -> dict[str, Any]:
        """Return the state for the page."""
        spot, blink = self.protocol.spot, self.blink or {}
        return {
            "phase": self.phase,
            "subject": self.subject,
            "protocol": self.protocol.name,
            "time_s": self.time_s,
            "phase_since_s": self.phase_since_s,
            "dark_since_s": self.dark_since_s,
            "bleach_s": self.protocol.bleach.duration_s,
            "duration_min": self.protocol.end.duration_min,
            "criterion": self.protocol.end.criterion_log10,
            "lowest": spot.lowest_log10,
            "highest": spot.highest_log10,
            "points": [[round(t, 3), round(v, 3)] for t, v in self.points],
            "missed": [round(t, 3) for t, v in self.thresholds.values() if v is None],
            "catches": len(self.catches),
            "false_presses": self.false_presses,
            "fixation": list(self.fixation),
            "lapses": list(self.lapses),
            "fixation_lost": self.fixation_lost,
            "level": blink.get("log10_level"),
            "pressed": bool(blink.get("presses_s")),
            "outcome": self.outcome,
        }


@dataclass(frozen=True, slots=True)
class RunningFit:
    """The fit of the thresholds so far."""

    count: int  # how many thresholds it is of
    text: str  # what it says
    # Minutes and log10 thresholds of the line; empty where nothing can be fitted yet
    curve: tuple[tuple[float, float], ...] = ()

    def to_mapping(self) -> dict[str, Any]:
        """Return the fit for the page."""
        return {"count": self.count, "text": self.text, "curve": [[round(t, 3), round(v, 3)] for t, v in self.curve]}


def running_fit(points: Iterable[tuple[float, float]], bias_log10: float = 0.0) -> RunningFit:
    """Return the fit of thresholds so far, or why there is none yet.

    Args:
        points: Minutes and log10 thresholds as they were found.
        bias_log10: Bias of the method, which the plateau that is stated is without, as that of `adapt fit`.
    """
    known = sorted(points)
    if len(known) < FEWEST:
        return RunningFit(len(known), f"a fit needs {FEWEST} thresholds")
    table = np.array(known)
    try:
        fit = best_branches(ThresholdSeries(table[:, 0], table[:, 1]))
    except MeasurementError as error:
        return RunningFit(len(known), f"no fit yet: {error}")
    times = np.linspace(table[0, 0], table[-1, 0], _CURVE_POINTS)
    curve = tuple((float(t), float(v)) for t, v in zip(times, fit.threshold(times), strict=True))
    return RunningFit(len(known), _words(fit.values | {"plateau": fit.values["plateau"] - bias_log10}), curve)


def _words(values: dict[str, float]) -> str:
    if "break_min" not in values:
        return f"one branch so far, plateau {values['plateau']:.2f}"
    return (
        f"cone plateau {values['plateau']:.2f}, break {values['break_min']:.1f} min, "
        f"S2 {values['s2_slope_per_min']:.2f} per min"
    )
