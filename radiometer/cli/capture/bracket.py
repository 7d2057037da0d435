"""`radiometer bracket`: capture a set of exposures of an unmoving scene."""

from __future__ import annotations

import typer

import radiometer as rm
from radiometer.cli.console import note
from radiometer.cli.function import command_of


def _show(found: rm.BracketReport) -> None:
    if not found.coverage:
        note(f"{found.capture}: {found.frames} frames as planned")
        return
    note(str(found))
    share = found.coverage["well_exposed_twice"] / found.coverage["pixels"]
    note(f"{100 * share:.2f} % of the {found.of} are well exposed at least twice")
    for sentence in found.not_reached:
        note(f"not reached: {sentence}")


command = command_of("bracket", _show, folder="out", shortest_s=typer.Option("--from"), longest_s=typer.Option("--to"))
