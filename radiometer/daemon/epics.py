"""Serves readings over EPICS pvAccess: NTScalar with alarm, time stamp, display limits and units; NTNDArray of the map.

Names below PREFIX:SERIAL: `radiance`, `u_radiance`, `luminance`, `u_luminance` (NTScalar), `flags` (NTScalar, text) and
`map` (NTNDArray, radiance per pixel, made only while somebody looks). They can be read, not written.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import structlog

from radiometer.daemon.alarms import READING
from radiometer.daemon.patches import MAIN
from radiometer.daemon.station import Station, Subscription
from radiometer.data import Reading
from radiometer.errors import MissingLibrary, UsageError
from radiometer.moments import moment_of

_log = structlog.get_logger(__name__)
_QUEUED_EVENTS: Final = 1000  # a quarter of an hour of readings, once a second
_NAMED: Final[Mapping[str, str]] = {
    "radiance": "radiance of the patch",
    "u_radiance": "standard uncertainty of the radiance (k = 1)",
    "luminance": "luminance of the patch",
    "u_luminance": "standard uncertainty of the luminance (k = 1)",
}
# Severities and statuses of EPICS (normative types, alarm_t).
_NO_ALARM, _MINOR, _MAJOR, _INVALID = 0, 1, 2, 3
_NO_STATUS, _DEVICE_STATUS, _RECORD_STATUS = 0, 1, 3


@dataclass(frozen=True, slots=True)
class PvaOptions:
    """How process variables are served."""

    prefix: str = "radiometer"  # first part of their names
    isolated: bool = False  # serve on loopback at a free port, and answer no searches (for tests)

    def __post_init__(self) -> None:
        if not self.prefix or any(c.isspace() for c in self.prefix):
            raise UsageError(f"{self.prefix!r} is no prefix of process variables; use letters, digits, colons")


class PvaServer:
    """Serves one station's readings. Raises MissingLibrary if p4p is not installed."""

    def __init__(self, station: Station, options: PvaOptions) -> None:
        self._station, self._options = station, options
        self._library = _library()
        self._server: Any = None
        self._variables: dict[str, Any] = {}
        self._watched = False
        self._subscription: Subscription | None = None
        self._task: asyncio.Task[None] | None = None

    @property
    def prefix(self) -> str:
        """Return what all names begin with, such as "radiometer:22500001:"."""
        serial = self._station.instrument.identity.serial or "unknown"
        return f"{self._options.prefix}:{''.join(c if c.isalnum() or c in '-_.' else '_' for c in serial)}:"

    @property
    def names(self) -> tuple[str, ...]:
        """Return the full names of the process variables."""
        return tuple(self.prefix + name for name in (*_NAMED, "flags", "map"))

    @property
    def settings(self) -> dict[str, str]:
        """Return what a client must know to find an isolated server, as EPICS environment variables."""
        return dict(self._server.conf())

    def start(self) -> None:
        """Serve, once the camera's serial number is known, from now on."""
        if not self._station.instrument.identity.serial:
            if self.start not in self._station.on_change:
                self._station.on_change.append(self.start)
            return
        if self._server is not None:
            return
        nt, shared = self._library.nt, self._library.SharedPV
        number = nt.NTScalar("d", display=True, valueAlarm=True)
        self._variables = {name: shared(nt=number, initial=self._unread(name)) for name in _NAMED}
        self._variables["flags"] = shared(nt=nt.NTScalar("s"), initial={"value": "", "alarm": self._no_reading()})
        self._variables["map"] = shared(handler=_Watching(self))  # takes whole values
        provider = self._library.StaticProvider("radiometer")
        for name, variable in self._variables.items():
            provider.add(self.prefix + name, variable)
        self._server = self._library.Server(providers=[provider], isolate=self._options.isolated)
        self._subscription = self._station.hub.subscribe(_QUEUED_EVENTS)
        self._task = asyncio.create_task(self._follow())
        self._station.on_change.append(self._post)
        self._post()

    async def stop(self) -> None:
        """Stop serving."""
        if self._task is not None:
            self._task.cancel()
        for callback in (self.start, self._post):
            if callback in self._station.on_change:
                self._station.on_change.remove(callback)
        if self._server is not None:
            await asyncio.to_thread(self._server.stop)
            for variable in self._variables.values():
                variable.close(destroy=True)

    async def _follow(self) -> None:
        while True:
            assert self._subscription is not None
            event = await self._subscription.next()
            if event is None:  # too many events at once: begin anew with the latest reading
                self._subscription = self._station.hub.subscribe(_QUEUED_EVENTS)
            if event is None or event.kind == "reading":
                self._post()
                await self._post_map()

    def _post(self) -> None:
        """Post the latest reading with the alarms that are up now; that there is none where another place is set."""
        reading = self._station.shown.latest
        if reading is None:
            for name in _NAMED:
                self._variables[name].post(self._unread(name))
            self._variables["flags"].post({"value": "", "alarm": self._no_reading()})
            return
        common = {"alarm": self._alarm(reading), "timeStamp": _time_stamp(reading)}
        for name in _NAMED:
            self._variables[name].post(self._number(name, reading) | common)
        self._variables["flags"].post({"value": ",".join(reading.flags)} | common)

    async def _post_map(self) -> None:
        measurement, reading = self._station.shown.measurement, self._station.shown.latest
        if not self._watched or measurement is None or reading is None or not measurement.frames:
            return
        from radiometer.daemon.http.picture import composite

        response = self._station.instrument.response
        picture = await asyncio.to_thread(composite, measurement, response, reading.sequence)
        attributes = {"unit": picture.unit, "sequence": picture.sequence, "u_rel": reading.radiance.u_rel}
        value = self._library.nt.NTNDArray().wrap(picture.radiance, attrib=attributes)
        value["alarm"], value["timeStamp"] = self._alarm(reading), _time_stamp(reading)
        variable = self._variables["map"]
        (variable.post if variable.isOpen() else variable.open)(value)

    def watch_map(self, watched: bool) -> None:
        """Make the map from now on, or no longer; called in p4p's thread."""
        self._watched = watched

    def _number(self, name: str, reading: Reading) -> dict[str, Any]:
        quantity = reading.radiance if name.endswith("radiance") else reading.luminance
        value = math.nan if quantity is None else quantity.u if name.startswith("u_") else quantity.value
        limits = self._station.patches.watches[MAIN].limits
        low, high = (limits.low, limits.high) if name == "radiance" else (None, None)
        alarm = {
            "active": low is not None or high is not None,
            "lowAlarmLimit": math.nan if low is None else low,
            "highAlarmLimit": math.nan if high is None else high,
            "lowAlarmSeverity": _MAJOR if low is not None else _NO_ALARM,
            "highAlarmSeverity": _MAJOR if high is not None else _NO_ALARM,
            "hysteresis": 0,
        }
        display = {
            "limitLow": 0.0 if low is None else low,
            "limitHigh": high if high is not None else max(2.0 * value, 0.0) if math.isfinite(value) else 0.0,
            "description": _NAMED[name],
            "units": quantity.unit if quantity else "",
        }
        return {"value": value, "display": display, "valueAlarm": alarm}

    def _unread(self, name: str) -> dict[str, Any]:
        shown = {"description": _NAMED[name]}
        return {"value": math.nan, "alarm": self._no_reading(), "display": shown}

    def _no_reading(self) -> dict[str, Any]:
        return {"severity": _INVALID, "status": _RECORD_STATUS, "message": "no reading yet"}

    def _alarm(self, reading: Reading) -> dict[str, Any]:
        """Return the alarm: invalid while no reading can come, major with any alarm, minor with a flag."""
        up = {alarm.name: alarm.message for alarm in self._station.alarms.active}
        for name in ("camera", READING):  # the value is no longer one of now
            if name in up:
                return {"severity": _INVALID, "status": _DEVICE_STATUS, "message": up[name]}
        if up:
            return {"severity": _MAJOR, "status": _DEVICE_STATUS, "message": next(iter(up.values()))}
        if reading.flags:
            return {"severity": _MINOR, "status": _RECORD_STATUS, "message": ",".join(reading.flags)}
        return {"severity": _NO_ALARM, "status": _NO_STATUS, "message": ""}


class _Watching:
    """Returns whether anybody looks at the map, and refuses to be written."""

    def __init__(self, server: PvaServer) -> None:
        self._server = server

    def onFirstConnect(self, pv: Any) -> None:  # noqa: N802 (p4p's name)
        self._server.watch_map(True)

    def onLastDisconnect(self, pv: Any) -> None:  # noqa: N802 (p4p's name)
        self._server.watch_map(False)


def _time_stamp(reading: Reading) -> dict[str, int]:
    moment = moment_of(reading.time)
    seconds = int(moment.timestamp())
    return {"secondsPastEpoch": seconds, "nanoseconds": moment.microsecond * 1000, "userTag": reading.sequence}


@dataclass(frozen=True, slots=True)
class _P4p:
    nt: Any
    Server: Any
    StaticProvider: Any
    SharedPV: Any


def _library() -> _P4p:
    try:
        from p4p import nt
        from p4p.server import Server, StaticProvider
        from p4p.server.thread import SharedPV
    except ImportError as error:
        raise MissingLibrary("pvAccess needs p4p; install it with: pip install 'radiometer[epics]'") from error
    return _P4p(nt, Server, StaticProvider, SharedPV)
