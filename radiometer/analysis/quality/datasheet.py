"""The datasheet as one HTML page that needs nothing else."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from radiometer.analysis.quality.indices import Figure
from radiometer.analysis.quality.session import Datasheet, Index
from radiometer.analysis.reading.budget import coverage_factor
from radiometer.numbers import rounded, with_u
from radiometer.reporting.page import folded, heading, listed, page, paragraph, section, table
from radiometer.reporting.pictures import MODEL, dress, label, picture

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Canvas

_SCALES: Final = {"px": (1.0, "px"), "1": (100.0, "%")}  # how a figure of a unit is printed
_LOWEST_PERCENT: Final = 1e-3  # what is less stands at the left edge of the picture


def datasheet_html(sheet: Datasheet) -> str:
    """Return the datasheet as HTML: the outcome, a picture, each index with its definition, what is missing last."""
    camera = sheet.camera
    measured = [one for one in sheet.indices if one.figure is not None]
    missing = [one for one in sheet.indices if one.figure is None]
    return page(
        f"Quality indices of {(camera.name if camera else '') or 'a camera'}",
        _sentence(measured, len(sheet.indices)),
        [
            _picture(measured),
            *(_measured(one) for one in measured),
            section("Not measured", listed([_asked(one) for one in missing])),
            section("What was assumed", listed([f"{one}." for one in sheet.assumptions])),
        ],
        kind="Datasheet",
        origin=sheet.origin,
    )


def shown(figure: Figure) -> tuple[str, str]:
    """Return (value, expanded uncertainty) with their unit, as many digits as u allows."""
    scale, unit = _SCALES[figure.unit]
    expanded = scale * coverage_factor(figure.degrees_of_freedom) * figure.u
    value, u = rounded(scale * figure.value, expanded)
    return f"{value} {unit}", f"{u} {unit}"


def _sentence(measured: list[Index], total: int) -> str:
    """Return the outcome in one sentence: how many, and which counts most."""
    shares = [(one, one.figure.value) for one in measured if one.figure and one.figure.unit == "1"]
    if not shares:
        return f"{len(measured)} of {total} indices measured."
    worst, _ = max((pair for pair in shares), key=lambda pair: pair[1])
    assert worst.figure is not None
    value, expanded = shown(worst.figure)
    k = coverage_factor(worst.figure.degrees_of_freedom)
    named = worst.procedure.called
    return f"{len(measured)} of {total} indices measured; the largest is {named}: {value} ± {expanded} (k = {k:.3g})."


def _measured(one: Index) -> str:
    assert one.figure is not None
    value, expanded = shown(one.figure)
    procedure = one.procedure
    remarks = "; ".join(one.figure.remarks)
    steps = f"Captures: {', '.join(one.steps)}." if one.steps else ""
    scale, unit = _SCALES[one.figure.unit]
    rows = [(each.label, with_u(scale * each.value, scale * each.expanded, unit)) for each in one.figure.details]
    return "\n".join(
        part
        for part in (
            heading(f"{procedure.called[:1].upper()}{procedure.called[1:]}"),
            paragraph(f"{value} ± {expanded} (95.45 %)", "what"),
            paragraph(" ".join(f"{procedure.definition} ({procedure.source}). {steps} {remarks}".split()), "small"),
            folded("Step by step", table((), rows)) if rows else "",
        )
        if part
    )


def _asked(one: Index) -> str:
    """Return what is missing of an index, and what to capture for it."""
    name = f"{one.procedure.called}: {one.reason}"
    steps = "; ".join(f"{step.name}: {step.ask}" for step in one.procedure.steps)
    return f"{name}. To capture: {steps}" if steps else name


def _picture(measured: list[Index]) -> str:
    """Return bars of the relative indices with their uncertainty, on a logarithmic scale."""
    shares = [(one.procedure, one.figure) for one in measured if one.figure and one.figure.unit == "1"]
    if not shares:
        return ""

    def draw(canvas: Canvas, narrow: bool) -> None:
        axes = canvas.add_subplot()
        for place, (procedure, figure) in enumerate(reversed(shares)):
            expanded = 100 * coverage_factor(figure.degrees_of_freedom) * figure.u
            ends = [max(100 * figure.value + sign * expanded, _LOWEST_PERCENT) for sign in (-1.0, 1.0)]
            axes.plot(ends, [place, place], lw=6, color=MODEL, alpha=0.4, solid_capstyle="butt")
            axes.plot(max(100 * figure.value, _LOWEST_PERCENT), place, "o", ms=6, color=MODEL)
            text = label(f"{procedure.symbol}: {shown(figure)[0]}")
            axes.annotate(text, (ends[1], place), (6, 0), textcoords="offset points", va="center", fontsize=9)
        axes.set_xscale("log")
        low, high = axes.get_xlim()
        axes.set_xlim(low, high * (high / low) ** (0.6 if narrow else 0.25))
        axes.set_ylim(-0.7, len(shares) - 0.3)
        dress(axes, "deviation of the reading in %", "")
        axes.set_yticks([])

    height = 0.42 * len(shares) + 1.0
    message = "; ".join(f"{p.symbol} {shown(f)[0]} ± {shown(f)[1]}" for p, f in shares)
    caption = f"How far a reading goes wrong under each influence, with its interval of 95.45 %: {message}."
    return picture(draw, caption, (9.0, height), (4.0, height))
