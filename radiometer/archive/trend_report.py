"""The report of trends: what drifts in one sentence, every history over its real time, what to do; tables last."""

from __future__ import annotations

import math
from collections.abc import Sequence
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from radiometer.archive.trend import MONTH_S, Trend
from radiometer.numbers import unit_text, with_u
from radiometer.reporting.origin import Origin, span_of
from radiometer.reporting.page import folded, heading, listed, page, paragraph, section, table
from radiometer.reporting.pictures import (
    BEFORE,
    DIMMED,
    MARK,
    MODEL,
    SEEN,
    dress,
    label,
    legend_above,
    picture,
    shortened,
)
from radiometer.typing import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_OPENING: Final = 4  # histories in the opening picture; the others follow with their sections
_GAP_OF_USUAL: Final = 10.0  # a pause so many times as long as the usual one is shown as a gap
_GAP_OF_SPAN: Final = 0.01  # and of the whole span at least, for others would not be seen
_BEYOND_SIGMAS: Final = 2.0  # 95 %
_TAGS: Final = {"drift": "drifts", "season_or_drift": "season or drift", "no_drift": "not claimed"}
_VERDICTS: Final = {"drift": "drifts", "season_or_drift": "a season or a drift", "no_drift": "no drift shown"}


def trend_report(trends: Sequence[Trend], source: str) -> str:
    """Return an HTML page with the outcome, a picture of the histories, and a section for each patch.

    Args:
        source: Where they come from, for the reader.
    """
    # Claimed ones first, the fastest in front: the opening picture shows these.
    ordered = sorted(trends, key=lambda t: (not t.drifts, -abs(t.drift_per_month) / t.u_drift_per_month))
    rows = [
        (
            t.patch,
            str(t.time_s.size),
            str(int(t.outlier.sum())),
            with_u(100 * t.drift_per_month, 200 * t.u_drift_per_month, "%"),
            f"{100 * _claimed_from(t):.2g} %",
            _VERDICTS[t.verdict],
        )
        for t in trends
    ]
    head = ("patch", "readings", "outliers", "drift per month (k = 2)", "claimed from", "verdict")
    return page(
        f"Trends of {len(trends)} {'patch' if len(trends) == 1 else 'patches'}",
        outcome(ordered),
        [
            paragraph(_alike(ordered)),
            _picture(ordered[:_OPENING]),
            section("What to do", listed(advice(ordered))),
            *(_section(trend, drawn=number < _OPENING) for number, trend in enumerate(ordered)),
            section("Figures", table(head, rows, words=(5,))),
            folded("What was assumed", listed(_assumptions(ordered))),
        ],
        kind="Trends",
        origin=Origin(
            span_of([end for one in trends for end in (float(one.time_s[0]), float(one.time_s[-1]))]),
            further=(("readings from", source),),
        ),
    )


def outcome(ordered: Sequence[Trend]) -> str:
    """Return in one sentence what drifts, by how much, or that nothing is shown to."""
    first = ordered[0]
    if not first.drifts:
        open_ones = [trend for trend in ordered if trend.verdict == "season_or_drift"]
        if open_ones:
            return _undecided(open_ones, len(ordered))
        if len(ordered) == 1:
            return f"No drift of {first.patch} is shown: {_per_month(first)}."
        nearest = f"the nearest to one is {first.patch}: {_per_month(first)}"
        return f"No drift is shown in any of {len(ordered)} patches; {nearest}."
    claimed = [trend for trend in ordered if trend.drifts]
    way = "falls" if first.drift_per_month < 0 else "rises"
    if len(ordered) == 1:
        return f"{first.patch} drifts: its {first.quantity} {way}, {_per_month(first)}."
    return f"{len(claimed)} of {len(ordered)} patches drift, {first.patch} most clearly: {_per_month(first)}."


def _undecided(changed: Sequence[Trend], count: int) -> str:
    """Return the verdict that something changes, and that the record does not show whether by season."""
    one = changed[0]
    of = "" if count == 1 else f" ({len(changed)} of {count} patches)"
    return (
        f"{one.patch} changes{of}, {_straight(one)}, k = 2, if on a straight line. A season could change it as much; "
        "the record is too short to separate the two."
    )


def _straight(trend: Trend) -> str:
    return with_u(100 * trend.straight_per_month, 200 * trend.u_straight_per_month, "% per month of the mean")


