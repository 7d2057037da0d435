"""The self-contained HTML report: one picture first, then each name with its evidence; tables last.

Pictures show the gap as it closes, each effect along its covariate, and the residual.
"""

from __future__ import annotations

import inspect
from typing import TYPE_CHECKING, Final

import numpy as np

from radiometer.numbers import unit_text, with_u
from radiometer.reconciliation.comparison import FAMILY
from radiometer.reconciliation.localise import covariates
from radiometer.reconciliation.result import FoundEffect, ReconcileResult, Verdict
from radiometer.reconciliation.search import Reconciled
from radiometer.reconciliation.state import FitState
from radiometer.reconciliation.statistics import STATISTICS, Prediction
from radiometer.reporting.origin import Origin
from radiometer.reporting.page import folded, heading, listed, page, paragraph, section, table
from radiometer.reporting.pictures import BEFORE, RULE, SEEN, dress, label, legend, picture, shortened
from radiometer.reporting.pictures import MODEL as AFTER
from radiometer.typing import Array
from simulators.effects.catalogue import CatalogueEffect
from simulators.effects.registry import all_effects

_LISTED_PLACES: Final = 5


def report_html(reconciled: Reconciled, title: str, origin: Origin) -> str:
    """Return the report as HTML, one file that needs nothing else."""
    result = reconciled.result
    return page(
        title,
        outcome(result),
        [
            paragraph(_summary(result)),
            _story(reconciled),
            *[_effect(effect, reconciled) for effect in result.effects],
            paragraph(f"Next capture: {result.next_capture['description']}", "do") if result.next_capture else "",
            _repeats(result),
            section("Where the residual is", _rest_map(reconciled.outcome.state)),
            heading("Figures"),
            folded("Equal frames, each less the others of its series", _frames(result)),
            folded(
                "Residuals along each setting, before and after",
                _residual_panels(reconciled) if result.covariates else "",
            ),
            folded(
                "Where simulation and measurement disagreed at first, found without any known effect", _places(result)
            ),
            folded("Largest trend along each covariate", _covariate_table(result)),
            folded("What these data would have detected", _limits(result)),
            folded("What was assumed", listed([f"{text}." for text in result.assumptions])),
        ],
        kind="reconcile",
        origin=origin,
    )


def outcome(result: ReconcileResult) -> str:
    """Return the verdict with names and their sizes with U (k = 2), where it shows if it has no name, or the gap."""
    named = [
        " or ".join((f"{effect.name}{_size(effect)}", *effect.alternatives))
        for effect in result.effects
        if effect.name != "unnamed"
    ]
    if result.verdict is Verdict.AGREES:
        return f"{result.sentence.removesuffix('.')} (gap {result.gap_after:.3g}; 1 is noise alone)."
    if result.verdict is Verdict.UNNAMED:
        where = next((along(effect.where) for effect in result.effects if effect.name == "unnamed"), "")
        return f"{result.sentence} It shows {where}." if where else result.sentence
    return f"{result.sentence.removesuffix('.')}: {', '.join(named)}." if named else result.sentence


def _size(effect: FoundEffect) -> str:
    for name, entry in effect.parameters.items():
        if entry.u is not None:
            unit = unit_text(entry.unit)
            return f" ({_plain(name, entry.unit)} {with_u(entry.value, 2.0 * entry.u, unit)}, k = 2)"
    return ""


def _plain(name: str, unit: str) -> str:
    stem, _, last = name.rpartition("_")
    return (stem if stem and last.casefold() == unit.casefold().rstrip("-") else name).replace("_", " ")


def _summary(result: ReconcileResult) -> str:
    names = [effect.name for effect in result.effects if effect.name != "unnamed"]
    gap = f"The gap of settings left out of the fit went from {result.gap_before:.3g} to {result.gap_after:.3g}"
    if not result.effects:
        gap = f"The gap of settings left out of the fit is {result.gap_after:.3g}"
    named = f" by {', '.join(names)}" if names else ""
    return (
        f"{gap}{named} ({result.gap_unit}; 1 is noise alone). {result.captures} settings, {result.frames} frames; "
        f"{result.tests[1]} of {result.tests[0]} tests still stand out."
    )


