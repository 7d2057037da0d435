"""A merged bracket as arrays: radiance, its standard uncertainty and a mask."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from radiometer.analysis.calibration.shared import channel_of
from radiometer.analysis.characterise.taps import camera_with_taps
from radiometer.analysis.exports.curves import read_curves
from radiometer.analysis.exports.maps import MapPicture, in_luminance, writer_for
from radiometer.analysis.merge.bracket import merge as merge_bracket
from radiometer.analysis.photometry.photometry import spectrum as spectrum_of
from radiometer.analysis.response.curves import black_of_curve
from radiometer.api.files import PathLike, Stack, stack_of
from radiometer.api.response import Response
from radiometer.api.result import Drawn, Progress
from radiometer.bench.sources import is_photographs, open_source
from radiometer.data import (
    BlackLevel,
    Bracket,
    Calibration,
    CaptureSet,
    Frame,
    PixelMask,
    RadianceMap,
    ResponseCurve,
    Scale,
    SensorNoise,
    SourceDescription,
)
from radiometer.data.drawing import new_axes
from radiometer.data.mosaic import COLOURS
from radiometer.data.pile_up import with_white_levels
from radiometer.data.setup import AS_CALIBRATED, Setup
from radiometer.data.storage import check_outputs
from radiometer.errors import CaptureError, UsageError, required_library
from radiometer.importing import imported_of, is_foreign, open_capture
from radiometer.numbers import unit_text
from radiometer.photographs.scene import (
    ALIGN_CHOICES,
    Photographs,
    by_channel,
    curve_of_channel,
    falloff_of,
    merge_photographs,
    prepared,
)
from radiometer.plausible import FNumber, Iso
from radiometer.progress import counted, unseen

if TYPE_CHECKING:
    import xarray
    from matplotlib.axes import Axes

# What a response can be given as: as recovered, a curve, a file of one or several curves, or several of these.
ResponseLike = Response | ResponseCurve | PathLike | Sequence[ResponseCurve | PathLike]


_AXES: Final = {"y": "row of pixels, from the top", "x": "column of pixels, from the left"}


def quantity_in_words(unit: str) -> str:
    """Return what a map of a unit holds, such as "radiance in W·sr⁻¹·m⁻²", for axes and headings."""
    if unit in ("1", "relative"):
        return "relative radiance"
    return f"{'luminance' if unit == 'cd m-2' else 'radiance'} in {unit_text(unit)}"


@dataclass(frozen=True, eq=False, repr=False)
class Radiance(Drawn):
    """Radiance per pixel: one map, or one for each colour of photographs.

    Examples:
        >>> import radiometer as rm
        >>> radiance = rm.merge(rm.read("out/chart"), calibration="calibration.yaml")
        >>> radiance.value.shape, radiance.u.shape, radiance.unit
        ((64, 96), (64, 96), 'W sr-1 m-2')

        >>> radiance.mask.dtype, bool((radiance.u[radiance.mask == 0] > 0).all())
        (dtype('uint8'), True)

        >>> radiance.to_xarray().radiance.attrs["units"]
        'W sr-1 m-2'
        >>> radiance.write("map.exr")

    Attributes:
        maps: Values, uncertainties, masks and provenance by channel; "mono" where there is one of no colour.
        files: Files that they were written to.
        responses: Files that a recovered response is kept in.
        alignment: How photographs lay to each other, in a sentence; None where that was not asked.
        falloff: What fall-off was taken out, in a sentence; None where none was.
        notes: What a user should know, a sentence each.
        bounds: Lowest and highest value of the false colours; None takes those of the picture.
        spectrum: Name of the light's spectrum where the caller or the capture states it; None where neither does.
    """

    maps: Mapping[str, RadianceMap]
    files: tuple[Path, ...] = ()
    responses: tuple[Path, ...] = ()
    alignment: str | None = None
    falloff: str | None = None
    notes: tuple[str, ...] = ()
    bounds: tuple[float, float] | None = None
    spectrum: str | None = None

    def __getitem__(self, channel: str) -> Radiance:
        """Return one channel alone. Raises KeyError for one that is not there."""
        return replace(self, maps={channel: self.maps[channel]})

    @property
    def map(self) -> RadianceMap:
        """Return the only map.

        Raises:
            UsageError: If there are several.
        """
        if len(self.maps) != 1:
            names = ", ".join(self.maps)
            raise UsageError(f"there is a map for each of {names}; choose one: radiance[{next(iter(self.maps))!r}]")
        return next(iter(self.maps.values()))

    @property
    def value(self) -> NDArray[np.float32]:
        """Return radiance per pixel in `unit`, shape (height, width)."""
        return self.map.radiance

    @property
    def u(self) -> NDArray[np.float32]:
        """Return the standard uncertainty of each pixel's own, in `unit`; `u_rel_common` comes on top."""
        return self.map.u_radiance

    @property
    def mask(self) -> NDArray[np.uint8]:
        """Return PixelMask bits per pixel; 0 is good."""
        return self.map.mask

    @property
    def unit(self) -> str:
        """Return "W sr-1 m-2", "cd m-2", or "relative"."""
        return self.picture.unit

    @property
    def u_rel_common(self) -> float:
        """Return the relative standard uncertainty that all pixels share."""
        return self.map.u_rel_common

    @property
    def assumptions(self) -> tuple[str, ...]:
        """Return what was assumed; what not all channels share has its channel's name before it."""
        texts = {name: one.provenance.assumptions for name, one in self.maps.items()}
        shared = [
            text for text in self.picture.first.provenance.assumptions if all(text in one for one in texts.values())
        ]
        own = [f"{name}: {text}" for name, some in texts.items() for text in some if text not in shared]
        return (*shared, *own)

    @property
    def picture(self) -> MapPicture:
        """Return the maps as what is written to files."""
        return MapPicture(self.maps, self.bounds)

    def write(self, path: PathLike) -> None:
        """Write .exr, .hdr, .tiff or .png by the ending. Raises UsageError for another, OutputError if it fails."""
        target = Path(path)
        writer_for(target)(target, self.picture)

    def to_mapping(self) -> dict[str, Any]:
        """Return the documented JSON form: figures of the only or the green channel, and of each by its name."""
        found = self.picture.first
        own = ("files", "unit", "assumptions", "notes", "responses", "alignment", "falloff")
        height, width = found.shape
        frames = {"exposures_s": found.exposures_s, "iso": found.provenance.parameters.get("iso", [])}
        by_channel = {name: _figures(one) for name, one in self.maps.items()}
        figures = {**frames, **_figures(found), "by_channel": by_channel}
        return self.plain(*own, width=width, height=height, channels=list(self.maps), **figures)

    def to_xarray(self) -> xarray.Dataset:
        """Return an xarray.Dataset with `radiance`, its uncertainties and `mask`: units and flags as in CF.

        `u_radiance` is each pixel's noise, `u_shared` what pixels of one level share, `u_common` what all share. Their
        attributes state how errors of pixels are correlated, as obsarray reads it (`unc_comps`, `err_corr_…`).
        `to_netcdf(…, engine="h5netcdf")` keeps all of it.

        Raises:
            MissingLibrary: If xarray is not installed.
        """
        xarray = required_library("xarray", "xarray is not installed: pip install 'radiometer[xarray]'")
        return xarray.Dataset(
            _variables(self),
            coords={
                name: (name, np.arange(size), {"units": "1", "long_name": words})
                for (name, words), size in zip(_AXES.items(), self.map.shape, strict=True)
            },
            attrs={
                "Conventions": "CF-1.11",
                "title": "radiance per pixel",
                "u_rel_common": self.u_rel_common,
                "exposures_s": list(self.map.exposures_s),
                "assumptions": "; ".join(self.map.provenance.assumptions),
            },
        )

    def plot(self, axes: Axes | None = None) -> Axes:
        """Draw the only or the green map in logarithmic false colours; what is not good is left white."""
        from matplotlib.colors import LogNorm

        where, found = axes if axes is not None else new_axes(), self.picture.first
        lost = (found.mask & (PixelMask.SATURATED | PixelMask.BELOW_NOISE)) != 0
        shown = np.ma.masked_where(lost | (found.radiance <= 0), found.radiance)
        low, high = (float(shown.min()), float(shown.max())) if shown.count() else (None, None)
        drawn = where.imshow(shown, norm=LogNorm(low, high), cmap="viridis")
        figure: Any = where.figure
        figure.colorbar(drawn, ax=where, label=quantity_in_words(self.unit))
        where.set(xlabel="x in pixels", ylabel="y in pixels")
        return where

    def __repr__(self) -> str:
        height, width = self.picture.first.shape
        names = "" if len(self.maps) == 1 else f" of {', '.join(self.maps)}"
        return f"<Radiance{names} {width} × {height} pixels in {unit_text(self.unit)}: {_summary(self.picture.first)}>"


