"""Measures continuously and on demand, one measurement at a time, each kind in its turn."""

from __future__ import annotations

import asyncio
import itertools
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, Final, Literal

import structlog

from radiometer.daemon.alarms import Alarms, Lateness
from radiometer.daemon.instrument import Measurement, MeasurementSettings, Origin, ServedInstrument
from radiometer.daemon.journal import JournalError
from radiometer.daemon.journal_writer import JournalWriter
from radiometer.daemon.keeper import DeviceKeeper
from radiometer.data import Patch, Reading
from radiometer.errors import DeviceError, RadiometerError, SettingOutOfRange, UsageError
from radiometer.numbers import unit_text

_log = structlog.get_logger(__name__)
ALARM: Final = "measurement"
WAVELENGTH_LIMITS_NM: Final = (300.0, 1200.0)  # what silicon sees
EVERY_LIMITS_S: Final = (0.0, 86400.0)  # as fast as it goes, to once a day
_PAUSE_AFTER_ERROR_S: Final = 0.5  # a fault that stays is tried twice a second, not in a tight loop
_JOURNAL_PATIENCE_S: Final = 5.0  # a client is not kept waiting for a journal that is known to be blocked
_Turn = Literal["shared", "asked", "named"]


@dataclass(frozen=True, slots=True)
class _Request:
    settings: MeasurementSettings
    done: asyncio.Future[Reading]
    sessions: list[str] = field(default_factory=list)


