"""The radiant flux of a light-emitting diode from a bracket of it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

from radiometer.analysis.calibration.shared import require_camera, require_channel, require_lens
from radiometer.analysis.flux.drive_law import LEAST_DRIVE, DriveLaw, fit_drive_law
from radiometer.analysis.flux.estimate import led_flux
from radiometer.analysis.flux.report import Emitter, FluxReport
from radiometer.analysis.flux.sensor import flux_scale
from radiometer.analysis.signal.model import corrected_settings
from radiometer.api.files import PathLike, stack_of
from radiometer.api.meter import PatchLike, as_patch
from radiometer.api.result import Result, require_other
from radiometer.bench.sources import is_photographs, open_source
from radiometer.data import Calibration, Frame, Quantity
from radiometer.data.setup import Setup
from radiometer.devices import CameraPreset
from radiometer.errors import MeasurementError, UsageError
from radiometer.importing import imported_of, open_capture
from radiometer.importing.light_tables import read_drive_table
from radiometer.numbers import with_u
from radiometer.photographs.scene import prepared
from radiometer.photographs.stated import stated_camera
from radiometer.plausible import HalfAngle, Iso, Millimetres, NotNegative, Positive, RelativeUncertainty, Uncertainty

__all__ = ["Flux", "FluxReport", "Quantity", "flux"]

_MOST_U_REL: Final = 0.25  # of a length: beyond it the square in solid angles is no line within u


@dataclass(frozen=True, slots=True, eq=False)
class DrivenFlux:
    """Flux at a drive by the law of a drive table; u holds the law's, and its misfit at both drives."""

    channel: str  # of the table
    drive: float  # in the table's unit
    flux: Quantity
    law: DriveLaw

    def to_mapping(self) -> dict[str, Any]:
        """Return the documented JSON form."""
        return {"channel": self.channel, "drive": self.drive, "flux": self.flux, "drive_law": self.law}


@dataclass(frozen=True, eq=False, repr=False)
class Flux(Result):
    """The flux of a diode through the sensor, and as emitted.

    Examples:
        >>> import radiometer as rm
        >>> found = rm.flux("out/chart", calibration="calibration.yaml")
        >>> found.result.unit, found.result.u > 0
        ('W', True)

    Attributes:
        report: Figures, the steps between them, and assumptions.
        notes: What a user should know, a sentence each.
        driven: Flux at another drive, where it was asked for.
    """

    report: FluxReport
    notes: tuple[str, ...] = ()
    driven: DrivenFlux | None = None

    @property
    def result(self) -> Quantity:
        """Return the emitted flux in W by the best way at hand, else the flux through the sensor."""
        return self.report.result

    def to_mapping(self) -> dict[str, Any]:
        notes = [*self.report.warnings, *self.notes]
        return self.plain(**self.report.to_mapping(), notes=notes, at_drive=self.driven)

    def __str__(self) -> str:
        where = "emitted" if self.report.emitted else "through the sensor"
        return f"{with_u(1e3 * self.result.value, 2e3 * self.result.u, 'mW', k=2)} {where}"


def flux(
    capture: PathLike,
    *,
    calibration: Calibration | PathLike | None = None,
    camera_file: PathLike | None = None,
    patch: PatchLike | None = None,
    half_angle: HalfAngle | None = None,
    half_angle_u: Uncertainty = 1.0,
    diameter: Millimetres | None = None,
    diameter_u: Uncertainty = 0.05,
    distance: Millimetres | None = None,
    distance_u: Uncertainty = 0.5,
    f_number_u_rel: RelativeUncertainty = 0.02,
    datasheet_mw: Positive | None = None,
    channel: str = "luminance",
    measured_iso: Mapping[Iso, Iso] | None = None,
    drive_table: PathLike | None = None,
    led: str | None = None,
    drive: NotNegative | None = None,
    at_drive: NotNegative | None = None,
) -> Flux:
    """Find the radiant flux of a light-emitting diode.

    Gives the flux through the sensor as the sum over unclipped pixels of one photograph, and what it lacks of the
    emitted flux: clipped pixels, background, lens losses, and light that missed the lens.

    Examples:
        >>> import radiometer as rm
        >>> rm.flux("out/chart", calibration="calibration.yaml")
        <Flux ... mW (k = 2) through the sensor>

    Args:
        capture: Capture set, or folder of photographs, of the lit diode: several exposures.
        calibration: Calibration, or its file; the capture's camera description where there is none.
        camera_file: Camera file of `characterise`, instead of a calibration.
        patch: Region (x, y, width, height) that holds the diode and its glow.
        half_angle: Angle in degrees at which its intensity is one half.
        half_angle_u: Its standard uncertainty in degrees.
        diameter: Diameter of its emitting area in mm.
        diameter_u: Its standard uncertainty in mm.
        distance: From emitter to the lens's entrance pupil in mm.
        distance_u: Its standard uncertainty in mm.
        f_number_u_rel: Relative standard uncertainty of the f-number.
        datasheet_mw: Flux that the datasheet states in mW.
        channel: Of colour photographs and colour cameras: "luminance", "red", "green" or "blue"; of the mosaic of a
            capture set "luminance" is green.
        measured_iso: Of photographs: real ISO speed by stated one.
        drive_table: Table of the diode's light over its drive, as for `light_law`: gives the flux at another drive.
        led: Its channel in that table; the only one by default.
        drive: Its drive in the capture, in the table's unit.
        at_drive: Drive whose flux is asked for.

    Raises:
        CalibrationError: If nothing gives the scale, or it does not fit.
        CaptureError: If the frames are missing or inconsistent.
        MeasurementError: If no frame shows the diode, or it clips everywhere.
        UsageError: If arguments are missing or exclude each other.
    """
    require_other("--drive-table", drive_table, led=led, drive=drive, at_drive=at_drive)
    emitter = _emitter(half_angle, half_angle_u, diameter, diameter_u, distance, distance_u, datasheet_mw)
    if calibration is not None and camera_file is not None:
        raise UsageError("--calibration and --camera-file exclude each other")
    known = calibration if isinstance(calibration, Calibration | None) else Calibration.read(Path(calibration))
    taken = _taken(Path(capture), known, channel, measured_iso)
    camera, u_rel = taken.setup.camera, None
    if camera_file is not None:
        preset = CameraPreset.read(Path(camera_file))
        camera, u_rel = preset.applied_to(camera, str(camera_file)), preset.figure_u_rel("R")
    frames = taken.frames
    if known is not None:
        found, black_dn = known.found, known.black_level.dn
        frames = [replace(one, settings=corrected_settings(one.settings, found, black_dn)) for one in frames]
    lit = [one.settings for one in frames if not one.settings.is_dark]
    scale = flux_scale(replace(taken.setup, camera=camera, calibration=known), lit, u_rel)
    report = led_flux(frames, scale, emitter, as_patch(patch), f_number_u_rel)
    law = None if drive_table is None else _driven(report.result, Path(drive_table), led, drive, at_drive)
    return Flux(report, taken.notes, law)