def _summary(found: RadianceMap) -> str:
    good = found.mask == 0
    if not good.any():
        return "no good pixel"
    low, high = float(found.radiance[good].min()), float(found.radiance[good].max())
    return f"{low:.4g} to {high:.4g}, {100 * good.mean():.3g} % good, {100 * found.u_rel_common:.2g} % common"


def _figures(found: RadianceMap) -> dict[str, Any]:
    sound = found.mask & (PixelMask.SATURATED | PixelMask.BELOW_NOISE) == 0
    values = found.radiance[sound]
    low, middle, high = (float(v) for v in np.percentile(values, (0, 50, 100))) if values.size else (0.0, 0.0, 0.0)
    counts = {flag.name.lower(): int(np.count_nonzero(found.mask & flag)) for flag in PixelMask if flag.name}
    return {
        "values": {"lowest": low, "median": middle, "highest": high},
        "median_u_rel": float(np.median(found.u_radiance[sound] / np.abs(values))) if values.size else None,
        "u_rel_common": found.u_rel_common,
        "pixels": {"good": int(np.count_nonzero(found.mask == 0)), **counts},
        "displacement_px": found.provenance.parameters.get("displacement_px"),
        "displacement_u_px": found.provenance.parameters.get("displacement_u_px"),
    }


def _variables(radiance: Radiance) -> dict[str, Any]:
    """Return the variables of a Dataset: dimensions, values, attributes."""
    dims, unit = ("y", "x"), radiance.unit.replace("relative", "1")
    bits = [flag for flag in PixelMask if flag]
    common = np.abs(radiance.value) * np.float32(radiance.u_rel_common)
    named = {
        "long_name": "what must be known of a pixel",
        "flag_masks": np.array([int(bit) for bit in bits], dtype=np.uint8),
        "flag_meanings": " ".join(str(flag.name).lower() for flag in bits),
    }
    noise, by_level = (part.astype(np.float32) for part in radiance.map.parts_of_u(np.s_[:, :]))
    own = {"units": unit, "long_name": "standard uncertainty of each pixel's own (k = 1)"} | _correlation("random")
    alike = {"units": unit, "long_name": "standard uncertainty shared by pixels of one level (k = 1)"}
    shared = {"units": unit, "long_name": "standard uncertainty shared by all pixels (k = 1)"} | _correlation(
        "systematic"
    )
    parts: dict[str, Any] = {"u_radiance": (dims, noise, own), "u_common": (dims, common, shared)}
    if radiance.map.u_shared is not None:
        parts["u_shared"] = (dims, by_level, alike | _correlation("systematic"))
    held = {
        "units": unit,
        "long_name": "radiance",
        "ancillary_variables": " ".join([*parts, "mask"]),
        "unc_comps": list(parts),
    }
    return {
        "radiance": (dims, radiance.value, held),
        **parts,
        "mask": (dims, radiance.mask, named),
    }


