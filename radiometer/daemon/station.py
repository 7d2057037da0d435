"""The core: one camera, perhaps a light box, a journal; what every interface talks to."""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import structlog

import radiometer
from radiometer.daemon.acquisition import Acquisition
from radiometer.daemon.alarms import Alarms
from radiometer.daemon.clock_watch import ClockWatch, Jump
from radiometer.daemon.hub import Event, Hub
from radiometer.daemon.instrument import DeviceReport, Instrument, LightSource, Measurement, MeasurementSettings, Origin
from radiometer.daemon.journal import Journal, JournalError
from radiometer.daemon.journal_writer import JournalWriter
from radiometer.daemon.keeper import DeviceKeeper, DeviceState, KeeperTimes
from radiometer.daemon.metrics import Metrics
from radiometer.daemon.timestamps import iso_time
from radiometer.data import Patch, Reading
from radiometer.data.provenance import utc_now
from radiometer.errors import DeviceError, DeviceLost, RadiometerError, SettingOutOfRange, UsageError

_log = structlog.get_logger(__name__)
WAVELENGTH_LIMITS_NM = (300.0, 1200.0)
EVERY_LIMITS_S = (0.0, 86400.0)
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
        instrument: Instrument,
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
        self._uncommitted: Measurement | None = None
        self._own_measurement: Measurement | None = None
        self.levels: dict[str, float] = {}
        self.started = time.monotonic()
        self.on_change: list[Callable[[], None]] = []
        self._tasks: list[asyncio.Task[None]] = []
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
        for measurement in (self.latest_measurement, self._own_measurement):
            if measurement is not None and _is_of(measurement, reading):
                return measurement
        return None

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
        identity, settings, patch = self.instrument.identity, self.settings, self.settings.patch
        return {
            "time": utc_now(),
            "instrument": {"vendor": identity.vendor, "model": identity.model, "serial": identity.serial},
            "software": f"radiometer {radiometer.__version__}",
            "devices": {keeper.name: self._device_status(keeper) for keeper in self._keepers()},
            "alarms": [alarm.to_mapping() for alarm in self.alarms.active],
            "every_s": self.acquisition.every_s,
            "settings": {
                "patch": _patch_mapping(patch) if patch else None,
                "auto_exposure": settings.auto_exposure,
                "exposure_s": settings.exposure_s,
                "gain_db": settings.gain_db,
                "wavelength_nm": settings.wavelength_nm,
            },
            "light": {channel: level if self.light_is_confirmed else None for channel, level in self.levels.items()},
            "light_confirmed": self.light_is_confirmed,
            "calibration": dict(self.instrument.calibration_summary),
            "latest_sequence": self.latest.sequence if self.latest else None,
            "queue": {"measurements": self.acquisition.queue_depth, "journal": self.writer.depth},
            "clock_jump": _jump_mapping(self.latest_jump) if self.latest_jump else None,
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
        metrics.queue_depth.labels("measurements").set(self.acquisition.queue_depth)
        metrics.queue_depth.labels("journal").set(self.writer.depth)
        metrics.alarms.set(len(self.alarms.active))

    def _journal_trouble(self) -> str:
        return next((alarm.message for alarm in self.alarms.active if alarm.name == "journal"), "")

    def _keepers(self) -> list[DeviceKeeper]:
        return [self.camera, *([self.box_keeper] if self.box_keeper else [])]

    def _device_status(self, keeper: DeviceKeeper) -> dict[str, Any]:
        return {
            "state": str(keeper.state),
            "losses": keeper.losses,
            "temperature_C": keeper.report.temperature_c,
            "counters": dict(keeper.report.counters),
        }

    def _refuse_outside(self, name: str, value: float, low: float, high: float, unit: str) -> None:
        if not low * (1 - 1e-9) <= value <= high * (1 + 1e-9):
            raise SettingOutOfRange(self.instrument.identity.model, name, value, low, high, unit)

    def _take_settings(self, wanted: MeasurementSettings) -> None:
        """Take settings over; where they change what is measured, the latest reading is of something else now."""
        if wanted.subject != self.settings.subject:
            self.latest, self.latest_line, self.latest_measurement = None, "", None
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
        self.hub.publish(Event("reading", line, reading.sequence))
        if not current:  # the patch was moved meanwhile: no latest reading of what is measured now
            return
        self.latest, self.latest_line = reading, line
        if self._uncommitted is not None and _is_of(self._uncommitted, reading):
            self.latest_measurement = self._uncommitted
        metrics, unit = self.metrics, reading.radiance.unit
        metrics.radiance.labels(unit).set(reading.radiance.value)
        metrics.u_radiance.labels(unit).set(reading.radiance.u)
        metrics.exposure_s.set(max(reading.exposures_s, default=0.0))
        for flag in reading.flags:
            metrics.flagged.labels(str(flag)).inc()

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


def _jump_mapping(jump: Jump) -> dict[str, Any]:
    return {"by_s": jump.by_us / 1e6, "time": iso_time(jump.after_us), "message": str(jump)}


def _light_alarm(channel: str) -> str:
    return f"light {channel}"


def _is_of(measurement: Measurement, reading: Reading) -> bool:
    made = measurement.reading
    return (made.time, made.patch, made.radiance) == (reading.time, reading.patch, reading.radiance)


def _patch_mapping(patch: Patch) -> dict[str, int]:
    return {"x": patch.x, "y": patch.y, "width": patch.width, "height": patch.height}
