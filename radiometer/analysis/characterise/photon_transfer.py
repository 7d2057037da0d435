"""The overall system gain K by photon transfer."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from radiometer.analysis.characterise.line_fit import Line, curve_u, fit_line
from radiometer.analysis.characterise.steps import SignalStep
from radiometer.data import Quantity
from radiometer.errors import MeasurementError

USED_SHARE = 0.7
CLIPPED_SHARE = 1e-4  # hot pixels at full scale; from there on clipping takes more than 0.1 % of the variance
SMALLEST_VARIANCE_DN2 = 0.24  # EMVA 1288, 6.7: below it rounding is no noise that adds up
# With σ² of noise before it, rounding adds 1/12 ± (1/π² + 4σ²)·exp(−2π²σ²) DN²: below 0.001 from σ² = 0.42 on.
_BLURRED_VARIANCE_DN2 = 0.5
_FLOOR_SHARE = 0.01  # pixels at 0
_FEWEST_STEPS = 3
UNSEEN_CURVE_U_REL = 0.02  # of K from one or two levels: real photon transfers bend by 2 to 4 % on the way up


@dataclass(frozen=True, slots=True)
class PhotonTransfer:
    """The photon transfer of one gain.

    Attributes:
        K: Overall system gain in DN/e-.
        line: The line that it is the slope of.
        used: Steps that took part.
        rounded: Rounding hides the dark noise, so that the line is of σ_y² itself and free of the origin.
        bend_u: What a bend of the points adds to the uncertainty of K; 0 where none is seen.
    """

    K: Quantity
    line: Line
    used: tuple[SignalStep, ...]
    rounded: bool = False
    bend_u: float = 0.0


def photon_transfer(steps: Sequence[SignalStep], saturation_dn: float, *, free: bool = False) -> PhotonTransfer:
    """Return K, the slope of σ_y² − σ_y.dark² over μ_y − μ_y.dark from zero to 70 % of saturation.

    Each variance is weighted by its predicted uncertainty σ²·√(2/ν) (σ² from a first unweighted fit, so that
    chance does not choose the weights) instead of all alike as the standard's least squares does; the line is tied to
    the origin as there. Where the dark variance is below 0.24 DN² (few bits, low gain), rounding hides part of it in
    the dark but not in the light: then the line is free, and only steps above 0.5 DN² count.

    Args:
        steps: Bright steps, of any number of regions.
        saturation_dn: Signal at saturation in DN.
        free: The line is not tied to the origin: there are no dark frames, so that the signal holds the black level.

    A bend of the points widens the uncertainty of K, since there is no one gain then.

    Raises:
        MeasurementError: If fewer than three steps lie in the range, or the variance does not rise with the signal.

    Source: EMVA Standard 1288, release 4.0, section 6.6, equation (14).
    """
    rounded = bool(np.median([s.dark_variance_dn2 for s in steps]) < SMALLEST_VARIANCE_DN2)
    used = tuple(s for s in steps if _lies_in_range(s, saturation_dn, rounded=rounded))
    if len(used) < _FEWEST_STEPS:
        raise MeasurementError(
            f"only {len(used)} of {len(steps)} bright steps lie between darkness and 70 % of saturation; the photon "
            f"transfer needs at least {_FEWEST_STEPS}: take more and shorter exposures"
        )
    x = np.array([s.signal_dn for s in used])
    y = np.array([s.bright.variance_dn2 if rounded else s.photo_variance_dn2 for s in used])
    slope = float(x @ y / (x @ x))
    tied = not (rounded or free)
    for _ in range(2):
        u = [_predicted_u(s, max(slope, 0.0)) for s in used]
        line = fit_line(x, y, u, through_origin=tied)
        slope = line.slope
    bend_u = curve_u(x, y, u, through_origin=tied)
    if slope <= 3 * line.u_slope:
        raise MeasurementError(
            f"the variance does not rise with the signal (slope {slope:.3g} ± {line.u_slope:.2g} DN): these frames "
            "show no shot noise; were they averaged, denoised, or compressed with loss?"
        )
    return PhotonTransfer(Quantity(slope, math.hypot(line.u_slope, bend_u), "DN/e-"), line, used, rounded, bend_u)


def transfer_of_few(steps: Sequence[SignalStep]) -> Quantity | None:
    """Return K in DN/e- from one or two levels of light, whose photon transfer nobody can see bend; None without any.

    The mean of σ_y² − σ_y.dark² over μ_y − μ_y.dark, weighted by noise; its uncertainty holds 2 % for the unseen bend.

    Source: EMVA Standard 1288, release 4.0, equation (14), for a single point.
    """
    lit = [s for s in steps if s.bright.has_noise and s.signal_dn > 0 and s.bright.clipped_share <= CLIPPED_SHARE]
    if not lit:
        return None
    ratios = np.array([s.photo_variance_dn2 / s.signal_dn for s in lit])
    u = np.array([_predicted_u(s, float(ratios.mean())) / s.signal_dn for s in lit])
    weights = u**-2 / np.sum(u**-2)
    K = float(weights @ ratios)
    if K <= 0:
        return None
    spread = math.sqrt(float(weights @ (ratios - K) ** 2))
    return Quantity(K, math.hypot(float(np.sum(u**-2)) ** -0.5, spread, UNSEEN_CURVE_U_REL * K), "DN/e-")


def _lies_in_range(step: SignalStep, saturation_dn: float, *, rounded: bool) -> bool:
    if step.bright.clipped_share > CLIPPED_SHARE or step.bright.floor_share > _FLOOR_SHARE:
        return False
    if not 0 < step.signal_dn <= USED_SHARE * saturation_dn:
        return False
    return not rounded or step.bright.variance_dn2 >= _BLURRED_VARIANCE_DN2


def _predicted_u(step: SignalStep, slope: float) -> float:
    """Return the uncertainty of a step's variance difference that a given K predicts, errors of the signal included."""
    total = slope * step.signal_dn + max(step.dark_variance_dn2, 1 / 12)
    u_bright = total * math.sqrt(2.0 / step.bright.degrees_of_freedom)
    return math.hypot(u_bright, step.u_dark_variance_dn2, slope * step.u_signal_dn)
