"""Effect of sub-pixel displacements on a map: more uncertainty at gradients, none on even ground.

A displacement of one frame by δ pixels along any direction changes its value at a pixel by δ·L·|∇ln L|. The map holds
the mean of its frames, each with its weight p, so that u gets δ·L·|∇ln L|·√Σp² where the displacements are independent.
Frames that disagree by at most their noise and this together do not contradict each other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from radiometer.analysis.merge.ghosts import signals
from radiometer.analysis.merge.records import AGREEMENT_SIGMA, CONTRADICTION_SIGMA, scatter_limit
from radiometer.analysis.merge.sums import MergeSample
from radiometer.analysis.merge.tables import MergeTables
from radiometer.compiled import compiled
from radiometer.typing import Array

# Levels per e-fold at which the weights of the frames are worked out: they change little between.
_PER_FOLD: Final = 16.0


@dataclass(frozen=True, slots=True, eq=False)
class MeanDisplacement:
    """√Σp² of the weights p of the frames, by the level of a pixel.

    Attributes:
        lowest: ln of the lowest rate that it is given for.
        factors: At steps of 1/`_PER_FOLD` from there, float64.
    """

    lowest: float
    factors: Array

    @classmethod
    def of(cls, tables: MergeTables) -> MeanDisplacement:
        """Return it for the maximum-likelihood weights of the frames that do not clip at each level.

        Args:
            tables: As the last step of the merge uses them, for all frames.
        """
        exposure, clips_at = tables.frames[:, :1], tables.frames[:, 2:3]
        lowest, highest = np.log(tables.bounds[1]), np.log(tables.bounds[0])
        log_rate = np.arange(lowest, max(highest, lowest) + 1.0 / _PER_FOLD, 1.0 / _PER_FOLD)
        expected = exposure * np.exp(log_rate)
        information = np.where(expected < clips_at, exposure**2 / tables.variance(expected)[0], 0.0)
        total = information.sum(axis=0)
        factors = np.sqrt((information**2).sum(axis=0)) / np.where(total > 0.0, total, 1.0)
        return cls(float(lowest), np.where(total > 0.0, factors, 1.0))


def relative_shift(radiance: NDArray[np.float32], u_radiance: NDArray[np.float32], px: float) -> NDArray[np.float32]:
    """Return by how much a displacement of one frame changes its value at every pixel, δ·|∇ln L|, float32.

    What noise makes of the square of the gradient is taken off; a value below its own uncertainty counts as that.

    Args:
        radiance: L, shape (height, width).
        u_radiance: Its standard uncertainty without displacement, same shape.
        px: δ in pixels.
    """
    found = np.zeros_like(radiance)
    _fill_shift(radiance, u_radiance, px, found)
    return found


@compiled
def _fill_shift(radiance: Any, u_radiance: Any, px: float, found: Any) -> None:  # pragma: no cover (compiled)
    height, width = radiance.shape
    for row in range(height):
        above, below = max(row - 1, 0), min(row + 1, height - 1)
        for column in range(width):
            left, right = max(column - 1, 0), min(column + 1, width - 1)
            down = _squared_slope(
                radiance[above, column],
                u_radiance[above, column],
                radiance[below, column],
                u_radiance[below, column],
                below - above,
            )
            across = _squared_slope(
                radiance[row, left], u_radiance[row, left], radiance[row, right], u_radiance[row, right], right - left
            )
            found[row, column] = px * np.sqrt(down + across)


@compiled
def _squared_slope(one: float, u_one: float, two: float, u_two: float, steps: int) -> float:  # pragma: no cover
    """Return the squared slope of ln L over so many pixels, less what noise makes of it."""
    one, two = max(one, u_one), max(two, u_two)
    if steps == 0 or one <= 0.0 or two <= 0.0:
        return 0.0
    slope = np.log(two / one)
    return float(max(slope * slope - (u_one / one) ** 2 - (u_two / two) ** 2, 0.0) / (steps * steps))


def with_shift(
    radiance: NDArray[np.float32],
    u_radiance: NDArray[np.float32],
    shift: NDArray[np.float32],
    per_unit: NDArray[np.float32],
    mean: MeanDisplacement,
) -> None:
    """Add to the uncertainty of every pixel, in place, what displacement makes of the mean of its frames.

    Args:
        radiance: L, flat.
        u_radiance: Its standard uncertainty, flat; overwritten.
        shift: As of `relative_shift`, flat.
        per_unit: Radiance per rate, of every pixel or of all (size 1).
        mean: What the weights of the frames leave of it.
    """
    _add_shift(radiance, u_radiance, shift, per_unit, mean.lowest, mean.factors, _PER_FOLD)


@compiled
def _add_shift(
    radiance: Any, u_radiance: Any, shift: Any, per_unit: Any, lowest: float, factors: Any, per_fold: float
) -> None:  # pragma: no cover (compiled)
    step = 1 if per_unit.size > 1 else 0
    for i in range(radiance.size):
        if shift[i] <= 0.0 or radiance[i] <= 0.0:
            continue
        place = (np.log(radiance[i] / per_unit[i * step]) - lowest) * per_fold
        level = min(max(int(place + 0.5), 0), factors.size - 1)
        added = shift[i] * factors[level] * radiance[i]
        u_radiance[i] = np.sqrt(u_radiance[i] ** 2 + added * added)


def excess_scatter(
    samples: Sequence[MergeSample],
    tables: MergeTables,
    pixels: NDArray[np.intp],
    rate: Array,
    shift: Array,
    absent: Sequence[NDArray[np.bool_]] = (),
) -> Array:
    """Return how much the frames disagree, as a part of what noise and displacement together make; infinite beyond.

    A ratio of sums of squares: 1 is expected, and what `AGREEMENT_SIGMA` does not reach is a contradiction.

    Args:
        samples: The frames.
        tables: As the last step of the merge uses them, for all frames.
        pixels: Indices of the pixels.
        rate: Merged rate of each.
        shift: As of `relative_shift` at each.
        absent: Where each frame shows nothing, shape (height, width) each; empty where all show everything.
    """
    gone = np.array([one.ravel()[pixels] for one in absent] or np.zeros((len(samples), pixels.size)), dtype=bool)
    x, used, high = signals(samples, pixels, gone)
    exposure, clips_at = tables.frames[:, :1], tables.frames[:, 2:3]
    expected = np.maximum(rate, 0.0) * exposure
    noise, curve = tables.variance(expected)
    variance = noise + (shift * expected) ** 2
    square = np.where(used, (x - expected) ** 2, 0.0).sum(axis=0)
    total, extra = np.where(used, variance, 0.0).sum(axis=0), np.where(used, variance**2, 0.0).sum(axis=0)
    freedom = total**2 / np.maximum(extra, 1e-300)
    slack_rel = float(tables.bounds[2]) ** 2 + (AGREEMENT_SIGMA * curve.max(axis=0)) ** 2
    slack = slack_rel * np.where(used, expected**2, 0.0).sum(axis=0)
    limit = np.array([scatter_limit(max(one, 1e-3)) for one in freedom])
    clipped = high & (clips_at - expected > CONTRADICTION_SIGMA * np.sqrt(variance))
    explained = (square <= total * limit + slack) & ~clipped.any(axis=0)
    return np.where(explained, square / np.maximum(total, 1e-300), np.inf)
