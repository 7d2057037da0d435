"""Writes a dark-adaptation fit as JSON, CSV and a page with its curve and published values of healthy eyes.

Each figure was read in the abstract of its source. None is a limit of this instrument: bleach, spot and place differ.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from radiometer.adaptation.adaptation_fit import AdaptationFit, intercept_verdict
from radiometer.adaptation.branch_fit import BranchFit
from radiometer.adaptation.outcome import MEANINGS, NAMES, Reliability
from radiometer.data.storage import csv_text, write_text_atomic
from radiometer.numbers import rounded, unit_text
from radiometer.reporting.origin import Origin, moment
from radiometer.reporting.page import folded, listed, page, paragraph, section, table
from radiometer.reporting.pictures import BEFORE, DIMMED, MARK, MODEL, RULE, SEEN, dress, legend, mark, picture
from radiometer.typing import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


@dataclass(frozen=True, slots=True)
class Norm:
    """What a study found in healthy eyes."""

    estimate: str  # name of the estimate that it is of
    found: str  # what was found, with ages
    conditions: str  # bleach, spot, place and number of eyes
    source: str  # author, year and where


NORMS: Final = (
    Norm(
        "rod_intercept_min",
        "5.8 min in the median above 55 years, half of the eyes from 3.8 to 7.5 min",
        "flash that bleaches 76 % of the rods, 5° from the fovea; healthy controls",
        "Binns et al. 2018, Invest. Ophthalmol. Vis. Sci. 59, AMD114",
    ),
    Norm(
        "rod_intercept_min",
        "up to 6.5 min in 19 of 21 healthy adults, above it in 115 of 127 with macular degeneration",
        "AdaptDx, rapid test",
        "Jackson et al. 2014, Invest. Ophthalmol. Vis. Sci. 55, 1427",
    ),
    Norm(
        "rod_intercept_min",
        "12.3 min and more counts as abnormal from 60 years on",
        "flash, 5° below the fovea; adults in normal macular health",
        "Owsley et al. 2014, Invest. Ophthalmol. Vis. Sci. 55, 4776",
    ),
    Norm(
        "tau_min",
        "16.4 s longer for each decade of age",
        "96 % of the cones bleached, white spot of 4° at the fovea; 41 healthy adults of 20 to 83 years",
        "Gaffney, Binns and Margrain 2012, Optom. Vis. Sci. 89, 1219",
    ),
    Norm(
        "plateau",
        "no change with age at the fovea",
        "96 % of the cones bleached, white spot of 4° at the fovea; 41 healthy adults of 20 to 83 years",
        "Gaffney, Binns and Margrain 2012, Optom. Vis. Sci. 89, 1219",
    ),
    Norm(
        "plateau",
        "0.04 log₁₀ units higher for each decade of age",
        "27 places up to 18° from the fovea; 94 healthy adults from the twenties to the eighties",
        "Jackson and Owsley 2000, Vision Res. 40, 2467",
    ),
    Norm(
        "final_threshold",
        "0.08 log₁₀ units higher for each decade of age",
        "27 places up to 18° from the fovea; 94 healthy adults from the twenties to the eighties",
        "Jackson and Owsley 2000, Vision Res. 40, 2467",
    ),
)
WITHOUT: Final = ("break_min", "s2_slope_per_min")  # no study with value, spread and age of healthy eyes was found


def norms_of(estimates: Iterable[str]) -> list[Norm]:
    """Return the published values of estimates."""
    known = set(estimates)
    return [one for one in NORMS if one.estimate in known]


LABELS: Final = {
    "plateau": "Cone plateau",
    "amplitude": "Cone amplitude",
    "tau_min": "Cone time constant",
    "break_min": "Rod–cone break",
    "s2_slope_per_min": "S2 slope",
    "s3_slope_per_min": "S3 slope",
    "rod_rod_break_min": "Rod–rod break",
    "final_from_min": "Final threshold from",
    "rod_intercept_min": "Rod-intercept time",
    "criterion_min": "Time at the criterion",
    "final_threshold": "Final threshold",
    "area_log10_min": "Area under the curve (AUDAC)",
    "area_from_min": "AUDAC from",
    "area_to_min": "AUDAC cut at",
}
CHOSEN_TO: Final = 0.1  # what is chosen, not estimated, as the ends of an area in min, has two decimals
_HELD_WEIGHT: Final = 0.5  # of the largest; below, a threshold hardly counts
_POINTS: Final = 600  # about one per pixel
_LEFT_PART: Final = 0.45  # of the time axis; where the break is there, its words are to the right of it
_CENTRED: Final = 0.1  # of half an interval: nearer to its middle a value has a ±
_INTERVAL_SIGMAS: Final = 1.96  # 95 %


def story(fit: AdaptationFit) -> str:
    """Return the curve with its branches above what it leaves of the thresholds."""
    claimed = (
        "the vertical line is the break, with its interval; the sloping one S2"
        if fit.has_break
        else "grey is the best curve with a break, which these thresholds do not support"
    )
    caption = f"Thresholds with 95 % bars and the fitted curve; {claimed}. Below, the residuals."

    def draw(figure: Figure, narrow: bool) -> None:
        upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(3.6, 1.0))
        _curve(upper, fit)
        _residuals(lower, fit)

    return picture(draw, caption, (10.0, 5.6), (4.0, 5.2))


def _curve(axes: Axes, fit: AdaptationFit) -> None:
    series, values = fit.chosen.series, fit.chosen.values
    grid = np.linspace(float(series.time_min[0]), float(series.time_min[-1]), _POINTS)
    if not fit.has_break:
        _unclaimed(axes, fit, grid)
    axes.errorbar(
        series.time_min, series.log_threshold, _INTERVAL_SIGMAS * _deviation(fit), fmt="o", ms=4, lw=0.8, color=SEEN,
        ecolor=DIMMED, label="thresholds", zorder=2,
    )  # fmt: skip
    axes.plot(grid, fit.chosen.threshold(grid), color=MODEL, lw=2.2, label="fitted curve", zorder=3)
    if fit.has_break:
        _break(axes, fit)
        cone = values["plateau"] + values["amplitude"] * np.exp(-grid / values["tau_min"])
        late = grid >= values["break_min"]
        axes.plot(grid[late], cone[late], "--", color=BEFORE, lw=1.3, label="cones alone")
        _plateau(axes, fit)
    _criterion(axes, fit)
    dress(axes, "", f"log₁₀ threshold ({series.level_name})")
    legend(axes, "upper right")


def _deviation(fit: AdaptationFit) -> Array:
    """Return the standard deviation of each threshold: the scatter about the curve, shared out by the stated ones."""
    stated = fit.chosen.series.sigma
    scatter = np.full(fit.chosen.series.time_min.shape, fit.chosen.sigma)
    return scatter if stated is None else np.asarray(scatter * stated / float(np.sqrt(1.0 / np.mean(stated**-2))))


def _break(axes: Axes, fit: AdaptationFit) -> None:
    found = fit.estimates["break_min"]
    axes.axvline(found.value, color=MARK, lw=1.4)
    if found.interval is not None and found.interval.is_closed:
        axes.axvspan(found.interval.low, found.interval.high, color=MARK, alpha=0.18, lw=0)
    series = fit.chosen.series
    share = (found.value - float(series.time_min[0])) / float(np.ptp(series.time_min))
    side, way = ("left", 6) if share < _LEFT_PART else ("right", -6)
    mark(
        axes, f"break\n{short(fit, 'break_min')} min", (found.value, 0.03), (way, 0), MARK,
        xycoords=("data", "axes fraction"), ha=side, va="bottom",
    )  # fmt: skip
    end = fit.chosen.values.get("rod_rod_break_min", float(series.time_min[-1]))
    place = found.value + 0.6 * (end - found.value)
    level = float(fit.chosen.threshold(np.array([place]))[0])
    label = f"S2 {short(fit, 's2_slope_per_min')}\nlog₁₀ per min"
    mark(axes, label, (place, level), (-8, -4), MODEL, ha="right", va="top")


def _plateau(axes: Axes, fit: AdaptationFit) -> None:
    level = fit.chosen.values["plateau"]
    axes.axhline(level, color=BEFORE, lw=0.9, ls=":")
    label = f"cone plateau {short(fit, 'plateau')}"
    mark(axes, label, (1.0, level), (-4, 3), BEFORE, xycoords=("axes fraction", "data"), ha="right")


def _unclaimed(axes: Axes, fit: AdaptationFit, grid: Array) -> None:
    """Draw the best curve with a break in grey: what is not claimed, and how much of the evidence there is."""
    broken: list[BranchFit] = [one for one in fit.tried if "break_min" in one.values]
    if not broken:
        return
    best = min(broken, key=lambda one: one.aicc)
    when = best.values["break_min"]
    axes.plot(grid, best.threshold(grid), "--", color=DIMMED, lw=1.4, label="with a break: not claimed")
    axes.axvline(when, color=DIMMED, lw=1.0, ls=":")
    deviance = fit.evidence.deviance
    weighed = f" ({deviance:.1f} of {fit.evidence.needed:g})" if np.isfinite(deviance) else ""
    text = f"no break claimed{weighed}"
    mark(axes, text, (when, 0.03), (4, 0), RULE, xycoords=("data", "axes fraction"))


def _criterion(axes: Axes, fit: AdaptationFit) -> None:
    """Draw the levels whose times are reported: the protocol's rod intercept, and one that was asked for."""
    rule, asked = fit.request.intercept, fit.criterion
    if rule is not None:
        _crossing(axes, rule.criterion_log10, fit, "rod_intercept_min", "rod intercept")
    if asked is not None:
        _crossing(axes, asked, fit, "criterion_min", "criterion")


