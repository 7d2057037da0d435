"""Clients of the daemon that know what they must see: each holds every answer against the radiance of its patch."""

from __future__ import annotations

import contextlib
import http.client
import json
import re
import socket
import threading
import time
import urllib.error
import urllib.request
from collections.abc import Callable
from typing import Any

from simulators.light_box.box import SimulatedLightBox
from testing.daemon_process import DaemonProcess
from testing.soak_world import PATCHES, SERIAL, Witness

_FULL_LEVEL = 65535
_BELIEF_S = 3.0  # a level that the box does not have may be shown for so long: the box is asked twice a second


class Client(threading.Thread):
    """Does one thing again and again until stopped; what is refused or broken off is counted."""

    def __init__(self, name: str, work: Callable[[], None], witness: Witness, pause_s: float) -> None:
        super().__init__(daemon=True, name=name)
        self._work, self._witness, self._pause_s, self._ended = work, witness, pause_s, threading.Event()

    def run(self) -> None:
        while not self._ended.wait(self._pause_s):
            try:
                self._work()
            except urllib.error.HTTPError as refusal:
                with refusal:
                    self._witness.count(f"{self.name} refused {refusal.code}")
            except (OSError, http.client.HTTPException) as error:
                self._witness.count(f"{self.name} broken off ({type(error).__name__})")

    def stop(self) -> None:
        """End it."""
        self._ended.set()
        self.join(30)


class ScpiLine:
    """One SCPI connection that is opened again where it broke."""

    def __init__(self, daemon: DaemonProcess) -> None:
        self._daemon, self._line, self._replies = daemon, None, None  # type: Any, Any, Any

    def ask(self, message: str) -> str | None:
        """Return the reply to a query; None where it was refused."""
        try:
            if self._line is None:
                self._line = socket.create_connection(("127.0.0.1", self._daemon.scpi_port), timeout=60)
                self._replies = self._line.makefile("rb")
            self._line.sendall(f"*CLS\n{message}\nSYST:ERR?\n".encode())
            first = self._take()
            if re.match(r'[-+]?\d+,"', first):
                return None
            self._take()
            return first
        except OSError:
            self.close()
            raise

    def close(self) -> None:
        """Hang up."""
        if self._line is not None:
            self._replies.close()
            self._line.close()
            self._line = None

    def _take(self) -> str:
        reply = self._replies.readline()
        if not reply:
            raise ConnectionError("hung up")
        return str(reply.decode().rstrip("\n"))


def fetching(daemon: DaemonProcess, witness: Witness) -> Callable[[], None]:
    """Ask for the latest reading of the patch for all."""
    line = ScpiLine(daemon)

    def work() -> None:
        _take_pair(line.ask("FETC?"), "FETC?", "bright", witness)

    return work


def measuring(daemon: DaemonProcess, witness: Witness, patch: str) -> Callable[[], None]:
    """Measure a patch of one's own over SCPI and fetch it again, on a connection that others share nothing of."""
    line, where = ScpiLine(daemon), ",".join(map(str, PATCHES[patch][0].values()))

    def work() -> None:
        _take_pair(line.ask(f"MEAS:RAD? {where}"), f"MEAS:RAD? {patch}", patch, witness)
        _take_pair(line.ask("FETC:RAD?"), f"FETC:RAD? after MEAS of {patch}", patch, witness)

    return work


def _take_pair(reply: str | None, who: str, patch: str, witness: Witness) -> None:
    if reply is None:
        witness.count(f"{who} refused")
        return
    value, u = map(float, reply.split(","))
    witness.saw_value(who, value, u, patch)


def posting(daemon: DaemonProcess, witness: Witness, patch: str) -> Callable[[], None]:
    """Measure a patch of one's own over HTTP."""

    def work() -> None:
        witness.saw("POST /measure", daemon.post("/measure", {"patch": PATCHES[patch][0]}), patch)

    return work


def looking(daemon: DaemonProcess, witness: Witness) -> Callable[[], None]:
    """Look at all that the page and a monitor look at."""

    def work() -> None:
        for reading in daemon.get("/readings?limit=5"):
            witness.saw("GET /readings", reading, "bright")
        for reading in daemon.get("/readings?limit=5&stream=patch+dim"):
            witness.saw("GET /readings of dim", reading, "dim")
        for path in ("/", "/frame.png?width=160", "/trend?points=300", "/events", "/readings?format=csv&limit=200"):
            with urllib.request.urlopen(daemon.url + path, timeout=60) as reply:
                reply.read()
        with urllib.request.urlopen(daemon.url + "/metrics", timeout=60) as reply:
            _take_metrics(reply.read().decode(), witness)

    return work


