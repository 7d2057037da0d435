"""Plots for people: a figure of one's own, and a picture that a notebook shows."""

from __future__ import annotations

import base64
import html
import io
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from radiometer.data.storage import write_bytes_atomic
from radiometer.errors import UsageError

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


PLOT_SUFFIXES: Final = (".png", ".pdf", ".svg")
_SIZE_IN: Final = (6.4, 4.0)  # matplotlib's width, a little lower: it fits a notebook's cell


def new_axes() -> Axes:
    """Return axes in a new figure: pyplot's current one where the user has pyplot, so that `plt.savefig` saves it."""
    pyplot = sys.modules.get("matplotlib.pyplot")
    if pyplot is not None:
        figure: Figure = pyplot.figure(figsize=_SIZE_IN, layout="constrained")
        return figure.subplots()
    return own_axes()


def own_axes() -> Axes:
    """Return axes in a new figure, which no global list of figures holds."""
    from matplotlib.figure import Figure

    return Figure(figsize=_SIZE_IN, layout="constrained").subplots()


def divided(axes: Axes, count: int) -> list[Axes]:
    """Return so many axes, one below the other with one x axis, in the place of one. Raises UsageError."""
    spec = axes.get_subplotspec()
    if count == 1:
        return [axes]
    if spec is None:
        raise UsageError(f"axes that are no subplot cannot be divided into {count} panels; leave axes out")
    figure: Any = axes.figure
    places = spec.subgridspec(count, 1)
    axes.set_subplotspec(places[0])
    panels = [axes, *(figure.add_subplot(places[n], sharex=axes) for n in range(1, count))]
    for one in panels[:-1]:
        one.tick_params(labelbottom=False)
        one.xaxis.get_offset_text().set_visible(False)
    return panels


def check_plot_name(path: Path) -> None:
    """Refuse a name whose ending is no form of a picture. Raises UsageError."""
    if path.suffix.lower() not in PLOT_SUFFIXES:
        raise UsageError(f"cannot draw {path}: its ending must be one of {', '.join(PLOT_SUFFIXES)}")


def write_figure(path: Path, axes: Axes, inches: tuple[float, float] | None = None) -> None:
    """Write the figure of axes into a PNG, PDF or SVG file, whole or not at all.

    Args:
        path: The file; its ending gives the form.
        axes: Axes of the figure.
        inches: Width and height of the figure; as it is by default.

    Raises:
        UsageError: If the ending is another.
        OutputError: If the file cannot be written.
    """
    check_plot_name(path)
    figure: Any = axes.figure
    if inches is not None:
        figure.set_size_inches(*inches)
    content = io.BytesIO()
    figure.savefig(content, format=path.suffix.lower()[1:], dpi=150)
    write_bytes_atomic(path, content.getvalue())


def picture(draw: Callable[[Axes], Axes], words: str) -> str:
    """Return HTML with a picture and, under it, what it shows in words."""
    content = io.BytesIO()
    figure: Any = draw(own_axes()).figure
    figure.savefig(content, format="png", dpi=110)
    encoded = base64.b64encode(content.getvalue()).decode()
    text = html.escape(words)
    return f'<figure><img alt="{text}" src="data:image/png;base64,{encoded}"><figcaption>{text}</figcaption></figure>'
