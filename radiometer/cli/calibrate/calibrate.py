"""`radiometer calibrate`: the absolute scale of a camera, written as one calibration file."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from inspect import Parameter
from typing import TYPE_CHECKING, Any

import typer

from radiometer.cli.arguments import parse_named, parse_numbers, parse_patch, parse_radiance, parse_seconds
from radiometer.cli.console import console
from radiometer.cli.function import command_of
from radiometer.errors import UsageError
from radiometer.numbers import with_u

if TYPE_CHECKING:
    from radiometer import Calibrated, Patch


def _patch(text: str | None) -> Patch | str | None:
    """Return a patch by its numbers, or its name in the capture set."""
    return text if text is None or "," not in text else parse_patch(text)


def _regions(words: Sequence[str]) -> list[tuple[float, ...]]:
    return [_region(word) for word in words]


def _region(word: str) -> tuple[float, ...]:
    """Return M, TIME in s and LANDED of a region that `--dynamic-range` names."""
    parts = word.split(",")
    if len(parts) in (2, 3):
        with contextlib.suppress(ValueError):
            return (float(parts[0]), parse_seconds(parts[1], "--dynamic-range"), *map(float, parts[2:]))
    raise UsageError(
        f"--dynamic-range {word!r}: expected M,TIME or M,TIME,LANDED, such as 254,1/2000: the region at pixel value M "
        "of the reference photograph lands on the reference value (or on LANDED) at TIME"
    )


def _stated(words: Sequence[str]) -> dict[str, float]:
    form = "NAME=U, such as glare_u=0.002"
    named = parse_named(words, "--stated", "=", form)
    return {name: parse_numbers(text, f"--stated {name}", form, 1)[0] for name, text in named.items()}


def _show(found: Calibrated) -> None:
    report: dict[str, Any] = found.to_mapping()
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


def _shares(budget: dict[str, float]) -> dict[str, float]:
    """Return what part of the scale's variance each contribution makes up: the largest is what to work on next."""
    total = sum(u**2 for u in budget.values())
    return {name: u**2 / total for name, u in budget.items() if u > 0.0}


command = command_of(
    "calibrate", _show, files=("out",), defaults={"out": Parameter.empty}, capture=typer.Argument(),
    converters={"dynamic_range": _regions, "stated": _stated},
    patch=typer.Option(parser=_patch, metavar="X,Y,W,H|NAME"),
    radiance=typer.Option(parser=parse_radiance, metavar="RADIANCE|FILE"),
    dynamic_range=typer.Option(metavar="M,TIME[,LANDED]"), stated=typer.Option(metavar="NAME=U"),
)  # fmt: skip
