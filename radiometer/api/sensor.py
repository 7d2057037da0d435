"""A camera's figures after EMVA 1288: gain, noise, dark current, saturation and linearity."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from radiometer.acquire.characterisation_ladder import LadderRequest, take_ladder
from radiometer.analysis.characterise import Characterisation, read_subject
from radiometer.analysis.characterise import characterise as characterise_subject
from radiometer.analysis.characterise.emva_export import export_descriptor, images_folder
from radiometer.analysis.characterise.report import datasheet, draw_telling
from radiometer.analysis.characterise.result import SYMBOLS, as_printed
from radiometer.analysis.characterise.subject import Subject, with_known_radiance
from radiometer.analysis.characterise.tap_report import HEADINGS, tap_mappings, tap_rows
from radiometer.analysis.characterise.taps import (
    Crosstalk,
    TapFigures,
    characterise_taps,
    crosstalk,
    differing,
    taps_as_stated,
)
from radiometer.api.files import PathLike
from radiometer.api.meter import PatchLike, as_patch
from radiometer.api.result import Ask, Progress, Result
from radiometer.bench.assembly import open_bench_camera, stated_source
from radiometer.bench.capturing import shutter_by_hand
from radiometer.bench.config import BenchConfig
from radiometer.bench.instrument import central_patch
from radiometer.data import CaptureSetWriter, LensDescription, Patch, PatchDescription, Quantity
from radiometer.data.drawing import new_axes, picture
from radiometer.data.mosaic import in_cells
from radiometer.data.storage import check_new_folder, write_text_atomic, write_yaml_atomic
from radiometer.devices import Camera
from radiometer.errors import UsageError
from radiometer.importing import open_capture
from radiometer.numbers import unit_text, with_u
from radiometer.plausible import ExposureSteps, KnownRadiance, RelativeUncertainty
from radiometer.reporting.page import listed, table

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@dataclass(frozen=True, eq=False, repr=False)
class Sensor(Result):
    """The figures of a camera after EMVA 1288.

    Examples:
        >>> import radiometer as rm
        >>> sensor = rm.characterise("out/chart")
        >>> black = sensor["mu_y_dark"]
        >>> abs(black.value - 64) < 4 * black.u, black.unit
        (True, 'DN')
        >>> sensor.to_csv("sensor.csv")

    Attributes:
        characterisation: Figures, steps, linearity and notes.
        taps: Figures of each output amplifier; empty where the camera has one.
        crosstalk: Shares of one tap's signal in another, where the frames determine them.
        limits: Limits of the camera that was driven, by name; None where the frames came from a folder.
        notes: What the EMVA 1288 descriptor that was written leaves out.
    """

    TAP_HEADINGS: ClassVar = HEADINGS

    characterisation: Characterisation
    limits: dict[str, Any] | None = None
    notes: tuple[str, ...] = ()
    taps: tuple[TapFigures, ...] = ()
    crosstalk: tuple[Crosstalk, ...] = ()

    def to_mapping(self) -> dict[str, Any]:
        """Return the camera file as plain values."""
        mapping = self.characterisation.to_mapping(self.limits)
        if self.taps:
            mapping["camera"]["taps"] = [one.tap.model_dump(mode="json", exclude_none=True) for one in self.taps]
            mapping["taps"] = tap_mappings(self.taps)
            mapping["crosstalk"] = [asdict(one) for one in self.crosstalk]
        return mapping

    def write(self, path: PathLike) -> None:
        """Write the camera file (YAML). Raises OutputError if it cannot be written."""
        write_yaml_atomic(Path(path), self.to_mapping())

    def write_report(self, path: PathLike) -> None:
        """Write the report (HTML). Raises OutputError if it cannot be written."""
        write_text_atomic(Path(path), datasheet(self.characterisation, self.taps))

    @property
    def figures(self) -> Mapping[str, Quantity]:
        """Return quantities with their standard uncertainty by EMVA 1288 symbol."""
        return self.characterisation.figures

    def __getitem__(self, symbol: str) -> Quantity:
        """Return one figure. Raises KeyError for one that the frames do not give."""
        return self.figures[symbol]

    def rows(self) -> list[tuple[str, str, str, str, str]]:
        """Return sign, meaning, value, U (k = 2) and unit of every figure as it is printed, in the standard's order."""
        return [
            (one.sign, one.meaning, *as_printed(key, self[key]), unit_text(self[key].unit))
            for key, one in SYMBOLS.items()
            if key in self.figures
        ]

    def tap_rows(self) -> list[tuple[str, ...]]:
        """Return name, rectangle and the main figures ± U (k = 2) of every tap as they are printed."""
        return tap_rows(self.taps)

    def to_csv(self, path: PathLike) -> None:
        """Write `symbol,value,u,unit`. Raises UsageError for another ending, OutputError if it fails."""
        if Path(path).suffix.lower() != ".csv":
            raise UsageError(f"{path}: the name must end in .csv")
        rows = [f"{name},{one.value!r},{one.u!r},{one.unit}" for name, one in self.figures.items()]
        write_text_atomic(Path(path), "\n".join(["symbol,value,u,unit", *rows]) + "\n")

    def plot(self, axes: Axes | None = None) -> Axes:
        """Draw the photon transfer (variance over signal), or the dark signal where no gain was found."""
        where = axes if axes is not None else new_axes()
        draw_telling(where, self.characterisation)
        return where

    def __str__(self) -> str:
        telling = [name for name in ("K", "sigma_d", "mu_I_mean") if name in self.figures] or list(self.figures)[:3]
        return ", ".join(f"{name} = {_quantity(self[name])}" for name in telling)

    def _repr_html_(self) -> str:
        figures = table(("EMVA 1288", "value ± U"), [(name, _quantity(one)) for name, one in self.figures.items()])
        return picture(self.plot, repr(self)) + figures + listed(self.characterisation.notes)