def _crossing(axes: Axes, level: float, fit: AdaptationFit, name: str, words: str) -> None:
    axes.axhline(level, color=RULE, lw=0.9, ls="-.")
    met = name in fit.estimates and np.isfinite(fit.estimates[name].value)
    if met:
        axes.plot([fit.estimates[name].value], [level], "D", ms=7, color=RULE, zorder=4)
        place, label = (fit.estimates[name].value, level), f"{words}\n{short(fit, name)} min"
    else:
        place, label = (float(fit.chosen.series.time_min[0]), level), f"{words}: not reached"
    mark(axes, label, place, (8, 4), RULE)


def short(fit: AdaptationFit, name: str) -> str:
    """Return an estimate with its interval, "value ± half", or "value +up -down" where it is not in the middle.

    It stands alone where the interval is open or was not made.
    """
    estimate = fit.estimates[name]
    interval = estimate.interval
    if interval is None or not interval.is_closed:
        return f"{estimate.value:.3g}"
    wide = (interval.high - interval.low) / 2.0
    value, half = rounded(estimate.value, wide)
    if abs((interval.high + interval.low) / 2.0 - estimate.value) <= _CENTRED * wide:
        return f"{value} ± {half}"
    decimals = len(half.partition(".")[2])
    up, down = (f"{end - estimate.value:+.{decimals}f}" for end in (interval.high, interval.low))
    return f"{value} {up} {down}"


