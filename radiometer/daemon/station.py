"""The core: one camera, perhaps a light box, a journal; every interface talks to it."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal

import structlog

import radiometer
from radiometer.daemon.acquisition import Acquisition
from radiometer.daemon.alarms import Alarms, Lateness
from radiometer.daemon.instrument import LightSource, Measurement, MeasurementSettings, Origin, ServedInstrument
from radiometer.daemon.journal import Journal
from radiometer.daemon.journal_writer import JournalWriter
from radiometer.daemon.keeper import DeviceKeeper, DeviceState, KeeperTimes
from radiometer.daemon.light import Light
from radiometer.daemon.metrics import Metrics
from radiometer.daemon.patch_book import PatchBook
from radiometer.daemon.patches import MAIN
from radiometer.daemon.timestamps import ClockWatch, Jump, iso_time
from radiometer.data import Reading
from radiometer.data.capture_header import other_notation
from radiometer.data.json_text import json_text
from radiometer.data.provenance import utc_now
from radiometer.devices import CameraIdentity
from radiometer.errors import RadiometerError, UsageError


@dataclass(frozen=True, slots=True)
class Event:
    """Something that is reported to listeners."""

    kind: Literal["reading", "patch", "status"]  # "reading", "patch" (a reading of a patch with a name) or "status"
    line: str  # one line of JSON
    sequence: int | None = None  # sequence number of the reading; None where it is none


class Subscription:
    """One listener's queue."""

    def __init__(self, capacity: int, since_s: float) -> None:
        self._queue: asyncio.Queue[Event | None] = asyncio.Queue(capacity)
        self.closed, self.since_s = False, since_s

    @property
    def waiting(self) -> int:
        """Return how many events the listener has not taken."""
        return self._queue.qsize()

    def offer(self, event: Event) -> None:
        """Queue an event; a full queue ends the subscription, for a gap must not pass unnoticed."""
        if self.closed:
            return
        try:
            self._queue.put_nowait(event)
        except asyncio.QueueFull:
            self.end()

    def end(self) -> None:
        """End the subscription: what was queued is thrown away and `next` returns None."""
        self.closed = True
        while not self._queue.empty():
            self._queue.get_nowait()
        self._queue.put_nowait(None)

    async def next(self) -> Event | None:
        """Return the next event; None once the subscription has ended."""
        return await self._queue.get()


