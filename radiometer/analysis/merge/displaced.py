"""Movement and displacement in a scene: contradicting frames are left out, shifts of parts of a pixel widen u.

Every frame's value at a pixel says what each of the others should show. The value that most frames bear out is taken,
of several the one that is known best, and what does not agree with it is another scene. Frames that clip bear out a
value too, or contradict it. Where two frames contradict each other and no third decides, this is reported.

A displacement of one frame by δ pixels along any direction changes its value at a pixel by δ·L·|∇ln L|. The map holds
the mean of its frames, each with its weight p, so that u gets δ·L·|∇ln L|·√Σp² where the displacements are independent.
Frames that disagree by at most their noise and this together do not contradict each other.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from radiometer.analysis.merge.finish import (
    AGREEMENT_SIGMA,
    CONTRADICTION_SIGMA,
    PER_FOLD,
    AtLevels,
    MergeTables,
    scatter_limit,
)
from radiometer.analysis.merge.sums import MergeSample
from radiometer.compiled import compiled
from radiometer.typing import Array

# Frames agree within so many standard deviations of their difference.
_AGREE_SIGMA: Final = 4.0
# A neighbour of so many contradicting pixels (of eight) shows the edge of what moved.
_OF_EIGHT: Final = 4.0
_CHUNK: Final = 1 << 13  # pixels of which 18 frames' values stay in the caches


@dataclass(frozen=True, slots=True, eq=False)
class Strays:
    """Which frames to leave out where."""

    pixels: NDArray[np.intp]  # indices of the pixels concerned, ascending
    # Bits of the frames to leave out of each, those that show nothing there included, uint64
    left_out: NDArray[np.uint64]
    alone: NDArray[np.bool_]  # whether no two frames bear out the value that is left


def find_strays(
    samples: Sequence[MergeSample],
    tables: MergeTables,
    doubtful: NDArray[np.bool_],
    absent: Sequence[NDArray[np.bool_]],
    shift: NDArray[np.float32] | None = None,
) -> Strays:
    """Return which frames to leave out at the pixels where frames contradict each other.

    Args:
        tables: As the last step of the merge uses them, for all frames.
        doubtful: Where frames disagree beyond their noise, shape (height, width).
        absent: Where each frame shows nothing, same shape; empty where all show everything.
        shift: By how much a displacement by one standard deviation changes a frame's value, relative, flat; None
            where the frames are in one place.
    """
    shape = doubtful.shape
    bits = np.zeros(doubtful.size, np.uint64)
    alone = np.zeros(doubtful.size, bool)
    missing = [None] * len(samples) if not absent else [one.ravel() for one in absent]

    def judge(here: NDArray[np.intp]) -> None:
        gone = np.array([np.zeros(here.size, bool) if one is None else one[here] for one in missing])
        moved = np.zeros(here.size) if shift is None else shift[here].astype(np.float64)
        out, few = _contradicting(samples, tables, here, gone, moved)
        alone[here] = few
        for k in range(len(samples)):
            bits[here[out[k]]] |= np.uint64(1 << k)

    concerned = np.flatnonzero(doubtful)
    with ThreadPoolExecutor(max_workers=os.cpu_count()) as pool:
        list(pool.map(judge, np.array_split(concerned, max(1, -(-concerned.size // _CHUNK)))))
    # The edge of what moved is only partly covered and hardly stands out: it is treated like its neighbours.
    kernel = np.ones((3, 3), np.float32)
    for k in range(len(samples)):
        bit = np.uint64(1 << k)
        core = (bits & bit > 0).reshape(shape)
        if core.any():
            many = cv2.filter2D(core.astype(np.float32), -1, kernel, borderType=cv2.BORDER_CONSTANT) >= _OF_EIGHT
            bits[(many & ~core).ravel()] |= bit
    pixels = np.flatnonzero(bits)
    for k, gone_k in enumerate(missing):
        if gone_k is not None:
            bits[pixels[gone_k[pixels]]] |= np.uint64(1 << k)
    return Strays(pixels, bits[pixels], alone[pixels])


def _contradicting(
    samples: Sequence[MergeSample],
    tables: MergeTables,
    pixels: NDArray[np.intp],
    gone: NDArray[np.bool_],
    shift: Array,
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return which frames contradict the best value of every pixel, (frames, pixels), and whether that stands alone."""
    x, used, high = signals(samples, pixels, gone)
    exposure = tables.frames[:, :1]
    best = np.full(pixels.size, -1.0)
    known = np.zeros(pixels.size)
    rate = np.zeros(pixels.size)
    for j in (int(k) for k in np.flatnonzero(used.any(axis=1))):
        own = np.flatnonzero(used[j])  # only where the frame shows something does it state a value
        of_j = x[:, own], used[:, own]
        guess = np.maximum(x[j, own] / exposure[j], 0.0)
        agree, information = _agreement(tables, guess, *of_j, high[:, own], shift[own], of=j)
        counted = np.where(agree & of_j[1], information, 0.0)
        votes, total = agree.sum(axis=0), counted.sum(axis=0)
        better = (votes > best[own]) | ((votes == best[own]) & (total > known[own]))
        mean = (counted * of_j[0] / exposure).sum(axis=0) / np.maximum(total, 1e-300)
        chosen = own[better]
        best[chosen], known[chosen] = votes[better], total[better]
        rate[chosen] = np.maximum(mean[better], 0.0)
    agree, _ = _agreement(tables, rate, x, used, high, shift, of=None)
    expected = rate * exposure
    shows = expected > _AGREE_SIGMA * np.sqrt(tables.variance(expected)[0])
    informative = (used | high) & ~gone
    out = informative & ~agree & (best >= 0)
    # Never all: a pixel keeps the frames that it was judged by.
    nothing = ~(used & ~out).any(axis=0)
    out[:, nothing] = False
    return out, (used & agree & shows).sum(axis=0) < 2


