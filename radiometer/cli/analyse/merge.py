"""`radiometer merge`: a bracket merged into a picture of radiance, with its uncertainty."""

from __future__ import annotations

import json as json_module
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from radiometer.cli.arguments import F_NUMBER_HELP, ISO_HELP, parse_bounds, parse_iso_speeds, with_f_number
from radiometer.cli.console import progress_bar
from radiometer.cli.outputs import writes
from radiometer.errors import CaptureError, UsageError
from radiometer.photographs.alignment import ALIGN_CHOICES
from radiometer.photographs.iso_record import with_iso_in_map

if TYPE_CHECKING:
    from radiometer.data import Bracket, Calibration, CaptureSet, FlatField, Frame, RadianceMap, ResponseCurve
    from radiometer.data.iso_speeds import IsoSpeeds


@writes("out")
def command(
    path: Annotated[Path, typer.Argument(help="Capture set, or folder of photographs.")],
    out: Annotated[
        list[Path] | None, typer.Option("--out", "-o", help="File to write: .exr, .hdr, .tiff or .png.")
    ] = None,
    calibration: Annotated[Path | None, typer.Option(help="Calibration: values in W·sr⁻¹·m⁻².")] = None,
    response: Annotated[
        list[Path] | None,
        typer.Option(help="Response curve (.yaml, .csv, .m, .rsp) without a scale; recovered where none is given."),
    ] = None,
    channel: Annotated[
        str | None,
        typer.Option(help="Of colour photographs: luminance, red, green, blue or each (the default without curves)."),
    ] = None,
    pattern: Annotated[str | None, typer.Option(help="Displayed pattern of the capture set; the first.")] = None,
    measured_iso: Annotated[list[str] | None, typer.Option(metavar="STATED=REAL", help=ISO_HELP)] = None,
    f_number: Annotated[float | None, typer.Option(help=F_NUMBER_HELP)] = None,
    linear: Annotated[
        bool, typer.Option("--linear", help="Photographs are linear above black (raw files always are).")
    ] = False,
    demosaic: Annotated[
        bool, typer.Option("--demosaic", help="Camera raw files at full size, missing colours filled in: for pictures.")
    ] = False,
    align: Annotated[
        str, typer.Option(help="Photographs from the hand: auto (where they moved), on, or off.", metavar="auto|on|off")
    ] = "auto",
    keep_ghosts: Annotated[
        bool, typer.Option("--keep-ghosts", help="Average what moved instead of taking it from frames that agree.")
    ] = False,
    vignetting: Annotated[
        str | None,
        typer.Option(metavar="lensfun|FILE", help="Fall-off of photographs: lensfun's, or a calibration's flat field."),
    ] = None,
    lens: Annotated[str | None, typer.Option(help="Name of the lens for --vignetting lensfun; EXIF's.")] = None,
    luminance: Annotated[bool, typer.Option("--luminance", help="Write cd·m⁻² instead of W·sr⁻¹·m⁻².")] = False,
    spectrum: Annotated[str | None, typer.Option(help="Spectrum for the luminance; the calibration's.")] = None,
    scale: Annotated[str | None, typer.Option(help="LOW,HIGH of the false colours; the picture's.")] = None,
    json: Annotated[bool, typer.Option("--json", help="Report as JSON on standard output.")] = False,
) -> None:
    """Merge a bracket into radiance per pixel.

    Every pixel is the maximum-likelihood value over the frames that do not clip there. .exr and .tiff carry the
    standard uncertainty and the mask as well; .png is a false-colour picture with a scale bar. The response of
    photographs is recovered from them where none is given, and kept beside the first file written. How far they lie
    apart by parts of a pixel is told with its uncertainty, and counts where the picture changes.
    """
    from radiometer.analysis.exports.maps import MapPicture, in_luminance, writer_for
    from radiometer.analysis.photometry.spectra import spectrum as spectrum_of
    from radiometer.cli.analyse.merge_report import map_report, show_map_report

    if not out:
        raise UsageError("-o FILE is missing: name a file that ends in .exr, .hdr, .tiff or .png")
    if calibration and response:
        raise UsageError("--calibration holds a response curve of its own; leave --response out")
    if linear and response:
        raise UsageError("--linear photographs need no response curve; leave --response out")
    if align not in ALIGN_CHOICES:
        raise UsageError(f"--align {align}: choose one of {', '.join(ALIGN_CHOICES)}")
    if lens and vignetting != "lensfun":
        raise UsageError("--lens names the lens for --vignetting lensfun")
    writers = [(file, writer_for(file)) for file in out]
    bounds = parse_bounds(scale, "--scale") if scale else None
    known = _calibration(calibration)
    speeds = parse_iso_speeds(measured_iso, known)
    options = _Options(
        known,
        response or [],
        channel,
        speeds,
        f_number,
        linear,
        out[0],
        align,
        without_ghosts=not keep_ghosts,
        vignetting=vignetting,
        lens=lens,
        demosaic=demosaic,
    )
    maps, beside = _maps(path, pattern, options)
    if luminance:
        chosen = spectrum_of(spectrum or (known.spectrum if known else "equal_energy"))
        maps = {name: in_luminance(found, chosen) for name, found in maps.items()}
    picture = MapPicture(maps, bounds)
    for file, write in writers:
        write(file, picture)
    report = {**map_report(picture, out), "responses": [str(file) for file in beside.responses]}
    report["alignment"], report["falloff"] = beside.alignment, beside.falloff
    print(json_module.dumps(report, ensure_ascii=False)) if json else show_map_report(report)


