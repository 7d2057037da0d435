"""Puts the daemon together: station, interfaces, signals, and what systemd is notified of."""

from __future__ import annotations

import asyncio
import logging
import os
import signal
import socket
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import structlog
from structlog.typing import EventDict, WrappedLogger

import radiometer
from radiometer.api.files import PathLike
from radiometer.api.meter import PatchLike, as_patch
from radiometer.daemon.bench_instrument import BenchInstrument, bench_light
from radiometer.daemon.epics import PvaOptions, PvaServer
from radiometer.daemon.http.server import HttpServer
from radiometer.daemon.instrument import MeasurementSettings
from radiometer.daemon.journal import Journal, default_journal_path
from radiometer.daemon.limits import Limits, Network, is_loopback, parse_networks
from radiometer.daemon.mqtt import MqttPublisher, MqttTarget, parse_target
from radiometer.daemon.resources import Descriptors, level_memory, limit_arenas, raise_limit
from radiometer.daemon.scpi.server import ScpiServer
from radiometer.daemon.station import Station
from radiometer.errors import ConfigurationError, RadiometerError
from radiometer.plausible import Days, Megabytes, Period, Port, RequestRate

_log = structlog.get_logger(__name__)
_HUNG_S: Final = 600.0  # a driver's call that takes longer never ends: systemd may start the daemon anew
_RELOAD_PAUSE_S: Final = 1.0  # between two reloads: a storm of signals leaves the camera to its measurements


class Notifier:
    """Sends state to the socket that systemd names; does nothing where it names none.

    Source: sd_notify(3), systemd's manual: datagrams of KEY=VALUE lines to $NOTIFY_SOCKET, "@" for an abstract name.

    Args:
        address: The socket; "" for none.
        watchdog_us: Time in µs after which systemd takes a silent daemon for hung; 0 for no watchdog.
    """

    def __init__(self, address: str, watchdog_us: int = 0) -> None:
        self._address = "\0" + address[1:] if address.startswith("@") else address
        self._watchdog_us = watchdog_us

    @classmethod
    def from_environment(cls) -> Notifier:
        """Return a notifier for what systemd put into the environment."""
        watchdog_us = os.environ.get("WATCHDOG_USEC", "0")
        for_us = os.environ.get("WATCHDOG_PID", str(os.getpid())) == str(os.getpid())
        return cls(os.environ.get("NOTIFY_SOCKET", ""), int(watchdog_us) if for_us and watchdog_us.isdigit() else 0)

    @property
    def watchdog_period_s(self) -> float | None:
        """Return how often `alive` must be sent, half the time systemd allows; None without a watchdog."""
        return self._watchdog_us / 2e6 if self._watchdog_us else None

    def ready(self, status: str) -> None:
        """Tell that start-up is over."""
        self._send(f"READY=1\nSTATUS={status}")

    def reloading(self) -> None:
        """Tell that a reload begins; `ready` must follow."""
        self._send(f"RELOADING=1\nMONOTONIC_USEC={time.monotonic_ns() // 1000}")

    def stopping(self) -> None:
        """Tell that the end has begun."""
        self._send("STOPPING=1\nSTATUS=stopping")

    def alive(self) -> None:
        """Feed the watchdog."""
        self._send("WATCHDOG=1")

    def status(self, text: str) -> None:
        """Set the line that `systemctl status` shows."""
        self._send("STATUS=" + text.replace("\n", " "))

    def _send(self, message: str) -> None:
        if not self._address:
            return
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as channel:
            channel.settimeout(1.0)
            try:
                channel.sendto(message.encode(), self._address)
            except OSError:
                return  # systemd is restarting; its watchdog decides


@dataclass(frozen=True, slots=True)
class ServiceOptions:
    """Where the daemon listens and what it reports to whom."""

    every_s: float | None = None  # period of continuous measurement in s; None for on demand only
    scpi_address: str | None = "127.0.0.1"  # address for SCPI; None for no TCP
    scpi_port: int = 5025  # port for SCPI; 0 chooses a free one
    scpi_socket: Path | None = None  # Unix socket for SCPI; None for none
    scpi_allow: tuple[Network, ...] = ()  # networks that may connect to SCPI in addition to loopback
    http_address: str | None = "127.0.0.1"  # address for HTTP; None for none
    http_port: int = 8080  # port for HTTP; 0 chooses a free one
    token: str | None = None  # token for HTTP; None where only loopback is listened on
    mqtt: MqttTarget | None = None  # broker to publish to; None for none
    pva: PvaOptions | None = None  # how to serve pvAccess; None for not at all
    limits: Limits = field(default_factory=Limits)  # what clients may use


