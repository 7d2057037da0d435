"""The state as clients see it: the latest reading that belongs to all, its frames, and the rest as mappings."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from radiometer.daemon.clock_watch import Jump
from radiometer.daemon.instrument import Measurement, MeasurementSettings, Origin
from radiometer.daemon.keeper import DeviceKeeper
from radiometer.daemon.timestamps import iso_time
from radiometer.data import Reading
from radiometer.data.serials import other_notation
from radiometer.devices import CameraIdentity


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