def _correlation(form: str) -> dict[str, Any]:
    """Return how errors of pixels hang together along both axes, by obsarray's names."""
    found: dict[str, Any] = {"pdf_shape": "gaussian"}
    for number, dimension in ((1, "y"), (2, "x")):
        key = f"err_corr_{number}"
        found |= {f"{key}_dim": dimension, f"{key}_form": form, f"{key}_params": [], f"{key}_units": []}
    return found


def merge(
    source: Stack | PathLike,
    response: ResponseLike | None = None,
    *,
    calibration: Calibration | PathLike | None = None,
    channel: str | None = None,
    pattern: str | None = None,
    measured_iso: Mapping[Iso, Iso] | None = None,
    iso: Iso | None = None,
    f_number: FNumber | None = None,
    linear: bool = False,
    demosaic: bool = False,
    align: str = "auto",
    keep_ghosts: bool = False,
    vignetting: PathLike | None = None,
    lens: str | None = None,
    luminance: bool = False,
    spectrum: str | None = None,
    scale: tuple[float, float] | None = None,
    taps: str | None = None,
    out: PathLike | Sequence[PathLike] = (),
    progress: Progress | None = None,
) -> Radiance:
    """Merge a bracket into radiance per pixel, by maximum likelihood over the frames that do not clip there.

    The response of photographs is recovered from them where none is given. They are treated as proportional to light
    only where they are camera raw files, or with `linear`.

    Examples:
        >>> import radiometer as rm
        >>> stack = rm.read("out/chart")
        >>> rm.merge(stack)
        <Radiance 96 × 64 pixels in relative: ...>
        >>> rm.merge(stack, calibration="calibration.yaml").unit
        'W sr-1 m-2'

    Args:
        source: Frames of one unmoving scene: a stack, a capture set, or a folder of photographs.
        response: The camera's response (.yaml, .csv, .m, .rsp), for relative values; recovered where none is given.
        calibration: Calibration, or its file: values in W·sr⁻¹·m⁻².
        channel: Of a folder of colour photographs: "luminance", "red", "green", "blue" or "each"; by default each
            where no calibration and no response of one channel is given, else the calibration's, else luminance. Of a
            capture set of a colour camera the same, with green for luminance.
        pattern: Displayed pattern of a capture set that holds several.
        measured_iso: Of photographs: real ISO speed by stated one.
        iso: ISO speed of photographs that state none.
        f_number: f-number of frames that state none.
        linear: Photographs are proportional to light above black.
        demosaic: Take camera raw files at full size, missing colours filled in: for pictures.
        align: Photographs from the hand: "auto" (where they moved), "on", or "off".
        keep_ghosts: Average what moved instead of taking it from the frames that agree.
        vignetting: Fall-off of photographs: "lensfun", or the file of a calibration with a flat field.
        lens: Name of the lens for lensfun; EXIF's by default.
        luminance: Return cd·m⁻² instead of W·sr⁻¹·m⁻².
        spectrum: Spectrum of the light; what the capture states by default, else the calibration's.
        scale: Lowest and highest value of the false colours; the picture's by default.
        taps: Of a capture set: output amplifiers, "2x2" for columns × rows of equal parts, or "find". By default those
            that the capture set or the calibration states.
        out: Files to write: .exr, .hdr, .tiff or .png. A recovered response is kept next to the first.
        progress: Called as the work goes on.

    Raises:
        CalibrationError: If the calibration does not fit camera, lens or frames.
        CaptureError: If the frames are missing or inconsistent.
        MeasurementError: If photographs hold no response.
        UsageError: If arguments exclude each other.
    """
    if calibration is not None and response is not None:
        raise UsageError("--calibration holds a response curve already; leave --response out")
    if linear and response is not None:
        raise UsageError("--linear photographs need no response curve; leave --response out")
    if align not in ALIGN_CHOICES:
        raise UsageError(f"--align {align}: choose one of {', '.join(ALIGN_CHOICES)}")
    files = tuple(Path(one) for one in ([out] if isinstance(out, str | os.PathLike) else out))
    for file in files:
        writer_for(file)
    check_outputs(*files, force=True)
    known = calibration if isinstance(calibration, Calibration | None) else Calibration.read(Path(calibration))
    map_path = files[0] if files else None
    asked = _Asked(
        known, response, channel, dict(measured_iso or {}), iso, f_number, linear, demosaic, align, keep_ghosts,
        None if vignetting is None else str(vignetting), lens, map_path, taps, spectrum,
    )  # fmt: skip
    found = (
        _of_stack(source, asked, pattern, progress or unseen)
        if isinstance(source, Stack)
        else _of_path(Path(source), asked, pattern, progress)
    )
    if luminance:
        light = spectrum_of(spectrum or found.spectrum or (known.spectrum if known else "equal_energy"))
        found = replace(found, maps={name: in_luminance(one, light) for name, one in found.maps.items()})
    found = replace(found, bounds=scale, files=files)
    for file in files:
        found.write(file)
    return found


