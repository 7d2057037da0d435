"""The overall system gain K by photon transfer."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from radiometer.analysis.characterise.line_fit import Line, fit_line, is_bent
from radiometer.analysis.characterise.steps import SignalStep
from radiometer.analysis.signal.model import FLOOR_SHARE
from radiometer.analysis.signal.rounding import PLAIN_FROM, SHEPPARD
from radiometer.data import Quantity
from radiometer.errors import MeasurementError

USED_SHARE = 0.7  # of saturation: EMVA 1288, release 4.0 (linear)
CLIPPED_SHARE = 1e-4  # hot pixels at full scale; from there on clipping takes more than 0.1 % of the variance
# With σ² of noise before it, rounding adds 1/12 ± (1/π² + 4σ²)·exp(−2π²σ²) steps²: below 0.001 from σ² = 0.42 on.
_BLURRED_VARIANCE = 0.5  # of squared code steps
_FEWEST_STEPS = 3
UNSEEN_CURVE_U_REL = 0.02  # of K from one or two levels: real photon transfers bend by 2 to 4 % on the way up


@dataclass(frozen=True, slots=True)
class PhotonTransfer:
    """The photon transfer of one gain."""

    K: Quantity  # overall system gain in DN/e-
    line: Line  # the weighted line through the points
    used: tuple[SignalStep, ...]  # steps that took part
    # The dark noise is below 0.24 squared code steps, so that its variance before rounding is estimated
    rounded: bool = False
    # Part of K's standard uncertainty that covers the local gains of a bent transfer; 0 where it is straight
    bend_u: float = 0.0
    # (K at the lower end, K at the upper end) in DN/e-: variance over signal of the outer thirds of the steps
    local: tuple[float, float] = (0.0, 0.0)


class FewSteps(MeasurementError):
    """Too few steps are in the range of a photon transfer."""

    def __init__(self, used: Sequence[SignalStep], message: str) -> None:
        super().__init__(message)
        self.used = tuple(used)  # the steps that are


def photon_transfer(
    steps: Sequence[SignalStep], saturation_dn: float, *, free: bool = False, step_dn: int = 1
) -> PhotonTransfer:
    """Return K, the slope of the light's variance over its mean from zero to 70 % of saturation.

    The line is tied to the origin, and each point is weighted by its predicted uncertainty σ²·√(2/ν). The σ² is that
    of a first unweighted fit, so that chance does not choose the weights. Where the dark variance is below 0.24
    squared code steps, the dark variance before rounding is estimated and subtracted, and 1/12 of a squared step is
    subtracted from the bright variance. Steps below 0.5 squared steps are left out then.

    Where the points bend, no one K describes the sensor. K is then the standard's figure, the unweighted least-squares
    slope, and its uncertainty covers the local gains at both ends.

    Args:
        steps: Bright steps, of any number of regions.
        free: The line is not tied to the origin: there are no dark frames, so that the signal holds the black level.

    Raises:
        FewSteps: If fewer than three steps are in the range.
        MeasurementError: If the variance does not rise with the signal.

    Source: EMVA Standard 1288, release 4.0, section 6.6, equation (14).
    """
    squared = float(step_dn) ** 2
    rounded = not free and bool(np.median([s.dark_variance_dn2 for s in steps]) < PLAIN_FROM * squared)
    least = _BLURRED_VARIANCE * squared if rounded else 0.0
    used = tuple(s for s in steps if _is_in_range(s, saturation_dn) and s.bright.variance_dn2 >= least)
    if len(used) < _FEWEST_STEPS:
        raise FewSteps(
            used,
            f"only {len(used)} of {len(steps)} bright steps are between darkness and 70 % of saturation; the photon "
            f"transfer needs at least {_FEWEST_STEPS}: take more and shorter exposures",
        )
    x = np.array([s.signal_dn for s in used])
    y = np.array([_light_variance_dn2(s, squared) if rounded else s.photo_variance_dn2 for s in used])
    slope = float(x @ y / (x @ x))
    for _ in range(2):
        u = np.array([_predicted_u(s, max(slope, 0.0)) for s in used])
        line = fit_line(x, y, u, through_origin=not free)
        slope = line.slope
    if slope <= 3 * line.u_slope:
        raise MeasurementError(
            f"the variance does not rise with the signal (slope {slope:.3g} ± {line.u_slope:.2g} DN): these frames "
            "show no shot noise; were they averaged, denoised, or compressed with loss?"
        )
    # The dark noise before rounding is one figure for all steps: its error moves them together.
    common = max(s.u_dark_noise_dn2 for s in used) if rounded else 0.0
    u_common = common * float(np.sum(x / u**2) / np.sum(x**2 / u**2))
    local = _local_gains(x, y - (0.0 if not free else line.intercept))
    u_slope = math.hypot(line.u_slope, u_common)
    if not is_bent(x, y, u, through_origin=not free):
        return PhotonTransfer(Quantity(slope, u_slope, "DN/e-"), line, used, rounded, 0.0, local)
    K = slope if free else _standard_gain([s for s in steps if _is_in_range(s, saturation_dn)])
    ends = _local_slopes(x, y) if free else local
    # A rectangular distribution that reaches from K to the farther end covers it at k = 2.
    bend_u = max(abs(end - K) for end in ends) / math.sqrt(3.0)
    return PhotonTransfer(Quantity(K, math.hypot(u_slope, bend_u), "DN/e-"), line, used, rounded, bend_u, ends)


def _light_variance_dn2(step: SignalStep, squared_step_dn2: float) -> float:
    return step.bright.variance_dn2 - SHEPPARD * squared_step_dn2 - step.dark_noise_dn2


def _standard_gain(steps: Sequence[SignalStep]) -> float:
    """Return the standard's K: all steps in its range count alike, and the variances are used as measured."""
    x, y = np.array([(s.signal_dn, s.photo_variance_dn2) for s in steps]).T
    return float(x @ y / (x @ x))


