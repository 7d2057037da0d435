"""`radiometer batch`: one job over all capture sets of an archive."""

from __future__ import annotations

from pathlib import Path

import typer

from radiometer.cli.function import command_of

command = command_of(
    "batch", lambda found: None, files=(), defaults={"output": Path("results.csv")},
    do=typer.Option(), output=typer.Option("-o", "--output"),
    code=lambda found: int(found.summary.interrupted or bool(found.summary.failures)),
)  # fmt: skip