class Service:
    """A station with its interfaces.

    Args:
        station: The instrument, not yet started.
        options: Where to listen.
        announce: Told, one line each, where the daemon listens and what must be known of it.
        notifier: Notifies systemd; by default the one that systemd asked for.
    """

    def __init__(
        self,
        station: Station,
        options: ServiceOptions,
        announce: Callable[[str], None] = lambda line: None,
        notifier: Notifier | None = None,
    ) -> None:
        self._station, self._options, self._announce = station, options, announce
        self._notifier = notifier or Notifier.from_environment()
        self._scpi = ScpiServer(station, limits=options.limits, allow=options.scpi_allow)
        self._http = HttpServer(station, limits=options.limits, token=options.token)
        self._mqtt = MqttPublisher(station, options.mqtt) if options.mqtt else None
        self._pva = PvaServer(station, options.pva) if options.pva else None
        self._reason = "ended"
        self._stop, self._descriptors = asyncio.Event(), Descriptors(station.alarms)
        self._reloading: asyncio.Task[None] | None = None
        self._reload_asked = asyncio.Event()
        self._housekeeping: asyncio.Task[None] | None = None

    async def run(self) -> None:
        """Serve until a signal ends it; SIGHUP reloads the calibration.

        Raises:
            RadiometerError: If it cannot start, or a part of it has ended that never should.
        """
        loop = asyncio.get_running_loop()
        for number in (signal.SIGTERM, signal.SIGINT):
            loop.add_signal_handler(number, self._end, f"ended by {number.name}")
        loop.add_signal_handler(signal.SIGHUP, self._reload)
        loop.set_exception_handler(self._descriptors.take_error)
        self._station.writer.note("start", f"radiometer {radiometer.__version__}, process {os.getpid()}")
        try:
            await self._station.start()
            await self._listen()
            self._station.set_every(self._options.every_s)
            self._housekeeping = asyncio.create_task(level_memory())
            self._notifier.ready(self._summary())
            self._station.on_change.append(lambda: self._notifier.status(self._summary()))
            await self._watch()
        except RadiometerError as error:
            self._reason = str(error)
            raise
        finally:
            self._notifier.stopping()
            await self._close()
            for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
                loop.remove_signal_handler(number)

    async def _listen(self) -> None:
        options = self._options
        if options.scpi_address is not None:
            port = await self._scpi.listen_tcp(options.scpi_address, options.scpi_port)
            reach = "this machine" if is_loopback(options.scpi_address) else ", ".join(map(str, options.scpi_allow))
            self._announce(f"SCPI on {options.scpi_address}:{port} (no authentication: {reach} may connect)")
        if options.scpi_socket is not None:
            await self._scpi.listen_unix(options.scpi_socket)
            self._announce(f"SCPI on {options.scpi_socket}")
        if options.http_address is not None:
            port = await self._http.listen(options.http_address, options.http_port)
            guarded = "token needed" if options.token else "no token: this machine only"
            self._announce(f"HTTP on http://{_bracketed(options.http_address)}:{port}/ ({guarded})")
        if self._mqtt is not None:
            self._mqtt.start()
            self._announce(f"MQTT to {self._mqtt.target} under {self._mqtt.topic}/")
        if self._pva is not None:
            self._pva.start()
            self._announce(f"pvAccess: {', '.join(self._pva.names)} (no authentication; read only)")
        self._announce(f"journal {self._station.journal_path}")

    async def _watch(self) -> None:
        """Feed the watchdog while all is well; end on request, or when a part has died."""
        period_s = min(self._notifier.watchdog_period_s or 1.0, 1.0)
        while not self._stop.is_set():
            with suppress(TimeoutError):
                async with asyncio.timeout(period_s):
                    await self._stop.wait()
            self._descriptors.look()
            if (failure := self._station.failed_task()) is not None:
                _log.error("a part of the daemon ended", error=repr(failure))
                raise RadiometerError(f"the daemon ends: {type(failure).__name__}: {failure}") from failure
            if self._station.camera.stuck_s < _HUNG_S:
                self._notifier.alive()

    async def _close(self) -> None:
        for task in (self._housekeeping, self._reloading):
            if task is not None:
                task.cancel()
        await self._http.close()
        await self._scpi.close()
        if self._pva is not None:
            await self._pva.stop()
        try:
            await self._station.stop(self._reason)
        finally:
            if self._mqtt is not None:
                await self._mqtt.stop()

    def _end(self, reason: str) -> None:
        self._reason = reason
        self._stop.set()

    def _reload(self) -> None:
        """Reload the calibration, or once more after a reload that runs: many signals are one."""
        self._reload_asked.set()
        if self._reloading is None or self._reloading.done():
            self._reloading = asyncio.create_task(self._reload_while_asked())

    async def _reload_while_asked(self) -> None:
        while self._reload_asked.is_set():
            self._reload_asked.clear()
            await self._reload_calibration()
            await asyncio.sleep(_RELOAD_PAUSE_S)

    async def _reload_calibration(self) -> None:
        self._notifier.reloading()
        try:
            self._announce(f"calibration reloaded: {await self._station.reload_calibration()}")
        except RadiometerError as error:
            self._announce(f"calibration not reloaded: {error}")
        self._notifier.ready(self._summary())

    def _summary(self) -> str:
        alarms = [alarm.message for alarm in self._station.alarms.active]
        return (
            f"alarm: {alarms[0]}"
            if alarms
            else "measuring"
            if self._station.acquisition.every_s is not None
            else "ready"
        )


def _bracketed(address: str) -> str:
    return f"[{address}]" if ":" in address else address


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