def advice(ordered: Sequence[Trend]) -> list[str]:
    """Return what to do about the drifts, or what would show one."""
    sentences = []
    for trend in ordered:
        stated = float(np.median(trend.u / trend.value))
        if trend.drifts:
            months = stated / abs(trend.drift_per_month)
            sentences.append(
                f"{trend.patch}: in {months:.2g} months the drift is as large as the readings' own uncertainty "
                f"({100 * stated:.2g} %, k = 1); calibrate it again before then."
            )
        elif trend.verdict == "season_or_drift":
            sentences.append(
                f"{trend.patch}: measure until {_day(trend.decided_from_s)[:10]}, a year and a half after the "
                "first one: "
                "that separates a season from a drift. Or keep temperature and ambient light steady."
            )
        else:
            sentences.append(
                f"{trend.patch}: a drift of {100 * _claimed_from(trend):.2g} % per month or more would have been "
                "shown; to see less, go on measuring: the uncertainty of a drift falls with the span."
            )
        if trend.excess_rel > stated:
            sentences.append(
                f"{trend.patch}: readings scatter by {100 * trend.excess_rel:.2g} % more than they state: something "
                "that changes from one to the next (warm-up, place, ambient light) is not in their uncertainty."
            )
    return sentences


def _per_month(trend: Trend) -> str:
    percent = with_u(100 * trend.drift_per_month, 200 * trend.u_drift_per_month, "% per month of the mean")
    return f"{percent}, k = 2"


def _claimed_from(trend: Trend) -> float:
    """Return the relative drift per month from which on it would be claimed."""
    return trend.claim_sigmas * trend.u_drift_per_month


def _alike(ordered: Sequence[Trend]) -> str:
    """Return whether claimed drifts agree: what all patches share is rather the instrument's than a source's."""
    claimed = [trend for trend in ordered if trend.drifts]
    if not claimed or len(ordered) < 2:
        return ""
    first = claimed[0]
    apart = [
        trend
        for trend in ordered
        if abs(trend.drift_per_month - first.drift_per_month)
        > _BEYOND_SIGMAS * math.hypot(trend.u_drift_per_month, first.u_drift_per_month)
    ]
    if not apart:
        return (
            "All patches change alike within their uncertainty. Check first what they share: camera, lens, calibration "
            "or supply."
        )
    names = ", ".join(trend.patch for trend in apart[:5])
    return f"Not all patches change alike ({names} apart from {first.patch}): what they share is not the only cause."


def _section(trend: Trend, *, drawn: bool) -> str:
    days = (trend.time_s[-1] - trend.time_s[0]) / 86400.0
    verdict = (
        f"The drift is claimed: it is {abs(trend.drift_per_month) / trend.u_drift_per_month:.1f} standard "
        f"uncertainties from zero; {trend.claim_sigmas:.1f} are required."
        if trend.drifts
        else f"No drift is claimed; one of {100 * _claimed_from(trend):.2g} % per month or more would be."
    )
    outliers = trend.time_s[trend.outlier]
    facts = [
        f"{trend.time_s.size} readings of {trend.quantity} over {days:.3g} days ({days * 86400 / MONTH_S:.2g} months).",
        f"A reading is correlated with the next by {trend.correlation:.2f}." if trend.correlation > 0.05 else "",
        f"A yearly cycle of ±{100 * trend.season_rel:.2g} % is fitted together with the drift."
        if trend.season_rel is not None
        else "The readings do not separate a yearly cycle from a drift: a cycle of up to 5 % is in its uncertainty.",
        f"Without any season it would be {_straight(trend)}." if trend.verdict == "season_or_drift" else "",
        " ".join(
            f"A cycle of {period / 86400:.3g} days, ±{100 * size:.2g} %, is fitted." for period, size in trend.cycles
        ),
        f"Left out as outliers: {', '.join(_day(t) for t in outliers[:12])}{' …' if outliers.size > 12 else ''}."
        if outliers.size
        else "",
        f"{len(_gaps(trend.time_s))} gaps, the longest of {_longest_days(trend):.3g} days."
        if _gaps(trend.time_s)
        else "",
        f"Measured with another calibration, or other settings, from {', '.join(_day(t) for t in trend.changes_s)} on."
        if trend.changes_s
        else "",
    ]
    left_out = [f"{count} rows take no part: {reason}." for reason, count in trend.left_out.items()]
    flagged = [f"{count} of the readings are flagged {name}." for name, count in trend.flags.items()]
    return "\n".join(
        (
            heading(trend.patch, [_TAGS[trend.verdict]]),
            paragraph(f"{_per_month(trend)}. {verdict}", "what"),
            paragraph(" ".join(fact for fact in facts if fact)),
            *(paragraph(text, "flag") for text in (*left_out, *flagged)),
            "" if drawn else _picture([trend]),
        )
    )


def _assumptions(ordered: Sequence[Trend]) -> list[str]:
    return [
        "A drift is a straight line over all the time; what else changes in steps or curves is in its uncertainty only "
        "as correlated scatter.",
        "Uncertainties that all readings share (the calibration's) do not blur a drift and are not in it.",
        f"Chance alone would show a drift in fewer than one archive in a hundred: it is claimed from "
        f"{ordered[0].claim_sigmas:.1f} standard uncertainties on.",
    ]


