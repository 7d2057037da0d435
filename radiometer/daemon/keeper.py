"""Keeps a device open: notices its loss, says so, reopens it with back-off."""

from __future__ import annotations

import asyncio
import time
import traceback
from collections.abc import Awaitable, Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from enum import StrEnum
from typing import Final, TypeVar

import structlog

from radiometer.daemon.alarms import Alarms
from radiometer.daemon.instrument import DeviceReport, KeptDevice
from radiometer.errors import (
    DeviceError,
    DeviceInUse,
    DeviceLost,
    DeviceNotFound,
    DeviceTimeout,
    LightEnded,
    MissingLibrary,
    RadiometerError,
    SettingOutOfRange,
    UnsafeStimulus,
)

_log = structlog.get_logger(__name__)
_T = TypeVar("_T")
_LOOK_S = 0.02  # a late device is reported within a fifth of a second
_FIRST_CALL_S = 2.0  # a call never made before may take so long, for nothing is known of it
_REFUSALS = (SettingOutOfRange, UnsafeStimulus, LightEnded)  # nothing is wrong with the device
_LOSS = (DeviceLost, DeviceTimeout, DeviceNotFound, DeviceInUse, MissingLibrary)


class DeviceState(StrEnum):
    """How a device stands."""

    READY = "ready"
    OVERDUE = "overdue"  # a call takes longer than it should: the device may be gone
    FAILING = "failing"  # open, but what failed last has not worked since
    LOST = "lost"
    CLOSED = "closed"


@dataclass(frozen=True, slots=True)
class KeeperTimes:
    """Times in s of a keeper."""

    first_pause_s: float = 0.2  # pause before the first try to reopen
    longest_pause_s: float = 0.5  # longest pause between two tries; pauses double up to it
    check_every_s: float = 0.5  # an idle device is asked this often whether it is still there
    overdue_s: float = 1.0  # a call that takes this much longer than the last good one is reported


_MARGIN: Final = 1.5  # the next late answer may be later by half
_LONGEST_S: Final = 3.0  # a device that is gone is reported this much later at most
_HALVED_AFTER_S: Final = 60.0  # a machine that was busy is calm again after minutes
ON_TIME: Final = 2  # so many answers in time, one after the other, end the alarm: one of them may be luck