def characterise(
    path: PathLike | None = None,
    patch: PatchLike | None = None,
    *,
    channel: str = "green",
    camera: str | None = None,
    bench: PathLike | None = None,
    radiance: KnownRadiance | None = None,
    radiance_u_rel: RelativeUncertainty = 0.0,
    steps: ExposureSteps = 30,
    keep: PathLike | None = None,
    emva_descriptor: PathLike | None = None,
    taps: str | None = None,
    ask: Ask | None = None,
    progress: Progress | None = None,
) -> Sensor:
    """Find gain, noise, dark current, saturation and linearity of a camera after EMVA 1288.

    Needs pairs of frames of steady, even light over exposure or level, and dark frames; a camera takes them.
    Every figure carries its standard uncertainty.

    Examples:
        >>> import radiometer as rm
        >>> rm.characterise("out/chart", patch=(0, 0, 48, 32))
        <Sensor ...mu_y_dark = 6...>

    Args:
        path: Capture set, or EMVA 1288 descriptor; or else `camera`.
        patch: Look at (x, y, width, height) only.
        channel: Of the mosaic of a colour camera: "red", "green" or "blue".
        camera: Drive this camera: "sim", or its id, serial number or address.
        bench: Bench file of that camera; the simulated bench by default.
        radiance: Known radiance of the region in W·sr⁻¹·m⁻², for the quantum efficiency.
        radiance_u_rel: Its relative standard uncertainty.
        steps: With a camera: exposures from darkness to saturation.
        keep: With a camera: keep the frames as a capture set here.
        emva_descriptor: EMVA 1288 descriptor file to write, for other programs.
        taps: Output amplifiers: "2x2" for columns × rows of equal parts, "find" for borders that the frames show. By
            default those that the files or the camera file state.
        ask: Has the lens covered where the camera has no shutter.
        progress: Called after every frame.

    Raises:
        UsageError: If neither or both of path and camera are named, or a mosaic has no such colour.
        OutputRefused: If a descriptor's folder of images holds files.
        CaptureError: If the frames are missing or inconsistent.
        MeasurementError: If they do not determine the figures.
        DeviceError: If the camera fails.
    """
    if (path is None) == (camera is None):
        raise UsageError("name a capture set (or descriptor file), or a camera with --camera; one of both")
    if emva_descriptor is not None:
        check_new_folder(images_folder(Path(emva_descriptor)))
    region = as_patch(patch)
    with tempfile.TemporaryDirectory(prefix="radiometer-") as scratch:
        limits, folder = None, Path(path) if path is not None else Path(keep or Path(scratch) / "capture")
        if path is None:
            limits = _take(folder, camera, Path(bench) if bench else None, region, steps, ask, progress)
            region = None  # only it was kept
        subject = read_subject(folder, region, channel)
        if radiance is not None:
            capture = open_capture(folder)
            shape = capture.read_frame(0).shape
            subject = with_known_radiance(subject, capture.header, shape, radiance, radiance_u_rel)
        if camera is not None and keep is None:
            subject = replace(subject, origin=f"camera {camera}")
        found, tapped, shares = _characterised(subject, folder, taps, region)
        remarks = tuple(export_descriptor(subject, found, Path(emva_descriptor))) if emva_descriptor else ()
    return Sensor(found, limits, remarks, tapped, shares)