def _places(result: ReconcileResult) -> str:
    rows = [
        (seen_in(place.block), along(place.covariate), place.form, f"{place.score:.1f}", f"{place.p_value:.2g}")
        for place in result.localisation[:_LISTED_PLACES]
    ]
    return table(("what", "along", "form", "χ²", "p"), rows, words=(1, 2))


def _repeats(result: ReconcileResult) -> str:
    message = [f"{text[0].upper()}{text[1:]}." for one in result.repeats for text in one.sentences()]
    return section("How equal frames differ", listed(message)) if message else ""


def _frames(result: ReconcileResult) -> str:
    rows = []
    for part in result.repeats:
        scale, unit = (100.0, "%") if part.scatter.unit == "1" else (1.0, part.scatter.unit)
        for one in part.series:
            apart = (with_u(scale * value, 2.0 * scale * u, unit) for value, u in zip(one.apart, one.u, strict=True))
            rows += [(str(n), f"{one.exposure_s:.4g} s", shown) for n, shown in zip(one.frames, apart, strict=True)]
    return table(("frame", "exposure", "apart (k = 2)"), rows)


def _effect(effect: FoundEffect, reconciled: Reconciled) -> str:
    present = {one.name: one for one in reconciled.outcome.state.effects}
    entry = present.get(effect.name)
    title = "Not explained by any known effect" if effect.name == "unnamed" else effect.name
    tags = [
        text
        for text, holds in (("provisional", effect.provisional), ("weak", effect.is_weak and entry is not None))
        if holds
    ]
    return "\n".join(
        (
            heading(title, tags),
            paragraph(_physics(type(entry)), "what") if entry else "",
            paragraph(_evidence(effect)),
            _effect_picture(effect, entry, reconciled),
            _parameters(effect),
            _law(effect),
            _rivals(effect),
            _advice(effect, entry),
        )
    )


def _physics(kind: type[CatalogueEffect]) -> str:
    return (inspect.getdoc(kind) or "").partition("\n\n")[0].replace("\n", " ")


def _evidence(effect: FoundEffect) -> str:
    sentence = f"It shows in {seen_in(effect.block)}, {along(effect.where)}."
    if effect.name == "unnamed":
        return sentence
    closed = f" With it the gap falls from {effect.gap_before:.3g} to {effect.gap_after:.3g}"
    weak = "; that is little: repeat the captures" if effect.is_weak else ""
    known = f" {effect.evidence.capitalize()}." if effect.probability is not None else ""
    return (
        f"{sentence}{closed}, and settings left out are predicted better by {effect.gain_nats:.0f} nats{weak}.{known}"
    )


def _effect_picture(effect: FoundEffect, entry: CatalogueEffect | None, reconciled: Reconciled) -> str:
    state = reconciled.outcome.state
    if entry is None:
        return plot_along(state, effect.where, effect.block)
    first = next(iter(effect.parameters.values()), None)
    known = first is not None and first.u is not None and first.value != 0
    u_rel = abs(first.u / first.value) if known and first is not None and first.u is not None else None
    return plot_along(state, entry.where, entry.block, entry, u_rel)


def _parameters(effect: FoundEffect) -> str:
    rows = []
    for name, entry in effect.parameters.items():
        shown = with_u(entry.value, 2.0 * entry.u if entry.u is not None else 0.0, entry.unit)
        rows.append((_plain(name, entry.unit), shown, "not fitted" if entry.u is None else ""))
    return table(("parameter", "value (k = 2)", ""), rows, words=(2,))


def _law(effect: FoundEffect) -> str:
    if effect.curve is None:
        return ""
    (first, knots), *second = effect.curve.along.items()
    columns = second[0][1] if second else (None,)
    known = zip(effect.curve.factor, effect.curve.u, strict=True)
    shown = [f"{value:.3g}" if u is None else with_u(value, 2.0 * u, "") for value, u in known]
    width = len(columns)
    rows = [(f"{at:.3g}", *shown[n * width : (n + 1) * width]) for n, at in enumerate(knots)]
    heads = ("factor",) if not second else tuple(f"{axis_label(second[0][0])[0]} {at:.3g}" for at in columns)
    sentence = "It follows another functional form: the factors below multiply the catalogue's equation, ± U (k = 2)."
    return paragraph(sentence) + table((axis_label(first)[0], *heads), rows)


