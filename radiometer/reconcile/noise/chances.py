"""Chances and ranks, from special functions alone: scipy.stats takes longer to load than they take to compute."""

from __future__ import annotations

import numpy as np
from scipy.special import chdtrc, gammaincinv

from radiometer.reconcile.measure.design import Array


def chi2_beyond(value: float, freedom: int) -> float:
    """Return the chance that χ² of so many degrees of freedom exceeds a value."""
    return float(chdtrc(freedom, max(value, 0.0)))


def chi2_quantile(chance: float, freedom: int) -> float:
    """Return the value below which χ² of so many degrees of freedom stays with a chance."""
    return float(2.0 * gammaincinv(freedom / 2, chance))


def ranks(values: Array) -> Array:
    """Return the rank of each value from 1 on, equal ones sharing the mean of theirs, (n,)."""
    _, level, count = np.unique(values, return_inverse=True, return_counts=True)
    return np.asarray((np.cumsum(count) - 0.5 * (count - 1))[level])
