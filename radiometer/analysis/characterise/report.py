"""The report of a characterisation: what the camera does in one sentence and one picture, what to do, tables last."""

from __future__ import annotations

import math

from radiometer.analysis.characterise.report_plots import further_pictures, story
from radiometer.analysis.characterise.result import Characterisation
from radiometer.analysis.characterise.symbols import SYMBOLS, as_printed, upper_limit
from radiometer.data import Quantity
from radiometer.numbers import rounded, unit_text, with_u
from radiometer.reporting.page import folded, listed, page, paragraph, section, side_by_side, table


def datasheet(result: Characterisation) -> str:
    """Return the report as one HTML page: outcome, picture, meaning, notes, plots, figures with U (k = 2)."""
    camera = result.believed
    name = " ".join(part for part in (camera.vendor, camera.model) if part) or "Camera"
    made = result.provenance
    return page(
        f"{name}, serial {camera.serial or 'unknown'}",
        outcome(result),
        [
            paragraph(
                f"{camera.bit_depth} bit, gain {result.gain_db:g} dB; EMVA 1288 release 4.0 (linear); saturation is "
                f"set by the {result.limited_by}. Every ± is an expanded uncertainty, k = 2."
            ),
            story(result),
            section("What it means, and what to do", listed(meaning(result))),
            section("Remarks", *(paragraph(note, "flag") for note in result.notes)),
            section("Further pictures", side_by_side(*further_pictures(result))),
            section("Figures", _figures(result), _gains(result)),
            folded("Steps of the photon transfer", _steps(result)),
        ],
        kind="EMVA 1288 figures",
        made=f"Made {made.created} by {made.software} from {', '.join(made.inputs)}.",
    )


def outcome(result: Characterisation) -> str:
    """Return in one sentence what was found: gain, noise and capacity, or what is missing for them."""
    figures = result.figures
    gain = figures.get("K", figures.get("K_dark"))
    if gain is None or not math.isfinite(gain.value):
        return "These frames determine no gain: the camera's electrons cannot be counted from them."
    said = [f"One electron is {with_u(gain.value, 2 * gain.u, 'DN')}"]
    if "sigma_d" in figures:
        said.append(f"the camera reads with {_with_u(figures['sigma_d'])} of noise")
    if "mu_e_sat" in figures:
        said.append(f"holds {_with_u(figures['mu_e_sat'])} before it saturates")
    if len(said) == 3:
        said[1:] = [f"{said[1]} and {said[2]}"]
    return f"{'; '.join(said)}."


def meaning(result: Characterisation) -> list[str]:
    """Return what the figures mean for measuring, and what to do about it."""
    figures = result.figures
    said = [
        _noise(figures.get("sigma_d"), figures.get("K")),
        _range(figures.get("DR_dB"), figures.get("SNR_max")),
        _straightness(figures.get("LE_min"), figures.get("LE_max")),
        _dark(figures.get("mu_I_mean"), figures.get("sigma_d")),
    ]
    if "K" in figures:
        said.append(
            "To use it, write the camera file (-o camera.yaml) and give it to radiometer calibrate --camera-file; "
            "its noise then determines the weights of every measurement."
        )
    elif "K_dark" in figures:
        said.append(
            "The gain comes from dark frames alone. Frames of steady, even light from darkness to saturation would "
            "determine it better, and linearity and saturation as well."
        )
    else:
        said.append(
            "To count electrons, take pairs of frames of steady, even light at three levels or more, and darks at the "
            "same exposures: radiometer bracket --repeat 2 --darks 2."
        )
    return [text for text in said if text]


def _noise(read: Quantity | None, gain: Quantity | None) -> str:
    if read is None or gain is None or not read.value > 0:
        return ""
    equal_e = read.value**2
    return (
        f"From {equal_e:.3g} e⁻ ({equal_e * gain.value:.3g} DN above black) on, the light's own noise is larger than "
        "the camera's: more light helps there, and nothing else. Below, longer exposures help more than averages."
    )


def _range(dynamic: Quantity | None, best: Quantity | None) -> str:
    if dynamic is None or best is None or not best.value > 0:
        return ""
    return (
        f"One exposure spans {dynamic.value:.3g} dB; the best pixel of one frame is uncertain by "
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
        return f"No dark current is seen: it is below {limit:.2g} {unit_text(current.unit)} (95 %)."
    when = f"; its noise reaches the read noise at {read.value**2 / current.value:.3g} s" if read is not None else ""
    return f"Every pixel gathers {_with_u(current)} in the dark{when}. Take darks at the exposures of long frames."


def _with_u(quantity: Quantity) -> str:
    return with_u(quantity.value, 2 * quantity.u, unit_text(quantity.unit))


def _figures(result: Characterisation) -> str:
    rows = []
    for key, symbol in SYMBOLS.items():
        if key in result.figures:
            value, expanded = as_printed(key, result.figures[key])
            shown = expanded if expanded.startswith("below") else f"± {expanded}"
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