def _calibration(path: Path | None) -> Calibration | None:
    from radiometer.data import Calibration

    return Calibration.read(path) if path else None


@dataclass(frozen=True, slots=True)
class _Options:
    """What the command was told of the frames.

    Attributes:
        calibration: The calibration; None for relative values.
        responses: Files of response curves.
        channel: Channel of photographs asked for.
        speeds: What is known of ISO speeds.
        f_number: Of frames that state none.
        linear: Whether photographs are linear.
        beside: File that a recovered response is kept beside.
        align: Whether photographs are aligned: "auto", "on" or "off".
        without_ghosts: Whether what moved is taken from the frames that agree.
        vignetting: "lensfun", or the file of a calibration with a flat field; None takes nothing out.
        lens: Name of the lens for lensfun.
        demosaic: Whether raw files are filled in to full size.
    """

    calibration: Calibration | None
    responses: list[Path]
    channel: str | None
    speeds: IsoSpeeds
    f_number: float | None
    linear: bool
    beside: Path
    align: str = "auto"
    without_ghosts: bool = True
    vignetting: str | None = None
    lens: str | None = None
    demosaic: bool = False


@dataclass(frozen=True, slots=True)
class _Beside:
    """What else came of a merge.

    Attributes:
        responses: Files that a recovered response is kept in.
        alignment: How the photographs lie to each other, in a sentence; None where that was not asked.
        falloff: What fall-off was taken out, in a sentence; None where none was.
    """

    responses: tuple[Path, ...] = ()
    alignment: str | None = None
    falloff: str | None = None


def _maps(path: Path, pattern: str | None, options: _Options) -> tuple[dict[str, RadianceMap], _Beside]:
    """Return the maps by channel, and what else came of it."""
    from radiometer.data.capture_set import HEADER_NAME
    from radiometer.importing import is_foreign
    from radiometer.photographs.response import curves_of

    foreign = is_foreign(path)
    if not (foreign or path.is_dir()):
        what = "is not a folder" if path.exists() else "does not exist"
        raise CaptureError(f"{path} {what}; give a capture set or a folder of photographs")
    if foreign or (path / HEADER_NAME).exists():
        if options.vignetting:
            raise UsageError("--vignetting belongs to photographs; a capture set takes its calibration's flat field")
        if not foreign:
            options.speeds.refuse_unstated(str(path), set())
        curves = curves_of(options.responses, 8)
        return {"mono": _merge_capture(path, options.calibration, curves, pattern, options.f_number)}, _Beside()
    return _merge_photographs(path, options)


def _merge_capture(
    path: Path,
    calibration: Calibration | None,
    curves: dict[str, ResponseCurve],
    pattern: str | None,
    f_number: float | None,
) -> RadianceMap:
    from radiometer.analysis.merge.bracket import merge
    from radiometer.cli.direct import opened

    capture = opened(path)
    header = capture.header
    levels = (header.camera.black_level_dn, *(entry.black_level_dn for entry in header.frames))
    black_dn = next((level for level in levels if level is not None), 0.0)
    known = calibration or _relative(curves, "mono", header.camera, header.lens, black_dn)
    lens = header.lens
    if f_number is not None:
        if lens.f_number is not None:
            raise UsageError(f"--f-number: the capture set states f/{lens.f_number:.4g} itself; leave it out")
        lens = lens.model_copy(update={"f_number": f_number})
    with progress_bar() as bar:
        task = bar.add_task("merging", total=len(capture))
        return merge(_frames(capture, pattern, lambda: bar.update(task, advance=1)), header.camera, lens, known)