@dataclass(frozen=True, slots=True)
class _Asked:
    """What `merge` was asked for, as its arguments."""

    calibration: Calibration | None
    response: ResponseLike | None
    channel: str | None
    measured_iso: dict[float, float]
    iso: float | None
    f_number: float | None
    linear: bool
    demosaic: bool
    align: str
    keep_ghosts: bool
    vignetting: str | None
    lens: str | None
    map_path: Path | None
    taps: str | None
    spectrum: str | None

    def curves(self, bit_depth: int) -> dict[str, ResponseCurve]:
        """Return the response as given, by channel."""
        if isinstance(self.response, Response):
            return {one.curve.channel: one.curve for one in self.response.estimates}
        found: list[tuple[str, ResponseCurve]] = []
        for one in _several(self.response):
            if isinstance(one, ResponseCurve):
                found.append((one.channel, one))
            else:
                found += read_curves(Path(one), bit_depth).items()
        return by_channel(found)


def _several(
    response: ResponseCurve | PathLike | Sequence[ResponseCurve | PathLike] | None,
) -> Sequence[ResponseCurve | PathLike]:
    if response is None:
        return ()
    return [response] if isinstance(response, ResponseCurve | str | os.PathLike) else response


def _of_path(path: Path, asked: _Asked, pattern: str | None, progress: Progress | None) -> Radiance:
    """Return the maps of a capture set, its frames in memory one at a time, or of a folder of photographs."""
    if is_photographs(path):
        if asked.taps is not None:
            raise UsageError("--taps belongs to capture sets; photographs are read as pictures")
        by_colour = asked.calibration is None and not set(asked.curves(8)) - {"red", "green", "blue"}
        channel = asked.channel or ("each" if by_colour else channel_of(asked.calibration) or "luminance")
        report = counted(progress, "reading")
        read = open_source(path, channel, report=report, interpolated=asked.demosaic)
        return _of_photographs(stack_of(read, str(path)).as_photographs(), asked, progress or unseen)
    if not (is_foreign(path) or path.is_dir()):
        what = "is not a folder" if path.exists() else "does not exist"
        raise CaptureError(f"{path} {what}; give a capture set or a folder of photographs")
    capture = open_capture(path)
    notes = tuple(imported_of(capture).lines()) if capture.store is not None else ()
    dark, lit = capture.lit_indices(pattern)
    levels = [capture.header.frames[i].settings.black_level_dn for i in lit]
    header, light = capture.header, _light(asked, capture.header.source)
    maps, camera = {}, camera_with_taps(capture, asked.taps)
    for name, plane in _planes(capture, asked):
        frames = _streamed(plane, (*dark, *lit), counted(progress, "merging"))
        maps[name] = _of_capture(frames, levels, Setup(camera, header.lens, None, *light, header.taken), asked)
    return Radiance(maps, notes=tuple(f"{path.name}: {line}" for line in notes), spectrum=_stated(light))


