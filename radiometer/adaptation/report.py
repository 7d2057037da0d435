"""Writes a dark-adaptation fit as JSON, CSV and a page with its curve."""

from __future__ import annotations

import base64
import csv
import html
import io
import math
from pathlib import Path
from typing import Any, Final

import numpy as np

from radiometer.adaptation.adaptation_fit import AdaptationFit, Estimate, intercept_verdict
from radiometer.adaptation.reliability import MEANINGS, NAMES, Reliability
from radiometer.data.storage import write_text_atomic

LABELS: Final = {
    "plateau": "Cone plateau",
    "amplitude": "Cone amplitude",
    "tau_min": "Cone time constant",
    "break_min": "Rod–cone break",
    "s2_slope_per_min": "S2 slope",
    "s3_slope_per_min": "S3 slope",
    "rod_rod_break_min": "Rod–rod break",
    "rod_intercept_min": "Rod-intercept time",
    "criterion_min": "Time at the criterion",
    "final_threshold": "Final threshold",
    "area_log10_min": "Area above the final threshold",
}
_STYLE: Final = (
    "body{font:16px/1.5 system-ui,sans-serif;max-width:60rem;margin:2rem auto;padding:0 1rem;color:#222}"
    "table{border-collapse:collapse}td,th{padding:.25rem .8rem;border-bottom:1px solid #ccc;text-align:right}"
    "td:first-child,th:first-child{text-align:left}img{max-width:100%}"
)


def label_of(name: str, fit: AdaptationFit) -> str:
    """Return the label of an estimate; a single branch may be the rods', so it is not called the cones'."""
    label = LABELS.get(name, name)
    return label if fit.has_break else label.removeprefix("Cone ").capitalize()


def to_mapping(fit: AdaptationFit) -> dict[str, Any]:
    """Return what stands in the JSON."""
    return {
        "verdict": fit.verdict,
        "model": fit.chosen.model.name,
        "break_found": fit.has_break,
        "break_deviance": fit.evidence.deviance if math.isfinite(fit.evidence.deviance) else None,
        "break_deviance_needed": fit.evidence.needed,
        "earliest_visible_break_min": fit.evidence.earliest_visible_min,
        "thresholds": int(fit.chosen.series.time_min.size),
        "sigma_log10": fit.chosen.sigma,
        "criterion_log10": fit.criterion,
        "rod_intercept": intercept_verdict(fit),
        "reliability": {
            name: {
                "share": rate.value,
                "low": rate.low,
                "high": rate.high,
                "hits": rate.count.hits,
                "of": rate.count.of,
            }
            for name, rate in Reliability.of_facts(fit.chosen.series.facts).rates.items()
        },
        "taken": list(fit.chosen.series.taken),
        "facts": dict(fit.chosen.series.facts),
        "stimulus_u_log10": fit.request.stimulus_u_log10,
        "confidence": fit.request.confidence,
        "estimates": {name: estimate.to_mapping() for name, estimate in fit.estimates.items()},
        "models": [
            {"model": one.model.name, "aicc": one.aicc, "sigma_log10": one.sigma, "parameters": one.values}
            for one in fit.tried
        ],
    }


def curve_csv(fit: AdaptationFit) -> str:
    """Return thresholds, fitted values and residuals as CSV."""
    series = fit.chosen.series
    fitted = fit.chosen.threshold(series.time_min)
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(["time_min", "log10_threshold", "fitted", "residual", "weight"])
    for row in zip(
        series.time_min, series.log_threshold, fitted, series.log_threshold - fitted, fit.chosen.weights, strict=True
    ):
        writer.writerow([f"{value:.6g}" for value in row])
    return stream.getvalue()