def _frames(capture: CaptureSet, pattern: str | None, step: Any) -> Iterator[Frame]:
    """Yield dark frames, then the light frames of one pattern at the source's highest level, one at a time."""
    entries = capture.header.frames
    wanted = pattern or next((e.pattern for e in entries if e.shutter == "open" and e.source_level > 0), "default")
    dark = [i for i, entry in enumerate(entries) if entry.shutter == "closed"]
    light = [i for i, e in enumerate(entries) if e.shutter == "open" and e.pattern == wanted and e.source_level > 0]
    if not light:
        there = ", ".join(sorted({entry.pattern for entry in entries}))
        raise CaptureError(f"{capture.path}: holds no lit frame of pattern {wanted!r}; there are: {there}")
    level = max(entries[i].source_level for i in light)
    light = [i for i in light if entries[i].source_level == level]
    order = [*dark, *sorted(light, key=lambda i: entries[i].settings.effective_exposure_s)]
    for frame in capture.read_frames(order):
        yield frame
        step()


def _merge_photographs(path: Path, options: _Options) -> tuple[dict[str, RadianceMap], _Beside]:
    from radiometer.bench.sources import open_brackets
    from radiometer.cli.console import note
    from radiometer.photographs.alignment import in_one_place
    from radiometer.photographs.response import (
        curves_of,
        in_their_own_depth,
        linear_doubt,
        offset_told,
        recovered_curves,
        refuse_another_channel,
        with_found_times,
    )

    curves, calibration = curves_of(options.responses, 8), options.calibration
    by_colour = not calibration and not set(curves) - {"red", "green", "blue"}
    with progress_bar() as bar:
        task = bar.add_task("reading", total=None)
        brackets = open_brackets(
            path,
            options.channel or ("each" if by_colour else "luminance"),
            report=lambda done, total: bar.update(task, completed=done, total=total),
            speeds=options.speeds,
            interpolated=options.demosaic,
        )
    if calibration:
        for bracket in brackets:
            refuse_another_channel(calibration, bracket)
    elif options.linear:
        brackets = in_their_own_depth(brackets)
    flat, falloff = _falloff(path, brackets[0], options)  # what it refuses is refused before the work
    placed = in_one_place(brackets, options.align)
    brackets = placed.brackets
    files: list[Path] = []
    if options.responses and brackets[0].bit_depth != 8:
        curves = curves_of(options.responses, brackets[0].bit_depth)
    raw = all("raw" in frame.extra for bracket in brackets for frame in bracket)
    if not (calibration or curves or raw or options.linear):
        curves, files = recovered_curves(placed.common, options.beside, note)
        brackets = [with_found_times(b, curves[str(b.frames[0].extra.get("channel", "mono"))]) for b in brackets]
        said = {channel: offset_told(curve) for channel, curve in curves.items()}
    else:
        brackets, said = _with_offsets(path, brackets, curves, calibration)
    asked = placed.common if options.linear and not (calibration or raw) else []
    doubts = {str(b.frames[0].extra.get("channel", "mono")): doubt for b in asked if (doubt := linear_doubt(b))}
    for name, doubt in doubts.items():
        note(f"{name}: {doubt}")
    several = [with_f_number(bracket, options.f_number) for bracket in brackets]
    maps: dict[str, RadianceMap] = {}
    for bracket in several:
        maps |= _merged(bracket, calibration, curves, placed.absent, flat, without_ghosts=options.without_ghosts)
    for texts in (doubts, said):
        maps = {name: _with_assumption(found, texts.get(name)) for name, found in maps.items()}
    return maps, _Beside(tuple(files), placed.sentence, falloff)


def _with_offsets(
    path: Path, brackets: Sequence[Bracket], curves: dict[str, ResponseCurve], calibration: Calibration | None
) -> tuple[list[Bracket], dict[str, str | None]]:
    """Return photographs with the shutter's offset of what was given, which is said, and what their maps say of it."""
    from radiometer.bench.sources import exposure_list
    from radiometer.cli.console import note
    from radiometer.photographs.response import with_offset_of_calibration, with_offset_of_response

    listed = exposure_list(path)
    timed: list[Bracket] = []
    said: dict[str, str | None] = {}
    notes: dict[str, list[str]] = {}
    for bracket in brackets:
        channel = str(bracket.frames[0].extra.get("channel", "mono"))
        curve = _of_channel(curves, channel) if curves else None
        if calibration:
            one, text, taken = with_offset_of_calibration(bracket, calibration, listed)
        else:
            one, text, taken = with_offset_of_response(bracket, curve, listed)
        timed.append(one)
        said[channel] = text if taken else None
        if text:
            notes.setdefault(text, []).append(channel)
    for text, channels in notes.items():
        note(f"{', '.join(channels)}: {text}")
    return timed, said