def _residuals(axes: Axes, fit: AdaptationFit) -> None:
    series = fit.chosen.series
    axes.axhline(0.0, color=RULE, lw=1.0)
    axes.axhspan(-fit.chosen.sigma, fit.chosen.sigma, color=DIMMED, alpha=0.2, lw=0)
    axes.plot(series.time_min, series.log_threshold - fit.chosen.threshold(series.time_min), "o", ms=3.2, color=SEEN)
    dress(axes, "minutes in the dark", "residual (log₁₀)")


def label_of(name: str, fit: AdaptationFit) -> str:
    """Return the label of an estimate; a single branch may be the rods', so it is not called the cones'."""
    label = LABELS.get(name, name)
    if fit.has_break or not label.startswith("Cone "):
        return label
    return label.removeprefix("Cone ").capitalize()


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
        "norms": [asdict(one) for one in norms_of(fit.estimates)],
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
    residual = series.log_threshold - fitted
    rows = zip(series.time_min, series.log_threshold, fitted, residual, fit.chosen.weights, strict=True)
    head = ["time_min", "log10_threshold", "fitted", "residual", "weight"]
    return csv_text([head, *([f"{value:.6g}" for value in row] for row in rows)])


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
    known = "rod_intercept_min" in fit.estimates
    time = f" The time is {_with_interval(fit, 'rod_intercept_min', 'min')}." if known else ""
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
    if "final_from_min" in values:
        sentences.append(f"From {_with_interval(fit, 'final_from_min', 'min')} on it stays at its final threshold.")
    interval = fit.estimates["break_min"].interval
    if interval is None or not interval.is_closed:
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
        interval = estimate.interval
        half = 0.5 * (interval.high - interval.low) if interval is not None else math.nan
        value = rounded(estimate.value, half or CHOSEN_TO)[0]
        ends = [rounded(end, half)[0] for end in (interval.low, interval.high)] if interval is not None and half else []
        rows.append((label_of(name, fit), value, " to ".join(ends), unit_text(estimate.unit)))
    head = ("", "value", f"{100 * fit.request.confidence:g} % interval", "unit")
    return table(head, rows, words=(3,))


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
