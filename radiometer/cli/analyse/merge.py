"""`radiometer merge`: a bracket merged into a picture of radiance, with its uncertainty."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

import radiometer as rm
from radiometer.cli.analyse.merge_report import show_map_report
from radiometer.cli.arguments import F_NUMBER_HELP, ISO_HELP, UNSTATED_ISO_HELP, parse_bounds, parse_measured_iso
from radiometer.cli.console import note, progress
from radiometer.cli.options import TapsOption
from radiometer.cli.outputs import writes
from radiometer.errors import UsageError


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
    pattern: Annotated[str | None, typer.Option(help="Displayed pattern of a capture set that holds several.")] = None,
    measured_iso: Annotated[list[str] | None, typer.Option(metavar="STATED=REAL", help=ISO_HELP)] = None,
    iso: Annotated[float | None, typer.Option(help=UNSTATED_ISO_HELP)] = None,
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
    taps: TapsOption = None,
    json: Annotated[bool, typer.Option("--json", help="Report as JSON on standard output.")] = False,
) -> None:
    """Merge a bracket into radiance per pixel.

    Every pixel is the maximum-likelihood value over the frames that do not clip there. .exr and .tiff carry the
    standard uncertainty and the mask as well; .png is a false-colour picture with a scale bar. The response of
    photographs is recovered from them where none is given, and kept with the first file written. Their displacement by
    parts of a pixel is reported with its uncertainty, and counts where the picture changes.
    """
    if not out:
        raise UsageError("-o FILE is missing: name a file that ends in .exr, .hdr, .tiff or .png")
    with progress(shown=not json) as shown:
        found = rm.merge(
            path, response or None, calibration=calibration, channel=channel, pattern=pattern,
            measured_iso=parse_measured_iso(measured_iso), iso=iso, f_number=f_number, linear=linear,
            demosaic=demosaic, align=align, keep_ghosts=keep_ghosts, vignetting=vignetting, lens=lens,
            luminance=luminance, spectrum=spectrum, scale=parse_bounds(scale, "--scale") if scale else None, taps=taps,
            out=out, progress=shown,
        )  # fmt: skip
    for text in found.notes:
        note(text)
    print(found.to_json()) if json else show_map_report(found.to_mapping())