def _light(asked: _Asked, source: SourceDescription | None) -> tuple[SourceDescription | None, str]:
    """Return what is known of the light and its spectrum: as asked, as the capture states, or the calibration's."""
    return source, asked.spectrum or (source.spectrum if source else None) or AS_CALIBRATED


def _stated(light: tuple[SourceDescription | None, str]) -> str | None:
    return None if light[1] == AS_CALIBRATED else light[1]


def _planes(capture: CaptureSet, asked: _Asked) -> Iterator[tuple[str, CaptureSet]]:
    """Yield the planes of a mosaic of colours that are asked for, by name; the capture set itself where it has none."""
    if capture.header.camera.mosaic is None:
        yield "mono", capture
        return
    chosen = asked.channel or ("each" if asked.calibration is None else channel_of(asked.calibration) or "luminance")
    for name in COLOURS if chosen == "each" else (chosen,):
        plane = capture.in_colour(name)
        yield plane.colour or name, plane


def _streamed(capture: CaptureSet, indices: Sequence[int], report: Callable[[int, int], None]) -> Iterator[Frame]:
    for done, frame in enumerate(capture.read_frames(indices), start=1):
        yield frame
        report(done, len(indices))


def _of_stack(stack: Stack, asked: _Asked, pattern: str | None, progress: Progress) -> Radiance:
    if asked.taps is not None:
        raise UsageError("taps say how a capture set is read: give its folder, or describe them in its camera.taps")
    if stack.photographs:
        if asked.channel or asked.demosaic:
            raise UsageError("channel and demosaic say how a folder is read: give them to read_photographs")
        return _of_photographs(stack.as_photographs(), asked, progress)
    chosen = stack.chosen(pattern)
    bracket = Bracket.from_frames(with_white_levels(chosen.every_frame), origin=chosen.origin)
    levels = [frame.settings.black_level_dn for frame in bracket.light]
    light = _light(asked, stack.source)
    merged = _of_capture(bracket, levels, Setup(stack.camera, stack.lens, None, *light, stack.taken), asked)
    return Radiance({"mono": merged}, notes=stack.notes, spectrum=_stated(light))