def _picture(trends: Sequence[Trend]) -> str:
    seasonal = any(trend.season_rel is not None for trend in trends)
    caption = (
        "Readings with their stated uncertainty (k = 1) over real time. Line: the model"
        f"{', a drift and a yearly cycle' if seasonal else ''}, with its k = 2 band; broken line: no drift claimed. "
        "Grey: times without readings. Dotted: 3 standard deviations of the readings. Crosses: outliers."
    )

    def draw(figure: Figure, narrow: bool) -> None:
        panels = figure.subplots(len(trends), 1, sharex=True, squeeze=False).ravel()
        for axes, trend in zip(panels, trends, strict=True):
            _history(axes, trend, narrow=narrow)
        legend_above(figure, panels[0], 2 if narrow else 4)

    return picture(draw, caption, (10.0, 1.0 + 2.6 * len(trends)), (4.0, 1.1 + 2.2 * len(trends)))


def _history(axes: Axes, trend: Trend, *, narrow: bool) -> None:
    from matplotlib.dates import AutoDateLocator, ConciseDateFormatter

    kept, gaps = ~trend.outlier, _gaps(trend.time_s)
    when = _dates(trend.time_s)
    for start, end in gaps:
        axes.axvspan(*_dates(np.array([start, end])), color="#ececec", lw=0)
    axes.errorbar(
        when[kept], trend.value[kept], trend.u[kept], fmt="o", ms=3, lw=0.6, color=SEEN, ecolor=DIMMED, label="readings"
    )
    axes.plot(
        when[~kept],
        trend.value[~kept],
        "x",
        ms=7,
        mew=1.6,
        color=BEFORE,
        label="outliers" if kept.sum() < kept.size else None,
    )
    at, line, u = _broken(trend, gaps)
    scatter = float(np.std((trend.value - trend.line)[kept], ddof=2))
    colour = MODEL if trend.drifts else DIMMED
    axes.plot(at, line, color=colour, lw=2.0, ls="-" if trend.drifts else "--", label="model")
    axes.fill_between(at, line - 2 * u, line + 2 * u, color=colour, alpha=0.3, lw=0)
    for side in (-3, 3):
        axes.plot(at, line + side * scatter, ":", color=DIMMED, lw=1.0)
    for number, change in enumerate(trend.changes_s):
        text = "other calibration or settings" if not number else None
        axes.axvline(_dates(np.array([change]))[0], color=MARK, lw=1.2, ls="--", label=text)
    most = 5 if narrow else 10
    # Half a day is the coarsest step of hours, and half an hour that of minutes: with (most - 1)/2 ticks at least, the
    # locator goes to days before half-days are too many.
    locator = AutoDateLocator(minticks=(most - 1) // 2, maxticks=most)  # type: ignore[no-untyped-call]
    axes.xaxis.set_major_locator(locator)
    axes.xaxis.set_major_formatter(ConciseDateFormatter(locator))  # type: ignore[no-untyped-call]
    name = shortened(trend.patch, 24 if narrow else 60)
    unit = f" in {unit_text(trend.unit)}" if trend.unit not in ("", "1") else ""
    dress(
        axes,
        "",
        label(shortened(f"{trend.quantity}{unit}", 40)),
        label(f"{name}: {'drifts' if trend.drifts else 'no drift claimed'}"),
    )


def _gaps(time_s: Array) -> list[tuple[float, float]]:
    """Return from when to when there are no readings though there usually would be."""
    pauses = np.diff(time_s)
    positive = pauses[pauses > 0]
    if not positive.size:
        return []
    least = max(_GAP_OF_USUAL * float(np.median(positive)), _GAP_OF_SPAN * float(time_s[-1] - time_s[0]))
    return [(float(time_s[k]), float(time_s[k + 1])) for k in np.flatnonzero(pauses > least)]


def _longest_days(trend: Trend) -> float:
    return max(end - start for start, end in _gaps(trend.time_s)) / 86400.0


def _broken(trend: Trend, gaps: Sequence[tuple[float, float]]) -> tuple[NDArray[np.datetime64], Array, Array]:
    """Return times, line and its u, with a break in every gap."""
    places = np.searchsorted(trend.time_s, [start for start, _ in gaps], side="right")
    time_s = np.insert(trend.time_s, places, [(start + end) / 2 for start, end in gaps])
    return _dates(time_s), np.insert(trend.line, places, np.nan), np.insert(trend.u_line, places, np.nan)


def _dates(time_s: Array) -> NDArray[np.datetime64]:
    return np.asarray(np.round(time_s).astype("int64").astype("datetime64[s]"))


def _day(time_s: float) -> str:
    return datetime.fromtimestamp(time_s, UTC).strftime("%Y-%m-%d %H:%M")
