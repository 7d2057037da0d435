"""Control charts of trends as one HTML page without outside resources."""

from __future__ import annotations

import base64
import html
import io

import numpy as np

from radiometer.archive.trend import Trend

_PAGE = """<!doctype html><html lang="en"><head><meta charset="utf-8"><title>Trends</title>
<meta name="viewport" content="width=device-width, initial-scale=1">
<style>body{{font:16px/1.5 system-ui,sans-serif;max-width:60rem;margin:2rem auto;padding:0 1rem;color:#222}}
img{{max-width:100%}}table{{border-collapse:collapse}}
td,th{{padding:.2rem .8rem;text-align:right;border-bottom:1px solid #ddd}}
th:first-child,td:first-child{{text-align:left}}</style></head><body><h1>Trends</h1><p>{source}</p>
<table><tr><th>patch</th><th>readings</th><th>outliers</th><th>drift per month</th>
<th>U (k = 2)</th><th>verdict</th></tr>
{rows}</table>{charts}</body></html>
"""


def trend_report(trends: list[Trend], source: str) -> str:
    """Return an HTML page with a table of drifts and a control chart per patch.

    Args:
        trends: Histories.
        source: Where they come from, for the reader.
    """
    rows = "".join(
        f"<tr><td>{html.escape(t.patch)}</td><td>{t.time_s.size}</td><td>{int(t.outlier.sum())}</td>"
        f"<td>{100 * t.drift_per_month:+.3f} %</td><td>{200 * t.u_drift_per_month:.3f} %</td>"
        f"<td>{'drifts' if t.drifts else 'no drift shown'}</td></tr>"
        for t in trends
    )
    charts = "".join(f'<h2>{html.escape(t.patch)}</h2><img alt="control chart" src="{_chart(t)}">' for t in trends)
    return _PAGE.format(source=html.escape(source), rows=rows, charts=charts)


def _chart(trend: Trend) -> str:
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 4), layout="constrained")
    axes = figure.add_subplot()
    days = (trend.time_s - trend.time_s[0]) / 86400.0
    kept = ~trend.outlier
    scatter = float(np.std((trend.value - trend.line)[kept], ddof=2))
    axes.fill_between(days, trend.line - 3 * scatter, trend.line + 3 * scatter, color="#dde7f3", label="±3 s limits")
    axes.errorbar(
        days[kept], trend.value[kept], trend.u[kept], fmt="o", ms=3, lw=0.7, color="#1f4e79", label="readings ± u"
    )
    axes.plot(days[~kept], trend.value[~kept], "x", color="#c0392b", label="outliers")
    axes.plot(days, trend.line, color="#e67e22", label="fit")
    axes.set_xlabel("days")
    axes.set_ylabel(f"{trend.quantity} ({trend.unit})")
    axes.legend(loc="best", fontsize=8)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=110)
    return "data:image/png;base64," + base64.b64encode(buffer.getvalue()).decode()