def _local_gains(x: NDArray[np.float64], y: NDArray[np.float64]) -> tuple[float, float]:
    """Return variance over signal of the lower and the upper third of the points."""
    order = np.argsort(x)
    third = max(1, x.size // 3)
    low, high = order[:third], order[-third:]
    return float(y[low].sum() / x[low].sum()), float(y[high].sum() / x[high].sum())


def _local_slopes(x: NDArray[np.float64], y: NDArray[np.float64]) -> tuple[float, float]:
    """Return the slope of a parabola through the points at both ends."""
    square, straight, _ = np.polyfit(x, y, 2)
    return float(straight + 2 * square * x.min()), float(straight + 2 * square * x.max())


def transfer_of_few(steps: Sequence[SignalStep]) -> Quantity | None:
    """Return K in DN/e- from one or two levels of light, whose photon transfer may bend unseen; None without any.

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


def _is_in_range(step: SignalStep, saturation_dn: float) -> bool:
    if step.bright.clipped_share > CLIPPED_SHARE or step.bright.floor_share > FLOOR_SHARE:
        return False
    return 0 < step.signal_dn <= USED_SHARE * saturation_dn


def _predicted_u(step: SignalStep, slope: float) -> float:
    """Return the uncertainty of a step's variance difference that a given K predicts, errors of the signal included.

    Each pixel's variance is known to √(2/ν) of itself. Where the light is uneven, bright pixels have more of it: the
    mean square of the variances is that of the mean and K² times the variance of the light over the pixels.
    """
    total = slope * step.signal_dn + max(step.dark_variance_dn2, 1 / 12)
    uneven = slope * math.sqrt(max(step.bright.spatial_variance_dn2, 0.0))
    u_bright = math.hypot(total, uneven) * math.sqrt(2.0 / step.bright.degrees_of_freedom)
    return math.hypot(u_bright, step.u_dark_variance_dn2, slope * step.u_signal_dn)
