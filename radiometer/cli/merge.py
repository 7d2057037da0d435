"""`radiometer merge`: a bracket merged into a picture of radiance, with its uncertainty."""

from __future__ import annotations

import json as json_module
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from radiometer.cli.arguments import F_NUMBER_HELP, ISO_HELP, parse_bounds, parse_iso_speeds, with_f_number
from radiometer.cli.console import console, progress_bar
from radiometer.cli.iso_record import with_iso_in_map
from radiometer.errors import CaptureError, UsageError

if TYPE_CHECKING:
    from radiometer.analysis.exports.maps import Picture
    from radiometer.data import Calibration, CaptureSet, Frame, RadianceMap, ResponseCurve
    from radiometer.data.iso_speeds import IsoSpeeds


def command(
    path: Annotated[Path, typer.Argument(help="Capture set, or folder of photographs.")],
    out: Annotated[
        list[Path] | None, typer.Option("--out", "-o", help="File to write: .exr, .hdr, .tiff or .png.")
    ] = None,
    calibration: Annotated[Path | None, typer.Option(help="Calibration: values in W·sr⁻¹·m⁻².")] = None,
    response: Annotated[
        list[Path] | None, typer.Option(help="Response curve without a scale; once, or once per channel.")
    ] = None,
    channel: Annotated[
        str, typer.Option(help="Of colour photographs: luminance, red, green, blue or each.")
    ] = "luminance",
    pattern: Annotated[str | None, typer.Option(help="Displayed pattern of the capture set; the first.")] = None,
    measured_iso: Annotated[list[str] | None, typer.Option(metavar="STATED=REAL", help=ISO_HELP)] = None,
    f_number: Annotated[float | None, typer.Option(help=F_NUMBER_HELP)] = None,
    luminance: Annotated[bool, typer.Option("--luminance", help="Write cd·m⁻² instead of W·sr⁻¹·m⁻².")] = False,
    spectrum: Annotated[str | None, typer.Option(help="Spectrum for the luminance; the calibration's.")] = None,
    scale: Annotated[str | None, typer.Option(help="LOW,HIGH of the false colours; the picture's.")] = None,
    json: Annotated[bool, typer.Option("--json", help="Report as JSON on standard output.")] = False,
) -> None:
    """Merge a bracket into radiance per pixel.

    Every pixel is the maximum-likelihood value over the frames that do not clip there. .exr and .tiff carry the
    standard uncertainty and the mask as well; .png is a false-colour picture with a scale bar.
    """
    from radiometer.analysis.exports.maps import Picture, in_luminance, writer_for
    from radiometer.analysis.signal.spectra import spectrum as spectrum_of

    if not out:
        raise UsageError("-o FILE is missing: name a file that ends in .exr, .hdr, .tiff or .png")
    if calibration and response:
        raise UsageError("--calibration holds a response curve of its own; leave --response out")
    writers = [(file, writer_for(file)) for file in out]
    bounds = parse_bounds(scale, "--scale") if scale else None
    known = _calibration(calibration)
    speeds = parse_iso_speeds(measured_iso, known)
    maps = _maps(path, known, _curves(response), channel, pattern, speeds, f_number)
    if luminance:
        chosen = spectrum_of(spectrum or (known.spectrum if known else "equal_energy"))
        maps = {name: in_luminance(found, chosen) for name, found in maps.items()}
    picture = Picture(maps, bounds)
    for file, write in writers:
        write(file, picture)
    report = _report(picture, out)
    print(json_module.dumps(report, ensure_ascii=False)) if json else _show(report)


def _calibration(path: Path | None) -> Calibration | None:
    from radiometer.data import Calibration

    return Calibration.read(path) if path else None


def _curves(paths: list[Path] | None) -> dict[str, ResponseCurve]:
    """Return curves by channel; a single one stands under its own channel and serves all."""
    from radiometer.data import ResponseCurve

    curves = [ResponseCurve.read(path) for path in paths or ()]
    by_channel = {curve.channel: curve for curve in curves}
    if len(by_channel) < len(curves):
        raise UsageError("two response curves are of the same channel; YAML curves say which channel they are of")
    return by_channel


