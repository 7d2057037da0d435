"""The self-contained HTML report: verdict, found effects, residuals before and after, limits."""

from __future__ import annotations

import base64
import html
import io
from pathlib import Path
from typing import Final

import numpy as np

from radiometer.data.storage import write_text_atomic
from radiometer.reconcile.engine import Reconciled
from radiometer.reconcile.fit.state import FitState
from radiometer.reconcile.measure.covariates import covariates
from radiometer.reconcile.measure.design import Array
from radiometer.reconcile.report.result import FoundEffect, ReconcileResult

_PANELS: Final = 6
_BINS: Final = 14
# Covariates drawn on a logarithmic axis, and what stands at the others.
_AXES: Final = {
    "exposure_s": ("exposure in s", True),
    "f_number": ("f-number", True),
    "signal": ("signal in e-", True),
    "patch_level": ("radiance of the patch in W·sr⁻¹·m⁻²", True),
    "previous_frame": ("signal of the capture before in e-, plus 1", True),
}
_PLAIN: Final = {
    "gain_db": "gain in dB",
    "temperature_C": "sensor temperature in °C",
    "timestamp_s": "time in s",
    "source_level": "source level",
    "image_x": "column in pixels",
    "image_y": "row in pixels",
    "field_radius": "field radius (1 in the corner)",
}
_LISTED_PLACES: Final = 5
_WEAK_NATS: Final = 10.0
_STYLE: Final = """
body{font:15px/1.5 system-ui,sans-serif;max-width:60rem;margin:2rem auto;padding:0 1rem;color:#1a1a1a}
table{border-collapse:collapse;margin:1rem 0}td,th{padding:.2rem .8rem;text-align:right;border-bottom:1px solid #ddd}
td:first-child,th:first-child{text-align:left}img{max-width:100%}.verdict{font-size:1.4rem;font-weight:600}
.small{color:#555;font-size:.9rem}
"""
_SAID: Final = {
    "agrees": "Nothing is missing: simulation and measurement agree.",
    "effects_found": "Found what was missing; with it they agree.",
    "unnamed_effect": "They disagree, and no known effect explains it.",
    "incomplete": "Structure stays: the names are provisional.",
}


def write_report(path: Path, reconciled: Reconciled, title: str) -> None:
    """Write the report as one HTML file that needs nothing else.

    Args:
        path: File to write.
        reconciled: What was found.
        title: Name of the capture set.

    Raises:
        OutputError: If the file cannot be written.
    """
    write_text_atomic(path, report_html(reconciled, title))


def report_html(reconciled: Reconciled, title: str) -> str:
    """Return the report as HTML."""
    result = reconciled.result
    parts = [
        f"<!doctype html><html lang='en'><meta charset='utf-8'><title>reconcile {html.escape(title)}</title>",
        f"<style>{_STYLE}</style><h1>{html.escape(title)}</h1>",
        f"<p class='verdict'>{_SAID[result.verdict]}</p>",
        f"<p>Gap {result.gap_before:.3f} → {result.gap_after:.3f} ({result.gap_unit}); {result.captures} captures, "
        f"{result.frames} frames, {result.tests[0]} tests, {result.tests[1]} significant in the end.</p>",
        *[_effect(effect) for effect in result.effects],
        _following(result),
        _places(result),
        "<h2>Residuals along each covariate, before and after</h2>",
        "<p class='small'>Means of patches, of one setting or of neighbouring settings.</p>",
        f"<img alt='residuals before and after' src='data:image/png;base64,{_residual_plot(reconciled)}'>",
        _covariate_table(result),
        "<h2>What these data would have shown</h2>",
        "<p class='small'>Amplitude that would stand out by 5 sigma; “nothing is missing” holds above these only.</p>",
        _limit_table(result),
        *[f"<p class='small'>Assumed: {html.escape(text)}.</p>" for text in result.assumptions],
    ]
    return "\n".join(parts) + "\n</html>\n"


def _places(result: ReconcileResult) -> str:
    """Return where the starting model disagrees, found without the catalogue."""
    rows = "".join(
        f"<tr><td>{html.escape(place.block)}</td><td>{html.escape(place.covariate)}</td>"
        f"<td>{html.escape(place.form)}</td><td>{place.score:.1f}</td><td>{place.p_value:.2g}</td></tr>"
        for place in result.localisation[:_LISTED_PLACES]
    )
    head = "<tr><th>statistic</th><th>along</th><th>form</th><th>χ²</th><th>p</th></tr>"
    note = "<p class='small'>Found without the catalogue: trends of the starting model's residuals.</p>"
    return f"<h2>Where they disagreed at first</h2><table>{head}{rows}</table>{note}"


def _following(result: ReconcileResult) -> str:
    if not result.next_capture:
        return ""
    return f"<p>Next capture: {html.escape(str(result.next_capture['description']))}</p>"


