"""The picture of a dark-adaptation fit: thresholds, branches, break with its interval, and what is not claimed."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from radiometer.adaptation.adaptation_fit import AdaptationFit
from radiometer.adaptation.branch_fit import BranchFit
from radiometer.numbers import rounded
from radiometer.reporting.pictures import BEFORE, DIMMED, MARK, MODEL, RULE, SEEN, dress, legend, mark, picture
from radiometer.typing import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_POINTS: Final = 600  # about one per pixel
_LEFT_PART: Final = 0.45  # of the time axis; where the break is there, its words are to the right of it
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
    interval = found.profile or found.bootstrap
    axes.axvline(found.value, color=MARK, lw=1.4)
    if interval is not None and np.isfinite([interval.low, interval.high]).all():
        axes.axvspan(interval.low, interval.high, color=MARK, alpha=0.18, lw=0)
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
    """Draw the level whose time is reported: the protocol's rod intercept, or one that was asked for."""
    rule, asked = fit.request.intercept, fit.criterion
    if rule is not None:
        _crossing(axes, rule.criterion_log10, fit, "rod_intercept_min", "rod intercept")
    elif asked is not None:
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
    """Return an estimate with half its interval, "value ± half"; alone where the interval is open or was not made."""
    estimate = fit.estimates[name]
    interval = estimate.profile or estimate.bootstrap
    if interval is None or not np.isfinite([interval.low, interval.high]).all():
        return f"{estimate.value:.3g}"
    value, half = rounded(estimate.value, (interval.high - interval.low) / 2.0)
    return f"{value} ± {half}"


def _residuals(axes: Axes, fit: AdaptationFit) -> None:
    series = fit.chosen.series
    axes.axhline(0.0, color=RULE, lw=1.0)
    axes.axhspan(-fit.chosen.sigma, fit.chosen.sigma, color=DIMMED, alpha=0.2, lw=0)
    axes.plot(series.time_min, series.log_threshold - fit.chosen.threshold(series.time_min), "o", ms=3.2, color=SEEN)
    dress(axes, "minutes in the dark", "residual")