class Hub:
    """The listeners.

    Args:
        clock: Steady time in s.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._subscriptions: set[Subscription] = set()

    def __len__(self) -> int:
        return len(self._subscriptions)

    def subscribe(self, capacity: int = 256) -> Subscription:
        """Return a new subscription that holds at most `capacity` events not yet taken."""
        subscription = Subscription(capacity, self._clock())
        self._subscriptions.add(subscription)
        return subscription

    def unsubscribe(self, subscription: Subscription) -> None:
        """Forget a subscription."""
        self._subscriptions.discard(subscription)

    def end_one(self, youngest_s: float) -> bool:
        """End the subscription that is furthest behind, else the oldest, and return whether there was one.

        Args:
            youngest_s: One that is not as old as this in s stays.
        """
        old = [one for one in self._subscriptions if self._clock() - one.since_s >= youngest_s]
        if not old:
            return False
        chosen = max(old, key=lambda one: (one.waiting, -one.since_s))
        chosen.end()
        self._subscriptions.discard(chosen)
        return True

    def publish(self, event: Event) -> None:
        """Queue an event with every listener."""
        for subscription in tuple(self._subscriptions):
            subscription.offer(event)
            if subscription.closed:
                self._subscriptions.discard(subscription)

    def close(self) -> None:
        """End every subscription."""
        for subscription in tuple(self._subscriptions):
            subscription.end()
        self._subscriptions.clear()


class Shown:
    """The latest reading that belongs to all, and the frames that are still held.

    Attributes:
        latest: That reading; None where there is none of what is measured now.
        line: It as a line of JSON; "" for none.
        measurement: The frames behind it; None where they are not held.
        pictured: The frames of the latest picture with their reading: it outlives a moved patch.
    """

    def __init__(self) -> None:
        self.latest: Reading | None = None
        self.line = ""
        self.measurement: Measurement | None = None
        self.pictured: tuple[Measurement, Reading] | None = None
        self._uncommitted: Measurement | None = None
        self._own: Measurement | None = None

    def hold(self, measurement: Measurement, origin: Origin) -> None:
        """Hold the frames of a measurement whose reading is not yet in the journal."""
        if origin.sessions:
            self._own = measurement
        elif not origin.name:
            self._uncommitted = measurement

    def show(self, reading: Reading, line: str) -> None:
        """Show a committed reading."""
        self.latest, self.line = reading, line
        if self._uncommitted is not None and _is_of(self._uncommitted, reading):
            self.measurement, self.pictured = self._uncommitted, (self._uncommitted, reading)

    def forget(self) -> None:
        """Show no reading until the next: what is measured has changed."""
        self.latest, self.line, self.measurement = None, "", None

    def measurement_of(self, reading: Reading | None) -> Measurement | None:
        """Return the frames of a reading as far as they are still held; those of the latest where None."""
        if reading is None:
            return self.measurement
        held = (self.measurement, self._own)
        return next((one for one in held if one is not None and _is_of(one, reading)), None)


def _is_of(measurement: Measurement, reading: Reading) -> bool:
    made = measurement.reading
    return (made.time, made.patch, made.radiance) == (reading.time, reading.patch, reading.radiance)


def identity_mapping(identity: CameraIdentity) -> dict[str, str]:
    """Return who the camera is; `serial_also` is a hexadecimal number in decimal, as people and labels write it."""
    return {
        "vendor": identity.vendor,
        "model": identity.model,
        "serial": identity.serial,
        "serial_also": other_notation(identity.serial),
    }


def settings_mapping(settings: MeasurementSettings) -> dict[str, Any]:
    """Return what is measured with; the patch is null for the middle of the picture."""
    return {
        "patch": asdict(settings.patch) if settings.patch else None,
        "auto_exposure": settings.auto_exposure,
        "exposure_s": settings.exposure_s,
        "gain_db": settings.gain_db,
        "wavelength_nm": settings.wavelength_nm,
    }


def device_mapping(keeper: DeviceKeeper) -> dict[str, Any]:
    """Return how a device is doing."""
    return {
        "state": str(keeper.state),
        "losses": keeper.losses,
        "temperature_C": keeper.report.temperature_c,
        "counters": dict(keeper.report.counters),
    }


def jump_mapping(jump: Jump) -> dict[str, Any]:
    """Return by how many s the clock was set, and when it was, by the new time."""
    return {"by_s": jump.by_us / 1e6, "time": iso_time(jump.after_us), "message": str(jump)}


_log = structlog.get_logger(__name__)
_LOOK_S = 0.5  # between two looks for what is late: a twentieth of the shortest time that is
_LONGEST_REMARK = 500  # a paragraph; it is one line of the log


class Station:
    """Puts the parts together; safe to use from the event loop only.

    Args:
        journal: Where readings are kept.
        box: The light box; None where there is none.
        keep_days: Age at which readings leave the journal; None keeps all.
        settings: What is measured with at first and after a reset.
        times: Pauses and deadlines of looking after the devices.
    """

    def __init__(
        self,
        instrument: ServedInstrument,
        journal: Journal,
        *,
        box: LightSource | None = None,
        keep_days: float | None = None,
        settings: MeasurementSettings | None = None,
        times: KeeperTimes | None = None,
    ) -> None:
        self.instrument, self.journal_path = instrument, journal.path
        self.hub, self.metrics, self.shown = Hub(), Metrics(), Shown()
        self.alarms = Alarms(self._alarm_changed)
        self.clock = ClockWatch(self._clock_jumped)
        self.writer = JournalWriter(
            journal, self.alarms, self._publish, keep_days=keep_days, look_at_clock=self.clock.look
        )
        self.camera = DeviceKeeper("camera", instrument, self.alarms, times=times, proof="measure")
        self.light = Light(box, self.alarms, self.writer, times, self.publish_status)
        self.lateness = Lateness(self.alarms)
        self.acquisition = Acquisition(instrument, self.camera, self.writer, self.alarms, self.lateness, self._measured)
        self._initial_settings = settings or MeasurementSettings()
        self.acquisition.settings = self._initial_settings
        self.patches = PatchBook(
            self.acquisition, self.lateness, self.writer, self.alarms, self.metrics, self._patches_changed
        )
        self.latest_jump: Jump | None = None
        self.started = time.monotonic()
        self.on_change: list[Callable[[], None]] = []
        self._tasks: list[asyncio.Task[None]] = []

    @property
    def settings(self) -> MeasurementSettings:
        """Return what is measured with."""
        return self.acquisition.settings

    async def start(self) -> None:
        """Open journal and devices and begin to measure. A device that is not there is waited for.

        Raises:
            OutputError: If the journal is damaged, foreign, or written by another daemon.
        """
        await self.writer.open()
        self.patches.restore(await self.writer.patches())
        for keeper in self._keepers():
            await keeper.open_once()
        loops = [self.writer.run(), self.acquisition.run(), self.clock.run(), self._look_often()]
        loops += [keeper.run() for keeper in self._keepers()]
        self._tasks = [asyncio.create_task(loop) for loop in loops]

    async def stop(self, reason: str = "") -> None:
        """End measuring, switch the light off, commit what waits, close everything.

        Args:
            reason: Why, for the event "stop"; "" for no event.
        """
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        self.hub.close()
        for keeper in self._keepers():
            await keeper.close()
        if reason:
            self.writer.note("stop", reason)
        await self.writer.close()

    def failed_task(self) -> BaseException | None:
        """Return the error of a loop that ended though none ever should; None while all run."""
        for task in self._tasks:
            if task.done() and not task.cancelled():
                return task.exception() or RuntimeError("a loop of the daemon ended")
        return None

    def configure(self, **changes: Any) -> MeasurementSettings:
        """Change what is measured with and return it.

        Args:
            **changes: Fields of `MeasurementSettings`.

        Raises:
            SettingOutOfRange: If a value is outside the camera's limits; nothing was changed.
            DeviceError: If the limits are not known yet because the camera was never open.
        """
        settings = replace(self.settings, **changes)
        self.acquisition.check_settings(settings)
        self._take_settings(settings)
        self.publish_status()
        return settings

    def reset(self) -> None:
        """Return to the settings the daemon was started with; readings and journal stay."""
        self._take_settings(self._initial_settings)
        self.publish_status()

    def set_every(self, every_s: float | None) -> None:
        """Set the period of continuous measurement in s; None stops it. Raises SettingOutOfRange."""
        before = self.acquisition.every_s
        self.acquisition.set_every(every_s)
        if before is not None and before != every_s:
            now = "stopped" if every_s is None else f"set to a period of {every_s:g} s"
            self.writer.note("period", f"continuous measurement, every {before:g} s before, was {now}")
        self._patches_changed()

    def _patches_changed(self) -> None:
        """Alarm where patches have limits that no measurement watches."""
        if unwatched := self.patches.unwatched:
            every_s = self.acquisition.every_s
            now = "does not take place" if every_s is None else f"takes place every {every_s:g} s only"
            self.alarms.put_up(
                "stopped", f"continuous measurement {now}: limits of {', '.join(unwatched)} are not watched"
            )
        else:
            self.alarms.clear("stopped")
        self.publish_status()

    def annotate(self, message: str) -> None:
        """Keep a remark of a person in the journal. Raises UsageError for an empty or endless one."""
        text = " ".join(message.split())
        if not 0 < len(text) <= _LONGEST_REMARK:
            raise UsageError(f"a remark has 1 to {_LONGEST_REMARK} characters, not {len(text)}")
        self.writer.note("remark", text)
        self.publish_status()

    async def reload_calibration(self) -> str:
        """Read the calibration again; a bad file puts up an alarm and the old one stays in use."""
        try:
            line = await self.camera.use(self.instrument.reload_calibration)
        except RadiometerError as error:
            self.alarms.put_up("calibration", f"calibration not reloaded, the old one stays: {error}")
            raise
        self.alarms.clear("calibration", "calibration reloaded")
        self.writer.note("calibration", line)
        _log.info("calibration reloaded", calibration=line)
        return line

    def status(self) -> dict[str, Any]:
        """Return the state of everything, as JSON on every interface."""
        latest = self.shown.latest
        return {
            "time": utc_now(),
            "instrument": identity_mapping(self.instrument.identity),
            "software": f"radiometer {radiometer.__version__}",
            "devices": {keeper.name: device_mapping(keeper) for keeper in self._keepers()},
            "alarms": [alarm.to_mapping() for alarm in self.alarms.active],
            "every_s": self.acquisition.every_s,
            "settings": settings_mapping(self.settings),
            **self.light.to_mapping(),
            "calibration": dict(self.instrument.calibration_summary),
            "latest_sequence": latest.sequence if latest else None,
            "queue": {"measurements": self.acquisition.queue_depth, "journal": self.writer.depth},
            "patches": self.patches.to_mapping(),
            "clock_jump": jump_mapping(self.latest_jump) if self.latest_jump else None,
            "uptime_s": round(time.monotonic() - self.started, 1),
        }

    def troubles(self) -> list[str]:
        """Return the names of what is wrong at this moment: alarms, and devices that are not ready."""
        self._look()
        names = [alarm.name for alarm in self.alarms.active]
        silent = [k.name for k in self._keepers() if k.state is not DeviceState.READY and k.name not in names]
        return names + silent

    def refresh_metrics(self) -> None:
        """Bring the gauges up to date."""
        metrics = self.metrics
        metrics.take_devices(self._keepers())
        metrics.take_device_counts(self.camera.report.counters)
        metrics.take_failures(self.acquisition.failures)
        metrics.queue_depth.labels("measurements").set(self.acquisition.queue_depth)
        metrics.queue_depth.labels("journal").set(self.writer.depth)
        metrics.alarms.set(len(self.alarms.active))

    def publish_status(self) -> None:
        """Hand the state, after a change of it, to whoever listens."""
        for callback in self.on_change:
            callback()
        self.hub.publish(Event("status", json_text(self.status())))

    def _keepers(self) -> list[DeviceKeeper]:
        return [self.camera, *([self.light.keeper] if self.light.keeper else [])]

    def _look(self) -> None:
        """Report measurements that are late and readings that stay away; nothing is late that waits for the journal."""
        able = self.camera.state in (DeviceState.READY, DeviceState.OVERDUE)
        self.lateness.look(able=able, paused=not self.writer.has_room)

    async def _look_often(self) -> None:
        while True:
            self._look()
            await asyncio.sleep(_LOOK_S)

    def _take_settings(self, settings: MeasurementSettings) -> None:
        """Take settings over; where they change what is measured, the latest reading is of something else now."""
        if settings.subject != self.settings.subject:
            self.shown.forget()
            self.metrics.drop_reading()
            self.patches.forget_main()
        self.acquisition.settings = settings

    def _measured(self, measurement: Measurement, origin: Origin, seconds: float) -> None:
        self.metrics.measuring_s.observe(seconds)
        self.shown.hold(measurement, origin)
        self.camera.report = measurement.report or self.camera.report

    def _publish(self, reading: Reading, origin: Origin | None, commit_s: float) -> None:
        """Make a committed reading visible to all; nothing else ever does, and a client's own never is."""
        self.metrics.readings.inc()
        self.metrics.committing_s.observe(commit_s)
        if origin is not None and origin.sessions:
            return
        if reading.name:
            self._show_named(reading)
        else:
            self._show(reading, current=origin is None or origin.settings.subject == self.settings.subject)

    def _show(self, reading: Reading, *, current: bool) -> None:
        line = reading.to_json()
        self.hub.publish(Event("reading", line, reading.sequence))
        if not current:  # the patch was moved meanwhile: no latest reading of what is measured now
            return
        self.shown.show(reading, line)
        self.metrics.take_reading(reading)
        self.patches.take(MAIN, reading)

    def _show_named(self, reading: Reading) -> None:
        """Make a reading of a patch with a name visible under that name; one of a place it has left is let pass."""
        if self.acquisition.named.get(reading.name) != reading.patch:
            return
        self.hub.publish(Event("patch", reading.to_json(), reading.sequence))
        self.metrics.take_patch_reading(reading)
        self.patches.take(reading.name, reading)

    def _alarm_changed(self, kind: str, name: str, message: str) -> None:
        self.writer.note(kind, f"{name}: {message}")
        self.publish_status()

    def _clock_jumped(self, jump: Jump) -> None:
        """Note in journal and state that times are not comparable across this moment."""
        _log.warning("the clock was set", by_s=jump.by_us / 1e6)
        self.latest_jump = jump
        self.writer.note_jump(jump)
        self.publish_status()
