"""One SCPI session: its status, settings of the shared instrument, and the execution of messages."""

from __future__ import annotations

import asyncio
import itertools
from collections import Counter
from collections.abc import Awaitable, Callable, Coroutine
from dataclasses import replace
from functools import lru_cache
from typing import Any, Final

import structlog

from radiometer.daemon.alarms import Alarm
from radiometer.daemon.instrument import Measurement, MeasurementSettings
from radiometer.daemon.keeper import DeviceState
from radiometer.daemon.light import Asker
from radiometer.daemon.limits import Limits
from radiometer.daemon.scpi import status as bits
from radiometer.daemon.scpi.language import CommandTable, Outcome, ScpiError, Unit, scpi_error, split_message
from radiometer.daemon.scpi.status import Status
from radiometer.daemon.station import Station
from radiometer.data import Flag, Patch, Reading
from radiometer.errors import RadiometerError

_log = structlog.get_logger(__name__)
MEASURING_DEADLINE_S: Final = 120.0  # twice the time limit of a bracket
_REPLY_BYTES: Final = Limits().reply_bytes
_DEFAULT_ELEMENTS: Final = ("READing", "UNCertainty")
_CALIBRATION_FLAGS: Final = {Flag.UNCALIBRATED, Flag.STALE_CALIBRATION}
_NUMBERS: Final = itertools.count(1)
_split_cached = lru_cache(maxsize=512)(split_message)