def _rivals(effect: FoundEffect) -> str:
    closest = (
        paragraph(
            f"Closest known effect: {effect.closest[0]}, which explains {100 * effect.closest[1]:.0f} % of it."
            f"{_in_words(effect.closest[0])}"
        )
        if effect.closest
        else ""
    )
    if not effect.alternatives:
        return closest
    others = listed([f"{name}.{_in_words(name)}" for name in effect.alternatives])
    together = f" ({effect.evidence_of_any})" if effect.evidence_of_any else ""
    only = "Each ± is conditional on this effect being the right one."
    return f"{closest}{paragraph(f'These data cannot separate it from{together}:')}{others}{paragraph(only, 'small')}"


def _in_words(name: str) -> str:
    kind = all_effects().get(name)
    return f" {_physics(kind)}" if kind is not None and issubclass(kind, CatalogueEffect) else ""


def _advice(effect: FoundEffect, entry: CatalogueEffect | None) -> str:
    following = str(effect.next_capture.get("description", "")) if effect.next_capture else ""
    if following:
        return paragraph(f"To settle it, take: {following}", "do")
    if effect.name == "unnamed":
        what = axis_label(effect.where)[0]
        return paragraph(f"To learn more, vary nothing but this, in more steps and in another order: {what}.", "do")
    return paragraph(f"To see it alone: {entry.settles}.", "do") if entry and entry.settles else ""


def _covariate_table(result: ReconcileResult) -> str:
    rows = [
        (along(name), f"{gap.before:.1f}", f"{gap.after:.1f}")
        for name, gap in sorted(result.covariates.items(), key=lambda item: -item[1].before)
    ]
    note = "Largest trend's χ² per degree of freedom; a single trend has 1 by chance."
    return table(("covariate", "before", "after"), rows) + paragraph(note, "small")


def _limits(result: ReconcileResult) -> str:
    rows = [
        (
            name,
            "blind" if v.amplitude is None else f"{v.amplitude:.3g}",
            unit_text(v.unit),
            v.parameter.replace("_", " "),
        )
        for name, v in result.limits.items()
    ]
    note = "Sizes that would stand out by 5 sigma; “nothing is missing” holds only for larger effects."
    shown = table(("effect", "from", "unit", "parameter"), rows, words=(2, 3))
    return f"{paragraph(note, 'small')}{shown}" if shown else ""


# ---- pictures -------------------------------------------------------------------------------------------------------
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


def _story(reconciled: Reconciled) -> str:
    steps = len(reconciled.outcome.steps)

    def draw(figure: Figure, narrow: bool) -> None:
        if narrow:
            first, second = figure.subplots(2, 1, height_ratios=(3.0, 1.2 + 0.25 * steps))
        else:
            first, second = figure.subplots(1, 2, width_ratios=(3, 2))
        _deviations(first, reconciled)
        _steps(second, reconciled)

    caption = (
        f"Every patch of every setting, measured against simulated{', before and after' if steps else ''}; then how "
        "far settings that the fit did not see are missed, step by step: at 1 only noise is left."
    )
    return picture(draw, caption, (10.0, 3.9), (4.0, 4.9 + 0.25 * steps))


def _deviations(axes: Axes, reconciled: Reconciled) -> None:
    from matplotlib.ticker import MaxNLocator

    outcome = reconciled.outcome
    states = [(outcome.start, BEFORE, "simulated before"), (outcome.state, AFTER, "simulated after")]
    if not outcome.steps:  # both are the same
        states = [(outcome.state, _colour_of_start(reconciled), "simulated")]
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


def _colour_of_start(reconciled: Reconciled) -> str:
    agrees = not reconciled.outcome.steps and reconciled.result.verdict is Verdict.AGREES
    return AFTER if agrees else BEFORE


