"""Draws the pictures of the report: the gap as it closes, each effect along its covariate, and the residual."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np

from radiometer.reconciliation.fit.comparison import FAMILY
from radiometer.reconciliation.fit.covariates import covariates
from radiometer.reconciliation.fit.state import FitState
from radiometer.reconciliation.report.words import AXES, axis_label
from radiometer.reconciliation.result import Verdict
from radiometer.reconciliation.search.outcome import Reconciled
from radiometer.reconciliation.statistics import STATISTICS, Prediction
from radiometer.reporting.pictures import BEFORE, RULE, SEEN, dress, label, legend, picture, shortened
from radiometer.reporting.pictures import MODEL as AFTER
from radiometer.typing import Array
from simulators.effects.catalogue import CatalogueEffect

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_WIDE: Final = (8.0, 3.3)
_NARROW: Final = (4.0, 3.0)
_CHANCE_SIGMAS: Final = 4.0
_FEWEST_ROWS: Final = 3  # of the bars: one alone is not drawn as tall as the picture
_BINS: Final = 14
_PANELS: Final = 6
_SMALLEST_REACH: Final = 0.01  # of an axis, in % or DN: finer than any converter resolves
_DIMMEST_DN: Final = 3.0  # below, a relative deviation of the means says nothing


def story(reconciled: Reconciled) -> str:
    """Return the opening picture: measured over simulated before and after, and the gap step by step."""
    steps = len(reconciled.outcome.steps)

    def draw(figure: Figure, narrow: bool) -> None:
        if narrow:
            first, second = figure.subplots(2, 1, height_ratios=(3.0, 1.2 + 0.25 * steps))
        else:
            first, second = figure.subplots(1, 2, width_ratios=(3, 2))
        _deviations(first, reconciled)
        _steps(second, reconciled)

    caption = (
        "Every patch of every setting, measured against simulated, before and after; then how far settings that the "
        "fit did not see are missed, step by step: at 1 only noise is left."
    )
    return picture(draw, caption, (10.0, 3.9), (4.0, 4.9 + 0.25 * steps))


def _deviations(axes: Axes, reconciled: Reconciled) -> None:
    """Draw what each patch deviates by: relative over its light, or in DN over the settings where none has light."""
    from matplotlib.ticker import MaxNLocator

    outcome = reconciled.outcome
    states = ((outcome.start, BEFORE, "simulated before"), (outcome.state, AFTER, "simulated after"))
    lit = any(_relative(state)[0].size for state, _, _ in states)
    drawn = [(*(_relative(state) if lit else _absolute(state)), colour, words) for state, colour, words in states]
    for x, deviation, colour, words in drawn:
        axes.plot(
            x, deviation, ".", ms=4, alpha=0.4, color=colour, label=words, markeredgewidth=0, rasterized=True
        )  # fmt: skip
    axes.axhline(0.0, color=SEEN, lw=1.2, label="measured = simulated")
    first = next((deviation for _, deviation, _, _ in drawn if deviation.size), np.ones(1))
    reach = max(float(np.quantile(np.abs(first), 0.99)), _SMALLEST_REACH)
    axes.set_ylim(-1.3 * reach, 1.3 * reach)
    if lit:
        axes.set_xscale("log")
        dress(axes, "simulated signal above black in DN", "measured − simulated in %")
    else:
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        dress(axes, "setting in the order taken (none has light)", "measured − simulated in DN")
    shown = axes.legend(fontsize=9, markerscale=3, framealpha=0.85, edgecolor="none")
    for handle in shown.legend_handles:
        if handle is not None:
            handle.set_alpha(1.0)


def _relative(state: FitState) -> tuple[Array, Array]:
    """Return what light adds to the means in DN, and their deviation in % of it, where both say something."""
    light = state.sensitivity  # d(mean)/d(ln light)
    usable = state.comparison.usable["mean"] & (light > _DIMMEST_DN)
    return light[usable], 100.0 * (state.seen.mean - state.prediction.mean)[usable] / light[usable]


def _absolute(state: FitState) -> tuple[Array, Array]:
    """Return the setting of each mean, counted from 1, its patches side by side, and its deviation in DN."""
    usable = state.comparison.usable["mean"]
    settings, patches = usable.shape
    place = np.arange(1.0, settings + 1.0)[:, None] + np.linspace(-0.35, 0.35, patches)
    return place[usable], (state.seen.mean - state.prediction.mean)[usable]


def _steps(axes: Axes, reconciled: Reconciled) -> None:
    """Draw the held-out gap after each name, from top to bottom."""
    result, steps = reconciled.result, reconciled.outcome.steps
    names = ["ideal camera", *(f"+ {step.name}" for step in steps)]
    gaps = [result.gap_before, *(step.gap_after for step in steps)]
    if steps and abs(gaps[-1] - result.gap_after) > 0.005:
        names, gaps = [*names, "all, fitted together"], [*gaps, result.gap_after]
    place = np.arange(len(gaps))[::-1]
    agrees = not steps and result.verdict is Verdict.AGREES
    colours = [AFTER if agrees else BEFORE, *[AFTER] * (len(gaps) - 1)]
    axes.barh(place, gaps, color=colours, height=0.62)
    for y, gap in zip(place, gaps, strict=True):
        behind = {"facecolor": "white", "edgecolor": "none", "pad": 0.6}  # the line of 1 may be there
        axes.annotate(f"{gap:.3g}", (gap, y), xytext=(3, 0), textcoords="offset points", va="center", bbox=behind)
    axes.axvline(1.0, color=SEEN, lw=1.0, ls="--")
    axes.set_ylim(min(0.0, len(gaps) - _FEWEST_ROWS) - 0.6, len(gaps) - 0.4)
    axes.set_yticks(place, [label(shortened(name, 30)) for name in names])
    if max(gaps) > 8.0:
        axes.set_xscale("log")
        axes.set_xlim(0.5, 3.0 * max(gaps))
    else:
        axes.set_xlim(0.0, 1.2 * max(*gaps, 1.0))
    dress(axes, "gap of held-out settings\n(1 = noise alone)", "")
    axes.grid(visible=False, axis="y")


def effect_plot(state: FitState, effect: CatalogueEffect, u_rel: float | None) -> str | None:
    """Return what the data show along an effect's covariate without it, and what it predicts there.

    Args:
        u_rel: Relative standard uncertainty of its main parameter; None where it has none.

    Returns:
        The picture; None where the covariate does not vary, or no entry of the statistic counts.
    """
    axis = covariates(state.model, state.prediction).get(effect.where)
    if axis is None:
        return None
    others = tuple(one for one in state.effects if one is not effect)
    value, without = _left(state, axis.value, effect.block, state.predicted_with(others))
    if not value.size:
        return None
    _, within = _left(state, axis.value, effect.block, state.prediction)
    x, seen, u = _binned(effect.where, value, without)
    _, curve, _ = _binned(effect.where, value, without - within)

    def draw(figure: Figure, narrow: bool) -> None:
        axes = figure.subplots()
        axes.errorbar(x, seen, u, fmt="o", ms=4, lw=1, color=BEFORE, label="measured − simulated without it")
        axes.plot(x, curve, color=AFTER, lw=1.6, label=label(f"what {shortened(effect.name, 40)} predicts"))
        if u_rel is not None and np.isfinite(u_rel):
            wide = 2.0 * min(u_rel, 1.0) * np.abs(curve)
            axes.fill_between(x, curve - wide, curve + wide, color=AFTER, alpha=0.2, linewidth=0)
        _along(axes, effect.where, f"{effect.block}: residual in σ")

    caption = "Points: residual without it, with k = 1 bars. Line: what it predicts, with its k = 2 band."
    return picture(draw, caption, _WIDE, _NARROW)


def unnamed_plot(state: FitState, where: str, block: str) -> str | None:
    """Return what the final model leaves of a statistic along a covariate.

    Returns:
        The picture; None where the covariate does not vary.
    """
    axis = covariates(state.model, state.prediction).get(where)
    value, left = (np.zeros(0),) * 2 if axis is None else _left(state, axis.value, block, state.prediction)
    if not value.size:
        return None
    x, seen, u = _binned(where, value, left)

    def draw(figure: Figure, narrow: bool) -> None:
        axes = figure.subplots()
        axes.errorbar(
            x, seen, u, fmt="o", ms=4, lw=1, color=BEFORE, label="measured − simulated with all that is named"
        )
        _along(axes, where, f"{block}: residual in σ")

    return picture(draw, "What no known effect explains, along what it follows, with k = 1 bars.", _WIDE, _NARROW)


def _left(state: FitState, value: Array, block: str, prediction: Prediction) -> tuple[Array, Array]:
    """Return a covariate's values and standardised residuals of a statistic, in all of its directions, where usable."""
    residual = state.comparison.residual(prediction)
    values, left = [np.zeros(0)], [np.zeros(0)]
    for name, cut in state.comparison.cuts.items():
        if block in (name, FAMILY[name]):
            shape, usable = STATISTICS[name].shape(state.design), state.comparison.usable[name]
            values.append(np.broadcast_to(_fitting(value, len(shape)), shape)[usable])
            left.append(residual[cut].reshape(shape)[usable])
    return np.concatenate(values), np.concatenate(left)


