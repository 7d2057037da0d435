"""Plots for people: a figure of one's own, and a picture that a notebook shows."""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def new_axes() -> Axes:
    """Return axes in a new figure, which no global list of figures holds."""
    from matplotlib.figure import Figure

    return Figure(figsize=(6.4, 4.0), layout="constrained").subplots()


def picture(draw: Callable[[], Axes], words: str) -> str:
    """Return HTML with a picture and, under it, what it shows in words."""
    content = io.BytesIO()
    figure: Any = draw().figure
    figure.savefig(content, format="png", dpi=110)
    encoded = base64.b64encode(content.getvalue()).decode()
    said = html.escape(words)
    return f'<figure><img alt="{said}" src="data:image/png;base64,{encoded}"><figcaption>{said}</figcaption></figure>'
