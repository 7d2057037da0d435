"""The running test in a terminal: a curve that grows, dim and red; plain lines where there is no terminal."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Final

from radiometer.cli.console import console
from radiometer.cli.light.terminal_chart import TerminalChart

if TYPE_CHECKING:
    from rich.text import Text

    from radiometer.adaptation.journal import Event
    from radiometer.adaptation.live import LiveState, RunningFit
    from radiometer.adaptation.protocol import AdaptationProtocol

_DIM_RED: Final = "rgb(135,0,0)"
_ROWS: Final = 12
_PHASES: Final = {
    "starting": "getting ready",
    "bleach": "bleach: look at the bright field",
    "fixation": "look at the red mark",
    "threshold": "press whenever the spot is seen",
    "paused": "paused",
    "over": "over",
}


@contextmanager
def live_curve(protocol: AdaptationProtocol, known: list[Event]) -> Iterator[Callable[[Event], None]]:
    """Show the test while the block runs; yield what is told its events.

    Args:
        protocol: What is done.
        known: Events that the journal holds already.
    """
    if not sys.stdout.isatty():
        yield tell_line
        return
    from rich.live import Live

    screen = _Terminal(protocol)
    for event in known:
        screen.take(event)
    with Live(console=console(), get_renderable=screen.render, refresh_per_second=2) as live:
        yield screen.take
        live.refresh()


class _Terminal:
    def __init__(self, protocol: AdaptationProtocol) -> None:
        from radiometer.adaptation.live import LiveState, RunningFit

        self._state, self._fit = LiveState(protocol), RunningFit(0, "")
        self._told_s = time.monotonic()

    def take(self, event: Event) -> None:
        """Take an event; no fit is made here, on the thread of the run."""
        self._state.take(event)
        self._told_s = time.monotonic()

    def render(self) -> Text:
        """Return what is to be seen now; the fit is brought up to date on the terminal's own thread."""
        from rich.text import Text

        from radiometer.adaptation.live import running_fit

        points = self._state.points
        if len(points) != self._fit.count:
            self._fit = running_fit(points)
        out = console()
        lines = live_lines(self._state, self._fit, max(40, out.width) - 12, self._waited_s())
        return Text("\n".join(lines), style=_DIM_RED, no_wrap=True)

    def _waited_s(self) -> float:
        return 0.0 if self._state.phase == "over" else time.monotonic() - self._told_s


def live_lines(state: LiveState, fit: RunningFit, columns: int, waited_s: float = 0.0) -> list[str]:
    """Return the lines of the live view.

    Args:
        state: The test.
        fit: The fit so far.
        columns: Width of the chart in characters.
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
        *_chart(state, fit, columns),
        fit.text,
        looks,
        counts,
    ]


def _clock(state: LiveState, waited_s: float) -> str:
    if state.phase == "bleach":
        return f"{_span(state.time_s + waited_s - state.phase_since_s)} of {_span(state.protocol.bleach.duration_s)}"
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


def tell_line(event: Event) -> None:
    """Print one line for each phase and each trial."""
    out = console()
    if event["kind"] == "check":
        out.print(f"checked: {_finding(event)}")
    elif event["kind"] == "room" and event["luminance_cd_m2"] is not None:
        out.print(f"dark room: ({event['luminance_cd_m2']:.2g} ± {2 * event['u_cd_m2']:.1g}) cd/m² (k = 2)")
    elif event["kind"] == "refused":
        out.print("refused: nothing was shown")
    elif event["kind"] == "bleach":
        out.print("bleach: look at the bright field")
    elif event["kind"] == "dark":
        out.print("dark: look at the red mark and press whenever the spot is seen")
    elif event["kind"] in ("pause", "resume", "stop"):
        out.print(f"{event['kind']} by {event.get('by', 'operator')}")
    elif event["kind"] == "fixation":
        out.print(f"FIXATION LOST ({event['lost']} of the last {event['of']} checks): look at the red mark")
    elif event["kind"] == "stage" and "no_fixation_check" in event:
        out.print(f"fixation is not checked: {event['no_fixation_check']}")
    elif event["kind"] == "trial" and event.get("of") == "blind_spot":
        out.print("  blind spot: seen" if event["seen"] else "  blind spot: rightly not seen")
    elif event["kind"] == "trial" and event.get("of") == "bright":
        out.print("  bright spot: seen" if event["seen"] else "  bright spot: missed")
    elif event["kind"] == "trial" and event["catch"]:
        out.print("  catch: pressed" if event["false_press"] else "  catch: rightly not pressed")
    elif event["kind"] == "trial":
        found = event["threshold"]
        said = "not seen" if found is None else f"{found:6.2f} log scotopic cd/m²  {_bar(found)}"
        out.print(f"{event['minutes']:6.2f} min  {'pressed too early' if event['false_press'] else said}")


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
