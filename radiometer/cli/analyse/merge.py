"""`radiometer merge`: a bracket merged into a picture of radiance, with its uncertainty."""

from __future__ import annotations

import math
from collections.abc import Callable
from inspect import Parameter
from pathlib import Path
from typing import Annotated, Any

import typer

import radiometer as rm
from radiometer.cli.arguments import parse_bounds
from radiometer.cli.console import console
from radiometer.cli.function import command_of
from radiometer.numbers import unit_text


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


def _show(found: rm.Radiance) -> None:
    show_map_report(found.to_mapping())


command = command_of(
    "merge", _show, files=("out",), defaults={"out": Parameter.empty}, source=typer.Argument(metavar="PATH"),
    response=Annotated[list[Path] | None, typer.Option()], vignetting=typer.Option(metavar="lensfun|FILE"),
    scale=typer.Option(parser=lambda text: parse_bounds(text, "--scale"), metavar="LOW,HIGH"),
)  # fmt: skip
