"""Publishes readings to an MQTT broker, so that many instruments report into one place."""

from __future__ import annotations

import asyncio
import json
from dataclasses import dataclass
from typing import Any, Final

import structlog

from radiometer.daemon.hub import Event, Subscription
from radiometer.daemon.station import Station
from radiometer.data.json_text import json_text
from radiometer.errors import MissingLibrary, UsageError

_log = structlog.get_logger(__name__)
ALARM: Final = "mqtt"
_KEEP_ALIVE_S: Final = 10
_AT_LEAST_ONCE: Final = 1
_QUEUED_MESSAGES: Final = 1000


@dataclass(frozen=True, slots=True)
class MqttTarget:
    """A broker.

    Attributes:
        host: Name or address.
        port: Port.
        prefix: First level of the topics.
        user: User name; None for none.
        password: Password; None for none.
        tls: Whether to use TLS with the system's certificates.
    """

    host: str
    port: int = 1883
    prefix: str = "radiometer"
    user: str | None = None
    password: str | None = None
    tls: bool = False

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

    Topics under PREFIX/SERIAL, all retained: `reading` (JSON line), `state` ("online"; "offline" is the last will),
    `status` (alarms and device states as JSON).

    Args:
        station: The instrument.
        target: The broker.

    Raises:
        MissingLibrary: If paho-mqtt is not installed.
    """

    def __init__(self, station: Station, target: MqttTarget) -> None:
        self._station, self.target = station, target
        self._mqtt = _library()
        self._client: Any = None
        self._subscription: Subscription | None = None
        self._task: asyncio.Task[None] | None = None
        self._loop: asyncio.AbstractEventLoop | None = None

    @property
    def topic(self) -> str:
        """Return what all topics of this instrument begin with."""
        serial = self._station.instrument.identity.serial or "unknown"
        return f"{self.target.prefix}/{''.join(c if c.isalnum() or c in '-_.' else '_' for c in serial)}"

    def start(self) -> None:
        """Connect in the background, now and whenever the connection is lost, and publish.

        The topic holds the camera's serial number, so a camera never seen yet is waited for.
        """
        if not self._station.instrument.identity.serial:
            if self._start_once_known not in self._station.on_change:
                self._station.on_change.append(self._start_once_known)
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
        client.on_connect_fail = self._not_connected
        client.connect_async(self.target.host, self.target.port, keepalive=_KEEP_ALIVE_S)
        client.loop_start()
        self._client = client
        self._subscription = self._station.hub.subscribe(_QUEUED_MESSAGES)
        self._task = asyncio.create_task(self._follow())

    def _start_once_known(self) -> None:
        if self._client is None and self._station.instrument.identity.serial:
            self.start()

    async def stop(self) -> None:
        """Say goodbye and disconnect."""
        if self._task is not None:
            self._task.cancel()
        if self._client is not None:
            message = self._client.publish(f"{self.topic}/state", "offline", qos=_AT_LEAST_ONCE, retain=True)
            await asyncio.to_thread(self._finish, message)

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
                continue
            self._publish(_topic_of(event), event.line)

    def _publish(self, name: str, line: str) -> None:
        self._client.publish(f"{self.topic}/{name}", line, qos=_AT_LEAST_ONCE, retain=True)

    def _connected(self, client: Any, userdata: Any, flags: Any, reason: Any, properties: Any) -> None:
        """Called in paho's thread."""
        if reason.is_failure:
            self._tell(f"MQTT broker {self.target} refuses: {reason}; look at user, password and TLS")
            return
        client.publish(f"{self.topic}/state", "online", qos=_AT_LEAST_ONCE, retain=True)
        self._tell("")

    def _disconnected(self, client: Any, userdata: Any, flags: Any, reason: Any, properties: Any) -> None:
        """Called in paho's thread."""
        if reason.is_failure:
            self._tell(f"MQTT broker {self.target} is gone: {reason}; trying again")

    def _not_connected(self, client: Any, userdata: Any) -> None:
        """Called in paho's thread."""
        self._tell(f"MQTT broker {self.target} does not answer; trying again")

    def _tell(self, trouble: str) -> None:
        if self._loop is None or self._loop.is_closed():
            return
        if trouble:
            self._loop.call_soon_threadsafe(self._station.alarms.put_up, ALARM, trouble)
        else:
            self._loop.call_soon_threadsafe(self._back)

    def _back(self) -> None:
        self._station.alarms.clear(ALARM, "the MQTT broker is back")
        self._publish("status", json_text(self._station.status()))
        if self._station.shown.line:
            self._publish("reading", self._station.shown.line)


def _topic_of(event: Event) -> str:
    """Return the topic of an event below that of the instrument: each patch with a name has its own."""
    if event.kind == "patch":
        name = str(json.loads(event.line)["name"])
        return f"patch/{''.join(c if c.isalnum() or c in '-_.' else '_' for c in name)}/reading"
    return event.kind


def _library() -> Any:
    try:
        import paho.mqtt.client as mqtt
    except ImportError as error:
        raise MissingLibrary("MQTT needs paho-mqtt; install it with: pip install 'radiometer[fleet]'") from error
    return mqtt
