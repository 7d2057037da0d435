"""Puts the daemon together: station, interfaces, signals, and what systemd is notified of."""

from __future__ import annotations

import asyncio
import os
import signal
import socket
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import structlog

import radiometer
from radiometer.daemon import memory
from radiometer.daemon.descriptors import Descriptors
from radiometer.daemon.epics import PvaOptions, PvaServer
from radiometer.daemon.http.server import HttpServer
from radiometer.daemon.limits import Limits, Network, is_loopback
from radiometer.daemon.mqtt import MqttPublisher, MqttTarget
from radiometer.daemon.scpi.server import ScpiServer
from radiometer.daemon.station import Station
from radiometer.errors import RadiometerError

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
            self._housekeeping = asyncio.create_task(memory.run())
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