class Acquisition:
    """Runs the measurements.

    There are three kinds: of the patch for all ("shared"), of the patches with names ("named"), and what clients ask
    for ("asked"). Of the kinds that wait, the one goes next that was served longest ago: none waits for more than two
    measurements of the others. Requests that wait for the same settings share one measurement. One made with the
    settings in force belongs to all; any other is the own one of the sessions that asked for it, and its reading
    carries their names.

    Args:
        keeper: Keeps that camera open.
        alarms: Where failures of continuous measurement are reported.
        on_measured: Called with every measurement, what it was made for and its duration in s, before it is committed.

    Attributes:
        journal_patience_s: Longest time in s that a client waits for a journal that is known to be blocked.
    """

    def __init__(
        self,
        instrument: ServedInstrument,
        keeper: DeviceKeeper,
        writer: JournalWriter,
        alarms: Alarms,
        lateness: Lateness,
        on_measured: Callable[[Measurement, Origin, float], None],
    ) -> None:
        self._instrument, self._keeper, self._writer, self._alarms = instrument, keeper, writer, alarms
        self._lateness, self._on_measured = lateness, on_measured
        self._served = dict[_Turn, int](shared=0, asked=0, named=0)
        self._turns = itertools.count(1)
        self._requests: dict[MeasurementSettings, _Request] = {}
        self._wake = asyncio.Event()
        self._due_at = 0.0
        self._every_s: float | None = None
        self._round: deque[str] = deque()  # patches with a name whose turn is still to come in this period
        self.named: dict[str, Patch] = {}
        self.settings = MeasurementSettings()
        self.journal_patience_s = _JOURNAL_PATIENCE_S
        self.failures = 0
        self.busy = False

    @property
    def queue_depth(self) -> int:
        """Return how many different measurements are asked for and not yet begun."""
        return len(self._requests)

    @property
    def every_s(self) -> float | None:
        """Return the period of continuous measurement in s; 0 for as fast as possible, None for on demand only."""
        return self._every_s

    def set_every(self, every_s: float | None) -> None:
        """Set the period of continuous measurement in s; None stops it. Raises SettingOutOfRange."""
        if every_s is not None:
            self._refuse_outside("period", every_s, *EVERY_LIMITS_S, "s")
        self._every_s = every_s
        self._lateness.follow(every_s)
        self._due_at = time.monotonic()
        if every_s is None:
            self._round.clear()
            self._alarms.clear(ALARM, "continuous measurement was ended")
        self._wake.set()

    def hasten(self, name: str) -> None:
        """Measure a patch next, "main" the one for all, where any is measured continuously."""
        if self._every_s is None:
            return
        if name in self.named:
            self._round.append(name)
        else:
            self._due_at = time.monotonic()
        self._wake.set()

    def check_settings(self, settings: MeasurementSettings) -> None:
        """Refuse settings outside the limits. Raises SettingOutOfRange, UsageError (the patch) or DeviceError."""
        limits = self._instrument.limits
        if not settings.auto_exposure:
            self._refuse_outside("exposure time", settings.exposure_s, *limits.exposure_s, "s")
        self._refuse_outside("gain", settings.gain_db, *limits.gain_db, "dB")
        if settings.wavelength_nm is not None:
            self._refuse_outside("wavelength", settings.wavelength_nm, *WAVELENGTH_LIMITS_NM, "nm")
        if settings.patch is not None and not settings.patch.fits((limits.height, limits.width)):
            raise UsageError(
                f"patch {settings.patch} is not inside the picture of {limits.width} × {limits.height} pixels"
            )

    async def measure(
        self, settings: MeasurementSettings | None = None, deadline_s: float = 120.0, session: str = ""
    ) -> Reading:
        """Return a reading that was begun after this call, committed to the journal.

        One made with other settings than those in force is the session's own: no other client comes to see it.

        Args:
            settings: What to measure with; the settings in force where None.
            deadline_s: Longest wait in s.
            session: Who asks.

        Raises:
            JournalError: If it was measured but cannot be committed now; it waits, and clients see it later.
            DeviceError: If the camera is not there.
            RadiometerError: If the measurement fails.
            TimeoutError: If the deadline passes first.
        """
        blocked = self._writer.trouble
        wait_s = min(deadline_s, self.journal_patience_s) if blocked else deadline_s
        try:
            return await self._ask(settings or self.settings, wait_s, session)
        except TimeoutError as error:
            if trouble := self._writer.trouble or blocked:
                raise JournalError(trouble) from error
            raise

    async def _ask(self, settings: MeasurementSettings, deadline_s: float, session: str) -> Reading:
        if not self._keeper.is_ready:
            raise DeviceError(self._keeper.loss_message())
        request = self._requests.get(settings)
        if request is None:
            future: asyncio.Future[Reading] = asyncio.get_running_loop().create_future()
            future.add_done_callback(_retrieve)
            request = self._requests[settings] = _Request(settings, future)
            self._wake.set()
        if session not in request.sessions:
            request.sessions.append(session)
        return await asyncio.wait_for(asyncio.shield(request.done), deadline_s)

    async def run(self) -> None:
        """Measure what is asked for and what is due, for ever."""
        while True:
            await self._writer.wait_for_room()
            await self._wait_until_needed()
            turn = min(self._waiting(), key=self._served.__getitem__, default=None)
            if turn is None:
                continue
            self._served[turn] = next(self._turns)
            self._lateness.begun(turn)
            if turn == "asked":
                await self._serve(self._requests.pop(next(iter(self._requests))))
            elif turn == "named":
                await self._measure_named(self._round.popleft())
            else:
                self._round.extend(name for name in self.named if name not in self._round)
                await self._measure_continuously()

    def _waiting(self) -> tuple[_Turn, ...]:
        """Return the kinds of measurement that wait for their turn."""
        kinds: dict[_Turn, Any] = {"shared": self._is_due(), "asked": self._requests, "named": self._round}
        return tuple(kind for kind, waits in kinds.items() if waits)

    async def _serve(self, request: _Request) -> None:
        try:
            _, committed = await self._measure(self._origin(request))
        except RadiometerError as error:
            request.done.set_exception(error)
            return
        committed.add_done_callback(lambda future: _pass_on(future, request.done))

    async def _measure_continuously(self) -> None:
        every_s = self._every_s or 0.0  # clients may change or end it while this measurement runs
        self._due_at = max(self._due_at + every_s, time.monotonic())
        started = time.monotonic()
        try:
            reading, _ = await self._measure(Origin(self.settings))
            self._lateness.took(time.monotonic() - started)
            if self._every_s is not None:
                self._judge(ALARM, "the shared patch", reading)
        except DeviceError:
            self._due_at = time.monotonic() + _PAUSE_AFTER_ERROR_S  # the keeper has its alarm up already
        except RadiometerError as error:
            if self._every_s is None:  # ended meanwhile: no client waits for a next turn that might clear an alarm
                return
            self._alarms.put_up(ALARM, f"measuring failed: {error}")
            self._due_at = time.monotonic() + max(every_s, _PAUSE_AFTER_ERROR_S)

    async def _measure_named(self, name: str) -> None:
        """Measure a patch with a name, with the other settings in force."""
        if (patch := self.named.get(name)) is None:
            return  # deleted meanwhile
        alarm = f"{ALARM} {name}"
        try:
            reading, _ = await self._measure(Origin(replace(self.settings, patch=patch), name=name))
            if name in self.named:
                self._judge(alarm, f"patch {name}", reading)
        except DeviceError:
            self._round.clear()
            self._due_at = min(self._due_at, time.monotonic() + _PAUSE_AFTER_ERROR_S)  # all are tried again
        except RadiometerError as error:
            self._alarms.put_up(alarm, f"measuring patch {name} failed: {error}")

    def _origin(self, request: _Request) -> Origin:
        """Return whose a measurement is: everybody's where it is made with the settings in force."""
        if request.settings == self.settings:
            return Origin(request.settings)
        return Origin(request.settings, tuple(filter(None, request.sessions)) or ("unnamed",))

    def _judge(self, alarm: str, patch: str, reading: Reading) -> None:
        """Alarm where a reading is a lower bound only: every frame clipped, so that nothing was measured."""
        if (limit := reading.lower_limit) is not None:
            self._alarms.put_up(
                alarm,
                f"{patch} cannot be measured: its pixels are saturated even in the shortest exposure"
                f" (above {limit.value:.3g} {unit_text(limit.unit)}); shorten the exposure, close the lens, or dim the"
                " light",
            )
        else:
            self._alarms.clear(alarm)

    async def _measure(self, origin: Origin) -> tuple[Reading, asyncio.Future[Reading]]:
        started = time.perf_counter()
        self.busy = True
        try:
            measurement = await self._keeper.use(self._instrument.measure, origin.settings)
        except RadiometerError:
            self.failures += 1
            raise
        finally:
            self.busy = False
        self._on_measured(measurement, origin, time.perf_counter() - started)
        reading = replace(measurement.reading, name=origin.name, session=",".join(origin.sessions))
        return reading, self._writer.submit(reading, origin)

    def _refuse_outside(self, name: str, value: float, low: float, high: float, unit: str) -> None:
        if not low * (1 - 1e-9) <= value <= high * (1 + 1e-9):
            raise SettingOutOfRange(self._instrument.identity.model, name, value, low, high, unit)

    def _is_due(self) -> bool:
        return self._every_s is not None and self._keeper.is_ready and time.monotonic() >= self._due_at

    async def _wait_until_needed(self) -> None:
        while not self._waiting():
            self._wake.clear()
            try:
                async with asyncio.timeout(self._pause_s()):
                    await self._wake.wait()
            except TimeoutError:
                continue

    def _pause_s(self) -> float | None:
        if self._every_s is None:
            return None
        if not self._keeper.is_ready:
            return 0.1
        return max(0.0, self._due_at - time.monotonic())


def _retrieve(future: asyncio.Future[Reading]) -> None:
    """Look at the error so that asyncio does not complain where every client has gone."""
    if not future.cancelled():
        future.exception()


def _pass_on(committed: asyncio.Future[Reading], done: asyncio.Future[Reading]) -> None:
    if done.done():
        return
    if committed.cancelled():
        done.cancel()
    else:
        done.set_result(committed.result())