def _effect(effect: FoundEffect) -> str:
    rows = "".join(
        f"<tr><td>{html.escape(name)}</td><td>{entry.value:.6g}</td>"
        f"<td>{'' if entry.u is None else f'± {entry.u:.2g}'}</td><td>{html.escape(entry.unit)}</td></tr>"
        for name, entry in effect.parameters.items()
    )
    only = "Each ± holds only if it is this one: it knows nothing of the choice among them."
    others = ", ".join(effect.alternatives)
    rivals = f"<p>These data cannot tell it from {others}. {only}</p>" if effect.alternatives else ""
    following = effect.next_capture.get("description", "") if effect.next_capture else ""
    advice = f"<p>Next capture: {html.escape(str(following))}</p>" if following else ""
    weak = " (weak: repeat the captures)" if effect.gain_nats < _WEAK_NATS else ""
    closest = (
        f"<p>Closest entry: {html.escape(effect.closest[0])}, which explains {100 * effect.closest[1]:.0f} % of it.</p>"
        if effect.closest
        else ""
    )
    return (
        f"<h2>{html.escape(effect.name)}{' (provisional)' if effect.provisional else ''}</h2>"
        f"<p>Along {html.escape(effect.where)}, seen in the {html.escape(effect.block)}: gap {effect.gap_before:.3f} → "
        f"{effect.gap_after:.3f}, {effect.gain_nats:.0f} nats{weak}.</p><table>{rows}</table>{closest}{rivals}{advice}"
    )


def _covariate_table(result: ReconcileResult) -> str:
    rows = "".join(
        f"<tr><td>{html.escape(name)}</td><td>{gap.before:.1f}</td><td>{gap.after:.1f}</td></tr>"
        for name, gap in sorted(result.covariates.items(), key=lambda item: -item[1].before)
    )
    head = "<tr><th>covariate</th><th>before</th><th>after</th></tr>"
    note = "<p class='small'>Largest trend's χ² per degree of freedom; 1 is chance.</p>"
    return f"<table>{head}{rows}</table>{note}"


def _limit_table(result: ReconcileResult) -> str:
    rows = "".join(
        f"<tr><td>{html.escape(name)}</td><td>{'blind' if v.amplitude is None else f'{v.amplitude:.3g}'}</td>"
        f"<td>{html.escape('' if v.unit == '1' else v.unit)}</td><td>{html.escape(v.parameter)}</td></tr>"
        for name, v in result.limits.items()
    )
    return f"<table><tr><th>effect</th><th>from</th><th>unit</th><th>parameter</th></tr>{rows}</table>"


def _residual_plot(reconciled: Reconciled) -> str:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    before, after = reconciled.outcome.start, reconciled.outcome.state
    names = _most_telling(reconciled.result)
    figure = Figure(figsize=(10, 2.6 * ((len(names) + 1) // 2)), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots((len(names) + 1) // 2, 2, squeeze=False).ravel()
    for axis, name in zip(axes, names, strict=False):
        for state, colour, label in ((before, "#c0392b", "before"), (after, "#2471a3", "after")):
            x, y, u = _profile(state, name)
            axis.errorbar(x, y, u, fmt="o", ms=3, lw=1, color=colour, label=label)
        axis.axhline(0.0, color="#888", lw=0.8)
        label, logarithmic = _AXES.get(name, (_PLAIN.get(name, name), False))
        if logarithmic:
            axis.set_xscale("log")
        axis.set_xlabel(label)
        axis.set_ylabel("measured − predicted, in σ")
        axis.legend(frameon=False, fontsize=8)
    for axis in axes[len(names) :]:
        axis.set_visible(False)
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=90)
    return base64.b64encode(stream.getvalue()).decode("ascii")


def _in_units(name: str, value: Array) -> Array:
    """Return values of a covariate as people read them; the tests use logarithms of most."""
    if name == "f_number":
        return np.asarray(2.0**value)
    if name == "signal":
        return np.asarray(np.maximum(10.0**value - 10.0, 1.0))
    return np.asarray(10.0**value if name in _AXES else value)


def _most_telling(result: ReconcileResult) -> list[str]:
    ranked = sorted(result.covariates, key=lambda name: -result.covariates[name].before)
    return ranked[:_PANELS]


def _profile(state: FitState, name: str) -> tuple[Array, Array, Array]:
    """Return bin centres, mean standardised residual of the means, and its standard uncertainty."""
    axis = covariates(state.model, state.prediction)[name]
    usable = state.comparison.usable["mean"]
    deviation = np.hypot(state.comparison.deviation["mean"], state.tau * state.sensitivity)
    standardised = ((state.seen.mean - state.prediction.mean) / deviation)[usable]
    value = axis.value[usable]
    levels = np.unique(np.round(value, 6))
    if levels.size <= _BINS:  # every setting has a point of its own
        place = np.argmin(np.abs(value[:, None] - levels), axis=1)
    else:
        edges = np.unique(np.quantile(value, np.linspace(0, 1, _BINS + 1)))
        place = np.clip(np.searchsorted(edges, value, side="right") - 1, 0, max(len(edges) - 2, 0))
    groups = np.unique(place)
    x = _in_units(name, np.array([value[place == g].mean() for g in groups]))
    y = np.array([standardised[place == g].mean() for g in groups])
    u = np.array([1.0 / np.sqrt(np.sum(place == g)) for g in groups])
    return x, y, u
