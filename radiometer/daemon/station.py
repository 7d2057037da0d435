"""The core: one camera, perhaps a light box, a journal; what every interface talks to."""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import structlog

import radiometer
from radiometer.daemon.acquisition import Acquisition
from radiometer.daemon.alarms import Alarms
from radiometer.daemon.clock_watch import ClockWatch, Jump
from radiometer.daemon.hub import Event, Hub
from radiometer.daemon.instrument import (
    DeviceReport,
    LightSource,
    Measurement,
    MeasurementSettings,
    Origin,
    ServedInstrument,
)
from radiometer.daemon.journal import Journal, JournalError
from radiometer.daemon.journal_writer import JournalWriter
from radiometer.daemon.keeper import DeviceKeeper, DeviceState, KeeperTimes
from radiometer.daemon.metrics import Metrics
from radiometer.daemon.patches import MAIN, MOST_PATCHES, NamedPatch, PatchLimits, PatchWatch, check_name
from radiometer.daemon.state import device_mapping, identity_mapping, jump_mapping, patch_mapping, settings_mapping
from radiometer.data import Patch, Reading
from radiometer.data.provenance import utc_now
from radiometer.errors import DeviceError, DeviceLost, RadiometerError, SettingOutOfRange, UsageError

_log = structlog.get_logger(__name__)
WAVELENGTH_LIMITS_NM = (300.0, 1200.0)
EVERY_LIMITS_S = (0.0, 86400.0)
_LONGEST_REMARK = 500
_LEVEL_TOLERANCE = 1e-6  # levels are 16-bit numbers, read back as such
_JOURNAL_PATIENCE_S = 5.0  # a client is not kept waiting for a journal that is known to be blocked


