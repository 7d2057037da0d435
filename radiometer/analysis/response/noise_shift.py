"""Group means of digital numbers turned into the digital number of the mean exposure."""

from __future__ import annotations

import numpy as np

from radiometer.analysis.response.limits import ValueLimits
from radiometer.typing import Array

ASSUMPTION = "noise arises before the response curve (shot and read noise); only quantisation after it"
_QUANTISATION_DN2 = 1.0 / 12.0


def mean_exposure_dn(dn: Array, variance_dn2: Array, log_exposure: Array, limits: ValueLimits) -> Array:
    """Return the digital number that the mean exposure of a group would have.

    Shot noise is symmetric in exposure, not in digital numbers: behind a curved response the mean of M is not the
    M of the mean H. To second order M(H̄) = M̄ + ½ (g''/g' + g')·σ_M², with the quantisation taken out of σ_M².

    Args:
        dn: Mean digital number of each group, any shape.
        variance_dn2: Variance of the group's pixels in DN², same shape.
        log_exposure: A first estimate of g at every digital number.
        limits: Black and saturation level.

    Source: second-order propagation of moments through h = exp g (GUM 5.1.2, note).
    """
    step = np.maximum(1.0, 0.1 * np.minimum(dn - limits.black_dn, limits.saturated_dn - dn))
    grid = np.arange(log_exposure.size)
    below, here, above = (np.interp(dn + s * step, grid, log_exposure) for s in (-1.0, 0.0, 1.0))
    slope = np.maximum((above - below) / (2.0 * step), 1e-12)
    bend = (above - 2.0 * here + below) / step**2
    noise = np.maximum(variance_dn2 - _QUANTISATION_DN2, 0.0)
    shift = 0.5 * (bend / slope + slope) * noise
    # Beyond half a standard deviation the second order no longer describes the noise.
    return np.asarray(dn + np.clip(shift, -0.5 * np.sqrt(noise), 0.5 * np.sqrt(noise)))
