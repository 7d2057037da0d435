"""A running test as lines of text: a curve that grows, and a line for each event."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable
from typing import Final

from radiometer.adaptation.live import LiveState, RunningFit, running_fit
from radiometer.adaptation.protocol import AdaptationProtocol
from radiometer.data.event_journal import Event
from radiometer.numbers import with_u
from radiometer.reporting.terminal_chart import TerminalChart

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
