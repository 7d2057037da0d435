"""Plots of a characterisation as SVG text."""

from __future__ import annotations

import io
from collections.abc import Callable

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

from radiometer.analysis.characterise.result import Characterisation

_WIDTH_IN, _HEIGHT_IN = 4.6, 3.2


def plots(result: Characterisation) -> list[tuple[str, str]]:
    """Return (caption, SVG text) of photon transfer, linearity, signal-to-noise ratio and dark signal."""
    light = "photons per pixel" if "R" in result.figures else "exposure × level in s"
    drawn: list[tuple[str, Callable[[Axes], None]]] = [
        ("Photon transfer: variance over signal, and the line that K is the slope of", lambda a: _transfer(a, result)),
        ("Signal over light", lambda a: _signal(a, result, light)),
        ("Signal-to-noise ratio, and that of an ideal sensor of this quantum efficiency", lambda a: _snr(a, result)),
        ("Dark signal over exposure", lambda a: _dark(a, result)),
    ]
    if not result.dark_points:
        drawn.pop()
    if result.transfer is None or "K" not in result.figures:
        del drawn[:3]
    if result.linearity is not None:
        drawn.insert(2, ("Deviation from linearity", lambda a: _deviation(a, result, light)))
    return [(caption, _svg(draw)) for caption, draw in drawn]


def draw_telling(axes: Axes, result: Characterisation) -> None:
    """Draw the photon transfer where there is one, else the dark signal over exposure, else the figures' lack."""
    axes.grid(visible=True, alpha=0.3)
    if result.transfer is not None and "K" in result.figures:
        _transfer(axes, result)
    elif result.dark_points:
        _dark(axes, result)
    else:
        axes.text(0.5, 0.5, "neither photon transfer nor darks", ha="center", transform=axes.transAxes)


def _svg(draw: Callable[[Axes], None]) -> str:
    figure = Figure(figsize=(_WIDTH_IN, _HEIGHT_IN), layout="constrained")
    FigureCanvasSVG(figure)
    axes = figure.add_subplot()
    axes.grid(visible=True, alpha=0.3)
    draw(axes)
    text = io.StringIO()
    figure.savefig(text, format="svg", metadata={"Date": None})
    content = text.getvalue()
    return content[content.index("<svg") :]


def _transfer(axes: Axes, result: Characterisation) -> None:
    assert result.transfer is not None
    signal = np.array([s.signal_dn for s in result.steps])
    rounded = result.transfer.rounded
    variance = np.array([s.bright.variance_dn2 if rounded else s.photo_variance_dn2 for s in result.steps])
    used = np.array([s.signal_dn for s in result.transfer.used])
    axes.plot(signal, variance, "o", markersize=3, color="tab:blue", label="steps")
    line = result.transfer.line
    ends = np.array([0.0, used.max()])
    axes.plot(ends, line.intercept + line.slope * ends, color="tab:red", label="fit to 70 %")
    axes.set_xlabel("μ_y − μ_y.dark in DN")
    axes.set_ylabel("σ_y² in DN²" if rounded else "σ_y² − σ_y.dark² in DN²")
    axes.legend()


def _signal(axes: Axes, result: Characterisation, light: str) -> None:
    axes.plot([s.light for s in result.steps], [s.signal_dn for s in result.steps], "o-", markersize=3)
    axes.set_xlabel(light)
    axes.set_ylabel("μ_y − μ_y.dark in DN")


def _deviation(axes: Axes, result: Characterisation, light: str) -> None:
    assert result.linearity is not None
    x, deviation, u = np.array(result.linearity.deviations).T
    axes.errorbar(x, deviation, 2 * u, fmt="o-", markersize=3, capsize=2)
    axes.axhline(0, color="black", linewidth=0.8)
    axes.set_xlabel(light)
    axes.set_ylabel("deviation in % (bars: k = 2)")


def _snr(axes: Axes, result: Characterisation) -> None:
    K = result.figures["K"].value
    steps = [s for s in result.steps if s.signal_dn > 0 and s.bright.variance_dn2 > 0]
    electrons = np.array([s.signal_dn / K for s in steps])
    ratio = np.array([s.signal_dn / np.sqrt(s.bright.variance_dn2) for s in steps])
    axes.loglog(electrons, ratio, "o", markersize=3, label="measured")
    axes.loglog(electrons, np.sqrt(electrons), color="tab:red", label="shot noise alone")
    axes.set_xlabel("signal in e⁻")
    axes.set_ylabel("SNR")
    axes.legend()


def _dark(axes: Axes, result: Characterisation) -> None:
    points = np.array([(t, mean) for t, mean, _, _ in result.dark_points])
    axes.plot(points[:, 0], points[:, 1], "o", markersize=3)
    axes.set_xlabel("exposure in s")
    axes.set_ylabel("μ_y.dark in DN")