def _maps(
    path: Path,
    calibration: Calibration | None,
    curves: dict[str, ResponseCurve],
    channel: str,
    pattern: str | None,
    speeds: IsoSpeeds,
    f_number: float | None,
) -> dict[str, RadianceMap]:
    from radiometer.data.capture_set import HEADER_NAME
    from radiometer.importing import is_foreign

    if is_foreign(path):
        return {"mono": _merge_capture(path, calibration, curves, pattern, f_number)}
    if not path.is_dir():
        raise CaptureError(f"{path} does not exist or is no folder; give a capture set or a folder of photographs")
    if (path / HEADER_NAME).exists():
        speeds.refuse_unstated(str(path), set())
        return {"mono": _merge_capture(path, calibration, curves, pattern, f_number)}
    if calibration is None and not curves:
        raise UsageError(
            "photographs are not linear: give --response, recovered with `radiometer response`, or --calibration"
        )
    return _merge_photographs(path, calibration, curves, channel, speeds, f_number)


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
    for index in (*dark, *sorted(light, key=lambda i: entries[i].settings.effective_exposure_s)):
        yield capture.read_frame(index)
        step()


def _merge_photographs(
    path: Path,
    calibration: Calibration | None,
    curves: dict[str, ResponseCurve],
    channel: str,
    speeds: IsoSpeeds,
    f_number: float | None,
) -> dict[str, RadianceMap]:
    from radiometer.analysis.merge.bracket import merge
    from radiometer.bench.sources import open_brackets
    from radiometer.data import CameraDescription, LensDescription

    with progress_bar() as bar:
        task = bar.add_task("reading", total=None)
        brackets = open_brackets(
            path, channel, report=lambda done, total: bar.update(task, completed=done, total=total), speeds=speeds
        )
    maps: dict[str, RadianceMap] = {}
    for bracket in (with_f_number(one, f_number) for one in brackets):
        name = str(bracket.frames[0].extra.get("channel", "mono"))
        camera = calibration.camera if calibration else CameraDescription(bit_depth=bracket.bit_depth)
        black_dn = bracket.frames[0].settings.black_level_dn or 0.0
        known = calibration or _relative(curves, name, camera, LensDescription(), black_dn)
        maps[name] = with_iso_in_map(merge(bracket, camera, LensDescription(), known), bracket)
    return maps


def _relative(
    curves: dict[str, ResponseCurve], channel: str, camera: Any, lens: Any, black_dn: float
) -> Calibration | None:
    """Return a calibration without a scale from the curve of a channel; None where no curve was given."""
    from radiometer.data import BlackLevel, Calibration, Scale, SensorNoise

    if not curves:
        return None
    if channel not in curves and len(curves) > 1:
        raise UsageError(f"there is no response curve of the channel {channel!r}; give one per channel, or one for all")
    curve = curves.get(channel) or next(iter(curves.values()))
    return Calibration(
        camera=camera,
        lens=lens,
        scale=Scale(value=1.0, u_rel=0.0, method="relative"),
        response=curve,
        noise=SensorNoise.of(camera),
        black_level=BlackLevel(dn=black_dn),
    )


def _report(picture: Picture, out: list[Path]) -> dict[str, Any]:
    import numpy as np

    from radiometer.data import PixelMask

    found = picture.first
    sound = found.mask & (PixelMask.SATURATED | PixelMask.BELOW_NOISE) == 0
    values = found.radiance[sound]
    low, middle, high = (float(v) for v in np.percentile(values, (0, 50, 100))) if values.size else (0.0, 0.0, 0.0)
    noise = float(np.median(found.u_radiance[sound] / np.abs(values))) if values.size else None
    counts = {flag.name.lower(): int(np.count_nonzero(found.mask & flag)) for flag in PixelMask if flag.name}
    return {
        "files": [str(file) for file in out],
        "width": found.shape[1],
        "height": found.shape[0],
        "channels": list(picture.maps),
        "unit": picture.unit,
        "exposures_s": list(found.exposures_s),
        "values": {"lowest": low, "median": middle, "highest": high},
        "median_u_rel": noise,
        "u_rel_common": found.u_rel_common,
        "pixels": {"good": int(np.count_nonzero(found.mask == 0)), **counts},
        "iso": found.provenance.parameters.get("iso", []),
        "assumptions": list(found.provenance.assumptions),
    }


def _show(report: dict[str, Any]) -> None:
    out, values = console(), report["values"]
    out.print(
        f"{report['width']} × {report['height']} pixels, {len(report['exposures_s'])} exposures, in {report['unit']}"
    )
    out.print(f"values     {values['lowest']:.4g} to {values['highest']:.4g}, median {values['median']:.4g}")
    if report["median_u_rel"] is not None:
        common = 100 * report["u_rel_common"]
        out.print(
            f"noise      {100 * report['median_u_rel']:.3g} % per pixel (median, k = 1), {common:.3g} % common to all"
        )
    total = report["width"] * report["height"]
    for name, count in report["pixels"].items():
        if count:
            out.print(f"{name.replace('_', ' '):<13}{count} pixels ({100 * count / total:.2g} %)")
    for assumption in report["assumptions"]:
        out.print(f"assumed    {assumption}")
    for file in report["files"]:
        out.print(f"written    {file}")
