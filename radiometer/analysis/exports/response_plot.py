"""The picture of response curves that `radiometer response --plot` draws."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np

from radiometer.analysis.response.estimate import ResponseEstimate
from radiometer.data.drawing import check_plot_name, save_plot

_COLOURS: Final = {"red": "#c0392b", "green": "#27843f", "blue": "#2a5db0"}


def draw_responses(estimates: Sequence[ResponseEstimate], path: Path) -> None:
    """Draw ln H over the digital number with its k = 2 band, and below it the standard uncertainty.

    Raises:
        OutputError: If the file cannot be written.
        UsageError: If its ending is no picture form.
    """
    from matplotlib.figure import Figure  # half a second, and few responses are drawn

    check_plot_name(path)
    figure = Figure(figsize=(7.2, 6.4), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(3, 1))
    for estimate in estimates:
        curve = estimate.curve
        low, high = curve.valid_dn or (0, curve.log_exposure.size - 1)
        dn = np.arange(low, high + 1)
        g, u = curve.log_exposure[low : high + 1], curve.u_log_exposure[low : high + 1]
        label = f"{estimate.method}, {curve.channel}"
        colour = _COLOURS.get(curve.channel) if len({e.method for e in estimates}) == 1 else None
        (line,) = upper.plot(dn, g, label=label, color=colour, linewidth=1.2)
        upper.fill_between(dn, g - 2 * u, g + 2 * u, color=line.get_color(), alpha=0.2, linewidth=0)
        lower.semilogy(dn[u > 0], u[u > 0], color=line.get_color(), linewidth=1.0)
    absolute = any(estimate.curve.absolute for estimate in estimates)
    upper.set_ylabel("ln H  (J m⁻²)" if absolute else "ln H, relative to the middle value")
    upper.legend(frameon=False)
    lower.set_ylim(top=min(1.0, lower.get_ylim()[1]))  # beyond a factor of e a curve says nothing
    lower.set_ylabel("u(ln H), k = 1")
    lower.set_xlabel("digital number M (DN)")
    for axes in (upper, lower):
        axes.grid(True, alpha=0.3)
    save_plot(figure, path)
