"""`radiometer trend`: drift over months in a table of results."""

from __future__ import annotations

import json as json_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import typer

from radiometer.cli.console import console, note
from radiometer.cli.outputs import writes
from radiometer.errors import InputError

if TYPE_CHECKING:
    from radiometer.archive.trend import Trend


@writes("report")
def command(
    results: Annotated[Path, typer.Argument(help="Table written by `radiometer batch --do measure`.")],
    quantity: Annotated[str, typer.Option(help="Quantity to follow.")] = "radiance",
    report: Annotated[Path | None, typer.Option(help="Report (HTML) to write: outcome, histories, figures.")] = None,
    json: Annotated[bool, typer.Option("--json", help="JSON on standard output.")] = False,
) -> None:
    """Find the drift of a source or of the instrument over months, with its uncertainty.

    Neighbours may be correlated and seasons may cycle: both are in the model, and a drift is claimed only where chance
    would show it in fewer than one archive in a hundred.
    """
    from radiometer.archive.history import read_histories
    from radiometer.data.storage import write_text_atomic

    trends = read_histories(results, quantity)
    if not trends:
        raise InputError(f"{results}: holds no dated {quantity!r} rows that succeeded; run `radiometer batch` first")
    if report:
        from radiometer.archive.trend_report import trend_report

        write_text_atomic(report, trend_report(trends, str(results)))
    if json:
        print(json_module.dumps({"trends": [trend.to_mapping() for trend in trends]}))
        return
    for trend in trends:
        console().print(_sentence(trend))
    if report:
        note(f"report: {report}")


_VERDICTS: Final = {
    "drift": "[bold yellow]drifts[/bold yellow]",
    "season_or_drift": "[yellow]changes, by a season or a drift: the record is too short to tell[/yellow]",
    "no_drift": "no drift shown",
}


def _sentence(trend: Trend) -> str:
    drift, u = 100 * trend.drift_per_month, 100 * trend.u_drift_per_month
    outliers = f", {int(trend.outlier.sum())} outliers" if trend.outlier.any() else ""
    return (
        f"{trend.patch}: {trend.quantity} {_VERDICTS[trend.verdict]}: ({drift:+.3f} ± {2 * u:.3f}) % per month (k = 2) "
        f"over {trend.time_s.size} readings{outliers}"
    )
