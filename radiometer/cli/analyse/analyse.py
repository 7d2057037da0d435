"""`radiometer analyse`: figures of regions of a radiance map."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, cast

import typer

import radiometer as rm
from radiometer.cli.arguments import parse_patch
from radiometer.cli.console import console, note, show_remarks, show_table
from radiometer.cli.options import JsonOption, ReportOption
from radiometer.cli.outputs import writes
from radiometer.errors import UsageError
from radiometer.numbers import unit_text

if TYPE_CHECKING:
    from radiometer import Patch

_Projection = Literal["equidistant", "equisolid", "stereographic", "orthographic"]


@writes("csv", "report")
def command(
    source: Annotated[Path, typer.Argument(metavar="MAP", help="Map as TIFF, as `radiometer merge -o` writes it.")],
    region: Annotated[
        list[str] | None, typer.Option(metavar="NAME:X,Y,W,H", help="A region in pixels; may be repeated.")
    ] = None,
    contrast: Annotated[str | None, typer.Option(metavar="BRIGHT,DARK", help="Two regions to compare.")] = None,
    line: Annotated[str | None, typer.Option(metavar="X1,Y1,X2,Y2", help="A profile between two points.")] = None,
    line_width: Annotated[int, typer.Option(min=1, help="Width in pixels that the profile is averaged over.")] = 1,
    box: Annotated[int, typer.Option(min=1, help="Side in pixels of the box whose means give the extremes.")] = 5,
    spectrum: Annotated[str | None, typer.Option(help="Spectrum of the light, for figures in cd·m⁻².")] = None,
    fisheye: Annotated[
        _Projection | None, typer.Option(help="Projection of a fisheye picture, for the vertical illuminance.")
    ] = None,
    field_of_view: Annotated[float | None, typer.Option(help="Full angle of its image circle in degrees.")] = None,
    field_of_view_u: Annotated[float, typer.Option(min=0.0, help="Its standard uncertainty in degrees.")] = 0.0,
    radius: Annotated[float | None, typer.Option(min=1.0, help="Radius of its image circle in pixels.")] = None,
    glare: Annotated[
        bool, typer.Option("--glare", help="Find UGR and DGP of a fisheye picture by evalglare (extra: glare).")
    ] = False,
    csv: Annotated[Path | None, typer.Option(help="Table of the figures to write.")] = None,
    report: ReportOption = None,
    json: JsonOption = False,
) -> None:
    """Measure regions, contrast, a profile and the illuminance of a radiance map.

    Gives mean, median, extremes, uniformity and deviation of each region, each with its uncertainty.
    """
    found = rm.analyse(
        source, regions=_regions(region or ()),
        contrast=None if contrast is None else cast(tuple[str, str], _numbered(contrast, 2, "--contrast BRIGHT,DARK")),
        line=None if line is None else _line(line), line_width=line_width, box=box, spectrum=spectrum, fisheye=fisheye,
        field_of_view=field_of_view, field_of_view_u=field_of_view_u, radius=radius, glare=glare,
    )  # fmt: skip
    if csv is not None:
        found.write_csv(csv)
    if report is not None:
        found.write_report(report)
        note(f"wrote {report}")
    if json:
        print(found.to_json())
        return
    unit = "relative units" if found.map.unit in ("1", "relative") else unit_text(found.map.unit)
    shown = ("mean", "lowest", "highest", "uniformity")
    show_table(f"{found.origin}: regions in {unit}; {found.coverage}", ("region", *shown), found.region_rows(shown))
    if found.profile is not None:
        show_table(f"{found.profile_title}; {found.coverage}", ("point", "distance in px", unit), found.profile_rows())
    for name, figure in found.of_picture.items():
        console().print(f"{name}: {figure.text()} (k = 2)")
    show_remarks(found.assumptions, flags=found.flags)


def _numbered(text: str, count: int, option: str) -> tuple[str, ...]:
    parts = tuple(part.strip() for part in text.split(","))
    if len(parts) != count or not all(parts):
        raise UsageError(f"{text!r}: expected {option}")
    return parts


def _regions(texts: Sequence[str]) -> dict[str, Patch]:
    found: dict[str, Patch] = {}
    for text in texts:
        name, colon, where = text.rpartition(":")
        if not colon or not name:
            raise UsageError(f"--region {text!r}: expected NAME:X,Y,W,H, such as centre:100,80,40,40")
        if name in found:
            raise UsageError(f"--region {text!r}: {name} is named twice; give each region another name")
        found[name] = parse_patch(where)
    return found


def _line(text: str) -> tuple[float, float, float, float]:
    option = "--line X1,Y1,X2,Y2 in pixels"
    try:
        x1, y1, x2, y2 = (float(part) for part in _numbered(text, 4, option))
    except ValueError as error:
        raise UsageError(f"{text!r}: expected {option}") from error
    return x1, y1, x2, y2