def _relative(state: FitState) -> tuple[Array, Array]:
    light = state.sensitivity  # d(mean)/d(ln light)
    usable = state.comparison.usable["mean"] & (light > _DIMMEST_DN)
    return light[usable], 100.0 * (state.seen.mean - state.prediction.mean)[usable] / light[usable]


def _absolute(state: FitState) -> tuple[Array, Array]:
    usable = state.comparison.usable["mean"]
    settings, patches = usable.shape
    place = np.arange(1.0, settings + 1.0)[:, None] + np.linspace(-0.35, 0.35, patches)
    return place[usable], (state.seen.mean - state.prediction.mean)[usable]


def _steps(axes: Axes, reconciled: Reconciled) -> None:
    result, steps = reconciled.result, reconciled.outcome.steps
    names = ["ideal camera", *(f"+ {step.name}" for step in steps)]
    gaps = [result.gap_before, *(step.gap_after for step in steps)]
    if steps and abs(gaps[-1] - result.gap_after) > 0.005:
        names, gaps = [*names, "all, fitted together"], [*gaps, result.gap_after]
    place = np.arange(len(gaps))[::-1]
    colours = [_colour_of_start(reconciled), *[AFTER] * (len(gaps) - 1)]
    axes.barh(place, gaps, color=colours, height=0.62)
    for y, gap in zip(place, gaps, strict=True):
        right = max(gap, 1.0)  # of the line of 1
        axes.annotate(f"{gap:.3g}", (right, y), xytext=(3, 0), textcoords="offset points", va="center")
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


def plot_along(
    state: FitState, where: str, block: str, effect: CatalogueEffect | None = None, u_rel: float | None = None
) -> str:
    """Return what the model leaves of a statistic along a covariate, without an effect and with what that predicts.

    Args:
        effect: One of the model's effects; None for what no name explains.
        u_rel: Relative standard uncertainty of its main parameter; None where it has none.

    Returns:
        The picture; nothing where the covariate does not vary, or no entry of the statistic counts.
    """
    axis = covariates(state.model, state.prediction).get(where)
    if axis is None:
        return ""
    value, within = _left(state, axis.value, block, state.prediction)
    if not value.size:
        return ""
    others = tuple(one for one in state.effects if one is not effect)
    without = within if effect is None else _left(state, axis.value, block, state.predicted_with(others))[1]
    x, seen, u = _binned(where, value, without)
    _, curve, _ = _binned(where, value, without - within)
    what = "with all that is named" if effect is None else "without it"

    def draw(figure: Figure, narrow: bool) -> None:
        axes = figure.subplots()
        axes.errorbar(x, seen, u, fmt="o", ms=4, lw=1, color=BEFORE, label=f"measured − simulated {what}")
        if effect is not None:
            axes.plot(x, curve, color=AFTER, lw=1.6, label=label(f"what {shortened(effect.name, 40)} predicts"))
        if u_rel is not None and np.isfinite(u_rel):
            wide = 2.0 * min(u_rel, 1.0) * np.abs(curve)
            axes.fill_between(x, curve - wide, curve + wide, color=AFTER, alpha=0.2, linewidth=0)
        _along(axes, where, f"{block}: residual in σ")

    caption = "What no known effect explains, along what it follows, with k = 1 bars."
    if effect is not None:
        caption = "Points: residual without it, with k = 1 bars. Line: what it predicts, with its k = 2 band."
    return picture(draw, caption, _WIDE, _NARROW)


def _left(state: FitState, value: Array, block: str, prediction: Prediction) -> tuple[Array, Array]:
    residual = state.comparison.residual(prediction)
    values, left = [np.zeros(0)], [np.zeros(0)]
    for name, cut in state.comparison.cuts.items():
        if block in (name, FAMILY[name]):
            shape, usable = STATISTICS[name].shape(state.design), state.comparison.usable[name]
            values.append(np.broadcast_to(_fitting(value, len(shape)), shape)[usable])
            left.append(residual[cut].reshape(shape)[usable])
    return np.concatenate(values), np.concatenate(left)


def _fitting(value: Array, dimensions: int) -> Array:
    return np.asarray(
        value.mean(axis=1) if dimensions == 1 else value if value.ndim == dimensions else value[..., None]
    )


