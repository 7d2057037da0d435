"""Movement in a scene: frames that contradict the others at a pixel are left out there.

Every frame's value at a pixel says what each of the others should show. The value that most frames bear out is taken,
of several the one that is known best, and what does not agree with it is another scene. Frames that clip bear out a
value too, or contradict it. Where two frames contradict each other and no third decides, this is reported.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from radiometer.analysis.merge.sums import MergeSample
from radiometer.analysis.merge.tables import MergeTables
from radiometer.typing import Array

# Frames agree within so many standard deviations of their difference.
_AGREE_SIGMA: Final = 4.0
# A neighbour of so many contradicting pixels (of eight) shows the edge of what moved.
_OF_EIGHT: Final = 4.0
_CHUNK: Final = 100_000


@dataclass(frozen=True, slots=True, eq=False)
class Strays:
    """Which frames to leave out where.

    Attributes:
        pixels: Indices of the pixels concerned, ascending.
        left_out: Bits of the frames to leave out of each, those that show nothing there included, uint64.
        alone: Whether no two frames bear out the value that is left.
    """

    pixels: NDArray[np.intp]
    left_out: NDArray[np.uint64]
    alone: NDArray[np.bool_]


def find_strays(
    samples: Sequence[MergeSample],
    tables: MergeTables,
    doubtful: NDArray[np.bool_],
    absent: Sequence[NDArray[np.bool_]],
    shift: NDArray[np.float32] | None = None,
) -> Strays:
    """Return which frames to leave out at the pixels where frames contradict each other.

    Args:
        samples: The frames.
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
    for start in range(0, doubtful.size, _CHUNK):
        here = start + np.flatnonzero(doubtful.ravel()[start : start + _CHUNK])
        if here.size:
            gone = np.array([np.zeros(here.size, bool) if one is None else one[here] for one in missing])
            moved = np.zeros(here.size) if shift is None else shift[here].astype(np.float64)
            out, few = _contradicting(samples, tables, here, gone, moved)
            alone[here] = few
            for k in range(len(samples)):
                bits[here[out[k]]] |= np.uint64(1 << k)
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
        guess = np.maximum(x[j] / exposure[j], 0.0)
        agree, information = _agreement(tables, guess, x, used, high, shift, of=j)
        votes, total = agree.sum(axis=0), np.where(agree & used, information, 0.0).sum(axis=0)
        better = used[j] & ((votes > best) | ((votes == best) & (total > known)))
        mean = np.where(agree & used, information * x / exposure, 0.0).sum(axis=0) / np.maximum(total, 1e-300)
        best, known = np.where(better, votes, best), np.where(better, total, known)
        rate = np.where(better, np.maximum(mean, 0.0), rate)
    agree, _ = _agreement(tables, rate, x, used, high, shift, of=None)
    expected = rate * exposure
    shows = expected > _AGREE_SIGMA * np.sqrt(tables.variance(expected)[0])
    speaks = (used | high) & ~gone
    out = speaks & ~agree & (best >= 0)
    # Never all: a pixel keeps the frames that it was judged by.
    nothing = ~(used & ~out).any(axis=0)
    out[:, nothing] = False
    return out, (used & agree & shows).sum(axis=0) < 2


def signals(
    samples: Sequence[MergeSample], pixels: NDArray[np.intp], gone: NDArray[np.bool_]
) -> tuple[Array, NDArray[np.bool_], NDArray[np.bool_]]:
    """Return the signal of every frame at some pixels, whether it is one, and whether it clips.

    Args:
        samples: The frames.
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
