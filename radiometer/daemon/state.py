"""Parts of the state as mappings, as every interface tells them in JSON."""

from __future__ import annotations

from typing import Any

from radiometer.daemon.clock_watch import Jump
from radiometer.daemon.instrument import MeasurementSettings
from radiometer.daemon.keeper import DeviceKeeper
from radiometer.daemon.timestamps import iso_time
from radiometer.data import Patch
from radiometer.data.serials import other_notation
from radiometer.devices import CameraIdentity


def patch_mapping(patch: Patch) -> dict[str, int]:
    """Return {x, y, width, height} in pixels."""
    return {"x": patch.x, "y": patch.y, "width": patch.width, "height": patch.height}


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
        "patch": patch_mapping(settings.patch) if settings.patch else None,
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
