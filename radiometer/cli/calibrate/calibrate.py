"""`radiometer calibrate`: the absolute scale of a camera, written as one calibration file."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

import radiometer as rm
from radiometer.cli.arguments import (
    ISO_HELP,
    parse_exposure,
    parse_f_number,
    parse_measured_iso,
    parse_patch,
    parse_radiance,
    parse_seconds,
)
from radiometer.cli.console import console, note, progress
from radiometer.cli.options import TapsOption, relative_option
from radiometer.cli.outputs import writes
from radiometer.errors import UsageError
from radiometer.numbers import with_u
from radiometer.plausible import FNumber, Iso, MeterConstant, Positive

if TYPE_CHECKING:
    from radiometer import Patch


@writes("out")
def command(
    capture: Annotated[Path | None, typer.Argument(help="Capture set or photographs of the known source.")] = None,
    out: Annotated[Path | None, typer.Option("--out", "-o", help="Calibration file to write.")] = None,
    response: Annotated[Path | None, typer.Option(help="Response curve; linear above black without one.")] = None,
    patch: Annotated[
        str | None, typer.Option(help="The known source: X,Y,W,H, or a patch name of the capture.")
    ] = None,
    radiance: Annotated[
        str | None, typer.Option(help="Its radiance in W·sr⁻¹·m⁻², or its calibration certificate (DCC, .xml).")
    ] = None,
    luminance: Annotated[Positive | None, typer.Option(help="Luminance in cd·m⁻², instead of the radiance.")] = None,
    u_rel: Annotated[float | None, relative_option("--u-rel", "Its relative u (k = 1)")] = None,
    meter_k: Annotated[
        MeterConstant | None,
        typer.Option("--luminance-meter-k", help="Constant K of the camera's light meter (ISO 2720)."),
    ] = None,
    k_u_rel: Annotated[
        float | None,
        relative_option("--k-u-rel", "Relative u (k = 1) of K beyond the meter's ±1/6 stop; 6.7 % (ISO 2720)"),
    ] = None,
    f_number: Annotated[
        FNumber | None,
        typer.Option(
            parser=lambda text: parse_f_number(text, "--f-number"),
            metavar="N",
            help="f-number of the reference photograph, or of frames that do not state theirs.",
        ),
    ] = None,
    exposure: Annotated[str | None, typer.Option(help="Its exposure time, such as 1/125.")] = None,
    iso: Annotated[
        Iso | None, typer.Option(help="Its ISO speed: as really measured, or stated (--measured-iso).")
    ] = None,
    measured_iso: Annotated[list[str] | None, typer.Option(metavar="STATED=REAL", help=ISO_HELP)] = None,
    channel: Annotated[str, typer.Option(help="Of colour frames: luminance, red, green or blue.")] = "luminance",
    pattern: Annotated[str | None, typer.Option(help="Pattern of a capture set that holds several.")] = None,
    align: Annotated[
        str, typer.Option(help="Photographs from the hand: auto (where they moved), on, or off.", metavar="auto|on|off")
    ] = "auto",
    reference_dn: Annotated[Positive | None, typer.Option(help="Its pixel value; half of full scale.")] = None,
    dynamic_range: Annotated[
        list[str] | None,
        typer.Option(
            help="M,TIME[,LANDED]: the region at pixel value M of the reference photograph lands on the reference "
            "value (or on LANDED) at TIME; once per region. Puts the exponent of the curve right."
        ),
    ] = None,
    as_printed: Annotated[
        bool, typer.Option("--as-printed", help="Take settings at face value, not as stops.")
    ] = False,
    spectrum: Annotated[
        str | None, typer.Option(help="Spectrum of the source, or a CSV; equal energy to 43 % where not stated.")
    ] = None,
    black_level: Annotated[float | None, typer.Option(help="Black level in DN; the capture's by default.")] = None,
    validity_days: Annotated[Positive, typer.Option(help="Days the calibration is valid for.")] = 365.0,
    spectral_response: Annotated[
        Path | None, typer.Option(help="CSV of wavelength in nm and relative response per watt of the camera.")
    ] = None,
    flat: Annotated[Path | None, typer.Option(help="Capture set of an evenly bright source: the flat field.")] = None,
    flat_u_rel: Annotated[float, relative_option("--flat-u-rel", "Relative u (k = 1) of that source's evenness")] = 0.0,
    camera: Annotated[str | None, typer.Option(help="Capture now with this camera: sim, id, serial, address.")] = None,
    bench: Annotated[Path | None, typer.Option(help="Bench file for --camera.")] = None,
    taps: TapsOption = None,
    camera_file: Annotated[
        Path | None, typer.Option(help="Camera file of `radiometer characterise`: gain, noise, saturation as measured.")
    ] = None,
    model: Annotated[
        Path | None, typer.Option(help="Model of `radiometer reconcile`: readings are corrected for its effects.")
    ] = None,
    stated: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME=U", help="Uncertainty of readings that you know better, such as glare_u=0.002."),
    ] = None,
    json: Annotated[bool, typer.Option("--json", help="Report as JSON on standard output.")] = False,
) -> None:
    """Give a response curve its absolute scale.

    The scale comes from a source of known radiance or luminance (a capture set, or --camera), or from the constant K of
    a light meter and the settings it asked for. With both, their ratio is printed and the less uncertain is used.
    """
    if out is None:
        raise UsageError("-o FILE is missing: name the file to write the calibration to")
    with progress(shown=not json) as shown:
        found = rm.calibrate(
            capture, out=out, response=response, patch=_patch(patch), radiance=parse_radiance(radiance),
            luminance=luminance, u_rel=u_rel, luminance_meter_k=meter_k, k_u_rel=k_u_rel, f_number=f_number,
            exposure_s=parse_exposure(exposure, "--exposure"), iso=iso,
            measured_iso=parse_measured_iso(measured_iso), channel=channel, pattern=pattern, align=align,
            reference_dn=reference_dn, dynamic_range=[_region(word) for word in dynamic_range or ()],
            as_printed=as_printed, spectrum=spectrum, black_level=black_level, validity_days=validity_days,
            spectral_response=spectral_response, flat=flat, flat_u_rel=flat_u_rel, camera=camera, bench=bench,
            camera_file=camera_file, model=model, taps=taps, stated=dict(_stated(word) for word in stated or ()),
            progress=shown,
        )  # fmt: skip
    for text in found.notes:
        note(text)
    print(found.to_json()) if json else show_report(found.to_mapping())


def _patch(text: str | None) -> Patch | str | None:
    """Return a patch by its numbers, or its name in the capture set."""
    return text if text is None or "," not in text else parse_patch(text)


def _region(word: str) -> tuple[float, ...]:
    """Return M, TIME in s and LANDED of a region that `--dynamic-range` names."""
    parts = word.split(",")
    try:
        number, landed = float(parts[0]), tuple(float(part) for part in parts[2:])
    except ValueError as error:
        raise UsageError(_region_form(word)) from error
    if len(parts) not in (2, 3):
        raise UsageError(_region_form(word))
    return (number, parse_seconds(parts[1], "--dynamic-range"), *landed)


def _region_form(word: str) -> str:
    return (
        f"--dynamic-range {word!r}: expected M,TIME or M,TIME,LANDED, such as 254,1/2000: the region at pixel value M "
        "of the reference photograph lands on the reference value (or on LANDED) at TIME"
    )


def _stated(word: str) -> tuple[str, float]:
    name, _, text = word.partition("=")
    try:
        return name, float(text)
    except ValueError as error:
        raise UsageError(f"--stated {word!r}: expected NAME=U, such as glare_u=0.002") from error


def show_report(report: dict[str, Any]) -> None:
    """Print the JSON form of a calibration's report for people."""
    out, scale = console(), report["scale"]
    method, budget = scale["method"].replace("_", " "), scale["budget"]
    shown = with_u(scale["value"], 2 * scale["u_rel"] * scale["value"], "J·m⁻² per unit of signal", k=2)
    out.print(f"scale      [bold]{shown}[/bold], {method}")
    if scale["reference"]:
        out.print(f"from       {scale['reference']}")
    out.print(f"spectrum   {report['spectrum']}")
    for name, share in sorted(_shares(budget).items(), key=lambda entry: -entry[1])[:3]:
        out.print(f"  {100 * share:5.1f} %  {name} (u = {100 * budget[name]:.2g} %)")
    if metered := report.get("metered"):
        for name, unit in (("luminance", "cd·m⁻²"), ("radiance", "W·sr⁻¹·m⁻²")):
            entry = metered[name]
            out.print(f"{name:<10} {with_u(entry['value'], 2 * entry['u'], unit, k=2)}  (metered surface)")
        thesis, u_rel = (
            metered["thesis_spectral_radiance"]["value"],
            metered["luminance"]["u"] / metered["luminance"]["value"],
        )
        shown = with_u(thesis, 2 * u_rel * thesis, "W·sr⁻¹·m⁻²·µm⁻¹", k=2)
        out.print(f"per µm     {shown}  (L_v/(683·0.1068): a spectral radiance, for comparison only)")
    if ranged := report.get("dynamic_range"):
        exponent, u = ranged["exponent"], ranged["u_exponent"]
        out.print(
            f"exponent   {with_u(exponent, 2 * u, k=2)} of the curve, by {len(ranged['points'])} "
            f"regions brought to {ranged['reference_dn']:g} DN"
        )
    if ratio := report.get("meter_over_source"):
        out.print(f"meter over source  {with_u(ratio['value'], 2 * ratio['u'], k=2)}")
    if flat := report.get("flat_field"):
        out.print(
            f"flat field fitted about {flat['principal_point_px'][0]:.1f}, {flat['principal_point_px'][1]:.1f} px, "
            f"± {200 * flat['u_rel']:.2g} % (k = 2)"
        )
    for assumption in report["assumptions"]:
        out.print(f"assumed    {assumption}")
    out.print(f"written    {report['calibration']}")


def _shares(budget: dict[str, float]) -> dict[str, float]:
    """Return what part of the scale's variance each contribution makes up: the largest is what to work on next."""
    total = sum(u**2 for u in budget.values())
    return {name: u**2 / total for name, u in budget.items() if u > 0.0}
