"""`radiometer certificate`: a reading or calibration as a digital calibration certificate."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

import radiometer as rm
from radiometer.cli.console import console
from radiometer.cli.options import JsonOption
from radiometer.cli.outputs import writes


@writes("out")
def command(
    source: Annotated[Path, typer.Argument(help="JSON of a reading (`measure --json`), or a calibration file.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="XML file to write; a page (.html) is written with it.")],
    laboratory: Annotated[Path, typer.Option(help="YAML file with laboratory, customer, person and item.")],
    identifier: Annotated[str, typer.Option(help="Number of the certificate, unique in the laboratory.")],
    json: JsonOption = False,
    force: Annotated[bool, typer.Option("--force", help="Replace output files that exist.")] = False,
) -> None:
    """Make a digital calibration certificate (DCC 3 with D-SI) and a page for people.

    It states value, expanded uncertainty, coverage factor and probability, budget, method, equipment and conditions.
    """
    made = rm.certificate(source, out, laboratory=laboratory, identifier=identifier, force=force)
    print(made.to_json()) if json else console().print(f"{made}; wrote {made.file} and {made.page}")