class Session:
    """One client.

    Args:
        reply_bytes: Bytes that the replies of one message may have together, without the largest of them.
    """

    def __init__(self, station: Station, table: CommandTable, reply_bytes: int = _REPLY_BYTES) -> None:
        self.station, self.table, self.reply_bytes = station, table, reply_bytes
        self.name = f"scpi-{next(_NUMBERS)}"
        self.status: Status = Status()
        self.function = "RADiance"
        self.elements: tuple[str, ...] = _DEFAULT_ELEMENTS
        self.big_endian: bool = True
        self.own_patch: tuple[Patch | None] | None = None  # (None,) is the middle; None the shared patch
        self.pending: asyncio.Task[Reading] | None = None
        self._own: Reading | None = None
        self._own_settings: MeasurementSettings | None = None
        self._held: Reading | None = None
        self.responses: list[str] = []
        self.asker = Asker(station.light.darkened_by_others())
        self._known_alarms: tuple[Alarm, ...] = ()
        self.update_status()
        self._report_alarms()

    def execute(
        self, message: str, darkened: Counter[str] | None = None
    ) -> str | Coroutine[Any, Any, str | None] | None:
        """Run a message and return its reply without terminator; None where there is none.

        Returns a coroutine of the same where a command in it has to wait.

        Args:
            darkened: How often others had asked for darkness when the message came; None where it has not waited.
        """
        self.asker.others = self.station.light.darkened_by_others(self.asker) if darkened is None else darkened
        units, error = _split_cached(message) if len(message) < 256 else split_message(message)
        self.responses, self._held = [], None
        return self._execute_from(units, 0, "", error)

    def close(self) -> None:
        """Forget what is pending."""
        self.abort()

    def update_status(self) -> None:
        """Bring the condition registers up to date and latch what rose."""
        station, reading = self.station, self.station.shown.latest
        operation = bits.CONTINUOUS * (station.acquisition.every_s is not None)
        operation |= bits.MEASURING * (self.pending is not None or station.acquisition.busy)
        self.status.operation.update(operation)
        flags = set(reading.flags) if reading else set()
        box_lost = station.light.keeper is not None and station.light.keeper.state is not DeviceState.READY
        questionable = bits.CALIBRATION * bool(flags & _CALIBRATION_FLAGS)
        questionable |= bits.CAMERA_LOST * (station.camera.state is not DeviceState.READY)
        questionable |= bits.BOX_LOST * box_lost
        questionable |= bits.READING_FLAGGED * bool(flags - _CALIBRATION_FLAGS)
        questionable |= bits.ALARM * bool(station.alarms.active)
        self.status.questionable.update(questionable)

    def state_changed(self) -> None:
        """Take note of alarms that went up: each is an entry of the error queue."""
        self.update_status()
        self._report_alarms()

    def start(self) -> asyncio.Task[Reading]:
        """Begin a measurement and return its task. Raises ScpiError -213 if one is pending."""
        if self.pending is not None and not self.pending.done():
            raise ScpiError(-213, "a measurement is pending; ABORt ends it")
        settings = self._settings()
        task = asyncio.create_task(self.station.acquisition.measure(settings, MEASURING_DEADLINE_S, self.name))
        task.add_done_callback(lambda done: self._finished(done, settings))
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
        self._held = task.result()
        return self._held

    def fetched(self) -> Reading:
        """Return the reading that FETCh? means; one message always sees one reading.

        A session with a separate patch sees its own readings only. Any other sees the newest of the patch that is
        measured for all: its own while nothing measures continuously. Raises ScpiError if there is none yet.
        """
        if self._held is None:
            own = self._own_if_current()
            everybodys = self.own_patch is None and (self.station.acquisition.every_s is not None or own is None)
            self._held = self.station.shown.latest if everybodys else own
        if self._held is None:
            raise ScpiError(-230, "there is no reading yet of this session's patch; READ? makes one")
        return self._held

    def reset(self) -> None:
        """Put the session and the instrument's settings back to those at start (*RST)."""
        self.abort()
        self.forget()
        self.function, self.elements, self.big_endian, self.own_patch = "RADiance", _DEFAULT_ELEMENTS, True, None
        self.station.reset()

    def choose(self, function: str, own_patch: tuple[Patch | None] | None) -> None:
        """Choose quantity and patch; a reading of another patch is not this one's."""
        self.abort()
        if own_patch != self.own_patch:
            self.forget()
        self.function, self.own_patch = function, own_patch

    def forget(self) -> None:
        """Forget the readings of this session."""
        self._own = self._own_settings = self._held = None

    def measurement(self) -> Measurement | None:
        """Return the frames behind the reading that this session would fetch; None where they are no longer held."""
        own = self._held or (self._own_if_current() if self.own_patch is not None else None)
        return self.station.shown.measurement_of(own)

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
            if outcome is not None and not self._respond(outcome):
                return self._reply()
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
        if outcome is not None and not self._respond(outcome):
            return self._reply()
        rest = self._execute_from(units, index, path, error)
        return await rest if isinstance(rest, Coroutine) else rest

    def _respond(self, response: str) -> bool:
        """Keep the response of a query and return whether the message may go on: all but the largest are bounded."""
        sizes = [*map(len, self.responses), len(response)]
        if sum(sizes) - max(sizes) > self.reply_bytes:
            text = f"a message's replies may have {self.reply_bytes} bytes without the largest; ask one by one"
            self.status.push(ScpiError(-225, text))
            return False
        self.responses.append(response)
        return True

    def _refuse(self, failure: Exception) -> bool:
        """Queue an error and return whether the rest of the message is to be thrown away."""
        entry = failure if isinstance(failure, ScpiError) else scpi_error(failure)
        self.status.push(entry)
        return entry.is_command_error

    def _reply(self) -> str | None:
        return ";".join(self.responses) if self.responses else None

    def _settings(self) -> MeasurementSettings:
        settings = self.station.settings
        return settings if self.own_patch is None else replace(settings, patch=self.own_patch[0])

    def _own_if_current(self) -> Reading | None:
        """Return this session's own reading; None where its patch or wavelength is no longer the one chosen."""
        if self._own is None or self._own_settings is None or self._own_settings.subject != self._settings().subject:
            return None
        return self._own

    def _finished(self, task: asyncio.Task[Reading], settings: MeasurementSettings) -> None:
        if self.pending is task:
            self.pending = None
        if not task.cancelled() and task.exception() is None:
            self._own, self._own_settings = task.result(), settings
        self.update_status()

    def _report_alarms(self) -> None:
        alarms = self.station.alarms.active
        known = {(alarm.name, alarm.since, alarm.announced) for alarm in self._known_alarms}
        for alarm in alarms:
            if (alarm.name, alarm.since, alarm.announced) not in known:
                number = (
                    -250
                    if alarm.name == "journal"
                    else -200
                    if alarm.name.split()[0] in ("measurement", "limit", "period", "reading")
                    else -240
                )
                self.status.push(ScpiError(number, alarm.message))
        self._known_alarms = alarms


def when_done(awaitable: Awaitable[object], then: Callable[[], str | None]) -> Outcome:
    """Return a coroutine that waits and then gives a reply."""

    async def wait() -> str | None:
        await awaitable
        return then()

    return wait()
