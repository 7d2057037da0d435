"""Pictures of reports: drawn once for a screen and once for a phone, and carried within the page."""

from __future__ import annotations

import base64
import io
import re
import warnings
from collections.abc import Callable
from functools import cache
from typing import TYPE_CHECKING, Any, Final, Literal

import numpy as np

from radiometer.reporting.page import prose

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Told apart by the colour-blind, and by 3 : 1 or more from white (WCAG 2.1, 1.4.11).
SEEN: Final = "#1a1a1a"  # what was measured
MODEL: Final = "#1f618d"  # what the model says
BEFORE: Final = "#b03a2e"  # what was before, what is out of bounds
MARK: Final = "#9a5b00"  # what is pointed out
DIMMED: Final = "#8a8a8a"  # what is not claimed
RULE: Final = "#555555"  # lines that something is compared with
_FEW_DECADES: Final = 1.0 / 3.0  # below, labels of a logarithmic axis run into each other and show no ratio
_NARROW_PX: Final = 640  # telephones held upright
_SMALLEST_PT: Final = 9.0  # what can be read in print

Place = Literal["best", "upper left", "upper right", "lower left", "lower right"]
Draw = Callable[["Figure", bool], object]


def picture(draw: Draw, caption: str, wide: tuple[float, float], narrow: tuple[float, float]) -> str:
    """Return a figure in two forms, of which the browser takes the one that fits.

    Args:
        draw: Draws into an empty figure; its argument is whether it is the narrow one.
        wide: Width and height in inches on a screen; 10 inches fill the page.
        narrow: The same on a phone; 4 inches fill it.
    """
    text = prose(caption)
    return (
        f"<figure><picture><source media='(max-width:{_NARROW_PX}px)' srcset='{_address(draw, narrow, narrow=True)}'>"
        f"<img alt='{text}' src='{_address(draw, wide, narrow=False)}'></picture>"
        f"<figcaption>{text}</figcaption></figure>"
    )


def label(text: str) -> str:
    """Return text as a label that shows just this text: no formulas, and � for characters that the font lacks."""
    shown = (c if c == "\n" or (c.isprintable() and _is_in_font(c)) else "\ufffd" for c in text)
    return "".join(shown).replace("$", r"\$")


@cache
def _is_in_font(character: str) -> bool:
    from matplotlib.font_manager import FontProperties, findfont, get_font

    return bool(get_font(findfont(FontProperties())).get_char_index(ord(character)))


def shortened(text: str, most: int) -> str:
    """Return text of at most so many characters."""
    return text if len(text) <= most else f"{text[: most - 1]}…"


def dress(axes: Axes, x: str, y: str, title: str = "") -> None:
    """Give axes their labels, a faint grid and no box; logarithms of less than a third of a decade are none."""
    from matplotlib.ticker import NullFormatter

    axes.set_xlabel(x)
    axes.set_ylabel(y)
    if title:
        axes.set_title(title, fontsize=_SMALLEST_PT + 1, loc="left", fontweight="bold")
    for side, to_scale in ((axes.xaxis, axes.set_xscale), (axes.yaxis, axes.set_yscale)):
        if side.get_scale() == "log":
            decades = abs(np.diff(np.log10(side.get_view_interval()))[0])
            if decades < _FEW_DECADES:
                to_scale("linear")
            elif decades > 1.0:
                side.set_minor_formatter(NullFormatter())
    axes.grid(visible=True, color="#dddddd", lw=0.6)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)


def mark(
    axes: Axes, text: str, place: tuple[float, float], offset: tuple[float, float], colour: str, **form: Any
) -> None:
    """Write a few words into a plot, in bold, readable across what is under them.

    Args:
        axes: Where to.
        text: The words; hyphens before digits become minus signs.
        place: What they belong to, in the coordinates of the data or as `xycoords` says.
        offset: Where they stand from there, in points.
        form: More of what matplotlib's annotations take.
    """
    from matplotlib.patheffects import withStroke

    words = axes.annotate(
        re.sub(r"(?<!\w)-(?=\d)", "\u2212", text), place, xytext=offset, textcoords="offset points", color=colour,
        fontweight="bold", path_effects=[withStroke(linewidth=3.0, foreground="white")], zorder=5, **form,
    )  # fmt: skip
    words.set_in_layout(False)  # words that reach over an edge make no plot smaller


def legend_above(figure: Figure, axes: Axes, columns: int) -> None:
    """Add the legend of some axes above all of the figure."""
    handles, labels = _entries(axes)
    figure.legend(handles, labels, fontsize=_SMALLEST_PT, loc="outside upper center", ncols=columns, frameon=False)


def legend(axes: Axes, place: Place = "best") -> None:
    """Add a legend that hides nothing."""
    handles, labels = _entries(axes)
    axes.legend(handles, labels, fontsize=_SMALLEST_PT, loc=place, framealpha=0.85, edgecolor="none")


def _entries(axes: Axes) -> tuple[list[Any], list[str]]:
    """Return handles and labels, what was measured first: matplotlib has points with bars last."""
    handles, labels = axes.get_legend_handles_labels()
    order = sorted(range(len(handles)), key=lambda k: not hasattr(handles[k], "has_yerr"))
    return [handles[k] for k in order], [labels[k] for k in order]


def _address(draw: Draw, size: tuple[float, float], *, narrow: bool) -> str:
    """Return a picture as a data address that holds its content."""
    from matplotlib import rc_context
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure

    with rc_context({"svg.hashsalt": "radiometer", "font.size": _SMALLEST_PT}), warnings.catch_warnings():
        # Words too long for their plot overlap; that is seen, and nothing for the terminal.
        warnings.filterwarnings("ignore", message="constrained_layout not applied")
        figure = Figure(figsize=size, layout="constrained", dpi=160)
        FigureCanvasSVG(figure)
        draw(figure, narrow)
        stream = io.BytesIO()
        figure.savefig(stream, format="svg", metadata={"Date": None})
    return f"data:image/svg+xml;base64,{base64.b64encode(stream.getvalue()).decode('ascii')}"