def _driven(flux: Quantity, path: Path, led: str | None, drive: float | None, at: float | None) -> DrivenFlux:
    """Return the flux at another drive. Raises UsageError for one that the law was not fitted to."""
    if drive is None or at is None:
        raise UsageError("--drive-table needs --drive, the drive of the capture, and --at-drive")
    table = read_drive_table(path)
    named = {one.name: one for one in table.channels}
    channel = next(iter(named.values())) if led is None and len(named) == 1 else named.get(led or "")
    if channel is None:
        raise UsageError(f"{path}: state by --led which channel the diode is: {', '.join(named)}")
    law = fit_drive_law(channel.drive, channel.light)
    if law is None:
        raise MeasurementError(
            f"{path}: channel {channel.name} has too few lit drives above {LEAST_DRIVE:.0%} for a law"
        )
    low, high = max(LEAST_DRIVE, float(channel.drive.min())), float(channel.drive.max())
    for option, value in (("--drive", drive), ("--at-drive", at)):
        if not low <= value / table.full <= high:
            raise UsageError(
                f"{option} {value:g}: the law of {channel.name} holds from {low * table.full:g} to "
                f"{high * table.full:g}; measure its light at this drive as well"
            )
    ratio = law.light_over(at / table.full, drive / table.full)
    misfit = 0.0 if at == drive else math.sqrt(2.0) * law.misfit_rel  # of either drive
    u = math.hypot(flux.u * ratio.value, flux.value * ratio.value * math.hypot(ratio.u_rel, misfit))
    return DrivenFlux(channel.name, at, Quantity(flux.value * ratio.value, u, flux.unit), law)


@dataclass(frozen=True, slots=True, eq=False)
class _Taken:
    """Frames of the lit diode, of the dark, and with the diode off."""

    frames: Sequence[Frame]
    setup: Setup
    notes: tuple[str, ...]


def _taken(
    path: Path, calibration: Calibration | None, channel: str, measured_iso: Mapping[float, float] | None
) -> _Taken:
    if is_photographs(path):
        if calibration is None:
            raise UsageError("photographs give a flux by --calibration only: they do not describe their sensor")
        stack = stack_of(open_source(path, channel), str(path))
        ready = prepared(stack.as_photographs(), calibration=calibration, measured_iso=measured_iso)
        frames = (*ready.only.dark, *ready.without_absent().light)
        camera, lens = stated_camera(ready.only)
        require_lens(calibration, lens)
        notes = (*ready.notes, *require_camera(calibration, camera))
        return _Taken(frames, Setup(calibration.camera, calibration.lens, spectrum=None), notes)
    capture = open_capture(path).in_colour(channel)
    chosen = capture.pattern_of()
    frames = tuple(one for one in capture.frames() if one.settings.is_dark or one.settings.pattern == chosen)
    notes = tuple(f"{path.name}: {line}" for line in imported_of(capture).lines()) if capture.store is not None else ()
    notes += require_channel(calibration, frames[0]) if calibration is not None else ()
    header = capture.header
    return _Taken(frames, Setup(header.camera, header.lens, None, header.source, None, header.taken), notes)


def _emitter(
    half_angle: float | None,
    half_angle_u: float,
    diameter: float | None,
    diameter_u: float,
    distance: float | None,
    distance_u: float,
    datasheet_mw: float | None,
) -> Emitter | None:
    if half_angle is None:
        if any(v is not None for v in (diameter, distance, datasheet_mw)):
            raise UsageError(
                "the emitted flux needs --half-angle, the datasheet's angle of half intensity in degrees (half of the "
                "viewing angle; 60 for an emitter without a lens)"
            )
        return None
    for name, value, u in (("--diameter", diameter, diameter_u), ("--distance", distance, distance_u)):
        if value is not None and u > _MOST_U_REL * value:
            raise UsageError(f"{name} {value:g} mm: known to ± {u:g} mm; state both in mm, and closer")
    return Emitter(
        Quantity(half_angle, half_angle_u, "°"),
        None if diameter is None else Quantity(diameter, diameter_u, "mm"),
        None if distance is None else Quantity(distance, distance_u, "mm"),
        None if datasheet_mw is None else datasheet_mw * 1e-3,
    )
