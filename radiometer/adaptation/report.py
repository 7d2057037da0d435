"""Writes a dark-adaptation fit as JSON, CSV and a page with its curve."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from radiometer.adaptation.adaptation_fit import AdaptationFit, intercept_verdict
from radiometer.adaptation.norms import WITHOUT, norms_of
from radiometer.adaptation.reliability import MEANINGS, NAMES, Reliability
from radiometer.adaptation.report_picture import short, story
from radiometer.data.storage import write_text_atomic
from radiometer.numbers import rounded, unit_text
from radiometer.reporting.origin import Origin, moment
from radiometer.reporting.page import folded, listed, page, paragraph, section, table

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
    "area_log10_min": "Area under the curve (AUDAC)",
    "area_from_min": "AUDAC from",
    "area_to_min": "AUDAC cut at",
}
_COVERAGE: Final = 2.0
_HELD_WEIGHT: Final = 0.5  # of the largest; below, a threshold hardly counts


def label_of(name: str, fit: AdaptationFit) -> str:
    """Return the label of an estimate; a single branch may be the rods', so it is not called the cones'."""
    label = LABELS.get(name, name)
    return label if fit.has_break else label.removeprefix("Cone ").capitalize()


def to_mapping(fit: AdaptationFit) -> dict[str, Any]:
    """Return what is written to the JSON."""
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
        "reliability": Reliability.of_facts(fit.chosen.series.facts).to_mapping(),
        "norms": [one.to_mapping() for one in norms_of(fit.estimates)],
        "taken": list(fit.chosen.series.taken),
        "facts": dict(fit.chosen.series.facts),
        "level_unit": fit.chosen.series.facts.get("level_unit"),
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
    write_text_atomic(path, report_html(fit, title))


def report_html(fit: AdaptationFit, title: str = "Dark adaptation") -> str:
    """Return the report: what the eye did in a sentence, the curve, what it means, what to mind, tables last."""
    return page(
        title,
        outcome(fit),
        [
            _intercept(fit),
            story(fit),
            section("What it means, and what to do", listed(meaning(fit))),
            section("Remarks", *(paragraph(text, "flag") for text in _remarks(fit))),
            section("Estimates", _estimates(fit)),
            section("The subject", _reliability(fit)),
            section("Published values of healthy eyes", *_norms(fit)),
            section("Models compared", _models(fit)),
            folded("What the file states", table((), sorted(fit.chosen.series.facts.items()), words=(1,))),
            folded("What was assumed", listed(_assumptions(fit))),
        ],
        kind="Dark adaptation",
        origin=origin_of([fit.chosen.series.facts]),
    )


_VISIT: Final = {
    "subject": "subject", "eye": "eye", "age_years": "age in years", "pupil_mm": "pupil in mm",
    "simulated": "simulated", "firmware": "firmware", "level_unit": "levels in log₁₀ of", "program": "measured by",
}  # fmt: skip


def origin_of(visits: Sequence[Mapping[str, str]]) -> Origin:
    """Return what the files of visits state of date, light, calibration, protocol and subject.

    Args:
        visits: Facts of each file by name.
    """

    def stated(*names: str) -> str:
        found = (facts.get(name, "") for facts in visits for name in names)
        return ", ".join(dict.fromkeys(one for one in found if one))

    simulated = bool(stated("simulated"))  # by a subject without devices: none could be stated
    dates = sorted(moment(facts["visit"]) for facts in visits if facts.get("visit"))
    return Origin(
        " to ".join(dict.fromkeys(dates[:1] + dates[-1:])),
        calibration=stated("calibrated") or (None if simulated else ""),
        box=stated("box", "screen") or (None if simulated else ""),
        protocol=stated("protocol"),
        further=tuple((label, stated(name)) for name, label in _VISIT.items()),
    )


def outcome(fit: AdaptationFit) -> str:
    """Return in one sentence what the eye did, with intervals; where no break is claimed, that none is."""
    percent = f"{100 * fit.request.confidence:g} % intervals"
    if not fit.has_break:
        final = short(fit, "final_threshold")
        return f"No rod–cone break is claimed: one branch, falling to {final} log₁₀ units ({percent})."
    return (
        f"Rod–cone break at {short(fit, 'break_min')} min, then S2 of {short(fit, 's2_slope_per_min')} log₁₀ units per "
        f"min ({percent})."
    )


def _intercept(fit: AdaptationFit) -> str:
    """Return what the rod intercept says, where the protocol reports one."""
    met = intercept_verdict(fit)
    if met is None:
        return ""
    time = (
        f" The time is {_with_interval(fit, 'rod_intercept_min', 'min')}."
        if "rod_intercept_min" in fit.estimates
        else ""
    )
    return paragraph(f"{met[0].upper()}{met[1:]}.{time}")


def meaning(fit: AdaptationFit) -> list[str]:
    """Return what the curve shows of the eye, and what would show more."""
    last_min = float(fit.chosen.series.time_min[-1])
    if not fit.has_break:
        earliest = fit.evidence.earliest_visible_min
        seen = (
            "With these thresholds no break could be detected. Take more of them, or a longer test."
            if earliest is None
            else f"A typical eye's break after {earliest:.1f} min would have been seen, an earlier one not. An eye of "
            "rods or of cones alone looks like this, and so does a bleach that was too weak."
        )
        return [
            seen,
            f"The last threshold was taken after {last_min:.1f} min: a later break cannot be detected.",
        ]
    values = fit.chosen.values
    sentences = [
        f"Cones alone set the threshold until {values['break_min']:.1f} min, and levelled off at "
        f"{_with_interval(fit, 'plateau', 'log₁₀')}.",
        f"Then the rods took over: their threshold falls by one log₁₀ unit in "
        f"{1.0 / -values['s2_slope_per_min']:.1f} min.",
    ]
    if "rod_rod_break_min" in values:
        sentences.append(f"From {_with_interval(fit, 'rod_rod_break_min', 'min')} on it falls more slowly (S3).")
    interval = fit.estimates["break_min"].profile or fit.estimates["break_min"].bootstrap
    if interval is None or not np.isfinite([interval.low, interval.high]).all():
        sentences.append("The break's interval is open at an end: more thresholds around it would close it.")
    return sentences


def _remarks(fit: AdaptationFit) -> list[str]:
    series = fit.chosen.series
    light = np.count_nonzero(fit.chosen.weights < _HELD_WEIGHT * float(np.max(fit.chosen.weights)))
    notes = [f"Taken: {text}." for text in series.taken]
    if light and series.sigma is None:
        notes.append(f"{light} of {series.time_min.size} thresholds are far from the curve and have little weight.")
    if not fit.request.stimulus_u_log10:
        notes.append("No uncertainty of the stimulus' calibration was given: levels in log₁₀ units do not include it.")
    return notes


def _assumptions(fit: AdaptationFit) -> list[str]:
    percent = f"{100 * fit.request.confidence:g} %"
    return [
        f"Model {fit.chosen.model.name}: {fit.chosen.model.meaning}.",
        "The area under the dark-adaptation curve (AUDAC) counts from the final threshold upwards.",
        f"Intervals are of {percent}: of parameters by profile likelihood, of the others by "
        f"{fit.request.bootstrap_draws} bootstrap redraws.",
        f"The stimulus' calibration is uncertain by {fit.request.stimulus_u_log10:g} log₁₀ units, which the "
        "levels include.",
        f"A break is claimed from a deviance of {fit.evidence.needed:g} against the best falling convex curve; here "
        f"it is {_deviance(fit)}.",
    ]


def _deviance(fit: AdaptationFit) -> str:
    found = fit.evidence.deviance
    return f"{found:.1f}" if math.isfinite(found) else "none: no model with a break is plausible"


def _with_interval(fit: AdaptationFit, name: str, unit: str) -> str:
    """Return value ± half the interval, unit and confidence."""
    return f"{short(fit, name)} {unit} ({100 * fit.request.confidence:g} %)"


def _estimates(fit: AdaptationFit) -> str:
    rows = []
    for name, estimate in fit.estimates.items():
        interval = estimate.profile or estimate.bootstrap
        value, expanded = rounded(estimate.value, _COVERAGE * estimate.u)
        ends = [rounded(end, _COVERAGE * estimate.u)[0] for end in (interval.low, interval.high)] if interval else []
        rows.append((label_of(name, fit), value, expanded, " to ".join(ends), unit_text(estimate.unit)))
    head = ("", "value", "U (k = 2)", f"{100 * fit.request.confidence:g} % interval", "unit")
    return table(head, rows, words=(4,))


def _reliability(fit: AdaptationFit) -> str:
    """Return the table of false alarms, lapses and looks away, as far as the run has them."""
    rates = Reliability.of_facts(fit.chosen.series.facts).rates
    rows = [
        (
            NAMES[name],
            f"{100 * rate.value:.1f} %",
            f"{100 * rate.low:.1f} to {100 * rate.high:.1f} %",
            str(rate.count),
            MEANINGS[name],
        )
        for name, rate in rates.items()
    ]
    return table(("", "share", "95 % interval", "counted", "of what"), rows, words=(4,))


def _norms(fit: AdaptationFit) -> list[str]:
    """Return the published values of what was found, and which estimates have none."""
    rows = [(label_of(one.estimate, fit), one.found, one.conditions, one.source) for one in norms_of(fit.estimates)]
    if not rows:
        return []
    without = " and ".join(label_of(name, fit) for name in WITHOUT if name in fit.estimates)
    return [
        paragraph(
            "They hold for their bleach, spot and place. Measure healthy eyes of the same age with this set-up before "
            "you judge by them." + (f" {without}: no norm by age is known." if without else "")
        ),
        table(("", "found", "with", "source"), rows, words=(1, 2, 3)),
    ]


def _models(fit: AdaptationFit) -> str:
    rows = [
        (
            f"{one.model.name}{', chosen' if one is fit.chosen else ''}",
            f"{one.aicc - fit.chosen.aicc:+.1f}",
            f"{one.sigma:.3f}",
        )
        for one in fit.tried
    ]
    return table(("model", "AICc above the chosen", "scatter in log₁₀ units"), rows)
