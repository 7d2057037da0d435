"""Pictures of a characterisation."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from radiometer.analysis.characterise.result import Characterisation
from radiometer.reporting.numbers import with_u
from radiometer.reporting.pictures import BEFORE, DIMMED, MARK, MODEL, RULE, SEEN, dress, legend, mark, picture
from radiometer.typing import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_WIDE: Final = (6.4, 3.6)
_NARROW: Final = (4.0, 3.0)


def story(result: Characterisation) -> str:
    """Return the opening picture: noise over signal with K and read noise, linearity, and SNR against the ideal."""
    if result.transfer is None or "K" not in result.figures:
        return _dark_picture(result) if len(result.dark_points) > 1 else ""
    straight = result.linearity is not None
    caption = (
        "Photon transfer: noise of a pixel over signal; full points took part in the fit, the dashed line is the read "
        "noise, the shaded band the fit with its k = 2 uncertainty. "
        + ("Beside it, how far the signal is from proportional to light (bars: k = 2), and " if straight else "Then ")
        + "the signal-to-noise ratio against that of an ideal sensor."
    )

    def draw(figure: Figure, narrow: bool) -> None:
        kinds: list[Callable[[Axes, Characterisation], None]] = [_transfer, _snr]
        if straight:
            kinds.insert(1, _deviation)
        if narrow:
            panels = figure.subplots(len(kinds), 1, height_ratios=[1.5, *[1.0] * (len(kinds) - 1)])
            axes = list(panels)
        else:
            grid = figure.add_gridspec(len(kinds) - 1, 2, width_ratios=(1.25, 1.0))
            axes = [figure.add_subplot(grid[:, 0]), *(figure.add_subplot(grid[k, 1]) for k in range(len(kinds) - 1))]
        for kind, one in zip(kinds, axes, strict=True):
            kind(one, result)

    return picture(draw, caption, (10.0, 5.2), (4.0, 8.6))


def draw_telling(axes: Axes, result: Characterisation) -> None:
    """Draw the photon transfer where there is one, else the dark signal over exposure, else the figures' lack."""
    if result.transfer is not None and "K" in result.figures:
        _transfer(axes, result)
    elif result.dark_points:
        _dark(axes, result)
    else:
        axes.text(0.5, 0.5, "neither photon transfer nor darks", ha="center", transform=axes.transAxes)


def further_pictures(result: Characterisation) -> list[str]:
    """Return the plots that the opening picture has no room for: variance and signal, and the dark signal."""
    told = result.transfer is not None and "K" in result.figures
    drawn: list[str] = []
    if told:
        drawn.append(
            picture(
                lambda figure, narrow: _variance(figure.subplots(), result),
                "Variance over signal, as the standard draws it, and the line whose slope is K.",
                _WIDE,
                _NARROW,
            )
        )
        drawn.append(
            picture(lambda figure, narrow: _signal(figure.subplots(), result), "Signal over light.", _WIDE, _NARROW)
        )
        if result.dark_points:
            drawn.append(_dark_picture(result))
    return drawn


def _dark_picture(result: Characterisation) -> str:
    return picture(
        lambda figure, narrow: _dark(figure.subplots(), result),
        "Dark signal over exposure: its height is the black level, its slope the dark current.",
        _WIDE,
        _NARROW,
    )


def _light(result: Characterisation) -> str:
    return "photons per pixel" if "R" in result.figures else "exposure × level in s"


def _used(result: Characterisation) -> NDArray[np.bool_]:
    assert result.transfer is not None
    used = {id(step) for step in result.transfer.used}
    return np.array([id(step) in used for step in result.steps])


