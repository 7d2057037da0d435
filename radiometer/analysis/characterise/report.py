"""The report of a characterisation: what the camera does in one sentence and one picture, what to do, tables last."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from radiometer.analysis.characterise.result import SYMBOLS, Characterisation, as_printed, upper_limit
from radiometer.analysis.characterise.tap_report import tap_section
from radiometer.analysis.characterise.taps import TapFigures
from radiometer.data import Quantity
from radiometer.numbers import below, rounded, unit_text, with_u
from radiometer.reporting.origin import Origin, moment
from radiometer.reporting.page import folded, listed, page, paragraph, section, side_by_side, table
from radiometer.reporting.pictures import BEFORE, DIMMED, MARK, MODEL, RULE, SEEN, dress, legend, mark, picture
from radiometer.typing import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_WIDE: Final = (6.4, 3.6)  # inches: the width of a page of text
_NARROW: Final = (4.0, 3.0)  # inches: the width of a phone


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
        _draw_dark(axes, result)
    else:
        axes.text(0.5, 0.5, "neither photon transfer nor darks", ha="center", transform=axes.transAxes)


def further_pictures(result: Characterisation) -> list[str]:
    """Return the plots that the opening picture has no room for: variance and signal, and the dark signal."""
    if result.transfer is None or "K" not in result.figures:
        return []
    line = "Variance over signal, as the standard draws it, and the line whose slope is K."
    drawn = [_plot(_variance, result, line), _plot(_signal, result, "Signal over light.")]
    return [*drawn, _dark_picture(result)] if result.dark_points else drawn


def _dark_picture(result: Characterisation) -> str:
    caption = "Dark signal over exposure: its height is the black level, its slope the dark current."
    return _plot(_draw_dark, result, caption)


def _plot(draw: Callable[[Axes, Characterisation], None], result: Characterisation, caption: str) -> str:
    return picture(lambda figure, narrow: draw(figure.subplots(), result), caption, _WIDE, _NARROW)


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
        text, at = f"read noise {with_u(read.value, 2 * read.u)} e⁻", (0.98, read.value * K.value)
        mark(axes, text, at, (0, 4), MARK, xycoords=("axes fraction", "data"), ha="right")
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


def _draw_dark(axes: Axes, result: Characterisation) -> None:
    points = np.array([(t, mean) for t, mean, _, _ in result.dark_points])
    axes.plot(points[:, 0], points[:, 1], "o", ms=4, color=SEEN)
    dress(axes, "exposure in s", "μ_y.dark in DN")


def datasheet(result: Characterisation, taps: Sequence[TapFigures] = ()) -> str:
    """Return the report as one HTML page: outcome, picture, meaning, notes, taps, plots, figures with U (k = 2)."""
    camera = result.believed
    made = result.provenance
    return page(
        f"EMVA 1288 figures of {camera.name or 'a camera'}",
        outcome(result),
        [
            paragraph(
                f"{camera.bit_depth} bit, gain {result.gain_db:g} dB; EMVA 1288 release 4.0 (linear); saturation is "
                f"set by the {result.limited_by}. Every ± is an expanded uncertainty, k = 2."
            ),
            story(result),
            section("What it means, and what to do", listed(meaning(result))),
            section("Remarks", *(paragraph(note, "flag") for note in result.notes)),
            tap_section(taps),
            section("Further pictures", side_by_side(*further_pictures(result))),
            section("Figures", _figures(result), _gains(result)),
            folded("Steps of the photon transfer", _steps(result)),
        ],
        kind="EMVA 1288 figures",
        origin=Origin(
            moment(str(made.parameters.get("taken", ""))), camera.name, str(made.parameters.get("lens", "")),
            further=(("evaluated (UTC)", moment(made.created)), ("from", ", ".join(made.inputs))),
        ),
    )  # fmt: skip


def outcome(result: Characterisation) -> str:
    """Return in one sentence what was found: gain, noise and capacity, or what is missing for them."""
    figures = result.figures
    gain = figures.get("K", figures.get("K_dark"))
    if gain is None or not math.isfinite(gain.value):
        return "These frames determine no gain: the camera's electrons cannot be counted from them."
    sentences = [f"One electron is {with_u(gain.value, 2 * gain.u, 'DN')}"]
    if "sigma_d" in figures:
        sentences.append(f"the camera reads with {_with_u(figures['sigma_d'])} of noise")
    if "mu_e_sat" in figures and upper_limit("mu_e_sat", figures["mu_e_sat"]) is None:
        sentences.append(f"holds {_with_u(figures['mu_e_sat'])} before it saturates")
    if len(sentences) == 3:
        sentences[1:] = [f"{sentences[1]} and {sentences[2]}"]
    return f"{'; '.join(sentences)} (k = 2)."


def meaning(result: Characterisation) -> list[str]:
    """Return what the figures mean for measuring, and what to do about it."""
    figures = result.figures
    sentences = [
        _noise(figures.get("sigma_d"), figures.get("K")),
        _range(figures.get("DR_dB"), figures.get("SNR_max")),
        _straightness(figures.get("LE_min"), figures.get("LE_max")),
        _dark(figures.get("mu_I_mean"), figures.get("sigma_d")),
    ]
    if "K" in figures:
        sentences.append(
            "To use it, write the camera file (-o camera.yaml) and give it to radiometer calibrate --camera-file; "
            "its noise then determines the weights of every measurement."
        )
    elif "K_dark" in figures:
        sentences.append(
            "The gain comes from dark frames alone. Frames of steady, even light from darkness to saturation would "
            "determine it better, and linearity and saturation as well."
        )
    else:
        sentences.append(
            "To count electrons, take pairs of frames of steady, even light at three levels or more, and darks at the "
            "same exposures: radiometer bracket --repeat 2 --darks 2."
        )
    return [text for text in sentences if text]


def _noise(read: Quantity | None, gain: Quantity | None) -> str:
    if read is None or gain is None or not read.value > 0:
        return ""
    equal_e = read.value**2
    return (
        f"From {equal_e:.3g} e⁻ ({equal_e * gain.value:.3g} DN above black) on, the light's own noise is larger than "
        "the camera's: more light helps there, and nothing else. Below, longer exposures help more than averages."
    )


def _range(dynamic: Quantity | None, best: Quantity | None) -> str:
    if dynamic is None or best is None or upper_limit("SNR_max", best) is not None:
        return ""
    return (
        f"One exposure spans {_with_u(dynamic)}; the best pixel of one frame is uncertain by "
        f"{100 / best.value:.2g} %. Scenes that span more take a bracket."
    )


def _straightness(low: Quantity | None, high: Quantity | None) -> str:
    if low is None or high is None:
        return ""
    worst = low if abs(low.value) > abs(high.value) else high
    ends = [rounded(one.value, 2 * worst.u)[0] for one in (low, high)]
    span = f"off by {ends[0]} to {ends[1]} %, each ± {rounded(worst.value, 2 * worst.u)[1]} %"
    if abs(worst.value) > 2 * worst.u:
        return (
            f"The signal is not proportional to the light ({span}): recover its response (radiometer response) before "
            "it is trusted better than that."
        )
    return f"The signal is proportional to the light within the noise ({span}): no response is needed."


def _dark(current: Quantity | None, read: Quantity | None) -> str:
    if current is None or not math.isfinite(current.value):
        return ""
    limit = upper_limit("mu_I_mean", current)
    if limit is not None:
        return f"No dark current is seen: it is {below(limit, current.unit)}."
    when = f"; its noise reaches the read noise at {read.value**2 / current.value:.3g} s" if read is not None else ""
    return f"Every pixel gathers {_with_u(current)} in the dark{when}. Take darks at the exposures of long frames."


def _with_u(quantity: Quantity) -> str:
    return with_u(quantity.value, 2 * quantity.u, unit_text(quantity.unit))


def _figures(result: Characterisation) -> str:
    rows = []
    for key, symbol in SYMBOLS.items():
        if key in result.figures:
            value, expanded = as_printed(key, result.figures[key])
            shown = expanded if expanded.startswith("<") else f"± {expanded}"
            unit = unit_text(result.figures[key].unit)
            rows.append((symbol.sign.replace("_", " "), symbol.meaning, value, shown, unit))
    return table(("symbol", "figure", "value", "U (k = 2)", "unit"), rows, words=(1, 4))


def _gains(result: Characterisation) -> str:
    if len(result.gains) < 2:
        return ""
    rows = []
    for gain_db, K in result.gains.items():
        value, expanded = rounded(K.value, 2 * K.u)
        rows.append((f"{gain_db:g} dB", value, f"± {expanded}"))
    return table(("gain", "K in DN/e⁻", "U (k = 2)"), rows)


def _steps(result: Characterisation) -> str:
    rows = [
        (
            f"{step.bright.settings.exposure_s:.6g}",
            f"{step.bright.settings.source_level:.4g}",
            f"{step.signal_dn:.5g}",
            f"{step.bright.variance_dn2:.4g}",
            f"{step.dark_variance_dn2:.4g}",
        )
        for step in result.steps
    ]
    return table(("exposure in s", "source level", "signal in DN", "σ_y² in DN²", "σ_y.dark² in DN²"), rows)
