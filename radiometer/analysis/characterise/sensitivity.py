"""Figures that follow from gain, darkness and saturation: responsivity, efficiency, thresholds, dynamic range."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from radiometer.analysis.characterise.line_fit import fit_line
from radiometer.analysis.characterise.saturation import Saturation
from radiometer.analysis.characterise.steps import SignalStep
from radiometer.data import Quantity


def responsivity(steps: Sequence[SignalStep], saturation: Saturation, photons_u_rel: float) -> Quantity:
    """Return R, the slope of signal over photons up to 70 % of saturation, in DN per photon.

    Args:
        steps: Steps of one region whose light is photons per pixel.
        saturation: Its saturation point.
        photons_u_rel: Relative standard uncertainty of the photon numbers.

    Source: EMVA Standard 1288, release 4.0, section 6.6, equation (13).
    """
    used = [s for s in steps if 0 < s.signal_dn <= 0.7 * saturation.signal_dn]
    line = fit_line(
        [s.light for s in used], [s.signal_dn for s in used], [s.u_signal_dn for s in used], through_origin=True
    )
    return Quantity(line.slope, math.hypot(line.u_slope, line.slope * photons_u_rel), "DN/photon")


def propagated(function: Callable[..., float], unit: str, *inputs: Quantity) -> Quantity:
    """Return a function of independent quantities with its standard uncertainty by linear propagation.

    Source: JCGM 100:2008, equation (10), with differences over one standard uncertainty.
    """
    values = [q.value for q in inputs]
    centre = function(*values)
    total = 0.0
    for index, entry in enumerate(inputs):
        above, below = list(values), list(values)
        above[index], below[index] = entry.value + entry.u, entry.value - entry.u
        total += ((function(*above) - function(*below)) / 2) ** 2
    return Quantity(centre, math.sqrt(total), unit)


def sensitivity_figures(
    K: Quantity,
    dark_variance: Quantity,
    saturation_dn: Quantity | None,
    eta_percent: Quantity | None,
    step_dn: int = 1,
    *,
    is_bound: bool = False,
) -> dict[str, Quantity]:
    """Return σ_y.dark, σ_d, thresholds, saturation capacities, SNR_max and dynamic range.

    Args:
        K: Overall system gain in DN/e-.
        dark_variance: σ_y.dark² at exposure 0 in DN².
        saturation_dn: Signal at saturation in DN; None where unknown, and then nothing follows from it.
        eta_percent: Quantum efficiency in %; None where unknown.
        step_dn: Distance between codes in DN, whose rounding adds step²/12.
        is_bound: The dark variance is a bound only: rounding hides the noise.

    Source: EMVA Standard 1288, release 4.0, sections 6.6 and 6.7.
    """
    figures = {
        "sigma_y_dark": propagated(math.sqrt, "DN", dark_variance),
        "sigma_d": propagated(lambda var, k: sigma_d(var, k, step_dn), "e-", dark_variance, K),
        "mu_e_min": propagated(_threshold_e, "e-", dark_variance, K),
    }
    if is_bound:  # σ_d lies anywhere between 0 and this: a rectangular distribution
        bound = figures["sigma_d"].value
        figures["sigma_d"] = Quantity(bound / 2.0, bound / math.sqrt(12.0), "e-")
    if saturation_dn is not None:
        figures |= _saturation_figures(K, dark_variance, saturation_dn)
    if eta_percent is not None:
        for name in ("min", "sat"):
            if f"mu_e_{name}" in figures:
                electrons = figures[f"mu_e_{name}"]
                figures[f"mu_p_{name}"] = propagated(lambda e, eta: 100 * e / eta, "photon", electrons, eta_percent)
    return figures


def _saturation_figures(K: Quantity, dark_variance: Quantity, saturation_dn: Quantity) -> dict[str, Quantity]:
    return {
        "mu_e_sat": propagated(lambda sat, k: sat / k, "e-", saturation_dn, K),
        "SNR_max": propagated(lambda sat, k: math.sqrt(sat / k), "1", saturation_dn, K),
        "SNR_max_dB": propagated(lambda sat, k: 10 * math.log10(sat / k), "dB", saturation_dn, K),
        "DR": propagated(_dynamic_range, "1", saturation_dn, dark_variance, K),
        "DR_dB": propagated(
            lambda sat, var, k: 20 * math.log10(_dynamic_range(sat, var, k)), "dB", saturation_dn, dark_variance, K
        ),
    }


def sigma_d(dark_variance: float, K: float, step_dn: int = 1) -> float:
    """Return the temporal dark noise in e- from its variance in DN², rounding (step²/12) taken out.

    Source: EMVA Standard 1288, release 4.0, section 6.7.
    """
    return math.sqrt(max(dark_variance - step_dn**2 / 12, 0.0)) / K


def _threshold_e(dark_variance: float, K: float) -> float:
    return math.sqrt(max(dark_variance, 0.0)) / K + 0.5


def _dynamic_range(saturation_dn: float, dark_variance: float, K: float) -> float:
    return saturation_dn / K / _threshold_e(dark_variance, K)