def _characterised(
    subject: Subject, folder: Path, how: str | None, region: Patch | None
) -> tuple[Characterisation, tuple[TapFigures, ...], tuple[Crosstalk, ...]]:
    """Return the figures of the frames, and those of each tap where there are several."""
    if how is not None and region is not None:
        raise UsageError("a patch is a part of some taps; name either the patch or the taps")
    if (how is None and not subject.camera.taps) or region is not None or not subject.groups:
        return characterise_subject(subject), (), ()
    described = taps_as_stated(how, subject, next(subject.groups[0].read(subject.camera.full_scale_dn)).shape)
    tapped = characterise_taps(subject, described)
    if len(tapped) == 1:  # overscan around one amplifier: its pixels are the sensor's
        subject = replace(subject, regions=(described[0].patch,), fluxes=(None,))
    notes = tuple(text for symbol in ("K", "mu_y_dark", "sigma_d") if (text := differing(tapped, symbol)))
    whole = characterise_subject(replace(subject, notes=(*subject.notes, *notes)))
    return whole, tapped, crosstalk(subject, described)


def _take(
    folder: Path,
    name: str | None,
    bench: Path | None,
    region: Patch | None,
    steps: int,
    ask: Ask | None,
    progress: Progress | None,
) -> dict[str, Any]:
    """Write the frames of the ladder and return the camera's limits; only the region of each frame is kept."""
    with open_bench_camera(bench, name) as (config, camera):
        where = region or (config.patch.patch if config.patch else central_patch(camera))
        if camera.description.mosaic is not None:
            where = in_cells(where)
        request = LadderRequest(where, steps)
        shutter = None if camera.capabilities.has_shutter else shutter_by_hand(camera, ask)
        with _writer(folder, camera, config, where) as writer:
            for number, frame in enumerate(take_ladder(camera, request, shutter), 1):
                writer.add(replace(frame, dn=frame.dn[where.slices].copy()))
                if progress:
                    progress("capturing", number, request.frames())
        limits = asdict(camera.capabilities)
        return {key: list(value) if isinstance(value, tuple) else value for key, value in limits.items()}


def _writer(folder: Path, camera: Camera, config: BenchConfig, region: Patch) -> CaptureSetWriter:
    patch = PatchDescription(name="region", x=0, y=0, width=region.width, height=region.height)
    return CaptureSetWriter(folder, camera.description, _shifted(camera, region), stated_source(config), (patch,))


def _shifted(camera: Camera, region: Patch) -> LensDescription:
    """Return the lens with its principal point counted from the region's corner."""
    capabilities, lens = camera.capabilities, camera.lens
    x, y = lens.principal_point_px or ((capabilities.width - 1) / 2, (capabilities.height - 1) / 2)
    return lens.model_copy(update={"principal_point_px": (x - region.x, y - region.y)})


def _quantity(figure: Quantity) -> str:
    return with_u(figure.value, 2.0 * figure.u, figure.unit, k=2)