def write_page(fit: AdaptationFit, path: Path, title: str = "Dark adaptation") -> None:
    """Write a self-contained HTML page. Raises OutputError."""
    rows = "".join(_row(label_of(name, fit), estimate) for name, estimate in fit.estimates.items())
    models = "".join(
        f"<tr><td>{one.model.name}</td><td>{one.aicc - fit.chosen.aicc:+.1f}</td><td>{one.sigma:.3f}</td></tr>"
        for one in fit.tried
    )
    percent = f"{100 * fit.request.confidence:g}"
    write_text_atomic(
        path,
        f"<!doctype html><html lang=en><meta charset=utf-8><title>{html.escape(title)}</title><style>{_STYLE}</style>"
        f"<h1>{html.escape(title)}</h1><p><strong>{html.escape(fit.verdict)}</strong></p>"
        f'<img alt="Thresholds over time with the fitted branches" src="data:image/png;base64,{_plot(fit)}">'
        f"<h2>Estimates</h2><table><tr><th></th><th>value</th><th>u (k = 1)</th><th>{percent} % interval</th>"
        f"<th>unit</th></tr>{rows}</table>"
        f"{_reliability(fit)}"
        f"<h2>Models</h2><table><tr><th>model</th><th>AICc above the best</th><th>scatter</th></tr>"
        f"{models}</table>"
        f"<p>Model {fit.chosen.model.name}: {fit.chosen.model.meaning}. Intervals of parameters by profile "
        f"likelihood, of the others by {fit.request.bootstrap_draws} bootstrap redraws; stimulus calibration u = "
        f"{fit.request.stimulus_u_log10:g} log10 units is in them.</p></html>\n",
    )


def _reliability(fit: AdaptationFit) -> str:
    """Return the table of false alarms, lapses and looks away, as far as the run has them."""
    rates = Reliability.of_facts(fit.chosen.series.facts).rates
    rows = "".join(
        f"<tr><td>{NAMES[name]}</td><td>{100 * rate.value:.1f} %</td><td>{100 * rate.low:.1f} to "
        f"{100 * rate.high:.1f} %</td><td>{rate.count}</td><td>{MEANINGS[name]}</td></tr>"
        for name, rate in rates.items()
    )
    head = "<tr><th></th><th>share</th><th>95 % interval</th><th>counted</th><th>of what</th></tr>"
    return f"<h2>The subject</h2><table>{head}{rows}</table>" if rows else ""


def _row(label: str, estimate: Estimate) -> str:
    interval = estimate.profile or estimate.bootstrap
    shown = f"{interval.low:.3f} to {interval.high:.3f}" if interval else ""
    return (
        f"<tr><td>{label}</td><td>{estimate.value:.3f}</td><td>{estimate.u:.3f}</td><td>{shown}</td>"
        f"<td>{estimate.unit}</td></tr>"
    )


def _plot(fit: AdaptationFit) -> str:
    """Return the curve as a base64 PNG."""
    from matplotlib.figure import Figure

    series, values = fit.chosen.series, fit.chosen.values
    figure = Figure(figsize=(8, 4.8), layout="constrained")
    axes = figure.add_subplot()
    axes.plot(series.time_min, series.log_threshold, "o", ms=4, color="#555", label="thresholds")
    grid = np.linspace(float(series.time_min[0]), float(series.time_min[-1]), 600)
    axes.plot(grid, fit.chosen.threshold(grid), color="#0b5", lw=2, label=fit.chosen.model.name)
    if fit.has_break:
        interval = fit.estimates["break_min"].profile
        axes.axvline(values["break_min"], color="#06c", lw=1, label="rod–cone break")
        if interval is not None and np.isfinite([interval.low, interval.high]).all():
            axes.axvspan(interval.low, interval.high, color="#06c", alpha=0.15)
        cone = values["plateau"] + values["amplitude"] * np.exp(-grid / values["tau_min"])
        axes.plot(grid, cone, "--", color="#a33", lw=1, label="cones alone")
    axes.set_xlabel("time in the dark / min")
    axes.set_ylabel("log10 threshold")
    axes.legend(frameon=False)
    stream = io.BytesIO()
    figure.savefig(stream, format="png")
    return base64.b64encode(stream.getvalue()).decode("ascii")