def signals(
    samples: Sequence[MergeSample], pixels: NDArray[np.intp], gone: NDArray[np.bool_]
) -> tuple[Array, NDArray[np.bool_], NDArray[np.bool_]]:
    """Return the signal of every frame at some pixels, whether it is one, and whether it clips.

    Args:
        pixels: Indices of the pixels.
        gone: Which frames show nothing there, shape (frames, pixels).
    """
    x = np.zeros((len(samples), pixels.size))
    used, high = np.zeros(x.shape, bool), np.zeros(x.shape, bool)
    for k, one in enumerate(samples):
        dn = one.dn[pixels]
        low, top = one.limits
        used[k], high[k] = (dn >= low) & (dn < top) & ~gone[k], (dn >= top) & ~gone[k]
        x[k] = one.signal_at(pixels)
    return np.where(used, x, 0.0), used, high


def _agreement(
    tables: MergeTables,
    rate: Array,
    x: Array,
    used: NDArray[np.bool_],
    high: NDArray[np.bool_],
    shift: Array,
    of: int | None,
) -> tuple[NDArray[np.bool_], Array]:
    """Return which frames agree with a rate per pixel (frame `of` by itself says it), and their information on it."""
    exposure, clips_at, sigma_clip = (tables.frames[:, k][:, None] for k in (0, 2, 3))
    expected = rate * exposure
    variance, curve = tables.variance(expected)
    own = (shift * expected) ** 2
    if of is not None:
        own = 2.0 * own + (exposure / exposure[of]) ** 2 * variance[of]
    slack = (float(tables.bounds[2]) + _AGREE_SIGMA * curve) * expected
    gap = np.abs(x - expected)
    agree = used & (gap <= _AGREE_SIGMA * np.sqrt(variance + own) + slack)
    short = clips_at - expected <= _AGREE_SIGMA * np.sqrt(sigma_clip**2 + own) + slack
    return agree | (high & short), exposure**2 / variance


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
    levels: AtLevels,
) -> None:
    """Add to the uncertainty of every pixel, in place, what displacement makes of the mean of its frames.

    Args:
        radiance: L, flat.
        u_radiance: Its standard uncertainty, flat; overwritten.
        shift: As of `relative_shift`, flat.
        per_unit: Radiance per rate, of every pixel or of all (size 1).
        levels: Weights of the frames.
    """
    _add_shift(radiance, u_radiance, shift, per_unit, levels.lowest, levels.root_sum_square)


@compiled
def _add_shift(
    radiance: Any, u_radiance: Any, shift: Any, per_unit: Any, lowest: float, factors: Any
) -> None:  # pragma: no cover (compiled)
    step = 1 if per_unit.size > 1 else 0
    for i in range(radiance.size):
        if shift[i] <= 0.0 or radiance[i] <= 0.0:
            continue
        place = (np.log(radiance[i] / per_unit[i * step]) - lowest) * PER_FOLD
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
