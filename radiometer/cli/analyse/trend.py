"""`radiometer trend`: drift over months in a table of results."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import typer

import radiometer as rm
from radiometer.cli.console import console
from radiometer.cli.function import command_of
from radiometer.numbers import with_u

if TYPE_CHECKING:
    from radiometer.api.archive import Trend

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


def _show(found: rm.Trends) -> None:
    for one in found.trends:
        console().print(_sentence(one))


command = command_of("trend", _show, results=("report",), quantity=typer.Option())
