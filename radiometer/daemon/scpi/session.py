"""One SCPI session: status of its own, settings of the shared instrument, and the execution of messages."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Coroutine
from dataclasses import replace
from functools import lru_cache
from typing import Any, Final

import structlog

from radiometer.daemon.alarms import Alarm
from radiometer.daemon.keeper import DeviceState
from radiometer.daemon.scpi import status as bits
from radiometer.daemon.scpi.command import CommandTable, Outcome
from radiometer.daemon.scpi.errors import ScpiError, scpi_error
from radiometer.daemon.scpi.lexer import Unit, split_message
from radiometer.daemon.scpi.status import Status
from radiometer.daemon.station import Station
from radiometer.data import Flag, Patch, Reading
from radiometer.errors import RadiometerError

_log = structlog.get_logger(__name__)
MEASURING_DEADLINE_S: Final = 120.0
_DEFAULT_ELEMENTS: Final = ("READing", "UNCertainty")
_CALIBRATION_FLAGS: Final = {Flag.UNCALIBRATED, Flag.STALE_CALIBRATION}
_split_cached = lru_cache(maxsize=512)(split_message)


class Session:
    """One client.

    Args:
        station: The instrument, shared by all sessions.
        table: The command table.
    """

    def __init__(self, station: Station, table: CommandTable) -> None:
        self.station, self.table = station, table
        self.status = Status()
        self.function = "RADiance"
        self.elements: tuple[str, ...] = _DEFAULT_ELEMENTS
        self.big_endian = True
        self.own_patch: tuple[Patch | None] | None = None  # (None,) is the middle; None the shared patch
        self.pending: asyncio.Task[Reading] | None = None
        self._own: Reading | None = None
        self._held: Reading | None = None
        self.responses: list[str] = []
        self._known_alarms: tuple[Alarm, ...] = ()
        self.update_status()
        self._tell_alarms()

    def execute(self, message: str) -> str | Coroutine[Any, Any, str | None] | None:
        """Run a message and return its reply without terminator; None where there is none.

        Returns a coroutine of the same where a command in it has to wait.
        """
        units, error = _split_cached(message) if len(message) < 256 else split_message(message)
        self.responses, self._held = [], None
        return self._execute_from(units, 0, "", error)

    def close(self) -> None:
        """Forget what is pending."""
        self.abort()

    def update_status(self) -> None:
        """Bring the condition registers up to date and latch what rose."""
        station, reading = self.station, self.station.latest
        operation = bits.CONTINUOUS * (station.acquisition.every_s is not None)
        operation |= bits.MEASURING * (self.pending is not None or station.acquisition.busy)
        self.status.operation.update(operation)
        flags = set(reading.flags) if reading else set()
        box_lost = station.box_keeper is not None and station.box_keeper.state is not DeviceState.READY
        questionable = bits.CALIBRATION * bool(flags & _CALIBRATION_FLAGS)
        questionable |= bits.CAMERA_LOST * (station.camera.state is not DeviceState.READY)
        questionable |= bits.BOX_LOST * box_lost
        questionable |= bits.READING_FLAGGED * bool(flags - _CALIBRATION_FLAGS)
        questionable |= bits.JOURNAL_BLOCKED * any(alarm.name == "journal" for alarm in station.alarms.active)
        self.status.questionable.update(questionable)

    def state_changed(self) -> None:
        """Take note of alarms that went up: each is an entry of the error queue."""
        self.update_status()
        self._tell_alarms()

    def start(self) -> asyncio.Task[Reading]:
        """Begin a measurement and return its task. Raises ScpiError -213 if one is pending."""
        if self.pending is not None and not self.pending.done():
            raise ScpiError(-213, "a measurement is pending; ABORt ends it")
        settings = self.station.settings
        if self.own_patch is not None:
            settings = replace(settings, patch=self.own_patch[0])
        task = asyncio.create_task(self.station.measure(settings, MEASURING_DEADLINE_S))
        task.add_done_callback(self._finished)
        self.pending = task
        return task

    def abort(self) -> None:
        """Give up what is pending."""
        if self.pending is not None:
            self.pending.cancel()
            self.pending = None

    async def wait_pending(self) -> None:
        """Return once nothing is pending."""
        if self.pending is not None:
            await asyncio.wait({self.pending})

    async def measured(self, task: asyncio.Task[Reading]) -> Reading:
        """Return the reading of a task; the rest of this message refers to it. Raises ScpiError."""
        await asyncio.wait({task})
        if task.cancelled():
            raise ScpiError(-230, "the measurement was aborted")
        if (error := task.exception()) is not None:
            raise scpi_error(error) if isinstance(error, Exception) else error
        self._held = self._own = task.result()
        return self._held

    def fetched(self) -> Reading:
        """Return the reading that FETCh? stands for; one message always sees one reading.

        Raises:
            ScpiError: If there is none yet.
        """
        if self._held is None:
            if self.station.acquisition.every_s is not None or self._own is None:
                self._held = self.station.latest or self._own
            else:
                self._held = self._own
        if self._held is None:
            raise ScpiError(-230, "there is no reading yet; READ? makes one")
        return self._held

    def reset(self) -> None:
        """Put the session and the instrument's settings back to those at start (*RST)."""
        self.abort()
        self.function, self.elements, self.big_endian, self.own_patch = "RADiance", _DEFAULT_ELEMENTS, True, None
        self._own = self._held = None
        self.station.reset()

    def _execute_from(
        self, units: tuple[Unit, ...], index: int, path: str, error: ScpiError | None
    ) -> str | Coroutine[Any, Any, str | None] | None:
        while index < len(units):
            try:
                command, channel, path = self.table.find(units[index].header, path)
                outcome = command.call(self, units[index], channel)
            except (ScpiError, RadiometerError) as failure:
                if self._refuse(failure):
                    return self._reply()
                outcome = None
            if isinstance(outcome, Coroutine):
                return self._continue(outcome, units, index + 1, path, error)
            if outcome is not None:
                self.responses.append(outcome)
            index += 1
        if error is not None:
            self.status.push(error)
        return self._reply()

    async def _continue(
        self,
        waiting: Coroutine[Any, Any, str | None],
        units: tuple[Unit, ...],
        index: int,
        path: str,
        error: ScpiError | None,
    ) -> str | None:
        try:
            outcome = await waiting
        except (ScpiError, RadiometerError, TimeoutError) as failure:
            if self._refuse(failure):
                return self._reply()
            outcome = None
        if outcome is not None:
            self.responses.append(outcome)
        rest = self._execute_from(units, index, path, error)
        return await rest if isinstance(rest, Coroutine) else rest

    def _refuse(self, failure: Exception) -> bool:
        """Queue an error and tell whether the rest of the message is to be thrown away."""
        entry = failure if isinstance(failure, ScpiError) else scpi_error(failure)
        self.status.push(entry)
        return entry.is_command_error

    def _reply(self) -> str | None:
        return ";".join(self.responses) if self.responses else None

    def _finished(self, task: asyncio.Task[Reading]) -> None:
        if self.pending is task:
            self.pending = None
        if not task.cancelled() and task.exception() is None:
            self._own = task.result()
        self.update_status()

    def _tell_alarms(self) -> None:
        alarms = self.station.alarms.active
        known = {(alarm.name, alarm.since, alarm.announced) for alarm in self._known_alarms}
        for alarm in alarms:
            if (alarm.name, alarm.since, alarm.announced) not in known:
                number = -250 if alarm.name == "journal" else -200 if alarm.name == "measurement" else -240
                self.status.push(ScpiError(number, alarm.message))
        self._known_alarms = alarms


def when_done(awaitable: Awaitable[object], then: Callable[[], str | None]) -> Outcome:
    """Return a coroutine that waits and then gives a reply."""

    async def wait() -> str | None:
        await awaitable
        return then()

    return wait()