class Patience:
    """Learns from answers that came late after all, and forgets: a busy machine must not make an alarm flap.

    Args:
        clock: Steady time in s.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock, self._learnt_s, self._learnt_at, self._on_time = clock, 0.0, clock(), 0

    @property
    def extra_s(self) -> float:
        """Return the time in s beyond the usual deadline that is still waited."""
        return float(self._learnt_s * 0.5 ** ((self._clock() - self._learnt_at) / _HALVED_AFTER_S))

    def was_late(self, by_s: float) -> None:
        """Note that an answer came, so many s after it was called late."""
        self._learnt_s = min(_LONGEST_S, max(self.extra_s, self.extra_s + _MARGIN * by_s))
        self._learnt_at, self._on_time = self._clock(), 0

    def was_on_time(self) -> bool:
        """Note that an answer came in time, and return whether enough did to believe that all is well."""
        self._on_time += 1
        return self._on_time >= ON_TIME


class DeviceKeeper:
    """Owns a device and the one thread that talks to it.

    Args:
        name: "camera" or "light box": the name of its alarm.
        device: The device, not yet open.
        alarms: Where its loss is reported.
        proof: The call that proves that the device does its work, such as "measure". Where it fails, an open port
            ends no alarm: only that call does, once it works.
        after_open: Called in the event loop after each opening.
        after_check: Called in the event loop with what an idle device reported.
        sleep: Waits for a number of seconds.
    """

    def __init__(
        self,
        name: str,
        device: KeptDevice,
        alarms: Alarms,
        *,
        times: KeeperTimes | None = None,
        proof: str = "",
        after_open: Callable[[], None] = lambda: None,
        after_check: Callable[[DeviceReport], None] = lambda report: None,
        sleep: Callable[[float], Awaitable[None]] = asyncio.sleep,
    ) -> None:
        self.name, self.state, self.report, self.losses = name, DeviceState.CLOSED, DeviceReport(), 0
        self._device, self._alarms, self._after_open, self._sleep = device, alarms, after_open, sleep
        self._after_check, self._proof, self._failure = after_check, proof, ""
        self._times = times or KeeperTimes()
        self._busy = asyncio.Lock()
        self._trouble = asyncio.Event()
        self._last_used = 0.0
        self._call_began: float | None = None
        self._usual_s: dict[str, float] = {}
        self._patience, self._called_late_at = Patience(), None  # type: Patience, float | None
        self._thread = ThreadPoolExecutor(1, thread_name_prefix=name)

    @property
    def is_ready(self) -> bool:
        """Return whether the device is open, so that it can be tried."""
        return self.state in (DeviceState.READY, DeviceState.OVERDUE, DeviceState.FAILING)

    @property
    def stuck_s(self) -> float:
        """Return for how many seconds the call in progress has run; 0 if there is none."""
        return 0.0 if self._call_began is None else time.monotonic() - self._call_began

    async def open_once(self) -> bool:
        """Try to open the device and return whether it worked; a failure puts the alarm up."""
        async with self._busy:
            try:
                await self._in_thread("open", self._device.open)
                self.report = await self._in_thread("check", self._device.check)
            except DeviceError as error:
                self._set_lost(error, "open")
                await self._in_thread("close", self._device.close)
                return False
            self.state = DeviceState.FAILING if self._failure else DeviceState.READY
            self._last_used = time.monotonic()
        self._after_open()
        if not self._failure:
            self._alarms.clear(self.name, f"{self.name} is back" if self.losses else f"{self.name} is open")
        return True

    async def use(self, call: Callable[..., _T], *arguments: object, usual_s: float | None = None) -> _T:
        """Run a blocking call on the device's thread and return its result.

        Args:
            *arguments: What it is called with.
            usual_s: How long it should take; None to go by the last call of that name.

        Raises:
            DeviceLost: If the device is not open, or was lost in the call.
            RadiometerError: What the call raises.
        """
        async with self._busy:
            if not self.is_ready:
                raise DeviceLost(self.loss_message())
            name = call.__name__
            try:
                result = await self._in_thread(name, call, *arguments, usual_s=usual_s)
                self._worked(name)
                return result
            except _LOSS as error:
                self._set_lost(error, name)
                raise
            except _REFUSALS:
                raise
            except DeviceError as error:
                self._set_failing(error, name)
                raise
            finally:
                self._last_used = time.monotonic()
                self._answered()

    def loss_message(self) -> str:
        """Return what is known about the loss."""
        alarm = next((a for a in self._alarms.active if a.name == self.name), None)
        return alarm.message if alarm else f"the {self.name} is not open"

    async def run(self) -> None:
        """Reopen the device whenever it is lost, and look after it while it is idle; for ever."""
        pause_s = self._times.first_pause_s
        while True:
            if self.is_ready:
                if self.state is DeviceState.READY:
                    pause_s = self._times.first_pause_s
                await self._look_after()
            elif not await self.open_once():
                await self._sleep(pause_s)
                pause_s = min(2 * pause_s, self._times.longest_pause_s)

    async def close(self) -> None:
        """Release the device and its thread."""
        async with self._busy:
            self.state = DeviceState.CLOSED
            try:
                async with asyncio.timeout(5.0):
                    await self._in_thread("close", self._device.close)
            except TimeoutError:
                _log.error("device does not let go", device=self.name)
        self._thread.shutdown(wait=False, cancel_futures=True)

    async def _look_after(self) -> None:
        """Wait for trouble or, while the device is unused, ask it whether it is there."""
        self._trouble.clear()
        try:
            async with asyncio.timeout(self._times.check_every_s):
                await self._trouble.wait()
            return
        except TimeoutError:
            pass
        if time.monotonic() - self._last_used < self._times.check_every_s or self._busy.locked():
            return
        try:
            self.report = await self.use(self._device.check)
            self._after_check(self.report)
        except DeviceError as error:
            _log.debug("check failed", device=self.name, error=str(error))

    def _set_lost(self, error: Exception, call: str) -> None:
        newly = self.state in (DeviceState.READY, DeviceState.OVERDUE, DeviceState.CLOSED)
        self.losses += newly
        self.state = DeviceState.LOST
        self._failure = str(error) if call == self._proof else self._failure
        self._alarms.put_up(self.name, f"{self.name} lost: {error}; trying to reopen it", worse=newly)
        self._trouble.set()

    def _set_failing(self, error: Exception, call: str) -> None:
        """Note that an open device does not do its work."""
        if call != self._proof:
            return
        newly = self.state in (DeviceState.READY, DeviceState.OVERDUE)
        self.state, self._failure = DeviceState.FAILING, str(error)
        message = f"{self.name} is open but fails to {call}: {error}; the alarm ends when it works"
        self._alarms.put_up(self.name, message, worse=newly)

    def _worked(self, call: str) -> None:
        """Note that a call returned: the proof ends what the proof began."""
        if call != self._proof or not self._failure:
            return
        self._failure = ""
        if self.state is DeviceState.FAILING:
            self.state = DeviceState.READY
            self._alarms.clear(self.name, f"{self.name} works again")

    async def _in_thread(
        self, name: str, call: Callable[..., _T], *arguments: object, usual_s: float | None = None
    ) -> _T:
        """Run a call on the device's thread; say so where it takes far longer than it should."""
        started = self._call_began = time.monotonic()
        future = asyncio.get_running_loop().run_in_executor(self._thread, _holding_nothing, call, *arguments)
        usual = self._usual_s.get(name, _FIRST_CALL_S) if usual_s is None else usual_s
        await self._warn_if_late(future, name, started, started + self._times.overdue_s + 1.5 * usual)
        try:
            result = await future
            self._call_began = None
        except RadiometerError:
            self._call_began = None
            raise
        except Exception as error:  # the daemon's edge: a driver's bug must not end the daemon
            self._call_began = None
            _log.exception("unexpected error in a device", device=self.name)
            raise DeviceLost(f"{type(error).__name__}: {error}") from error
        self._usual_s[name] = time.monotonic() - started
        return result

    async def _warn_if_late(self, future: asyncio.Future[_T], name: str, started: float, usual_end: float) -> None:
        """Return when the call is over; put the alarm up meanwhile if the device itself, else the clock, says late.

        Time in which this program itself did not get to run is nothing that the device is to blame for.
        """
        starved_s = 0.0
        while not future.done():
            late_at, looked_at = self._device.late_at, time.monotonic()
            due = (usual_end if late_at is None else late_at) + self._patience.extra_s + starved_s
            pause_s = max(_LOOK_S, min(due - looked_at, 10 * _LOOK_S))
            await asyncio.wait({future}, timeout=pause_s)
            now = time.monotonic()
            if self._device.late_at != late_at:
                starved_s = 0.0
                continue
            overslept_s = max(0.0, now - looked_at - pause_s)
            starved_s += overslept_s
            if not future.done() and now >= due + overslept_s and self.is_ready and self._called_late_at is None:
                self._called_late_at = now
                self._call_late(name, now - started)

    def _call_late(self, name: str, for_s: float) -> None:
        if self.state is DeviceState.READY:
            self.state = DeviceState.OVERDUE
            self._alarms.put_up(self.name, f"{self.name} has not answered {name!r} for {for_s:.1f} s")

    def _answered(self) -> None:
        """Take the alarm of a late answer down once answers come in time again."""
        late_at, self._called_late_at = self._called_late_at, None
        if late_at is not None:
            self._patience.was_late(time.monotonic() - late_at)
        elif self._patience.was_on_time() and self.state is DeviceState.OVERDUE:
            self.state = DeviceState.READY
            self._alarms.clear(self.name, f"{self.name} answers again")


def _holding_nothing(call: Callable[..., _T], *arguments: object) -> _T:
    """Return what a call returns; what it raises keeps none of its variables alive.

    The event loop holds an error until the next garbage collection, and with it all that the call had in hand. A
    camera that ends only then says goodbye to whatever answers at its address by that time, and waits for seconds.
    """
    try:
        return call(*arguments)
    except BaseException as error:
        link: BaseException | None = error
        while link is not None:
            traceback.clear_frames(link.__traceback__)
            link = link.__cause__ or link.__context__
        raise
