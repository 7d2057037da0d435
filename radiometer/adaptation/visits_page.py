"""Several visits of a subject on one page: their curves over each other, and what they found side by side."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

import numpy as np

from radiometer.adaptation.adaptation_fit import AdaptationFit
from radiometer.adaptation.report import label_of, origin_of
from radiometer.adaptation.report_picture import short
from radiometer.adaptation.threshold_series import ThresholdSeries
from radiometer.numbers import unit_text
from radiometer.reporting.page import page, paragraph, section, table
from radiometer.reporting.pictures import dress, label, legend, picture

if TYPE_CHECKING:
    from matplotlib.figure import Figure

OVERLAID: Final = ("break_min", "s2_slope_per_min", "rod_intercept_min", "plateau", "final_threshold")
# Colours that the colour-blind can distinguish, dark enough on white (after Okabe and Ito 2008).
_COLOURS: Final = ("#0072b2", "#b3461b", "#00725a", "#8a4a7d", "#333333", "#8a6d00")
_POINTS: Final = 300


def label_of_visit(series: ThresholdSeries, name: str) -> str:
    """Return subject, eye and date of a visit as its file states them; else the file's name."""
    facts = series.facts
    known = [facts[key] for key in ("subject", "eye") if key in facts]
    date = facts.get("visit", "")[:16].replace("T", " ")
    return " ".join([*known, date]).strip() or name


def visits_html(visits: Sequence[tuple[AdaptationFit, str]]) -> str:
    """Return the page of several visits.

    Args:
        visits: Fits and the names of their files, in the order of the visits.
    """
    names = [label_of_visit(fit.chosen.series, name) for fit, name in visits]

    def draw(figure: Figure, narrow: bool) -> None:
        axes = figure.subplots()
        for number, ((fit, _), name) in enumerate(zip(visits, names, strict=True)):
            series, colour = fit.chosen.series, _COLOURS[number % len(_COLOURS)]
            grid = np.linspace(float(series.time_min[0]), float(series.time_min[-1]), _POINTS)
            axes.plot(series.time_min, series.log_threshold, "o", ms=3, color=colour, alpha=0.5)
            axes.plot(grid, fit.chosen.threshold(grid), color=colour, lw=2, label=label(name))
        units = list(dict.fromkeys(fit.chosen.series.level_name for fit, _ in visits))
        dress(axes, "time in the dark (min)", f"log₁₀ threshold ({'; '.join(units)})")
        legend(axes, "upper right")

    first = visits[0][0]
    found = [one for one in OVERLAID if any(one in fit.estimates for fit, _ in visits)]
    rows = [
        (
            f"{label_of(one, first)} ({_unit(visits, one)})",
            *(short(fit, one) if one in fit.estimates else "–" for fit, _ in visits),
        )
        for one in found
    ]
    head = ("", *names)
    facts = [
        (name, *(fit.chosen.series.facts.get(key, "–") for key in ("protocol", "age_years", "pupil_mm", "program")))
        for (fit, _), name in zip(visits, names, strict=True)
    ]
    differ = len({fit.chosen.series.facts.get("protocol") for fit, _ in visits}) > 1
    return page(
        "Dark adaptation: visits",
        f"{len(visits)} visits, from {names[0]} to {names[-1]}.",
        [
            picture(draw, "Thresholds and fitted curves of all visits.", (10.0, 5.2), (4.0, 4.6)),
            paragraph("The visits were run by different protocols: their curves cannot be compared.", "flag")
            if differ
            else "",
            section("What each visit found", table(head, rows), paragraph("± is half of the 95 % interval.", "small")),
            section("How each was made", table(("visit", "protocol", "age", "pupil in mm", "program"), facts,
                                               words=(1, 4))),
        ],
        kind="Dark adaptation",
        origin=origin_of([fit.chosen.series.facts for fit, _ in visits]),
    )  # fmt: skip


def _unit(visits: Sequence[tuple[AdaptationFit, str]], name: str) -> str:
    return next((unit_text(fit.estimates[name].unit) for fit, _ in visits if name in fit.estimates), "–")