def _with_assumption(found: RadianceMap, text: str | None) -> RadianceMap:
    origin = found.provenance
    return replace(found, provenance=replace(origin, assumptions=(*origin.assumptions, text))) if text else found


def _falloff(path: Path, bracket: Bracket, options: _Options) -> tuple[FlatField | None, str | None]:
    """Return the fall-off that is to be taken out of photographs, and what to say of it."""
    from radiometer.bench.sources import lensfun_falloff
    from radiometer.data import Calibration

    if options.vignetting is None:
        return None, None
    if options.calibration is not None and options.calibration.flat_field is not None:
        raise UsageError("--vignetting: the calibration has a flat field of its own; leave one of them out")
    if options.vignetting == "lensfun":
        return lensfun_falloff(path, bracket, options.lens)
    flat = Calibration.read(Path(options.vignetting)).flat_field
    if flat is None:
        raise UsageError(f"--vignetting {options.vignetting}: that calibration has no flat field (calibrate --flat)")
    if flat.shape != bracket.shape:
        raise UsageError(
            f"--vignetting {options.vignetting}: made from frames of {flat.shape[1]} × {flat.shape[0]} pixels, the "
            f"photographs have {bracket.shape[1]} × {bracket.shape[0]}"
        )
    return flat, f"fall-off by the flat field of {Path(options.vignetting).name}"


def _merged(
    bracket: Bracket,
    calibration: Calibration | None,
    curves: dict[str, ResponseCurve],
    absent: Sequence[Any],
    flat: FlatField | None,
    *,
    without_ghosts: bool,
) -> dict[str, RadianceMap]:
    """Return the map of a bracket by its channel."""
    from radiometer.analysis.merge.bracket import merge
    from radiometer.data import CameraDescription, LensDescription
    from radiometer.photographs.response import displacement_of, relative_calibration, with_displacement_told

    name = str(bracket.frames[0].extra.get("channel", "mono"))
    camera = calibration.camera if calibration else CameraDescription(bit_depth=bracket.bit_depth)
    curve = _of_channel(curves, name)
    if calibration:
        known, displacement = calibration, displacement_of(bracket, calibration.response)
    else:
        known, displacement = relative_calibration(bracket, curve, camera, LensDescription())
    known = replace(known, flat_field=flat) if flat else known
    found = merge(
        bracket,
        camera,
        LensDescription(),
        known,
        absent=absent,
        without_ghosts=without_ghosts,
        displacement_px=displacement.px if displacement else 0.0,
    )
    for text in _assumed_of(curve, name) if curve else ():
        found = _with_assumption(found, text)
    return {name: with_iso_in_map(with_displacement_told(found, displacement), bracket)}


def _assumed_of(curve: ResponseCurve, channel: str) -> tuple[str, ...]:
    """Return what a map takes for granted of its response: an uncertainty that no file states, another's colour."""
    from radiometer.analysis.exports.curves import FILE_METHOD

    origin = curve.provenance
    of_file = origin.assumptions if origin.method == FILE_METHOD else ()
    if channel in (curve.channel, "mono"):
        return of_file
    return (*of_file, f"the response curve given ({curve.channel}) holds for {channel}")


def _relative(
    curves: dict[str, ResponseCurve], channel: str, camera: Any, lens: Any, black_dn: float
) -> Calibration | None:
    """Return a calibration without a scale from the curve of a channel; None where no curve was given."""
    from radiometer.data import BlackLevel, Calibration, Scale, SensorNoise

    curve = _of_channel(curves, channel)
    if curve is None:
        return None
    return Calibration(
        camera=camera,
        lens=lens,
        scale=Scale(value=1.0, u_rel=0.0, method="relative"),
        response=curve,
        noise=SensorNoise.of(camera),
        black_level=BlackLevel(dn=black_dn),
    )


def _of_channel(curves: dict[str, ResponseCurve], channel: str) -> ResponseCurve | None:
    """Return the curve of a channel, or the only one; None where there is none at all."""
    if channel not in curves and len(curves) > 1:
        raise UsageError(f"there is no response curve of the channel {channel!r}; give one per channel, or one for all")
    return curves.get(channel) or next(iter(curves.values()), None)
