"""Where the sensor saturates, and how few photons it sees."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from radiometer.analysis.characterise.line_fit import fit_line
from radiometer.analysis.characterise.photon_transfer import CLIPPED_SHARE
from radiometer.analysis.characterise.steps import SignalStep
from radiometer.analysis.signal.rounding import SHEPPARD
from radiometer.data import Quantity
from radiometer.errors import MeasurementError

_COLLAPSED_SHARE = 0.05  # of the largest variance, below which nearly all pixels clip


@dataclass(frozen=True, slots=True)
class Saturation:
    """The saturation point by the standard: the step with the largest temporal variance."""

    signal_dn: float  # μ_y − μ_y.dark of that step in DN
    u_signal_dn: float  # its standard uncertainty
    light: float  # its light (photons per pixel, or exposure × level)
    u_light_rel: float  # relative standard uncertainty that the spacing of the steps leaves
    linear_signal_dn: float  # signal that this light would give without compression, from the line below 70 %
    u_linear_signal_dn: float  # its standard uncertainty, with what spacing and uneven light make
    reached: bool  # false where the variance still rises at the last step, so that all is a lower bound
    limited_by: str  # "converter" where pixels are at full scale there or beyond, else "full well"
    # Mean on the plateau beyond, where all pixels are saturated, with standard uncertainty (the black level is still in
    # it); None where the steps end before it
    plateau_dn: Quantity | None = None
    bright_dn: float = math.inf  # mean of that step in DN, dark signal included

    def rising(self, steps: Sequence[SignalStep]) -> tuple[SignalStep, ...]:
        """Return the steps up to the saturation point: beyond it the signal falls by what the dark signal grows."""
        return tuple(s for s in steps if s.bright.mean_dn <= self.bright_dn)


def find_saturation(steps: Sequence[SignalStep]) -> Saturation:
    """Return the saturation point of one region's steps by rising light.

    Raises:
        MeasurementError: If there are fewer than three steps, or the signal does not rise.

    Source: EMVA Standard 1288, release 4.0, section 6.6.
    """
    if len(steps) < 3:
        raise MeasurementError(f"{len(steps)} bright steps; a characterisation needs at least 3 levels of light")
    variances = np.array([s.bright.variance_dn2 for s in steps])
    light = np.array([s.light for s in steps])
    top = int(np.argmax(variances))
    reached = top < len(steps) - 1 or steps[top].bright.clipped_share > CLIPPED_SHARE
    slope, u_slope = _slope(_below(steps[: top + 1], steps[top].signal_dn))
    u_light_rel = _spacing_u(steps, top) / steps[top].light
    if not slope > 0.0:
        raise MeasurementError(
            "the signal does not rise with the light: the frames are capped, dark or clipped throughout; take frames "
            "from darkness to saturation"
        )
    linear = slope * float(light[top])
    # Pixels that get more light than the mean are full before it.
    below = _below(steps[: top + 1], steps[top].signal_dn)[-1]
    u_uneven_rel = math.sqrt(max(below.bright.spatial_variance_dn2, 0.0)) / (slope * below.light)
    return Saturation(
        signal_dn=steps[top].signal_dn,
        u_signal_dn=math.hypot(steps[top].u_signal_dn, steps[top].u_warmth_dn),
        light=float(light[top]),
        u_light_rel=u_light_rel,
        linear_signal_dn=linear,
        u_linear_signal_dn=linear * math.hypot(u_slope / slope, u_light_rel, u_uneven_rel),
        reached=reached,
        limited_by="converter" if any(s.bright.clipped_share > CLIPPED_SHARE for s in steps[top:]) else "full well",
        plateau_dn=_plateau(steps[-1], float(variances[top])),
        bright_dn=steps[top].bright.mean_dn,
    )


def _plateau(last: SignalStep, largest_variance: float) -> Quantity | None:
    """Return the mean of the last step where its variance has collapsed."""
    if last.bright.variance_dn2 > _COLLAPSED_SHARE * largest_variance:
        return None
    return Quantity(last.bright.mean_dn, last.bright.u_mean_dn, "DN")


def _spacing_u(steps: Sequence[SignalStep], top: int) -> float:
    """Return the uncertainty of a largest value that is known to be between two steps only, taken as rectangular.

    The steps whose variance may be the largest within twice their uncertainties all count, and so do the gaps next to
    them.
    """
    bright = [s.bright for s in steps]
    floor = bright[top].variance_dn2 - 2 * bright[top].u_variance_dn2
    likely = [i for i, one in enumerate(bright) if one.variance_dn2 + 2 * one.u_variance_dn2 >= floor]
    below = steps[max(min(likely) - 1, 0)].light
    above = steps[min(max(likely) + 1, len(steps) - 1)].light
    return max(above - steps[top].light, steps[top].light - below) / math.sqrt(3)


def _below(steps: Sequence[SignalStep], signal_dn: float) -> list[SignalStep]:
    """Return the steps up to 70 % of a signal, at least one."""
    return [s for s in steps if 0 < s.signal_dn <= 0.7 * signal_dn] or list(steps[:1])


def _slope(used: Sequence[SignalStep]) -> tuple[float, float]:
    """Return the slope of signal over light from the origin, and its standard uncertainty."""
    light, u = [s.light for s in used], [s.u_signal_dn for s in used]
    line = fit_line(light, [s.signal_dn for s in used], u, through_origin=True)
    of_warmth = fit_line(light, [s.u_warmth_dn for s in used], u, through_origin=True)
    return line.slope, math.hypot(line.u_slope, of_warmth.slope)


def responsivity(steps: Sequence[SignalStep], saturation: Saturation, photons_u_rel: float) -> Quantity:
    """Return R, the slope of signal over photons up to 70 % of saturation, in DN per photon.

    Args:
        steps: Steps of one region whose light is photons per pixel.

    Source: EMVA Standard 1288, release 4.0, section 6.6, equation (13).
    """
    slope, u_slope = _slope(_below(saturation.rising(steps), saturation.signal_dn))
    return Quantity(slope, math.hypot(u_slope, slope * photons_u_rel), "DN/photon")


def propagated(function: Callable[..., float], unit: str, *inputs: Quantity) -> Quantity:
    """Return a function of independent quantities with its standard uncertainty by linear propagation.

    Source: JCGM 100:2008, equation (10), with differences over one standard uncertainty. They reach over half of the
    value at most: logarithms and roots have no value beyond zero.
    """
    values = [q.value for q in inputs]
    centre = function(*values)
    total = 0.0
    for index, entry in enumerate(inputs):
        above, below = list(values), list(values)
        step = min(entry.u, 0.5 * abs(entry.value)) or entry.u
        above[index], below[index] = entry.value + step, entry.value - step
        if step:
            total += ((function(*above) - function(*below)) / 2 * entry.u / step) ** 2
    return Quantity(centre, math.sqrt(total), unit)


def sensitivity_figures(
    K: Quantity,
    dark_variance: Quantity,
    saturation_dn: Quantity | None,
    eta_percent: Quantity | None,
    noise: Quantity | None = None,
    *,
    is_bound: bool = False,
) -> dict[str, Quantity]:
    """Return σ_y.dark, σ_d, thresholds, saturation capacities, SNR_max and dynamic range.

    Args:
        K: Overall system gain in DN/e-.
        dark_variance: σ_y.dark² at exposure 0 in DN².
        saturation_dn: Signal at saturation in DN; None where unknown, and then nothing follows from it.
        eta_percent: Quantum efficiency in %; None where unknown.
        noise: The dark variance before rounding in DN²; None takes 1/12 DN² off.
        is_bound: The dark variance is a bound only: rounding hides the noise.

    Source: EMVA Standard 1288, release 4.0, sections 6.6 and 6.7.
    """
    figures = {
        "sigma_y_dark": propagated(math.sqrt, "DN", dark_variance),
        "sigma_d": propagated(_noise_e, "e-", noise or replace(dark_variance, value=dark_variance.value - SHEPPARD), K),
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


def _noise_e(noise: float, K: float) -> float:
    return math.sqrt(max(noise, 0.0)) / K


def _threshold_e(dark_variance: float, K: float) -> float:
    return math.sqrt(max(dark_variance, 0.0)) / K + 0.5


def _dynamic_range(saturation_dn: float, dark_variance: float, K: float) -> float:
    return saturation_dn / K / _threshold_e(dark_variance, K)