def _of_capture(
    frames: Bracket | Iterator[Frame],
    levels: Sequence[float | None],
    setup: Setup,
    asked: _Asked,
) -> RadianceMap:
    """Return the map of a capture set: dark frames first, then light ones.

    Args:
        frames: The frames.
        levels: Black level in DN that each light frame states.
        setup: Camera, lens and light as the capture set describes them, without calibration.
        asked: What is asked for.
    """
    lens = setup.lens
    if asked.vignetting:
        raise UsageError("--vignetting belongs to photographs; a capture set takes its calibration's flat field")
    if asked.measured_iso or asked.iso is not None:
        raise UsageError("--measured-iso and --iso belong to photographs; frames of a capture set state their gain")
    if asked.f_number is not None:
        if lens.f_number is not None:
            raise UsageError(f"--f-number: the capture set states f/{lens.f_number:.4g} itself; leave it out")
        lens = lens.model_copy(update={"f_number": asked.f_number})
    camera, known = setup.camera, asked.calibration
    curve = curve_of_channel(asked.curves(camera.bit_depth), "mono")
    if known is None and curve is not None:
        # The frames' own statement comes first: it was read back from the device, the camera's is a data sheet's.
        stated = (*levels, camera.black_level_dn, black_of_curve(curve))
        known = Calibration(
            camera=camera,
            lens=lens,
            scale=Scale(value=1.0, u_rel=0.0, method="relative"),
            response=curve,
            noise=SensorNoise.of(camera),
            black_level=BlackLevel(dn=next(black for black in stated if black is not None)),
        )
    used = replace(setup, lens=lens, calibration=known)
    return _with_light(merge_bracket(frames, used), used.calibration, setup.source)


def _with_light(found: RadianceMap, known: Calibration | None, source: SourceDescription | None) -> RadianceMap:
    """Return a map that states the spectrum which its radiance is for, and that of the light as captured."""
    light = {
        "spectrum": known.spectrum if known is not None and known.absolute else "",
        "light": (source.spectrum if source else None) or "",
    }
    origin = found.provenance.parameters.get("origin", {}) | light
    return replace(
        found, provenance=replace(found.provenance, parameters={**found.provenance.parameters, "origin": origin})
    )


def _of_photographs(photographs: Photographs, asked: _Asked, progress: Progress) -> Radiance:
    depth = next(iter(photographs.brackets.values())).bit_depth
    flat, falloff = falloff_of(photographs, asked.vignetting, asked.lens, asked.calibration)
    ready = prepared(
        photographs,
        calibration=asked.calibration,
        curves=asked.curves(depth),
        linear=asked.linear,
        measured_iso=asked.measured_iso,
        iso=asked.iso,
        f_number=asked.f_number,
        align=asked.align,
        map_path=asked.map_path,
        progress=progress,
    )
    maps = merge_photographs(ready, asked.calibration, flat, keep_ghosts=asked.keep_ghosts, progress=progress)
    maps = {name: _with_light(one, asked.calibration, None) for name, one in maps.items()}
    return Radiance(maps, (), ready.files, ready.alignment, falloff, ready.notes)
