"""The report of reconciled photographs: each frame against what the other frames say of it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Final

import numpy as np

from radiometer.numbers import with_u
from radiometer.reconciliation.result import ReconcileResult, Verdict
from radiometer.reporting.origin import Origin
from radiometer.reporting.page import folded, heading, listed, page, paragraph, section, table
from radiometer.reporting.pictures import BEFORE, DIMMED, MODEL, RULE, dress, label, legend, picture, shortened
from radiometer.typing import Array

if TYPE_CHECKING:
    from matplotlib.figure import Figure


OFFSET: Final = "exposure_time_offset"
_BINS: Final = 24
_LONGEST_NAME: Final = 18
_COVERAGE: Final = 2.0
# From this error in ln exposure on a ninth of a stop counts as wrong.
_TOLERATED: Final = 0.08


@dataclass(frozen=True, slots=True, eq=False)
class FrameFinding:
    """One photograph compared with the others."""

    name: str  # of its file
    stated_s: float  # exposure on its label in s
    taken_s: float  # exposure that it was taken to have in the end in s
    ratio: float  # exposure that the others say over that of the label
    # Its standard uncertainty, the curve that the others leave open included; infinite where too few pixels show the
    # frame
    u_ratio: float
    # Real exposure over that of label and offset, or its inverse, from which the label would be named; infinite where
    # none
    named_from: float
    wrong: bool  # whether the label was found wrong
    dn: Array  # digital numbers of the frame, shape (rows,)
    error_dn: Array  # predicted from the others minus found, same shape; NaN where no other frame shows it
    error_as_printed_dn: Array  # the same with all labels as printed
    # What the label and the shutter's offset make together, over the label; 1 where no offset was taken
    expected: float = 1.0


def report_html(
    result: ReconcileResult, frames: Sequence[FrameFinding], sentence: str, title: str, origin: Origin
) -> str:
    """Return the report as HTML.

    Args:
        result: Verdict, effects and assumptions.
        frames: The photographs in the order of their exposure.
        sentence: The outcome in a sentence.
        title: What was reconciled.
        origin: What the photographs come from.
    """
    wrong = [one for one in frames if one.wrong]
    line = "the line of 1" if all(one.expected == 1.0 for one in frames) else "what label and shutter's offset make"
    return page(
        title,
        outcome(result, frames),
        [
            paragraph(sentence),
            picture(
                partial(_draw_ratios, frames=frames),
                "Exposure of each photograph found from the others, over its label, with U (k = 2): "
                + (f"those off {line} are named." if wrong else f"all are about {line}.")
                + " Within the grey band no label is called wrong: the common tone curve is not known better.",
                (10.0, 4.2),
                (4.0, 4.4),
            ),
            *[_label_section(one) for one in wrong],
            _what_to_do(wrong, result),
            section(
                "Each photograph against its prediction",
                picture(
                    partial(_draw_errors, frames=frames),
                    "Digital numbers of a left-out part of the picture, predicted by the other photographs, less "
                    "those measured: with the printed exposures, and with those found.",
                    (10.0, 4.6),
                    (4.0, 6.4),
                ),
            ),
            heading("Figures"),
            _frame_table(frames),
            folded("What these photographs would have detected", _limits(result)),
            folded("What was assumed", listed([f"{text}." for text in result.assumptions])),
        ],
        kind="reconcile",
        origin=origin,
    )


def outcome(result: ReconcileResult, frames: Sequence[FrameFinding]) -> str:
    """Return the outcome in one sentence, with U (k = 2)."""
    wrong = [one for one in frames if one.wrong]
    parts = []
    if any(effect.name == "nominal_settings" for effect in result.effects):
        parts.append("the printed times are rounded stops")
    for effect in (one for one in result.effects if one.name == OFFSET):
        found = effect.parameters["offset_s"]
        size = with_u(1e6 * abs(found.value), _COVERAGE * 1e6 * (found.u or 0.0), "µs")
        longer = "longer" if found.value > 0 else "shorter"
        parts.append(f"all exposures are {size} (k = {_COVERAGE:g}) {longer} than printed (the shutter's offset)")
    parts += [
        f"{one.name} had {with_u(one.ratio, _COVERAGE * one.u_ratio)} of its printed exposure (k = {_COVERAGE:g})"
        for one in wrong
    ]
    if result.verdict is Verdict.UNNAMED:
        return f"The {len(frames)} photographs follow no single tone curve with their printed exposures."
    if result.verdict is Verdict.AGREES or not parts:
        return f"The printed exposures of all {len(frames)} photographs agree."
    sentence = f"{', '.join(parts[:-1])} and {parts[-1]}" if len(parts) > 1 else parts[0]
    rivals = [text for effect in result.effects for text in effect.alternatives]
    agree = (
        "the others agree"
        if wrong or all(effect.name != OFFSET for effect in result.effects)
        else "with that offset all agree"
    )
    others = f"or, as these photographs cannot decide, {' or '.join(rivals)} instead" if rivals else agree
    return f"{sentence[0].upper() if not wrong else sentence[0]}{sentence[1:]}; {others}."


def _label_section(one: FrameFinding) -> str:
    stops = math.log2(one.ratio)
    taken = with_u(one.taken_s, _COVERAGE * one.taken_s * _rel(one), "s")
    before, after = (_mean_size(errors) for errors in (one.error_as_printed_dn, one.error_dn))
    return section(
        f"Label of {one.name}",
        paragraph(
            f"Printed {_seconds(one.stated_s)}, exposed for {taken} "
            f"(k = 2), {abs(stops):.2f} stops {'more' if stops > 0 else 'less'}. Left-out parts of this photograph are "
            f"then predicted by the others to {after:.2g} DN on average, {before:.2g} DN as printed.",
            "what",
        ),
    )


def _what_to_do(wrong: Sequence[FrameFinding], result: ReconcileResult) -> str:
    if not wrong and all(effect.name != OFFSET for effect in result.effects):
        return ""
    if not wrong:
        return paragraph(
            "-o exposures.txt writes the exposures that agree, which every command reads with the photographs.",
            "do",
        )
    names = ", ".join(one.name for one in wrong)
    return paragraph(
        f"Look at the EXIF record of {names}, or take {'it' if len(wrong) == 1 else 'them'} again; -o exposures.txt "
        "writes the exposures that agree, which every command reads with the photographs.",
        "do",
    )


def _frame_table(frames: Sequence[FrameFinding]) -> str:
    rows = [
        (
            one.name,
            _seconds(one.stated_s),
            _seconds(one.taken_s),
            with_u(one.ratio, _COVERAGE * one.u_ratio),
            f"× or ÷ {one.named_from:.2f}" if math.isfinite(one.named_from) else "never",
            _dn(one.error_as_printed_dn),
            _dn(one.error_dn),
        )
        for one in frames
    ]
    by_others, named = "by the others ÷ printed (k = 2)", "a wrong label is named from"
    head = ("photograph", "printed", "taken as", by_others, named, "error as printed", "in the end")
    return table(head, rows)


def _limits(result: ReconcileResult) -> str:
    rows = [
        (name, "not at all" if limit.amplitude is None else f"from {limit.amplitude:.2g}")
        for name, limit in result.limits.items()
    ]
    return table(("effect", "seen at 5 sigma"), rows)


def _draw_ratios(figure: Figure, narrow: bool, frames: Sequence[FrameFinding]) -> None:
    axes = figure.add_subplot()
    place = np.arange(len(frames))
    for wrong, colour, text in ((False, MODEL, "agrees"), (True, BEFORE, "wrong label")):
        these = [k for k, one in enumerate(frames) if one.wrong == wrong and math.isfinite(one.ratio)]
        if these:
            u = [_COVERAGE * min(frames[k].u_ratio, frames[k].ratio) for k in these]
            axes.errorbar(
                place[these],
                [frames[k].ratio for k in these],
                yerr=u,
                fmt="o",
                ms=4,
                color=colour,
                capsize=2,
                label=text,
            )
    expected = np.array([one.expected for one in frames])
    ends = np.repeat(place, 2) + np.tile([-0.5, 0.5], len(frames))
    middle = np.repeat(expected, 2)
    axes.plot(ends, middle, color=RULE, lw=0.8)
    tolerated = math.exp(_TOLERATED)
    axes.fill_between(ends, middle / tolerated, middle * tolerated, color=DIMMED, alpha=0.15, lw=0)
    names = [f"{label(shortened(one.name, _LONGEST_NAME))}\n{_seconds(one.stated_s)}" for one in frames]
    axes.set_xticks(
        place, names, rotation=60 if narrow or len(names) > 8 else 0, ha="right" if len(names) > 8 else "center"
    )
    axes.set_yscale("log")
    shown = np.array([one.ratio for one in frames if math.isfinite(one.ratio)])
    low, high = min(0.85, 0.95 * shown.min(initial=1.0)), max(1.18, 1.05 * shown.max(initial=1.0))
    axes.set_ylim(low, high)
    ticks = [
        t for t in (0.1, 0.2, 0.3, 0.5, 0.7, 0.8, 0.9, 1.0, 1.1, 1.25, 1.5, 2.0, 3.0, 5.0, 10.0) if low <= t <= high
    ]
    axes.set_yticks(ticks, [f"{t:g}" for t in ticks])
    axes.minorticks_off()
    dress(axes, "photograph", "exposure by the others ÷ printed")
    if any(one.wrong for one in frames):
        legend(axes)


def _draw_errors(figure: Figure, narrow: bool, frames: Sequence[FrameFinding]) -> None:
    panels = figure.subplots(2, 1, sharex=True) if narrow else figure.subplots(1, 2, sharey=True)
    for axes, title, which in (
        (panels[0], "as printed", "error_as_printed_dn"),
        (panels[1], "with the exposures found", "error_dn"),
    ):
        for one in frames:
            dn, mean, scatter = _binned(one.dn, getattr(one, which))
            colour = BEFORE if one.wrong else MODEL
            form = {"color": colour, "lw": 1.6 if one.wrong else 0.9}
            axes.plot(dn, mean, label=label(one.name) if one.wrong else None, **form)
            axes.fill_between(dn, mean - scatter, mean + scatter, color=colour, alpha=0.12, lw=0)
        axes.axhline(0.0, color=RULE, lw=0.8)
        dress(axes, "digital number found (DN)", "predicted − found (DN)", title)
    if any(one.wrong for one in frames):
        legend(panels[0])


def _binned(dn: Array, error: Array) -> tuple[Array, Array, Array]:
    """Return middle, mean error and its standard deviation of bins along the digital numbers, empty ones left out."""
    known = np.isfinite(error)
    if not known.any():
        return np.empty(0), np.empty(0), np.empty(0)
    dn, error = dn[known], error[known]
    edges = np.linspace(dn.min(), dn.max() + 1e-9, _BINS + 1)
    place = np.clip(np.digitize(dn, edges) - 1, 0, _BINS - 1)
    count = np.bincount(place, minlength=_BINS)
    filled = count > 0
    mean, middle = (np.bincount(place, v, _BINS)[filled] / count[filled] for v in (error, dn))
    square = np.bincount(place, error**2, _BINS)[filled] / count[filled]
    return middle, mean, np.sqrt(np.maximum(square - mean**2, 0.0))


def _rel(one: FrameFinding) -> float:
    return one.u_ratio / one.ratio if one.ratio > 0 else math.inf


def _mean_size(errors: Array) -> float:
    known = errors[np.isfinite(errors)]
    return float(np.mean(np.abs(known))) if known.size else math.nan


def _dn(errors: Array) -> str:
    size = _mean_size(errors)
    return f"{size:.2g} DN" if math.isfinite(size) else "–"


def _seconds(seconds: float) -> str:
    return f"1/{1.0 / seconds:.4g} s" if seconds < 0.3 else f"{seconds:.4g} s"


__all__ = ["OFFSET", "FrameFinding", "outcome", "report_html"]
