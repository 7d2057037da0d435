"""`radiometer light account`: what boxes and eyes were given, and the word that no eye was exposed."""

from __future__ import annotations

import json as json_module
from dataclasses import asdict
from typing import Annotated

import typer

from radiometer.cli.console import console


def account(
    box: Annotated[str | None, typer.Option("--box", help="Serial number of a light box; all by default.")] = None,
    confirm_no_exposure: Annotated[
        bool,
        typer.Option(
            "--confirm-no-exposure",
            help="State that no eye that will look into the box saw its light, or another light as bright, in the last"
            " 10⁴ s (2 h 47 min).",
        ),
    ] = False,
    json: Annotated[bool, typer.Option("--json", help="JSON on standard output.")] = False,
) -> None:
    """Show how much of the blue-light limit boxes and eyes have used up within 10⁴ s.

    A box without a history on this computer counts as used up, and so does every box where the account was lost,
    damaged or from the future. That ends after 10⁴ s, or with --confirm-no-exposure.
    """
    from radiometer.bench.boxes import confirm_no_exposure as confirm
    from radiometer.bench.boxes import exposure_reports, require_known_box

    if box is not None or confirm_no_exposure:
        box = require_known_box(box)
    if confirm_no_exposure:
        confirm(box or "")
    reports = [report for report in exposure_reports() if box is None or report.name == f"box {box}"]
    if json:
        print(json_module.dumps([asdict(report) for report in reports]))
        return
    if not reports:
        console().print("no light box was opened on this computer yet")
    for report in reports:
        if report.unknown_for_s > 0:
            minutes = -(-report.unknown_for_s // 60)
            console().print(f"{report.name}: its history is unknown; it counts as used up for {minutes:.0f} min")
            continue
        free = f"; free again in {-(-report.frees_in_s // 60):.0f} min" if report.blue_light > 0 else ""
        console().print(f"{report.name}: {100 * report.blue_light:.3g} % of the blue-light limit within 10⁴ s{free}")
