"""Error that a smoothed curve may have missed: more than an evenly rough curve with the same λ would."""

from __future__ import annotations

from typing import Final

import numpy as np

from radiometer.analysis.response.basis import ValueBasis
from radiometer.analysis.response.estimate import inner_range
from radiometer.typing import Array

# Frames at whole stops do not show a wave of one stop's period, and real responses hold more of it than their
# smoothness elsewhere predicts. With this factor the mean squared error in units of u over the DoRF curves is about 1
# (benchmarks/response_accuracy.py states it).
_UNSEEN_WAVE: Final = 2.0


def unseen_factor(coefficients: Array, covariance: Array, basis: ValueBasis, valid_dn: tuple[int, int]) -> float:
    """Return the factor on the standard uncertainty that smoothness decides, at least 2.

    One λ represents the whole curve. Where a few kinks hold most of the roughness, the mean understates what may
    have been smoothed away there: the squared third differences of the coefficients are weighted by themselves.

    Args:
        coefficients: Of the curve, shape (basis.size,).
        covariance: Their posterior covariance, shape (basis.size, basis.size).
        basis: The basis.
        valid_dn: Lowest and highest digital number that data supported.
    """
    inner = inner_range(valid_dn)
    first, last = np.argmax(basis.design(np.array([inner.start, inner.stop - 1.0])).toarray(), axis=1)
    bent = np.diff(np.eye(basis.size), basis.roughness_order, axis=0)[first:last]
    if not bent.size:
        return _UNSEEN_WAVE
    square = (bent @ coefficients) ** 2 + np.einsum("ij,ij->i", bent @ covariance, bent)
    return float(_UNSEEN_WAVE * np.sqrt(np.mean(square**2)) / np.mean(square))
