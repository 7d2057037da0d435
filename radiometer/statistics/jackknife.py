"""Uncertainty by leaving out parts of the data: for results without a covariance."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from radiometer.typing import Array


def jackknife_u(left: Sequence[ArrayLike], *, few_parts: bool = False) -> Array:
    """Return the standard uncertainty that results with one part of the data left out each show.

    Args:
        left: The result without each part, all of one shape; with fewer than two nothing is known: zero.
        few_parts: Widen u for the small number of parts F, which know the variance only roughly, by (F − 1)/(F − 3).
            Leave it out where the degrees of freedom F − 1 are stated with the result, or where several u are joined.

    Source: grouped jackknife, s² = (F − 1)/F · Σ (θ_f − θ̄)² over F parts; Shao and Tu 1995, section 1.2. The factor
    for few parts: JCGM 101:2008, 6.4.9.
    """
    values = np.array(left, dtype=np.float64)
    count = len(values)
    if count < 2:
        return np.zeros(values.shape[1:] if count else 1)
    variance = (count - 1) * values.var(axis=0)
    return np.asarray(np.sqrt(variance * (count - 1) / max(count - 3, 1) if few_parts else variance))