def _take_metrics(text: str, witness: Witness) -> None:
    for pattern, patch in (
        (r"^radiometer_radiance\{[^}]*\} (\S+)$", "bright"),
        (r'^radiometer_patch_radiance\{[^}]*patch="dim"[^}]*\} (\S+)$', "dim"),
    ):
        for value in re.findall(pattern, text, re.MULTILINE):
            witness.saw_value(f"/metrics {patch}", float(value), 0.0, patch)


def listening(daemon: DaemonProcess, witness: Witness) -> Callable[[], None]:
    """Follow the stream for a minute, come back where it ended, and miss nothing."""
    state = {"last": -1}

    def work() -> None:
        connection = http.client.HTTPConnection("127.0.0.1", daemon.http_port, timeout=60)
        with contextlib.closing(connection):
            headers = {"Last-Event-ID": str(state["last"])} if state["last"] >= 0 else {}
            connection.request("GET", "/readings/stream", headers=headers)
            reply, kind, begun = connection.getresponse(), "reading", time.monotonic()
            while time.monotonic() - begun < 60.0 and (line := reply.readline()):
                if line.startswith(b"event: "):
                    kind = line[7:].decode().strip()
                elif line.startswith(b"data: "):
                    _take_event(kind, json.loads(line[6:]), witness, state)
                elif line == b"\n":
                    kind = "reading"

    return work


def _take_event(kind: str, content: dict[str, Any], witness: Witness, state: dict[str, int]) -> None:
    if kind == "status":
        return
    witness.saw(f"stream {kind}", content, "bright" if kind == "reading" else "dim")
    if kind == "reading":
        witness.main.add(content["sequence"])
        state["last"] = content["sequence"]


def lighting(daemon: DaemonProcess, witness: Witness, twin: SimulatedLightBox) -> Callable[[], None]:
    """Light the fixation mark or darken it, and hold what is shown as confirmed against what the box does."""
    state = {"doubt": 0.0, "turn": 0}

    names = [limits.name for limits in twin.settings.channels]
    fixation = twin.channels[names.index("fixation")]

    def work() -> None:
        state["turn"] += 1
        if state["turn"] % 8 == 0:
            daemon.post("/light", {"channel": "fixation", "level": 0.02 * (state["turn"] % 16 == 0)})
            return
        status, truth = daemon.get("/status"), fixation.driven_level / _FULL_LEVEL
        witness.count("light looked at")
        shown = (status["light"] or {}).get("fixation")
        if not status["light_confirmed"] or shown is None or abs(shown - truth) < 1e-3:
            state["doubt"] = 0.0
        elif not state["doubt"]:
            state["doubt"] = time.monotonic()
        elif time.monotonic() - state["doubt"] > _BELIEF_S:
            witness.blame(f"light: {shown:.4g} confirmed where the box does {truth:.4g}")

    return work


class MqttListener:
    """A subscriber that stays through the broker's deaths."""

    def __init__(self, port: int, witness: Witness) -> None:
        import paho.mqtt.client as mqtt

        self._witness = witness
        self._client = mqtt.Client(mqtt.CallbackAPIVersion.VERSION2)
        self._client.reconnect_delay_set(min_delay=1, max_delay=2)
        self._client.on_connect = lambda client, *_: client.subscribe("radiometer/#", qos=1)
        self._client.on_message = self._take
        self._client.connect_async("127.0.0.1", port, keepalive=10)
        self._client.loop_start()

    def close(self) -> None:
        """Hang up."""
        self._client.disconnect()
        self._client.loop_stop()

    def _take(self, client: Any, userdata: Any, message: Any) -> None:
        topic = str(message.topic).removeprefix(f"radiometer/{SERIAL}/")
        if topic in ("reading", "patch/dim/reading"):
            patch = "bright" if topic == "reading" else "dim"
            self._witness.saw(f"MQTT {topic}", json.loads(message.payload), patch)
