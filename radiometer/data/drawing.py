"""Plots for people: a figure of one's own, and a picture that a notebook shows."""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from radiometer.data.storage import write_bytes_atomic
from radiometer.errors import UsageError

if TYPE_CHECKING:
    from matplotlib.axes import Axes


_PICTURES: Final = (".png", ".pdf", ".svg")


def new_axes() -> Axes:
    """Return axes in a new figure, which no global list of figures holds."""
    from matplotlib.figure import Figure

    return Figure(figsize=(6.4, 4.0), layout="constrained").subplots()


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
    if path.suffix.lower() not in _PICTURES:
        raise UsageError(f"{path}: name a .png, .pdf or .svg file")
    figure: Any = axes.figure
    if inches is not None:
        figure.set_size_inches(*inches)
    content = io.BytesIO()
    figure.savefig(content, format=path.suffix.lower()[1:], dpi=150)
    write_bytes_atomic(path, content.getvalue())


def picture(draw: Callable[[], Axes], words: str) -> str:
    """Return HTML with a picture and, under it, what it shows in words."""
    content = io.BytesIO()
    figure: Any = draw().figure
    figure.savefig(content, format="png", dpi=110)
    encoded = base64.b64encode(content.getvalue()).decode()
    said = html.escape(words)
    return f'<figure><img alt="{said}" src="data:image/png;base64,{encoded}"><figcaption>{said}</figcaption></figure>'
