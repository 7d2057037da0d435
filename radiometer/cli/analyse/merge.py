"""`radiometer merge`: a bracket merged into a picture of radiance, with its uncertainty."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer

import radiometer as rm
from radiometer.cli.arguments import F_NUMBER_HELP, ISO_HELP, UNSTATED_ISO_HELP, parse_bounds, parse_measured_iso
from radiometer.cli.console import console, note, progress
from radiometer.cli.options import TapsOption
from radiometer.cli.outputs import writes
from radiometer.errors import UsageError
from radiometer.numbers import unit_text


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
        typer.Option(help="Of colour frames: luminance, red, green, blue or each (the default without curves)."),
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
    spectrum: Annotated[str | None, typer.Option(help="Spectrum of the light; the capture's or calibration's.")] = None,
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


def displacement_in_words(px: float, u_px: float) -> str:
    """Return in words how far the frames are displaced against each other.

    Args:
        px: Standard deviation of a frame's displacement in pixels; 0 where none shows.
        u_px: Its standard uncertainty, or what would have shown.
    """
    if not px and not u_px:  # none of the pixels asked says anything of it
        return "displacement is unknown: these frames cannot show one"
    if not px:
        return f"no displacement found; one below about {u_px:.1g} pixels cannot be detected and is not in u"
    decimals = max(0, 1 - math.floor(math.log10(u_px)))  # two digits of the uncertainty
    return f"displaced by {px:.{decimals}f} ± {u_px:.{decimals}f} pixels (k = 1), in u where the picture changes"


def show_map_report(report: dict[str, Any]) -> None:
    """Print a map's JSON form for people.

    Args:
        report: As of `Radiance.to_mapping`.
    """
    out, total = console(), report["width"] * report["height"]
    unit = "relative values" if report["unit"] == "relative" else f"in {unit_text(report['unit'])}"
    out.print(f"{report['width']} × {report['height']} pixels, {len(report['exposures_s'])} exposures, {unit}")
    for text in _of_channels(report, _values_in_words):
        out.print(f"values     {text}")
    for text in _of_channels(report, _noise_in_words):
        out.print(f"noise      {text}")
    for name in report["pixels"]:
        counts = {channel: one["pixels"][name] for channel, one in report["by_channel"].items()}
        if any(counts.values()):
            out.print(f"{name.replace('_', ' '):<13}{_pixels_in_words(counts, total)}")
    if report["alignment"]:
        out.print(f"frames     {report['alignment']}")
    for text in _of_channels(report, _displacement_of):
        out.print(f"frames     {text}")
    if report["falloff"]:
        out.print(f"lens       {report['falloff']}")
    for assumption in report["assumptions"]:
        out.print(f"assumed    {assumption}")
    for file in report["responses"]:
        out.print(f"response   {file}")
    for file in report["files"]:
        out.print(f"written    {file}")


def _of_channels(report: dict[str, Any], describe: Callable[[dict[str, Any]], str]) -> list[str]:
    """Return a text of every channel with its name; of all at once where they have the same or there is but one."""
    texts = {name: describe(figures) for name, figures in report["by_channel"].items()}
    if len(set(texts.values())) == 1:
        return [text for text in set(texts.values()) if text]
    return [f"{name}: {text}" for name, text in texts.items() if text]


def _values_in_words(figures: dict[str, Any]) -> str:
    values = figures["values"]
    return f"{values['lowest']:.4g} to {values['highest']:.4g}, median {values['median']:.4g}"


def _noise_in_words(figures: dict[str, Any]) -> str:
    if figures["median_u_rel"] is None:
        return ""
    each, common = 100 * figures["median_u_rel"], 100 * figures["u_rel_common"]
    return f"{each:.3g} % per pixel (median, k = 1), {common:.3g} % common to all"


def _pixels_in_words(counts: dict[str, int], total: int) -> str:
    shares = [f"{100 * count / total:.3g}" for count in counts.values()]
    if len(counts) == 1:
        return f"{next(iter(counts.values()))} pixels ({shares[0]} %)"
    return f"{', '.join(f'{name} {count}' for name, count in counts.items())} pixels ({', '.join(shares)} %)"


def _displacement_of(figures: dict[str, Any]) -> str:
    if figures["displacement_u_px"] is None:
        return ""
    return displacement_in_words(figures["displacement_px"], figures["displacement_u_px"])
