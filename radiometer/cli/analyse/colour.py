"""`radiometer colour`: X, Y, Z, chromaticity and colour temperature from a camera with colour channels."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

import radiometer as rm
from radiometer.cli.arguments import parse_patch
from radiometer.cli.console import note, progress, show_remarks, show_table
from radiometer.cli.options import JsonOption, PatchOption, ReportOption, command_group, relative_option
from radiometer.cli.outputs import writes
from radiometer.errors import UsageError
from radiometer.numbers import unit_text

app = command_group(
    "Measure colour: X, Y, Z, x y, u′ v′, colour temperature and Duv, from a camera with colour channels."
)
Source = Annotated[
    Path | None, typer.Argument(help="Capture set of a colour camera, or photographs; none with --filter.")
]
FilterOption = Annotated[
    list[str] | None,
    typer.Option("--filter", metavar="NAME=FOLDER", help="Of a monochrome camera: a capture set per filter."),
]
LinearOption = Annotated[bool, typer.Option("--linear", help="Developed photographs are proportional to light.")]
ResponseOption = Annotated[
    list[Path] | None, typer.Option("--response", help="Response of photographs; one file, or one per colour.")
]


@app.command()
@writes("out")
def calibrate(
    source: Source = None,
    chart: Annotated[
        Path | None,
        typer.Option(help="Table: name, X, Y, Z (cd/m2), and u_rel, kind, left, top, width, height, capture."),
    ] = None,
    spectra: Annotated[
        Path | None, typer.Option(help="Table: wavelength_nm and W/(sr m2 nm) of each light, instead of X, Y, Z.")
    ] = None,
    responsivities: Annotated[
        Path | None, typer.Option(help="Table: wavelength_nm and responsivity per watt of each channel.")
    ] = None,
    train_on: Annotated[
        Literal["chart", "responsivities"],
        typer.Option(help="Fit to the known lights, or to plausible ones: known lights then give the scale alone."),
    ] = "chart",
    kind: Annotated[
        str | None, typer.Option(help="Kind of the lights, such as oled, surfaces, or your own word.")
    ] = None,
    per_kind: Annotated[bool, typer.Option("--per-kind", help="A matrix for each kind of light.")] = False,
    white: Annotated[
        str | None, typer.Option(metavar="NAME", help="Known light whose X, Y, Z the matrix gives exactly, for greys.")
    ] = None,
    u_rel: Annotated[float, relative_option("--u-rel", "Relative u (k = 1) that all known X, Y, Z share")] = 0.0,
    filters: FilterOption = None,
    linear: LinearOption = False,
    response: ResponseOption = None,
    out: Annotated[Path, typer.Option("--out", "-o", help="Calibration file to write.")] = Path("colour.yaml"),
    json: JsonOption = False,
) -> None:
    """Find the matrix from a camera's channels to X, Y, Z, and its error for other lights."""
    with progress(shown=not json) as shown:
        found = rm.colour_calibrate(
            source, chart, spectra=spectra, responsivities=responsivities, train_on=train_on, kind=kind,
            per_kind=per_kind, white=white, u_rel=u_rel, filters=_filters(filters), linear=linear,
            response=response or None, out=out, notice=note, progress=shown,
        )  # fmt: skip
    if json:
        print(found.to_json())
        return
    known = found.calibration
    show_table(
        f"{', '.join(known.channels)} to X, Y, Z in {unit_text(known.unit)}",
        ("kind of light", "u of a white's luminance", "in the training"),
        [(kind, f"{100 * found.u_rel(kind):.2g} %", "yes" if kind in known.trained else "no") for kind in known.errors],
    )
    show_remarks(known.provenance.assumptions)
    note(f"wrote {out}")


@app.command()
@writes("maps", "report", "plot")
def measure(
    source: Source = None,
    calibration: Annotated[Path, typer.Option(help="Colour calibration of the camera.")] = Path("colour.yaml"),
    patch: PatchOption = None,
    kind: Annotated[str | None, typer.Option(help="Kind of the light, one that the calibration knows.")] = None,
    filters: FilterOption = None,
    linear: LinearOption = False,
    response: ResponseOption = None,
    maps: Annotated[Path | None, typer.Option("--map", help="Quantities and u of every pixel, .exr or .tiff.")] = None,
    report: ReportOption = None,
    plot: Annotated[Path | None, typer.Option(help="Chromaticity diagram to draw: PNG, PDF or SVG.")] = None,
    json: JsonOption = False,
) -> None:
    """Measure the colour of a patch, or of the whole picture, each figure with its uncertainty."""
    with progress(shown=not json) as shown:
        found = rm.colour_measure(
            source, calibration=calibration, patch=parse_patch(patch), kind=kind, filters=_filters(filters),
            linear=linear, response=response or None, maps=maps, report=report, notice=note, progress=shown,
        )  # fmt: skip
    if plot is not None:
        found.write_plot(plot)
    for file in (maps, report, plot):
        if file is not None:
            note(f"wrote {file}")
    if json:
        print(found.to_json())
        return
    title = f"{found.source}: {found.kind or 'light of unstated kind'}"
    show_table(title, ("quantity", "value (k = 2)"), found.rows())
    show_remarks(found.assumptions, flags=found.flags)


def _filters(words: list[str] | None) -> dict[str, Path] | None:
    """Return folders by channel. Raises UsageError for a word that is no NAME=FOLDER, or a name that occurs twice."""
    found = dict[str, Path]()
    for word in words or ():
        name, equals, folder = word.partition("=")
        if not (name and equals and folder) or name in found:
            raise UsageError(f"--filter {word!r}: expected NAME=FOLDER, each name once, such as red=out/red")
        found[name] = Path(folder)
    return found or None
