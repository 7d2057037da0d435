"""Publishes readings to an MQTT broker, so that many instruments report into one place."""

from __future__ import annotations

import asyncio
import math
import time
import uuid
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final
from urllib.parse import quote

import structlog

from radiometer.daemon.patches import MAIN
from radiometer.daemon.station import Event, Station, Subscription
from radiometer.data.json_text import json_text, parsed_json
from radiometer.errors import UsageError, required_library

_log = structlog.get_logger(__name__)
ALARM: Final = "mqtt"
_KEEP_ALIVE_S: Final = 10  # a broker announces the last will after one and a half of it
_AT_LEAST_ONCE: Final = 1  # quality of service 1 (MQTT 3.1.1, 4.3.2)
_QUEUED_MESSAGES: Final = 1000  # a quarter of an hour of readings, once a second
_ACKNOWLEDGED_WITHIN_S: Final = 10.0  # a healthy broker takes milliseconds; as long as the connection is kept alive
_LOOK_S: Final = 1.0  # a tenth of the time in which messages must be acknowledged
_READING: Final = "reading"
_DAEMON: Final = "daemon"
_NAMED_EVERY_S: Final = 5.0  # so often a daemon says who it is; two that publish as one instrument hear each other
_NAMED_WITHIN_S: Final = 3 * _NAMED_EVERY_S  # the other one has ended, or publishes elsewhere now


@dataclass(frozen=True, slots=True)
class MqttTarget:
    """A broker."""

    host: str  # name or address
    port: int = 1883  # port
    prefix: str = "radiometer"  # first level of the topics
    user: str | None = None  # user name; None for none
    password: str | None = None  # password; None for none
    tls: bool = False  # whether to use TLS with the system's certificates

    def __str__(self) -> str:
        return f"{self.host}:{self.port}"


def parse_target(text: str, prefix: str, user: str | None, password: str | None, *, tls: bool) -> MqttTarget:
    """Return the broker of HOST or HOST:PORT. Raises UsageError."""
    host, _, port = text.rpartition(":") if text.count(":") == 1 else (text, "", "")
    if not host or (port and not (port.isdigit() and 0 < int(port) < 65536)):
        raise UsageError(f"{text!r} is no broker; give HOST or HOST:PORT")
    if not prefix or any(char in prefix for char in "+#\0") or prefix.startswith("$"):
        raise UsageError(f"{prefix!r} is no topic prefix; leave out +, # and a leading $")
    return MqttTarget(host, int(port) if port else (8883 if tls else 1883), prefix.strip("/"), user, password, tls)