def _fitting(value: Array, dimensions: int) -> Array:
    """Return a covariate in the shape of a statistic: of captures alone where it has no tiles."""
    return np.asarray(
        value.mean(axis=1) if dimensions == 1 else value if value.ndim == dimensions else value[..., None]
    )


def rest_map(state: FitState) -> str:
    """Return where on the picture the final model still disagrees: each patch by its residual over all captures."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import TwoSlopeNorm
    from matplotlib.patches import Rectangle

    design = state.design
    cut = state.comparison.cuts["mean"]
    residual = state.comparison.residual(state.prediction)[cut].reshape(STATISTICS["mean"].shape(design))
    usable = state.comparison.usable["mean"]
    count = usable.sum(axis=0)
    score = np.where(count > 0, residual.sum(axis=0) / np.sqrt(np.maximum(count, 1)), np.nan)
    height, width = design.shape
    reach = max(_CHANCE_SIGMAS, float(np.nanmax(np.abs(score), initial=0.0)))
    norm, colours = TwoSlopeNorm(0.0, -reach, reach), _diverging()

    def draw(figure: Figure, narrow: bool) -> None:
        axes = figure.subplots()
        for tile, one in zip(design.tiles, score, strict=True):
            colour = colours(norm(one)) if np.isfinite(one) else "#dddddd"
            axes.add_patch(
                Rectangle((tile.x, tile.y), tile.width, tile.height, facecolor=colour, edgecolor="#555", lw=0.4)
            )
        axes.set_xlim(0, width)
        axes.set_ylim(height, 0)
        axes.set_aspect("equal")
        axes.set_xlabel("column in pixels")
        axes.set_ylabel("row in pixels")
        bar = {"orientation": "horizontal", "aspect": 40} if narrow else {"shrink": 0.9}
        figure.colorbar(ScalarMappable(norm, colours), ax=axes, label="mean over all captures, in σ", **bar)

    beyond = int(np.count_nonzero(np.abs(score[np.isfinite(score)]) > _CHANCE_SIGMAS))
    caption = (
        f"Patches by their residual after the final model; within ±{_CHANCE_SIGMAS:g} σ is chance. {beyond} of "
        f"{int(np.isfinite(score).sum())} are beyond."
    )
    return picture(draw, caption, (6.8, 0.6 + 5.2 * height / width), (4.0, 1.0 + 3.2 * height / width))


def _diverging() -> Any:
    from matplotlib import colormaps

    return colormaps["RdBu_r"]


def residual_panels(reconciled: Reconciled) -> str:
    """Return the residuals of the means along the most telling covariates, before and after."""
    gaps = reconciled.result.covariates
    # What varies in the tiles that one model leaves usable need not vary in those of the other.
    drawn = [covariates(one.model, one.prediction) for one in (reconciled.outcome.start, reconciled.outcome.state)]
    both = [name for name in gaps if all(name in axes for axes in drawn)]
    names = sorted(both, key=lambda name: -gaps[name].before)[:_PANELS]
    if not names:
        return ""

    def draw(figure: Figure, narrow: bool) -> None:
        columns = 1 if narrow else 2
        panels = figure.subplots(-(-len(names) // columns), columns, squeeze=False).ravel()
        for axes, name in zip(panels, names, strict=False):
            for state, colour, words in (
                (reconciled.outcome.start, BEFORE, "before"),
                (reconciled.outcome.state, AFTER, "after"),
            ):
                x, y, u = _profile(state, name)
                axes.errorbar(x, y, u, fmt="o", ms=3, lw=1, color=colour, label=words)
            _along(axes, name, "residual in σ")
        for axes in panels[len(names) :]:
            axes.set_visible(False)

    caption = "Measured − simulated: means of patches, of one setting or of neighbouring settings."
    return picture(draw, caption, (10.0, 2.6 * -(-len(names) // 2)), (4.0, 2.3 * len(names)))


def _profile(state: FitState, name: str) -> tuple[Array, Array, Array]:
    """Return bin centres, mean standardised residual of the means, and its standard uncertainty."""
    axis = covariates(state.model, state.prediction)[name]
    usable = state.comparison.usable["mean"]
    deviation = np.hypot(state.comparison.deviation["mean"], state.tau * state.sensitivity)
    standardised = ((state.seen.mean - state.prediction.mean) / deviation)[usable]
    return _binned(name, axis.value[usable], standardised)


def _binned(name: str, value: Array, standardised: Array) -> tuple[Array, Array, Array]:
    """Return centres in a reader's units, means, and standard uncertainties of bins along a covariate."""
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


def _in_units(name: str, value: Array) -> Array:
    """Return values of a covariate as people read them; the tests use logarithms of most."""
    if name == "f_number":
        return np.asarray(2.0**value)
    if name == "signal":
        return np.asarray(np.maximum(10.0**value - 10.0, 1.0))
    return np.asarray(10.0**value if name in AXES else value)


def _along(axes: Axes, covariate: str, what: str) -> None:
    words, logarithmic = axis_label(covariate)
    axes.axhline(0.0, color=RULE, lw=0.8)
    if logarithmic:
        axes.set_xscale("log")
    dress(axes, label(words), label(what))
    legend(axes)
