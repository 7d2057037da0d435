"""How many tones and places a stack really holds: far fewer than it has groups of pixels.

Behind a real camera what a response curve cannot follow (flare, registration, mixed colours) is alike in neighbouring
tones and alike within a part of the picture. Groups of pixels counted as independent would then call for every wave
that they share.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from radiometer.typing import Array

# The sum over correlations ends where two neighbouring ones together are no longer clearly positive.
_LEAST_PAIR: Final = 0.1
# Pairs of tones fewer than this share of all say too little of a correlation.
_LEAST_SHARE: Final = 0.25
# Four quadrants know a variance so badly that only a ratio above this is not chance: χ² of three differences of two
# independent features of a curve exceeds it once in a thousand stacks.
_BY_CHANCE: Final = 4.0


def tones_as_one(residual: Array, group: NDArray[np.intp], frame: NDArray[np.intp]) -> float:
    """Return how many neighbouring groups count as one tone, at least 1: 1 + 2 Σ ρ over their distance.

    Args:
        residual: Standardised residuals of the rows of a fit, shape (rows,).
        group: Group of every row; groups ascend in brightness.
        frame: Frame of every row.

    Source: integrated autocorrelation with an initial positive sequence, C. J. Geyer 1992, Stat. Sci. 7, 473–483,
    section 3.3.
    """
    groups = int(group.max()) + 1
    product, pairs = np.zeros(groups), np.zeros(groups)
    for one in np.unique(frame):
        rows = frame == one
        line, there = np.zeros(groups), np.zeros(groups)
        line[group[rows]], there[group[rows]] = residual[rows], 1.0
        product += _correlation(line)
        pairs += _correlation(there)
    known = pairs > _LEAST_SHARE * pairs[0]
    correlation = product / np.maximum(pairs, 1.0) / max(float(product[0] / pairs[0]), 1e-300)
    total = 1.0
    for lag in range(1, groups - 1, 2):
        pair = float(correlation[lag] + correlation[lag + 1])
        if pair <= _LEAST_PAIR or not known[lag + 1]:
            break
        total += 2.0 * pair
    return total


def _correlation(line: Array) -> Array:
    """Return Σ_i x_i x_(i+lag) for every lag."""
    spectrum = np.fft.rfft(line, 2 * line.size)
    return np.asarray(np.fft.irfft(np.abs(spectrum) ** 2)[: line.size])


def places_as_one(between: Array, expected: Array) -> float:
    """Return by how much parts of the picture differ beyond the scatter of their groups, as a ratio of variances.

    Args:
        between: Variance of the curve by leaving out quadrants, over the supported digital numbers.
        expected: Its variance from the scatter of groups taken as independent.

    Returns:
        The ratio; 1 where it may be chance.
    """
    ratio = float(np.mean(between)) / max(float(np.mean(expected)), 1e-300)
    return ratio if ratio > _BY_CHANCE else 1.0
