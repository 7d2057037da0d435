"""Starts the daemon: instrument, journal and services from plain arguments."""

from __future__ import annotations

import asyncio
import logging
import os
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final

import structlog
from structlog.typing import EventDict, WrappedLogger

from radiometer.api.files import PathLike
from radiometer.api.meter import PatchLike, as_patch
from radiometer.daemon.bench_instrument import BenchInstrument, bench_light
from radiometer.daemon.descriptors import raise_limit
from radiometer.daemon.epics import PvaOptions
from radiometer.daemon.instrument import MeasurementSettings
from radiometer.daemon.journal import Journal, default_journal_path
from radiometer.daemon.limits import Limits, parse_networks
from radiometer.daemon.memory import limit_arenas
from radiometer.daemon.mqtt import parse_target
from radiometer.daemon.service import Service, ServiceOptions
from radiometer.daemon.station import Station
from radiometer.errors import ConfigurationError
from radiometer.plausible import Days, Megabytes, Period, Port, RequestRate

TOKEN_VARIABLE: Final = "RADIOMETER_TOKEN"  # name of a variable, no token
MQTT_PASSWORD_VARIABLE: Final = "RADIOMETER_MQTT_PASSWORD"  # name of a variable, no password
_LONGEST_TOKEN: Final = 10_000  # characters of its file, which may be a device without an end
# The event loop gives the interpreter away at each write to a socket, and a measurement that computes keeps it for
# this time. With Python's default of 5 ms, 50 clients waited for 105 ms on a busy machine (median). With this figure
# they waited for 18 ms.
_SWITCH_INTERVAL_S: Final = 0.0005
_WINDOW_S: Final = 60.0  # with ten lines of a kind a minute a log stays readable
_MOST: Final = 10  # enough to see a pattern; a thousand connections refused a second show nothing more
_KINDS: Final = 256  # different lines that are remembered


class LogThrottle(logging.Filter):
    """Lets ten lines of each kind pass in a minute; the first of the next minute says how many did not.

    It is a processor of structlog and a filter of the standard library's loggers.

    Args:
        clock: Steady time in s.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        super().__init__()
        self._clock = clock
        self._seen: dict[str, tuple[float, int]] = {}

    def __call__(self, logger: WrappedLogger, method: str, event: EventDict) -> EventDict:
        """Pass an event of structlog on. Raises DropEvent where there were too many like it."""
        suppressed = self._take(str(event.get("event")))
        if suppressed is None:
            raise structlog.DropEvent
        return {**event, "suppressed": suppressed} if suppressed else event

    def filter(self, record: logging.LogRecord) -> bool:
        """Return whether a record of the standard library is written."""
        suppressed = self._take(record.getMessage()[:80])
        if suppressed:
            record.msg = f"{record.msg} ({suppressed} more before were not written)"
        return suppressed is not None

    def install(self) -> None:
        """Put it before structlog's other processors, and onto the loggers of the libraries that serve clients."""
        structlog.configure(processors=[self, *structlog.get_config()["processors"]])
        for name in ("asyncio", "aiohttp.server", "paho"):
            logging.getLogger(name).addFilter(self)

    def _take(self, kind: str) -> int | None:
        """Return how many of a kind were suppressed before this one; None where it is too."""
        now = self._clock()
        since, count = self._seen.pop(kind, (now, 0))
        suppressed = 0
        if now - since >= _WINDOW_S:
            since, count, suppressed = now, 0, max(0, count - _MOST)
        self._seen[kind] = since, count + 1
        if len(self._seen) > _KINDS:
            del self._seen[next(iter(self._seen))]
        return suppressed if count < _MOST else None


