"""The best mixture of a pixel's two estimates where quantisation depends on the level: behind a response curve.

It depends on the frames used and on the level alone. So each set of frames has a table over √E, with straight lines
between the levels where rounding is tabulated for the frame that shows most. The table is filled in where a pixel
asks.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from radiometer.analysis.merge.records import FIRST_POWER, INV1, INV2, ROOT
from radiometer.compiled import compiled

# Columns of a level: what a pixel there needs.
(SHARE, VARIANCE, TOTAL, SQUARES) = range(4)
LEVEL_SIZE = 4
# Lower levels are worked out singly: so near to zero straight lines over √E are off by more than 0.1 %.
FIRST_LEVEL = 16


@compiled
def from_root_table(signal: float, entries: Any, top: float) -> float:  # pragma: no cover (compiled)
    """Return a table's value at x.

    Args:
        signal: x times gain.
        entries: Values at x = top·(k/(size − 1))², float64.
        top: x of the last entry.
    """
    place = math.sqrt(min(max(signal, 0.0) / top, 1.0)) * (entries.size - 1)
    low = min(int(place), entries.size - 2)
    return float(entries[low] + (place - low) * (entries[low + 1] - entries[low]))


@compiled
def moments(
    rate: float, pattern: Any, frames: Any, gains: Any, kappa: float, quantisation: Any, top: float
) -> tuple[float, float, float, float, float]:  # pragma: no cover (compiled)
    """Return (Σv, Σv², Σw²·v, Σw·t·v, Σt²·v), w = t^0.35, over the frames of a pattern at a rate."""
    total, squares, var_a, both, var_b = 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(frames.shape[0]):
        if not (pattern >> np.uint64(i)) & np.uint64(1):
            continue
        t, gain = frames[i, 0], gains[i]
        v = frames[i, 1] + kappa * rate * t + from_root_table(rate * t * gain, quantisation, top) / gain**2
        w = t**FIRST_POWER
        total, squares = total + v, squares + v * v
        var_a, both, var_b = var_a + w * w * v, both + w * t * v, var_b + t * t * v
    return total, squares, var_a, both, var_b


@compiled
def mixture(
    rate_a: float, rate_b: float, var_a: float, both: float, var_b: float
) -> tuple[float, float, float]:  # pragma: no cover (compiled)
    """Return (rate, share of the first, variance) of the mixture of two estimates with the least variance."""
    between = var_a + var_b - 2.0 * both
    if between <= 1e-9 * var_a:
        return rate_a, 1.0, var_a
    share = (var_b - both) / between
    return rate_b + share * (rate_a - rate_b), share, var_a - (var_a - both) ** 2 / between


@compiled
def fill_levels(
    k: int,
    pattern: Any,
    record: Any,
    levels: Any,
    frames: Any,
    gains: Any,
    kappa: float,
    quantisation: Any,
    top: float,
) -> None:  # pragma: no cover (compiled)
    """Fill in level k of a set of frames and the next, where they are not yet.

    At level k √(rate·t·gain/top) = k/(size − 1) of the frame that shows most.

    Args:
        k: Number of the level.
        pattern: Bits of the frames used.
        record: As of `fill_record`.
        levels: Shape (size, 4): what `at_rate` returns; written at k and k + 1 where nothing is yet.
        frames: As in `fill_record`.
        gains: Gain factor of every frame.
        kappa: Shot noise variance per unit of x.
        quantisation: As in `from_root_table`, of as many entries as there are levels.
        top: Likewise.
    """
    for j in (k, k + 1):
        if levels[j, VARIANCE] > 0.0:
            continue
        rate = (j / ((levels.shape[0] - 1) * record[ROOT])) ** 2
        share, variance, total, squares = at_rate(rate, pattern, record, frames, gains, kappa, quantisation, top)
        levels[j, SHARE], levels[j, VARIANCE], levels[j, TOTAL], levels[j, SQUARES] = share, variance, total, squares


@compiled
def at_rate(
    rate: float, pattern: Any, record: Any, frames: Any, gains: Any, kappa: float, quantisation: Any, top: float
) -> tuple[float, float, float, float]:  # pragma: no cover (compiled)
    """Return (share of the first estimate, variance of the mixture, Σv, Σv²) at a rate; arguments as `fill_levels`."""
    total, squares, var_a, both, var_b = moments(max(rate, 0.0), pattern, frames, gains, kappa, quantisation, top)
    inv1, inv2 = record[INV1], record[INV2]
    _, share, variance = mixture(0.0, 0.0, var_a * inv1**2, both * inv1 * inv2, var_b * inv2**2)
    return share, variance, total, squares