def _rest_map(state: FitState) -> str:
    from matplotlib import colormaps
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
    norm, colours = TwoSlopeNorm(0.0, -reach, reach), colormaps["RdBu_r"]

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


def _residual_panels(reconciled: Reconciled) -> str:
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
    axis = covariates(state.model, state.prediction)[name]
    usable = state.comparison.usable["mean"]
    deviation = np.hypot(state.comparison.deviation["mean"], state.tau * state.sensitivity)
    standardised = ((state.seen.mean - state.prediction.mean) / deviation)[usable]
    return _binned(name, axis.value[usable], standardised)


def _binned(name: str, value: Array, standardised: Array) -> tuple[Array, Array, Array]:
    levels = np.unique(np.round(value, 6))
    if levels.size <= _BINS:  # every setting has a separate point
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
    if name == "f_number":
        return np.asarray(2.0**value)
    if name == "signal":
        return np.asarray(np.maximum(10.0**value - 10.0, 1.0))
    return np.asarray(10.0**value if axis_label(name)[1] else value)


def _along(axes: Axes, covariate: str, what: str) -> None:
    words, logarithmic = axis_label(covariate)
    axes.axhline(0.0, color=RULE, lw=0.8)
    if logarithmic:
        axes.set_xscale("log")
    dress(axes, label(words), label(what))
    legend(axes)


# ---- words ----------------------------------------------------------------------------------------------------------
# What stands at the axis of a covariate, whether that is logarithmic, and along what something changes.
_COVARIATES: Final = {
    "exposure_s": ("exposure in s", True, "with the exposure time"),
    "f_number": ("f-number", True, "with the f-number"),
    "signal": ("signal in e⁻", True, "with the signal"),
    "patch_level": ("radiance of the patch in W·sr⁻¹·m⁻²", True, "with the brightness of the patch"),
    "previous_frame": ("signal of the capture before in e⁻, plus 1", True, "with the brightness of the capture before"),
    "gain_db": ("gain in dB", False, "with the gain"),
    "temperature_C": ("sensor temperature in °C", False, "with the sensor's temperature"),
    "timestamp_s": ("time in s", False, "in the course of time"),
    "source_level": ("source level", False, "with the level of the source"),
    "image_x": ("column in pixels", False, "across the picture"),
    "image_y": ("row in pixels", False, "down the picture"),
    "field_radius": (
        "distance from the middle of the picture (1 in the corner)",
        False,
        "from the middle of the picture to its corners",
    ),
    "half_x": ("left and right half of the picture", False, "along half x"),
    "half_y": ("upper and lower half of the picture", False, "along half y"),
    "pattern": ("displayed pattern", False, "along pattern"),
    "screen_x": ("screen_x", False, "across the screen"),
}
_SEEN: Final = {
    "mean": "how bright patches are",
    "slope": "how brightness changes within patches",
    "variance": "how much a pixel's value scatters from frame to frame",
    "spatial": "how much pixels of a patch differ among each other",
    "neighbour": "how alike neighbouring pixels scatter",
    "first": "how the first frame of a setting differs from the next",
    "common": "how whole frames brighten and darken together",
    "bands": "how rows brighten and darken together",
    "row_temporal": "how whole rows scatter",
    "columns": "how columns differ from each other",
    "rows": "how rows differ from each other",
    "edge": "how sharp the borders of patches are",
    "outliers": "how many single pixels stand far out",
    "unsteady": "how many single pixels are far noisier than the others",
    "comb": "which codes occur",
}


def axis_label(covariate: str) -> tuple[str, bool]:
    """Return what stands at the axis of a covariate, and whether the axis is logarithmic."""
    return _COVARIATES.get(covariate, (covariate, False, ""))[:2]


def along(covariate: str) -> str:
    """Return in words along what something changes."""
    return _COVARIATES[covariate][2] if covariate in _COVARIATES else f"along {covariate.replace('_', ' ')}"


def seen_in(block: str) -> str:
    """Return in words what a statistic is."""
    return _SEEN.get(block.partition("_x")[0], block)
