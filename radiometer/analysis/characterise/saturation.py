"""Where the sensor saturates."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from radiometer.analysis.characterise.line_fit import fit_line
from radiometer.analysis.characterise.photon_transfer import CLIPPED_SHARE
from radiometer.analysis.characterise.steps import SignalStep
from radiometer.data import Quantity
from radiometer.errors import MeasurementError

_COLLAPSED_SHARE = 0.05


@dataclass(frozen=True, slots=True)
class Saturation:
    """The saturation point by the standard: the step with the largest temporal variance.

    Attributes:
        signal_dn: μ_y − μ_y.dark of that step in DN.
        light: Its light (photons per pixel, or exposure × level).
        u_light_rel: Relative standard uncertainty that the spacing of the steps leaves.
        linear_signal_dn: Signal that this light would give without compression, from the line below 70 %.
        u_linear_signal_dn: Its standard uncertainty, spacing included.
        reached: False where the variance still rises at the last step, so that all is a lower bound.
        limited_by: "converter" where pixels are at full scale there or beyond, else "full well".
        plateau_dn: Mean on the plateau beyond, where all pixels are saturated, with standard uncertainty (the black
            level is still in it); None where the steps end before it.
    """

    signal_dn: float
    light: float
    u_light_rel: float
    linear_signal_dn: float
    u_linear_signal_dn: float
    reached: bool
    limited_by: str
    plateau_dn: Quantity | None = None


def find_saturation(steps: Sequence[SignalStep]) -> Saturation:
    """Return the saturation point of one region's steps by rising light.

    Raises:
        MeasurementError: If there are fewer than three steps.

    Source: EMVA Standard 1288, release 4.0, section 6.6.
    """
    if len(steps) < 3:
        raise MeasurementError(f"{len(steps)} bright steps; a characterisation needs at least 3 levels of light")
    variances = np.array([s.bright.variance_dn2 for s in steps])
    light = np.array([s.light for s in steps])
    top = int(np.argmax(variances))
    reached = top < len(steps) - 1 or steps[top].bright.clipped_share > CLIPPED_SHARE
    slope, u_slope = _slope_below(steps, steps[top].signal_dn)
    u_light_rel = _spacing_u(steps, top) / steps[top].light
    linear = slope * float(light[top])
    return Saturation(
        signal_dn=steps[top].signal_dn,
        light=float(light[top]),
        u_light_rel=u_light_rel,
        linear_signal_dn=linear,
        u_linear_signal_dn=linear * math.hypot(u_slope / slope, u_light_rel),
        reached=reached,
        limited_by="converter" if any(s.bright.clipped_share > CLIPPED_SHARE for s in steps[top:]) else "full well",
        plateau_dn=_plateau(steps[-1], float(variances[top])),
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


def _slope_below(steps: Sequence[SignalStep], signal_dn: float) -> tuple[float, float]:
    used = [s for s in steps if 0 < s.signal_dn <= 0.7 * signal_dn] or list(steps[:1])
    line = fit_line(
        [s.light for s in used], [s.signal_dn for s in used], [s.u_signal_dn for s in used], through_origin=True
    )
    return line.slope, line.u_slope