class Station:
    """Owns the devices and the journal; safe to use from the event loop only.

    Args:
        instrument: The camera with its calibration.
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
        self.instrument, self.box, self.journal_path = instrument, box, journal.path
        self.hub, self.metrics = Hub(), Metrics()
        self.alarms = Alarms(self._alarm_changed)
        self.writer = JournalWriter(journal, self.alarms, self._publish, keep_days=keep_days)
        self.camera = DeviceKeeper("camera", instrument, self.alarms, times=times)
        self.box_keeper = (
            DeviceKeeper(
                "light box", box, self.alarms, times=times, after_open=self._box_opened, after_check=self._box_reported
            )
            if box
            else None
        )
        self.acquisition = Acquisition(instrument, self.camera, self.writer, self.alarms, self._measured)
        self._initial_settings = settings or MeasurementSettings()
        self.acquisition.settings = self._initial_settings
        self.latest: Reading | None = None
        self.latest_line = ""
        self.latest_measurement: Measurement | None = None
        self.pictured: tuple[Measurement, Reading] | None = None  # shows the whole frame: a moved patch leaves it
        self._uncommitted: Measurement | None = None
        self._own_measurement: Measurement | None = None
        self.levels: dict[str, float] = {}
        self.started = time.monotonic()
        self.on_change: list[Callable[[], None]] = []
        self._tasks: list[asyncio.Task[None]] = []
        self.watches: dict[str, PatchWatch] = {MAIN: PatchWatch()}
        self.clock = ClockWatch(self._clock_jumped)
        self.latest_jump: Jump | None = None

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
        self._take_patches(await self.writer.patches())
        await self.camera.open_once()
        if self.box_keeper:
            await self.box_keeper.open_once()
        loops = [self.writer.run(), self.camera.run(), self.acquisition.run(), self.clock.run()]
        if self.box_keeper:
            loops.append(self.box_keeper.run())
        self._tasks = [asyncio.create_task(loop) for loop in loops]

    async def stop(self) -> None:
        """End measuring, switch the light off, commit what waits, close everything."""
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        self.hub.close()
        await self.camera.close()
        if self.box_keeper:
            await self.box_keeper.close()
        await self.writer.close()

    def failed_task(self) -> BaseException | None:
        """Return the error of a loop that ended though none ever should; None while all run."""
        for task in self._tasks:
            if task.done() and not task.cancelled():
                return task.exception() or RuntimeError("a loop of the daemon ended")
        return None

    async def measure(
        self, settings: MeasurementSettings | None = None, deadline_s: float = 120.0, session: str = ""
    ) -> Reading:
        """Return a fresh reading, committed to the journal.

        One made with other settings than those in force is the session's own: no other client comes to see it.

        Raises:
            JournalError: If it was measured but cannot be committed now; it waits, and clients see it later.
            RadiometerError: If it cannot be measured.
            TimeoutError: If it takes longer than `deadline_s`.
        """
        blocked = self._journal_trouble()
        wait_s = min(deadline_s, _JOURNAL_PATIENCE_S) if blocked else deadline_s
        try:
            return await self.acquisition.measure(settings or self.settings, wait_s, session)
        except TimeoutError as error:
            if trouble := self._journal_trouble() or blocked:
                raise JournalError(trouble) from error
            raise

    def configure(self, **changes: Any) -> MeasurementSettings:
        """Change what is measured with and return it.

        Args:
            **changes: Fields of `MeasurementSettings`.

        Raises:
            SettingOutOfRange: If a value is outside the camera's limits; nothing was changed.
            DeviceError: If the limits are not known yet because the camera was never open.
        """
        wanted = replace(self.settings, **changes)
        self.check_settings(wanted)
        self._take_settings(wanted)
        self._tell_status()
        return wanted

    def check_settings(self, wanted: MeasurementSettings) -> None:
        """Refuse settings outside the limits. Raises SettingOutOfRange, UsageError (the patch) or DeviceError."""
        limits = self.instrument.limits
        refuse = self._refuse_outside
        if not wanted.auto_exposure:
            refuse("exposure time", wanted.exposure_s, *limits.exposure_s, "s")
        refuse("gain", wanted.gain_db, *limits.gain_db, "dB")
        if wanted.wavelength_nm is not None:
            refuse("wavelength", wanted.wavelength_nm, *WAVELENGTH_LIMITS_NM, "nm")
        if wanted.patch is not None and not wanted.patch.fits((limits.height, limits.width)):
            patch = wanted.patch
            raise UsageError(
                f"patch {patch.x},{patch.y},{patch.width},{patch.height} is not inside the picture of"
                f" {limits.width} × {limits.height} pixels"
            )

    def define_patch(self, name: str, patch: Patch) -> None:
        """Measure a patch with a name from now on, beside the one for all; one of that name is moved.

        Raises:
            UsageError: If the name cannot be one, the patch is not inside the picture, or there are too many.
        """
        check_name(name)
        self.check_settings(replace(self.settings, patch=patch))
        if name not in self.acquisition.named and len(self.acquisition.named) >= MOST_PATCHES:
            raise UsageError(f"there are {MOST_PATCHES} patches with names already; delete one first")
        limits = self.watches[name].limits if name in self.watches else PatchLimits()
        self._drop_patch_figures(name)
        self.watches[name] = PatchWatch(limits)
        self.acquisition.named[name] = patch
        self._keep_patch(name)
        self.alarms.clear(_limit_alarm(name), "the patch was moved")
        self.writer.note("patch", f"{name} is {patch.x},{patch.y},{patch.width},{patch.height}")
        self._tell_status()

    def delete_patch(self, name: str) -> None:
        """Measure a patch no longer; its readings stay in the journal. Raises UsageError if there is none."""
        self._known_watch(name)
        if name == MAIN:
            raise UsageError(f"{MAIN!r} is the patch that is measured for all; it can be moved, not deleted")
        del self.watches[name], self.acquisition.named[name]
        self._drop_patch_figures(name)
        self.writer.keep_patch(name, None)
        for alarm in (_limit_alarm(name), f"measurement {name}"):
            self.alarms.clear(alarm, "the patch was deleted")
        self.writer.note("patch", f"{name} was deleted")
        self._tell_status()

    def set_limits(self, name: str, limits: PatchLimits) -> None:
        """Alarm where a patch leaves its limits. Raises UsageError if there is no such patch."""
        self._known_watch(name).limit(limits)
        self.metrics.limit_alarm.labels(name).set(0)
        self._keep_patch(name)
        self.alarms.clear(_limit_alarm(name), "the limits were set anew")
        shown = " to ".join("none" if value is None else f"{value:g}" for value in (limits.low, limits.high))
        self.writer.note("patch", f"limits of {name}: {shown}")
        self._tell_status()

    def latest_of(self, name: str) -> Reading | None:
        """Return the latest reading of a patch with a name, or of "main". Raises UsageError if there is none such."""
        watch = self._known_watch(name)
        return self.latest if name == MAIN else watch.latest

    def annotate(self, message: str) -> None:
        """Keep a remark of a person in the journal. Raises UsageError for an empty or endless one."""
        text = " ".join(message.split())
        if not 0 < len(text) <= _LONGEST_REMARK:
            raise UsageError(f"a remark has 1 to {_LONGEST_REMARK} characters, not {len(text)}")
        self.writer.note("remark", text)
        self._tell_status()

    def set_every(self, every_s: float | None) -> None:
        """Set the period of continuous measurement in s; None stops it. Raises SettingOutOfRange."""
        if every_s is not None:
            self._refuse_outside("period", every_s, *EVERY_LIMITS_S, "s")
        self.acquisition.set_every(every_s)
        self._tell_status()

    def reset(self) -> None:
        """Return to the settings the daemon was started with; readings and journal stay."""
        self._take_settings(self._initial_settings)
        self._tell_status()

    def measurement_of(self, reading: Reading | None) -> Measurement | None:
        """Return the frames of a reading as far as they are still held; those of the latest where None."""
        if reading is None:
            return self.latest_measurement
        held = (self.latest_measurement, self._own_measurement)
        return next((one for one in held if one is not None and _is_of(one, reading)), None)

    async def set_level(self, channel: str, level: float) -> float:
        """Set a light channel's level, 0 to 1, and return it as read back.

        Raises:
            SettingOutOfRange: If the level is outside 0 to 1.
            DeviceLost: If there is no box or it is lost.
        """
        if self.box is None or self.box_keeper is None:
            raise DeviceLost("no light box is configured; name one in the bench file")
        self._refuse_outside(f"level of {channel}", level, 0.0, 1.0, "")
        before = self.levels.get(channel, 0.0)
        self.levels[channel] = await self.box_keeper.use(self.box.set_level, channel, level)
        if bool(before) != bool(self.levels[channel]):
            self.writer.note("light", f"{channel} lit at {level:.4g}" if level else f"{channel} switched off")
        self.alarms.clear(_light_alarm(channel), f"{channel} was set anew")
        self._tell_status()
        return self.levels[channel]

    async def lights_off(self) -> None:
        """Darken every channel, whatever is known of it; each is tried although another failed.

        Raises:
            DeviceLost: If there is no box, or it is lost: it is dark by itself 1 s after it was.
            DeviceError: If a channel could not be darkened.
        """
        if self.box is None or self.box_keeper is None:
            raise DeviceLost("no light box is configured; name one in the bench file")
        failure: DeviceError | None = None
        for channel in self.box.channels:
            try:
                await self.set_level(channel, 0.0)
            except DeviceError as error:
                failure = error
        if failure is not None:
            raise failure

    @property
    def light_is_confirmed(self) -> bool:
        """Tell whether the box itself has told the levels and can be asked again: a lost one may do anything."""
        return self.box_keeper is not None and self.box_keeper.state is DeviceState.READY

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
        identity, settings = self.instrument.identity, self.settings
        return {
            "time": utc_now(),
            "instrument": identity_mapping(identity),
            "software": f"radiometer {radiometer.__version__}",
            "devices": {keeper.name: device_mapping(keeper) for keeper in self._keepers()},
            "alarms": [alarm.to_mapping() for alarm in self.alarms.active],
            "every_s": self.acquisition.every_s,
            "settings": settings_mapping(settings),
            "light": {channel: level if self.light_is_confirmed else None for channel, level in self.levels.items()},
            "light_limits": dict(getattr(self.box, "level_limits", {}) or {}),
            "light_confirmed": self.light_is_confirmed,
            "calibration": dict(self.instrument.calibration_summary),
            "latest_sequence": self.latest.sequence if self.latest else None,
            "queue": {"measurements": self.acquisition.queue_depth, "journal": self.writer.depth},
            "patches": {name: self._patch_status(name) for name in self.watches},
            "clock_jump": jump_mapping(self.latest_jump) if self.latest_jump else None,
            "uptime_s": round(time.monotonic() - self.started, 1),
        }

    def refresh_metrics(self) -> None:
        """Bring the gauges up to date."""
        metrics = self.metrics
        for keeper in self._keepers():
            metrics.device_up.labels(keeper.name).set(keeper.state is DeviceState.READY)
            metrics.device_losses.labels(keeper.name).set(keeper.losses)
            if keeper.report.temperature_c is not None:
                metrics.temperature_c.labels(keeper.name).set(keeper.report.temperature_c)
        metrics.take_device_counts(self.camera.report.counters)
        metrics.take_failures(self.acquisition.failures)
        metrics.queue_depth.labels("measurements").set(self.acquisition.queue_depth)
        metrics.queue_depth.labels("journal").set(self.writer.depth)
        metrics.alarms.set(len(self.alarms.active))

    def _journal_trouble(self) -> str:
        return next((alarm.message for alarm in self.alarms.active if alarm.name == "journal"), "")

    def _keepers(self) -> list[DeviceKeeper]:
        return [self.camera, *([self.box_keeper] if self.box_keeper else [])]

    def _refuse_outside(self, name: str, value: float, low: float, high: float, unit: str) -> None:
        if not low * (1 - 1e-9) <= value <= high * (1 + 1e-9):
            raise SettingOutOfRange(self.instrument.identity.model, name, value, low, high, unit)

    def _take_settings(self, wanted: MeasurementSettings) -> None:
        """Take settings over; where they change what is measured, the latest reading is of something else now."""
        if wanted.subject != self.settings.subject:
            self.latest, self.latest_line, self.latest_measurement = None, "", None
            self.watches[MAIN].limit(self.watches[MAIN].limits)
            self.alarms.clear(_limit_alarm(MAIN), "the patch was moved")
        self.acquisition.settings = wanted

    def _measured(self, measurement: Measurement, origin: Origin, seconds: float) -> None:
        self.metrics.measuring_s.observe(seconds)
        if origin.sessions:
            self._own_measurement = measurement
        elif not origin.name:
            self._uncommitted = measurement
        self.camera.report = measurement.report or self.camera.report

    def _publish(self, reading: Reading, origin: Origin | None, commit_s: float) -> None:
        """Make a committed reading visible to all; nothing else ever does, and a client's own never is."""
        self.metrics.readings.inc()
        self.metrics.committing_s.observe(commit_s)
        if origin is None or not origin.sessions:
            self._show(reading, current=origin is None or origin.settings.subject == self.settings.subject)

    def _show(self, reading: Reading, *, current: bool) -> None:
        line = reading.to_json()
        if reading.name:
            self._show_named(reading, line)
            return
        self.hub.publish(Event("reading", line, reading.sequence))
        if not current:  # the patch was moved meanwhile: no latest reading of what is measured now
            return
        self.latest, self.latest_line = reading, line
        if self._uncommitted is not None and _is_of(self._uncommitted, reading):
            self.latest_measurement, self.pictured = self._uncommitted, (self._uncommitted, reading)
        metrics, unit = self.metrics, reading.radiance.unit
        metrics.radiance.labels(unit).set(reading.radiance.value)
        metrics.u_radiance.labels(unit).set(reading.radiance.u)
        metrics.exposure_s.set(max(reading.exposures_s, default=0.0))
        for flag in reading.flags:
            metrics.flagged.labels(str(flag)).inc()
        self._watch_limits(MAIN, reading)

    def _show_named(self, reading: Reading, line: str) -> None:
        """Make a reading of a patch with a name visible under that name; one of a place it has left is let pass."""
        if self.acquisition.named.get(reading.name) != reading.patch:
            return
        self.hub.publish(Event("patch", line, reading.sequence))
        labels = (reading.name, reading.radiance.unit)
        self.metrics.patch_radiance.labels(*labels).set(reading.radiance.value)
        self.metrics.patch_u_radiance.labels(*labels).set(reading.radiance.u)
        self._watch_limits(reading.name, reading)

    def _watch_limits(self, name: str, reading: Reading) -> None:
        watch = self.watches[name]
        if not watch.take(reading):
            return
        self.metrics.limit_alarm.labels(name).set(bool(watch.breached))
        if watch.breached:
            self.alarms.put_up(_limit_alarm(name), watch.message(name), worse=True)
        else:
            self.alarms.clear(_limit_alarm(name), f"patch {name} is within its limits again")

    def _patch_status(self, name: str) -> dict[str, Any]:
        watch, patch = self.watches[name], self.acquisition.named.get(name, self.settings.patch)
        return {
            "patch": patch_mapping(patch) if patch else None,
            "limits": watch.limits.to_mapping(),
            "breached": watch.breached,
        }

    def _known_watch(self, name: str) -> PatchWatch:
        if name not in self.watches:
            raise UsageError(f"there is no patch {name[:40]!r}; there are: {', '.join(self.watches)}")
        return self.watches[name]

    def _drop_patch_figures(self, name: str) -> None:
        for gauge in (self.metrics.patch_radiance, self.metrics.patch_u_radiance):
            for labels in [key for key in list(gauge._metrics) if key[0] == name]:
                gauge.remove(*labels)

    def _keep_patch(self, name: str) -> None:
        patch = self.acquisition.named.get(name, Patch(0, 0, 0, 0))  # of the one for all only its limits are kept
        self.writer.keep_patch(name, NamedPatch(name, patch, self.watches[name].limits).to_json())

    def _take_patches(self, kept: Mapping[str, str]) -> None:
        for name, line in kept.items():
            named = NamedPatch.from_json(name, line)
            self.watches[name] = PatchWatch(named.limits)
            if name != MAIN:
                self.acquisition.named[name] = named.patch

    def _alarm_changed(self, kind: str, name: str, message: str) -> None:
        self.writer.note(kind, f"{name}: {message}")
        self._tell_status()

    def _clock_jumped(self, jump: Jump) -> None:
        """Note in journal and state that times are not comparable across this moment."""
        _log.warning("the clock was set", by_s=jump.by_us / 1e6)
        self.latest_jump = jump
        self.writer.note_jump(jump)
        self._tell_status()

    def _box_opened(self) -> None:
        """A box that comes back is dark: the levels set before are gone, and must not be believed."""
        self.levels = dict.fromkeys(self.box.channels, 0.0) if self.box else {}

    def _box_reported(self, report: DeviceReport) -> None:
        """Take over what the box says that it does; light that is not as it was set is an alarm."""
        for channel, level in (report.levels or {}).items():
            believed = self.levels.get(channel, 0.0)
            if abs(level - believed) <= _LEVEL_TOLERANCE:
                continue
            self.levels[channel] = level
            message = (
                f"{channel} was set to {believed:.4g} and went dark by itself: its energy budget is used up, its button"
                " was held, or another program asked for darkness"
                if level == 0.0
                else f"{channel} is at {level:.4g} where {believed:.4g} was set"
            )
            self.alarms.put_up(_light_alarm(channel), message)
            self._tell_status()

    def _tell_status(self) -> None:
        for callback in self.on_change:
            callback()
        self.hub.publish(Event("status", json.dumps(self.status(), ensure_ascii=False)))


def _limit_alarm(name: str) -> str:
    return f"limit {name}"


def _light_alarm(channel: str) -> str:
    return f"light {channel}"


def _is_of(measurement: Measurement, reading: Reading) -> bool:
    made = measurement.reading
    return (made.time, made.patch, made.radiance) == (reading.time, reading.patch, reading.radiance)
