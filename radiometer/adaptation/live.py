"""The state of a test from its events, for whoever watches: as values, and as lines of text."""

from __future__ import annotations

import asyncio
import contextlib
import math
import queue
import threading
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from importlib.resources import files
from typing import Any, Final

import numpy as np

from radiometer.adaptation.adaptation_fit import best_branches
from radiometer.adaptation.outcome import BLIND_SPOT, BRIGHT
from radiometer.adaptation.protocol import AdaptationProtocol
from radiometer.adaptation.request import Controls
from radiometer.adaptation.run_facts import method_bias
from radiometer.adaptation.threshold_series import FEWEST, ThresholdSeries
from radiometer.data.event_journal import Event
from radiometer.devices.opening import Opened
from radiometer.errors import DeviceError, MeasurementError
from radiometer.numbers import with_u
from radiometer.reporting.terminal_chart import TerminalChart
from radiometer.screen.loopback import Darken, LoopbackServer, Message, nothing_to_darken

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


_ROWS: Final = 11  # of the chart: with the lines around it, it fits a terminal of 24 rows
_PHASES: Final = {
    "starting": "getting ready",
    "bleach": "bleach: look at the bright field",
    "fixation": "look at the red mark",
    "threshold": "press whenever the spot is seen",
    "paused": "paused",
    "over": "over",
}


