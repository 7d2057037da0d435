"""The running test on a page for a dark room: served on loopback, with buttons to pause and to stop."""

from __future__ import annotations

import asyncio
import contextlib
import queue
import threading
import time
from collections.abc import Callable, Mapping
from importlib.resources import files
from typing import Final

from radiometer.adaptation.live import LiveState, RunningFit, running_fit
from radiometer.adaptation.protocol import AdaptationProtocol
from radiometer.adaptation.request import Controls
from radiometer.data.event_journal import Event
from radiometer.devices.opening import Opened
from radiometer.errors import DeviceError
from radiometer.screen.loopback import Darken, LoopbackServer, Message, nothing_to_darken

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
