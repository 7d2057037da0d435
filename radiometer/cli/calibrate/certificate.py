"""`radiometer certificate`: a reading or calibration as a digital calibration certificate."""

from __future__ import annotations

from inspect import Parameter
from typing import TYPE_CHECKING

import typer

from radiometer.cli.console import console
from radiometer.cli.function import command_of

if TYPE_CHECKING:
    from radiometer import Certificate


def _show(made: Certificate) -> None:
    console().print(f"{made}; page: {made.page}")


command = command_of(
    "certificate", _show, files=("out",), source=typer.Argument(), out=typer.Option("--out", "-o"),
    defaults={"out": Parameter.empty},
)  # fmt: skip
