"""Uncertainty by leaving out parts of the pixels: for methods that give no covariance."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from radiometer.analysis.response.samples import ResponseSamples
from radiometer.typing import Array

_FOLDS = 10


def jackknife(samples: ResponseSamples, solve: Callable[[ResponseSamples], Array]) -> Array:
    """Return the standard uncertainty of what `solve` returns, shape of its result.

    Every tenth group of pixels is left out in turn.

    Args:
        samples: All rows.
        solve: Returns any array of values that depend on the rows.

    Source: grouped jackknife, s² = (F − 1)/F · Σ (θ_f − θ̄)² over F folds; Shao & Tu 1995, section 1.2. So few folds
    know s² itself only roughly: u² = s²·(F − 1)/(F − 3), JCGM 101:2008, 6.4.9.
    """
    folds = min(_FOLDS, samples.group_count)
    left = [solve(samples.kept(samples.group % folds != fold)) for fold in range(folds)]
    values = np.array(left)
    scatter = (folds - 1) / folds * np.square(values - values.mean(axis=0)).sum(axis=0)
    return np.asarray(np.sqrt(scatter * (folds - 1) / max(folds - 3, 1)))


def jackknife_u(left: Sequence[Array]) -> Array:
    """Return the standard uncertainty that results with one part of the data left out each show.

    Args:
        left: The result without each part, all of one shape; with fewer than two nothing is known: zero.

    Source: as for `jackknife`, with the parts taken as they are.
    """
    if len(left) < 2:
        return np.zeros(left[0].shape if left else 1)
    values = np.array(left)
    return np.asarray(np.sqrt((len(values) - 1) * values.var(axis=0)))