def _transfer(axes: Axes, result: Characterisation) -> None:
    """Draw noise over signal, both logarithmic: read noise is flat, shot noise rises with the root of the signal."""
    assert result.transfer is not None
    signal = np.array([s.signal_dn for s in result.steps])
    noise = np.sqrt(np.maximum([s.bright.variance_dn2 for s in result.steps], 0.0))
    shown, used = (signal > 0) & (noise > 0), _used(result)
    axes.plot(signal[shown & ~used], noise[shown & ~used], "o", ms=4.5, mfc="white", mec=SEEN, label="steps left out")
    axes.plot(signal[shown & used], noise[shown & used], "o", ms=4.5, color=SEEN, label="steps of the fit")
    line, K, dark = result.transfer.line, result.figures["K"], result.figures.get("sigma_y_dark")
    floor = float(np.median([s.dark_variance_dn2 for s in result.steps])) if dark is None else dark.value**2
    floor = 0.0 if result.transfer.rounded else floor
    least = min(float(signal[shown].min()), 0.3 * floor / K.value if floor > 0 else np.inf)
    grid = np.geomspace(least, float(signal[shown].max()), 200)

    def model(slope: float) -> Array:
        return np.asarray(np.sqrt(np.maximum(floor + line.intercept + slope * grid, 0.0)))

    axes.plot(grid, model(line.slope), color=MODEL, lw=1.6, label="fit")
    axes.fill_between(grid, model(line.slope - 2 * K.u), model(line.slope + 2 * K.u), color=MODEL, alpha=0.25, lw=0)
    axes.plot(grid, np.sqrt(line.slope * grid), ":", color=MODEL, lw=1.2, label="shot noise alone")
    gain = f"K = {with_u(K.value, 2 * K.u)} DN/e⁻"
    if "sigma_d" in result.figures:
        read = result.figures["sigma_d"]
        axes.axhline(read.value * K.value, color=MARK, lw=1.2, ls="--")
        said, at = f"read noise {with_u(read.value, 2 * read.u)} e⁻", (0.98, read.value * K.value)
        mark(axes, said, at, (0, 4), MARK, xycoords=("axes fraction", "data"), ha="right")
        mark(axes, gain, at, (0, -13), MODEL, xycoords=("axes fraction", "data"), ha="right")
    else:
        mark(axes, gain, (0.98, 0.36), (0, 0), MODEL, xycoords="axes fraction", ha="right")
    axes.set_xscale("log")
    axes.set_yscale("log")
    dress(axes, "signal above dark in DN", "noise of a pixel in DN", "Photon transfer")
    legend(axes, "upper left")


def _variance(axes: Axes, result: Characterisation) -> None:
    assert result.transfer is not None
    signal = np.array([s.signal_dn for s in result.steps])
    rounded = result.transfer.rounded
    variance = np.array([s.bright.variance_dn2 if rounded else s.photo_variance_dn2 for s in result.steps])
    used = _used(result)
    axes.plot(signal[~used], variance[~used], "o", ms=4, mfc="white", mec=SEEN, label="steps left out")
    axes.plot(signal[used], variance[used], "o", ms=4, color=SEEN, label="steps of the fit")
    line = result.transfer.line
    ends = np.array([0.0, signal[used].max()])
    axes.plot(ends, line.intercept + line.slope * ends, color=MODEL, label="fit")
    dress(axes, "μ_y − μ_y.dark in DN", "σ_y² in DN²" if rounded else "σ_y² − σ_y.dark² in DN²")
    legend(axes)


def _signal(axes: Axes, result: Characterisation) -> None:
    axes.plot([s.light for s in result.steps], [s.signal_dn for s in result.steps], "o-", ms=4, lw=1, color=SEEN)
    dress(axes, _light(result), "μ_y − μ_y.dark in DN")


def _deviation(axes: Axes, result: Characterisation) -> None:
    assert result.linearity is not None
    x, deviation, u = np.array(result.linearity.deviations).T
    axes.axhline(0.0, color=RULE, lw=1.0)
    axes.errorbar(x, deviation, 2 * u, fmt="o", ms=3.5, lw=1, color=SEEN)
    for figure in (result.linearity.LE_min, result.linearity.LE_max):
        axes.axhline(figure.value, color=BEFORE, lw=1.0, ls="--")
    dress(axes, _light(result), "deviation in %", "Linearity: off the line")


def _snr(axes: Axes, result: Characterisation) -> None:
    K = result.figures["K"].value
    # Beyond the largest variance pixels clip, and a noise that is cut off is no signal-to-noise ratio.
    full = max(result.steps, key=lambda s: s.bright.variance_dn2).signal_dn
    steps = [s for s in result.steps if 0 < s.signal_dn <= full and s.bright.variance_dn2 > 0]
    electrons = np.array([s.signal_dn / K for s in steps])
    ratio = np.array([s.signal_dn / np.sqrt(s.bright.variance_dn2) for s in steps])
    read = result.figures["sigma_d"].value if "sigma_d" in result.figures else 0.0
    grid = np.geomspace(min(float(electrons.min()), max(0.3 * read**2, 1.0)), electrons.max(), 100)
    axes.plot(grid, np.sqrt(grid), color=DIMMED, lw=1.4, label="ideal: shot noise alone")
    if read > 0:
        axes.plot(grid, grid / np.sqrt(grid + read**2), color=MODEL, lw=1.4, label="with the read noise")
    axes.plot(electrons, ratio, "o", ms=3.5, color=SEEN, label="measured")
    axes.set_xscale("log")
    axes.set_yscale("log")
    dress(axes, "signal in e⁻", "signal-to-noise ratio", "SNR against the ideal")
    legend(axes, "upper left")


def _dark(axes: Axes, result: Characterisation) -> None:
    points = np.array([(t, mean) for t, mean, _, _ in result.dark_points])
    axes.plot(points[:, 0], points[:, 1], "o", ms=4, color=SEEN)
    dress(axes, "exposure in s", "μ_y.dark in DN")
