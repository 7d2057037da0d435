"""`radiometer colour`: X, Y, Z, chromaticity and colour temperature from a camera with colour channels."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal

import typer

from radiometer.cli.arguments import parse_named
from radiometer.cli.console import show_remarks, show_table
from radiometer.cli.function import command_of
from radiometer.cli.options import FNumberOption, command_group
from radiometer.numbers import unit_text

if TYPE_CHECKING:
    from radiometer import CalibratedColour, ColourReading

app = command_group(
    "Measure colour: X, Y, Z, x y, u′ v′, colour temperature and Duv, from a camera with colour channels."
)


def _show_calibration(found: CalibratedColour) -> None:
    known = found.calibration
    show_table(
        f"{', '.join(known.channels)} to X, Y, Z in {unit_text(known.unit)}",
        ("kind of light", "u of a white's luminance", "in the training"),
        [(kind, f"{100 * found.u_rel(kind):.2g} %", "yes" if kind in known.trained else "no") for kind in known.errors],
    )
    show_remarks(known.provenance.assumptions)


def _show_reading(found: ColourReading) -> None:
    title = f"{found.source}: {found.kind or 'light of unstated kind'}"
    show_table(title, ("quantity", "value (k = 2)"), found.rows())
    show_remarks(found.assumptions, flags=found.flags)


_FRAMES: Final[dict[str, Any]] = {
    "converters": {"filters": lambda words: parse_named(words, "--filter", "=", "NAME=FOLDER, such as red=out/red")},
    "source": typer.Argument(),
    "filters": typer.Option("--filter", metavar="NAME=FOLDER"),
    "f_number": FNumberOption,
    "response": Annotated[
        list[Path] | None, typer.Option(help="Response of photographs; one file, or one per colour.")
    ],
}
_calibrate = command_of(
    "colour_calibrate", _show_calibration, files=("out",), defaults={"out": Path("colour.yaml")}, **_FRAMES,
    white=typer.Option(metavar="NAME"),
    train_on=Annotated[Literal["chart", "responsivities"], typer.Option()],
)  # fmt: skip
_measure = command_of(
    "colour_measure", _show_reading, files=("maps", "report"), results=("plot",), **_FRAMES,
    defaults={"calibration": Path("colour.yaml")}, maps=typer.Option("--map"),
)  # fmt: skip
app.command("calibrate")(_calibrate)
app.command("measure")(_measure)