class LiveText:
    """The running test as the lines of a terminal.

    Args:
        known: Events that the journal holds already.
        clock: Steady clock in s.
    """

    def __init__(
        self, protocol: AdaptationProtocol, known: Iterable[Event], clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._state, self._fit, self._clock = LiveState(protocol), RunningFit(0, ""), clock
        self._newest_s = clock()
        for event in known:
            self.take(event)

    def take(self, event: Event) -> None:
        """Take an event; no fit is made here, on the thread of the run."""
        self._state.take(event)
        self._newest_s = self._clock()

    def lines(self, columns: int) -> list[str]:
        """Return what is to be seen now; the fit is brought up to date here."""
        points = self._state.points
        if len(points) != self._fit.count:
            self._fit = running_fit(points, self._state.bias_log10)
        waited_s = 0.0 if self._state.phase == "over" else self._clock() - self._newest_s
        return live_lines(self._state, self._fit, columns, waited_s)


def live_lines(state: LiveState, fit: RunningFit, columns: int, waited_s: float = 0.0) -> list[str]:
    """Return the lines of the live view.

    Args:
        waited_s: Time since the newest event in s.
    """
    level = state.blink["log10_level"] if state.blink and state.phase == "threshold" else None
    pressed = "  pressed" if state.blink and state.blink["presses_s"] else ""
    spot = "" if level is None else f"   spot {level:.2f}{pressed}"
    counts = (
        f"{len(state.points)} thresholds   {len(state.thresholds) - len(state.points)} not seen   "
        f"{len(state.catches)} catches   {state.false_presses} false presses{spot}"
    )
    looks = f"fixation lost {state.fixation[0]}/{state.fixation[1]}   lapses {state.lapses[0]}/{state.lapses[1]}"
    if state.fixation_lost:
        looks += "   FIXATION LOST: look at the red mark"
    return [
        f"{_clock(state, waited_s)}   {_PHASES[state.phase]}",
        "log₁₀ threshold, scotopic cd·m⁻²",
        *_chart(state, fit, columns),
        fit.text,
        looks,
        counts,
    ]


def _clock(state: LiveState, waited_s: float) -> str:
    if state.phase == "bleach":
        passed_s = state.time_s + waited_s - state.phase_since_s
        lasts_s = state.protocol.bleach.duration_s
        return f"{_span(max(0.0, lasts_s - passed_s))} left of {_span(lasts_s)}"
    if state.dark_since_s is None:
        return _span(state.time_s + waited_s)
    return f"{_span(state.time_s + waited_s - state.dark_since_s)} in the dark"


def _span(seconds: float) -> str:
    return f"{int(seconds) // 60}:{int(seconds) % 60:02d}"


def _chart(state: LiveState, fit: RunningFit, columns: int) -> list[str]:
    shown = max(5.0, 5.0 * math.ceil((state.minutes + 0.5) / 5))
    longest = min(shown, max(state.protocol.end.duration_min, state.minutes))
    values = [v for _, v in (*state.points, *fit.curve)]
    high = math.ceil(max([*values, min(state.protocol.spot.highest_log10, -1.0)]) + 0.1)
    low = math.floor(min([*values, high - 3.0]) - 0.1)
    chart = TerminalChart(columns, _ROWS, (0.0, longest), (float(low), float(high)))
    chart.dots(fit.curve)
    chart.blobs(state.points)
    step = 10 if longest > 20 else 5 if longest > 8 else 1
    return chart.lines(range(low, high + 1), range(0, int(longest) + 1, step), "min")


def event_line(event: Event) -> str | None:
    """Return one line for a phase, a check or a trial; None for events that a reader need not see."""
    match event["kind"]:
        case "check":
            return f"checked: {_finding(event)}"
        case "room" if event["luminance_cd_m2"] is not None:
            return f"dark room: {with_u(event['luminance_cd_m2'], 2 * event['u_cd_m2'], 'cd m-2', k=2)}"
        case "refused":
            return "refused: nothing was shown"
        case "bleach":
            return "bleach: look at the bright field"
        case "dark":
            return "dark: look at the red mark and press whenever the spot is seen"
        case "pause" | "resume" | "stop" as kind:
            return f"{kind} by {event.get('by', 'operator')}"
        case "fixation":
            return f"FIXATION LOST ({event['lost']} of the last {event['of']} checks): look at the red mark"
        case "stage" if "no_fixation_check" in event:
            return f"fixation is not checked: {event['no_fixation_check']}"
        case "trial":
            return _trial_line(event)
        case _:
            return None


def _trial_line(event: Event) -> str:
    if event.get("of") == "blind_spot":
        return "  blind spot: seen" if event["seen"] else "  blind spot: rightly not seen"
    if event.get("of") == "bright":
        return "  bright spot: seen" if event["seen"] else "  bright spot: missed"
    if event["catch"]:
        return "  catch: pressed" if event["false_press"] else "  catch: rightly not pressed"
    found = event["threshold"]
    shown = "not seen" if found is None else f"{found:6.2f} log₁₀ scotopic cd·m⁻²  {_bar(found)}"
    return f"{event['minutes']:6.2f} min  {'pressed too early' if event['false_press'] else shown}"


def _finding(event: Event) -> str:
    """Return a check's finding in words."""
    if event["what"] == "calibration":
        stale = ", older than the protocol allows: accepted" if event.get("accepted_stale") else ""
        age = f", {event['age_days']:.0f} days old" if "age_days" in event else ""
        return f"calibration of {event['of']}{age}{stale}"
    if "blue_light" not in event:
        return "the box's limits"
    blue, thermal = 100 * event["blue_light"], 100 * event["thermal"]
    return f"{blue:.2g} % of the blue-light limit, {thermal:.2g} % of the thermal one"


def _bar(threshold: float) -> str:
    """Return a bar from −5.5 up to the threshold: the curve as it grows."""
    return "▪" * max(0, round(5 * (threshold + 5.5)))


_REFRESH_S: Final = 0.05  # events that come closer together are reported together
_BY: Final = "page"
_LIGHTS_OFF: Final = "lights off"
_OVER: Final = None

Health = Callable[[], Mapping[str, str]]


class LivePage(Opened):
    """Shows a running test to any number of browsers; one that goes away does no harm.

    Args:
        controls: Where its buttons ask for a pause or the end.
        port: Port on 127.0.0.1; 0 for any free one.
        health: Returns the state of box or screen by name; asked on the thread of the run after every trial.
        darken: Darkens the light box, whoever holds it, and returns what it did in words; called on its own thread.
        clock: Steady clock in s.
    """

    def __init__(
        self,
        protocol: AdaptationProtocol,
        controls: Controls,
        port: int = 0,
        *,
        audio: bool = False,
        health: Health = dict,
        darken: Darken = nothing_to_darken,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        page = files("radiometer.adaptation.page").joinpath("live.html").read_text(encoding="utf-8")
        self._server = LoopbackServer(page, self, port, what="page of the test")
        self._controls, self._audio, self._health, self._clock = controls, audio, health, clock
        self._darken = darken
        self._state, self._fit = LiveState(protocol), RunningFit(0, "")
        self._sent_s, self._due = clock(), False
        self._devices = self._ask_devices()
        self._points: queue.SimpleQueue[list[tuple[float, float]] | None] = queue.SimpleQueue()
        self._fitter = threading.Thread(target=self._follow, name="running fit", daemon=True)

    @property
    def url(self) -> str:
        """Return the address of the page. Raises DeviceError unless open."""
        return self._server.url

    def open(self) -> None:
        """Serve the page. Raises DeviceInUse where the port is taken."""
        self._server.start()
        self._fitter.start()

    def close(self) -> None:
        """Finish the last fit, report to the browsers that it is over, and stop serving."""
        self._points.put(_OVER)
        self._fitter.join()
        self._server.stop({**self._message(), "phase": "over"})

    def publish(self, event: Event) -> None:
        """Take an event of the run, at once and without waiting for any browser."""
        if event["kind"] == "trial":
            self._devices = self._ask_devices()
        self._server.soon(lambda: self._take(event))

    def greeting(self) -> Message:
        return self._message()

    def received(self, message: Message) -> None:
        match message.get("kind"):
            case "pause":
                self._controls.pause(_BY)
            case "resume":
                self._controls.resume()
            case "stop":
                self._controls.stop(_BY)
            case "lights_off":  # the test ends, or its next blink would light the box again
                self._controls.stop(_LIGHTS_OFF)
                self._server.darken(self._darken)
            case _:
                return
        self._broadcast()

    def left(self) -> None:
        """Do nothing: the others go on looking."""

    def _ask_devices(self) -> dict[str, str]:
        """Return the devices' state; where they do not report it, the run goes on and finds out for itself."""
        try:
            return dict(self._health())
        except DeviceError as error:
            return {"devices": str(error)}

    def _take(self, event: Event) -> None:
        known = len(self._state.points)
        self._state.take(event)
        self._sent_s = self._clock()
        if event["kind"] == "prompt":
            self._server.keep(self._server.send_all({"kind": "prompt", "say": event["say"]}))
        if len(self._state.points) != known:
            self._points.put(self._state.points)
        self._broadcast()

    def _message(self) -> Message:
        return {
            "kind": "state",
            **self._state.to_mapping(),
            "age_s": round(self._clock() - self._sent_s, 2),
            "fit": self._fit.to_mapping(),
            "devices": self._devices,
            "audio": self._audio,
            "pause_asked": self._controls.paused_by,
            "stop_asked": self._controls.stopped_by,
        }

    def _broadcast(self) -> None:
        """Tell every browser the state, soon."""
        if not self._due:
            self._due = True
            asyncio.get_running_loop().call_later(_REFRESH_S, self._refresh)

    def _refresh(self) -> None:
        self._due = False
        self._server.keep(self._server.send_all(self._message()))

    def _follow(self) -> None:
        """Fit the newest thresholds, one fit at a time; those that came meanwhile are fitted together."""
        while (points := self._points.get()) is not _OVER:
            over = False
            with contextlib.suppress(queue.Empty):
                while not over:
                    newer = self._points.get_nowait()
                    over, points = newer is _OVER, points if newer is _OVER else newer
            found = running_fit(points, self._state.bias_log10)
            self._server.soon(lambda found=found: self._fitted(found))  # type: ignore[misc]
            if over:
                return

    def _fitted(self, found: RunningFit) -> None:
        self._fit = found
        self._broadcast()


def replayed(page: LivePage, events: list[Event]) -> None:
    """Tell a page what a journal held already; its prompts are not sounded again."""
    for event in events:
        if event["kind"] != "prompt":
            page.publish(event)