class MqttPublisher:
    """Publishes each reading and state of one instrument.

    Topics under PREFIX/SERIAL, retained: `reading` and `patch/NAME/reading` (JSON lines), `status` (alarms and device
    states as JSON), `state` ("online"; "offline" is the last will). A retained reading is cleared where it is no longer
    one: the patch was moved or deleted, the daemon ended, or an earlier one was killed. Not retained is `daemon`, by
    which a daemon says who it is: where another one does, both publish as one instrument, which is an alarm.

    Attributes:
        acknowledged_within_s: A message that the broker has not acknowledged after this time in s is an alarm.

    Raises:
        MissingLibrary: If paho-mqtt is not installed.
    """

    def __init__(self, station: Station, target: MqttTarget) -> None:
        self._station, self.target = station, target
        self.acknowledged_within_s = _ACKNOWLEDGED_WITHIN_S
        self._mqtt = required_library(
            "paho.mqtt.client", "MQTT needs paho-mqtt; install it with: pip install 'radiometer[fleet]'"
        )
        self._client: Any = None
        self._subscription: Subscription | None = None
        self._tasks: list[asyncio.Task[None]] = []
        self._loop: asyncio.AbstractEventLoop | None = None
        self._trouble = ""
        self._waiting: dict[int, float] = {}  # when each message without an acknowledgement was published, by its id
        self._dropped = 0
        self._retained: set[str] = set()
        self._ended = False
        self._own_name = uuid.uuid4().hex
        self._named_s = self._other_s = -math.inf  # when it named itself, and when another daemon did

    @property
    def topic(self) -> str:
        """Return what all topics of this instrument begin with."""
        return f"{self.target.prefix}/{topic_level(self._station.instrument.identity.serial or 'unknown')}"

    def start(self) -> None:
        """Connect in the background, now and whenever the connection is lost, and publish.

        The topic holds the camera's serial number, so a camera never seen yet is waited for.
        """
        if not self._station.instrument.identity.serial:
            if self.start not in self._station.on_change:
                self._station.on_change.append(self.start)
            return
        if self._client is not None:
            return
        self._loop = asyncio.get_running_loop()
        client = self._mqtt.Client(self._mqtt.CallbackAPIVersion.VERSION2, protocol=self._mqtt.MQTTv311)
        client.max_queued_messages_set(_QUEUED_MESSAGES)
        client.reconnect_delay_set(min_delay=1, max_delay=30)
        if self.target.user is not None:
            client.username_pw_set(self.target.user, self.target.password)
        if self.target.tls:
            client.tls_set()
        client.will_set(f"{self.topic}/state", "offline", qos=_AT_LEAST_ONCE, retain=True)
        client.on_connect, client.on_disconnect = self._connected, self._disconnected
        client.on_connect_fail, client.on_publish = self._not_connected, self._acknowledged
        client.on_message = self._found
        client.connect_async(self.target.host, self.target.port, keepalive=_KEEP_ALIVE_S)
        client.loop_start()
        self._client = client
        self._subscription = self._station.hub.subscribe(_QUEUED_MESSAGES)
        self._station.on_change.append(self._clear_outdated)
        self._tasks = [asyncio.create_task(self._follow()), asyncio.create_task(self._look_often())]

    async def stop(self) -> None:
        """Clear what is retained, say goodbye and disconnect."""
        self._ended = True
        for task in self._tasks:
            task.cancel()
        for callback in (self.start, self._clear_outdated):
            if callback in self._station.on_change:
                self._station.on_change.remove(callback)
        if self._client is not None:
            for name in (*self._retained, "status"):
                self._publish(name, "")
            await asyncio.to_thread(self._finish, self._publish("state", "offline"))

    def _finish(self, message: Any) -> None:
        if self._client.is_connected():
            message.wait_for_publish(2.0)
        self._client.disconnect()
        self._client.loop_stop()

    async def _follow(self) -> None:
        while True:
            assert self._subscription is not None
            event = await self._subscription.next()
            if event is None:
                if self._station.shown.latest is None or self._client is None:
                    return
                self._subscription = self._station.hub.subscribe(_QUEUED_MESSAGES)
            elif event.kind == "status" or topic_of(event) in self._current():
                self._publish(topic_of(event), event.line)

    async def _look_often(self) -> None:
        while True:
            self._look()
            if time.monotonic() - self._named_s >= _NAMED_EVERY_S and self._client.is_connected():
                self._named_s = time.monotonic()
                self._client.publish(f"{self.topic}/{_DAEMON}", self._own_name, qos=_AT_LEAST_ONCE)
            await asyncio.sleep(_LOOK_S)

    def _look(self) -> None:
        """Put the alarm up where the broker is away or acknowledges nothing; down where all is acknowledged."""
        if not self._waiting:
            self._dropped = 0
        oldest_s = time.monotonic() - min(self._waiting.values(), default=time.monotonic())
        trouble = self._trouble
        if not trouble and (oldest_s > self.acknowledged_within_s or self._dropped):
            trouble = f"MQTT broker {self.target} is connected but has not acknowledged a message for {oldest_s:.0f} s"
        if not trouble and time.monotonic() - self._other_s < _NAMED_WITHIN_S:
            self._station.alarms.put_up(
                ALARM,
                f"another daemon publishes under {self.topic} at MQTT broker {self.target}, so that its readings and"
                " these are mixed; end one of them, or give it another --mqtt-prefix",
            )
            return
        if not trouble:
            self._station.alarms.clear(ALARM, "the MQTT broker takes messages again")
            return
        lost = f", {self._dropped} were dropped: {_QUEUED_MESSAGES} wait at most" if self._dropped else ""
        self._station.alarms.put_up(ALARM, f"{trouble}; {len(self._waiting)} messages wait{lost}")

    def _current(self) -> set[str]:
        """Return the topics whose latest reading is one of what is measured now."""
        watches = self._station.patches.watches
        named = {_patch_topic(name) for name, watch in watches.items() if name != MAIN and watch.latest is not None}
        return named | ({_READING} if self._station.shown.latest is not None else set())

    def _clear_outdated(self) -> None:
        for name in self._retained - self._current():
            self._publish(name, "")

    def _publish(self, name: str, line: str) -> Any:
        """Publish a line to keep, or clear what is kept with an empty one."""
        message = self._client.publish(f"{self.topic}/{name}", line, qos=_AT_LEAST_ONCE, retain=True)
        if message.rc == self._mqtt.MQTT_ERR_QUEUE_SIZE:
            self._dropped += 1
            return message
        self._waiting[message.mid] = time.monotonic()
        if name.endswith(_READING):
            (self._retained.add if line else self._retained.discard)(name)
        return message

    def _connected(self, client: Any, userdata: Any, flags: Any, reason: Any, properties: Any) -> None:
        """Called in paho's thread."""
        if reason.is_failure:
            self._report(f"MQTT broker {self.target} refuses: {reason}; look at user, password and TLS")
            return
        client.subscribe(f"{self.topic}/{_patch_topic('+', quoted=True)}", qos=_AT_LEAST_ONCE)
        client.subscribe(f"{self.topic}/state", qos=_AT_LEAST_ONCE)
        client.subscribe(f"{self.topic}/{_DAEMON}", qos=_AT_LEAST_ONCE)
        self._report("")

    def _disconnected(self, client: Any, userdata: Any, flags: Any, reason: Any, properties: Any) -> None:
        """Called in paho's thread."""
        if reason.is_failure:
            self._report(f"MQTT broker {self.target} is gone: {reason}; trying again")

    def _not_connected(self, client: Any, userdata: Any) -> None:
        """Called in paho's thread."""
        self._report(f"MQTT broker {self.target} does not answer; trying again")

    def _acknowledged(self, client: Any, userdata: Any, mid: int, reason: Any, properties: Any) -> None:
        """Called in paho's thread."""
        self._in_loop(lambda: self._waiting.pop(mid, None))

    def _found(self, client: Any, userdata: Any, message: Any) -> None:
        """Called in paho's thread: a reading that the broker holds is cleared if its patch is gone.

        An earlier daemon left it behind, or it came late. The last will of an earlier daemon may come late, too: its
        connection ended by a power cut, say.
        """
        if message.topic == f"{self.topic}/{_DAEMON}":
            if message.payload != self._own_name.encode():
                self._in_loop(self._met_another)
        elif message.topic == f"{self.topic}/state":
            if message.payload == b"offline":
                self._in_loop(self._online)
        elif message.payload:
            self._in_loop(lambda: self._left_behind(message.topic.removeprefix(f"{self.topic}/")))

    def _online(self) -> None:
        if not self._ended:
            self._publish("state", "online")

    def _met_another(self) -> None:
        self._other_s = time.monotonic()
        self._look()

    def _left_behind(self, name: str) -> None:
        self._retained.add(name)
        self._clear_outdated()

    def _report(self, trouble: str) -> None:
        self._in_loop(lambda: self._took(trouble))

    def _in_loop(self, call: Callable[[], object]) -> None:
        if self._loop is not None and not self._loop.is_closed():
            self._loop.call_soon_threadsafe(call)

    def _took(self, trouble: str) -> None:
        self._trouble = trouble
        self._look()
        if not trouble:
            self._publish("state", "online")
            self._publish("status", json_text(self._station.status()))
            self._publish(_READING, self._station.shown.line)


def topic_level(name: str) -> str:
    """Return a name as one level of a topic: what is no letter, digit or one of `_.-~` as %XX, so that none coincide.

    Source: RFC 3986, 2.1 (percent-encoding); MQTT 3.1.1, 4.7 forbids only `+`, `#`, `/` and NUL in a level.
    """
    return quote(name, safe="")


def topic_of(event: Event) -> str:
    """Return the topic of an event below that of the instrument: each patch with a name has its own."""
    return _patch_topic(str(parsed_json(event.line)["name"])) if event.kind == "patch" else event.kind


def _patch_topic(name: str, *, quoted: bool = False) -> str:
    return f"patch/{name if quoted else topic_level(name)}/{_READING}"