def serve(
    bench: PathLike | None = None,
    camera: str | None = None,
    *,
    calibration: PathLike | None = None,
    uncalibrated: bool = False,
    box: str | None = None,
    box_preset: PathLike | None = None,
    patch: PatchLike | None = None,
    every_s: Period = 1.0,
    on_demand: bool = False,
    journal: PathLike | None = None,
    keep_days: Days | None = None,
    journal_max_mb: Megabytes | None = None,
    scpi_address: str = "127.0.0.1",
    scpi_port: Port = 5025,
    scpi_socket: PathLike | None = None,
    scpi_allow: Sequence[str] = (),
    http_address: str = "127.0.0.1",
    http_port: Port = 8080,
    token_file: PathLike | None = None,
    http_rate: RequestRate = 100.0,
    scpi: bool = True,
    http: bool = True,
    mqtt: str | None = None,
    mqtt_prefix: str = "radiometer",
    mqtt_user: str | None = None,
    mqtt_tls: bool = False,
    pva: bool = False,
    pva_prefix: str = "radiometer",
    announce: Callable[[str], None] = print,
) -> None:
    """Measure and serve the readings over SCPI, HTTP (with a web page), MQTT and EPICS pvAccess.

    SIGTERM or Ctrl-C ends it, SIGHUP reloads the calibration. A camera that is lost is reported and reopened.
    SCPI has no authentication: it listens on this machine only, or on another address for those listed with
    `scpi_allow`. HTTP on another address needs a token.

    Args:
        bench: Bench file; the simulated bench by default.
        camera: "sim", an id, serial number or address, or v4l2:, picamera:, gphoto2:.
        calibration: Calibration file; the bench's by default.
        uncalibrated: Use none: relative values.
        box: Light box: "sim", a serial number or a port; none by default.
        box_preset: Light-box preset; the reference box's by default.
        patch: Region to measure; the bench's by default.
        every_s: Time from one reading's start to the next's in s.
        on_demand: Measure only when a client asks.
        journal: Journal file; in the user's state folder by default.
        keep_days: Delete readings and alarms older than this, once an hour; none by default.
        journal_max_mb: Let the journal grow no larger; measuring pauses at the limit.
        scpi_address: Address for SCPI.
        scpi_port: Port for SCPI; 0 chooses one.
        scpi_socket: Unix socket for SCPI as well.
        scpi_allow: Addresses or networks that may use SCPI.
        http_address: Address for HTTP.
        http_port: Port for HTTP; 0 chooses one.
        token_file: File with the token for HTTP; the variable RADIOMETER_TOKEN by default.
        http_rate: Requests per second that one address may make.
        scpi: Serve SCPI.
        http: Serve HTTP.
        mqtt: MQTT broker HOST[:PORT] to publish to.
        mqtt_prefix: First level of the MQTT topics.
        mqtt_user: User at the broker; the password is in RADIOMETER_MQTT_PASSWORD.
        mqtt_tls: Use TLS to the broker.
        pva: Serve readings over EPICS pvAccess (needs p4p).
        pva_prefix: First part of the names of process variables.
        announce: Gets the addresses that are served.

    Raises:
        RadiometerError: If anything named cannot be used.
    """
    broker = mqtt and parse_target(mqtt, mqtt_prefix, mqtt_user, os.environ.get(MQTT_PASSWORD_VARIABLE), tls=mqtt_tls)
    options = ServiceOptions(
        every_s=None if on_demand else every_s,
        scpi_address=scpi_address if scpi else None,
        scpi_port=scpi_port,
        scpi_socket=Path(scpi_socket) if scpi_socket else None,
        scpi_allow=parse_networks(scpi_allow),
        http_address=http_address if http else None,
        http_port=http_port,
        token=_token(Path(token_file) if token_file else None),
        limits=Limits(http_requests_per_s=http_rate),
        mqtt=broker or None,
        pva=PvaOptions(pva_prefix) if pva else None,
    )
    bench_file, scale, preset = (Path(one) if one else None for one in (bench, calibration, box_preset))
    instrument = BenchInstrument(bench_file, camera, scale, uncalibrated=uncalibrated)
    where = as_patch(patch) or instrument.default_patch()
    limit = int(journal_max_mb * 1e6) if journal_max_mb else None
    station = Station(
        instrument,
        Journal(Path(journal) if journal else default_journal_path(), max_bytes=limit),
        box=bench_light(box, preset=preset) if box else None,
        keep_days=keep_days,
        settings=MeasurementSettings(patch=where, gain_db=instrument.config.camera.gain_db),
    )
    asyncio.run(_run(station, options, announce))


async def _run(station: Station, options: ServiceOptions, announce: Callable[[str], None]) -> None:
    limit_arenas()
    raise_limit()
    LogThrottle().install()
    sys.setswitchinterval(_SWITCH_INTERVAL_S)
    await Service(station, options, announce=announce).run()


def _token(file: Path | None) -> str | None:
    if file is None:
        return os.environ.get(TOKEN_VARIABLE) or None
    try:
        with file.open(encoding="utf-8") as stream:
            token = stream.read(_LONGEST_TOKEN).strip()
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigurationError(f"cannot read the token file {file}: {error}") from error
    return token
