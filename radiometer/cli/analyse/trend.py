"""`radiometer trend`: drift over months in a table of results."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import typer

import radiometer as rm
from radiometer.cli.console import console, note
from radiometer.cli.options import JsonOption
from radiometer.cli.outputs import writes
from radiometer.numbers import with_u

if TYPE_CHECKING:
    from radiometer.api.archive import Trend


@writes("report")
def command(
    results: Annotated[Path, typer.Argument(help="Table written by `radiometer batch --do measure`.")],
    quantity: Annotated[str, typer.Option(help="Quantity to follow.")] = "radiance",
    report: Annotated[Path | None, typer.Option(help="Report (HTML) to write: outcome, histories, figures.")] = None,
    json: JsonOption = False,
) -> None:
    """Find the drift of a source or of the instrument over months, with its uncertainty.

    Neighbours may be correlated and seasons may cycle: both are in the model, and a drift is claimed only where chance
    would show it in fewer than one archive in a hundred.
    """
    found = rm.trend(results, quantity)
    if report:
        found.write_report(report)
    if json:
        print(found.to_json())
        return
    for one in found.trends:
        console().print(_sentence(one))
    if report:
        note(f"report: {report}")


_VERDICTS: Final = {
    "drift": "[bold yellow]drifts[/bold yellow]",
    "season_or_drift": "[yellow]changes, by a season or a drift: the record is too short to decide[/yellow]",
    "no_drift": "no drift shown",
}


def _sentence(trend: Trend) -> str:
    drift, u = 100 * trend.drift_per_month, 100 * trend.u_drift_per_month
    outliers = f", {int(trend.outlier.sum())} outliers" if trend.outlier.any() else ""
    return (
        f"{trend.patch}: {trend.quantity} {_VERDICTS[trend.verdict]}: "
        f"{with_u(drift, 2 * u, '% per month of the mean', k=2)} over {trend.time_s.size} readings{outliers}"
        + "".join(f"\n  {count} rows take no part: {reason}" for reason, count in trend.left_out.items())
    )
