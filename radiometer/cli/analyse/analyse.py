"""`radiometer analyse`: figures of regions of a radiance map."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from radiometer.cli.arguments import parse_named, parse_numbers, parse_patch
from radiometer.cli.console import console, show_remarks, show_table
from radiometer.cli.function import command_of
from radiometer.cli.options import words
from radiometer.numbers import unit_text

if TYPE_CHECKING:
    from radiometer import MapAnalysis, Patch

_Projection = Literal["equidistant", "equisolid", "stereographic", "orthographic"]


def _show(found: MapAnalysis) -> None:
    unit = "relative units" if found.map.unit in ("1", "relative") else unit_text(found.map.unit)
    shown = ("mean", "lowest", "highest", "uniformity")
    show_table(f"{found.origin}: regions in {unit}; {found.coverage}", ("region", *shown), found.region_rows(shown))
    if found.profile is not None:
        show_table(f"{found.profile_title}; {found.coverage}", ("point", "distance in px", unit), found.profile_rows())
    for name, figure in found.of_picture.items():
        console().print(f"{name}: {figure.text()} (k = 2)")
    show_remarks(found.assumptions, flags=found.flags)


def _regions(words: Sequence[str]) -> dict[str, Patch]:
    named = parse_named(words, "--region", ":", "NAME:X,Y,W,H, such as centre:100,80,40,40")
    return {name: parse_patch(where) for name, where in named.items()}


command = command_of(
    "analyse", _show, results=("csv", "report"), source=typer.Argument(metavar="MAP"),
    converters={"regions": _regions},
    regions=typer.Option("--region", metavar="NAME:X,Y,W,H", help="A region in pixels; may be repeated."),
    contrast=typer.Option(parser=words, metavar="BRIGHT,DARK"),
    line=typer.Option(
        parser=lambda text: tuple(parse_numbers(text, "--line", "X1,Y1,X2,Y2 in pixels", 4)), metavar="X1,Y1,X2,Y2"
    ),
    fisheye=Annotated[_Projection | None, typer.Option()],
)  # fmt: skip
