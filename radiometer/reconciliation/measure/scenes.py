"""Checks whether frames of one pattern show one scene: a changing scene is no effect of the camera.

Lens, sensor and source change a picture smoothly, along its rows or along its columns. The residual of its logarithm
is the scene's own fine structure, which exposure, gain and response leave in place.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radiometer.statistics.least_squares import residual
from radiometer.typing import Array

_MOST_BLOCKS: Final = 32  # along either side of a frame
_SMALLEST_BLOCK_PX: Final = 4
_SAMPLES: Final = 12  # pixels along a block's side that are looked at, every n-th of large frames
_FEWEST_BLOCKS: Final = 100  # that both frames show, beyond the smooth terms
_FAINTEST: Final = 10.0  # times the noise of a block's mean
_LEAST_CONTRAST: Final = 0.05  # standard deviation of the logarithm: even fields have a hundredth and less
_COMPARED: Final = 3  # latest frames of each scene: exposures far apart share few blocks that show either
_SAME: Final = 0.5  # least correlation of one scene's fine structure; that of different ones scatters about 0


@dataclass(frozen=True, slots=True)
class FineStructure:
    """Fine structure of a frame in blocks of pixels."""

    log_light: Array  # (rows, columns) logarithm of a block's mean above black; NaN where it is clipped or too dark
    noise2: Array  # (rows, columns) bound on its variance by the noise of the pixels

    @classmethod
    def of(cls, dn: NDArray[np.generic], black_dn: float, full_scale_dn: int) -> FineStructure:
        """Return what a frame shows.

        Args:
            dn: (height, width) digital numbers.
            black_dn: Black level; 0 where none is stated.
            full_scale_dn: Highest code: a block that holds it is clipped.
        """
        step = max(1, max(dn.shape) // (_MOST_BLOCKS * _SAMPLES))
        dn = dn[::step, ::step]
        side = max(_SMALLEST_BLOCK_PX, -(-max(dn.shape) // _MOST_BLOCKS))
        rows, columns = dn.shape[0] // side, dn.shape[1] // side
        blocks = dn[: rows * side, : columns * side].reshape(rows, side, columns, side)
        values = blocks.astype(np.float32)
        mean = np.asarray(values.mean(axis=(1, 3), dtype=np.float64))
        apart = values - mean.astype(np.float32)[:, None, :, None]
        scatter2 = np.asarray(np.square(apart).mean(axis=(1, 3), dtype=np.float64))
        light, noise = mean - black_dn, np.sqrt(scatter2) / side
        clear = (light > np.maximum(_FAINTEST * noise, 0.0)) & (blocks.max(axis=(1, 3)) < full_scale_dn)
        light = np.where(clear, light, np.nan)
        return cls(np.log(light), np.square(noise / light))

    def correlation(self, other: FineStructure) -> float | None:
        """Return the correlation of two frames' fine structure; None where either has too little structure."""
        known = np.isfinite(self.log_light) & np.isfinite(other.log_light)
        terms = _smooth_terms(known)
        if known.sum() - terms.shape[1] < _FEWEST_BLOCKS:
            return None
        both = np.column_stack([self.log_light[known], other.log_light[known]])
        rest = residual(terms, both)
        contrast2 = np.mean(np.square(rest), axis=0)
        noise2 = np.array([float(np.mean(noise2[known])) for noise2 in (self.noise2, other.noise2)])
        if (contrast2 < np.maximum(_LEAST_CONTRAST**2, _FAINTEST * noise2)).any():
            return None
        products = rest.T @ rest
        return float(products[0, 1] / np.sqrt(products[0, 0] * products[1, 1]))


def scenes_of(structures: Mapping[int, FineStructure]) -> dict[int, int]:
    """Return the number of the scene, from 0 on, that each frame of one pattern shows.

    A frame with too little structure counts as the scene of the frame before.

    Args:
        structures: Of each frame, by its position in the header.
    """
    found: dict[int, int] = {}
    latest: list[deque[FineStructure]] = []  # of each scene
    scene = 0
    for frame, own in sorted(structures.items()):
        likeness = [[r for other in members if (r := own.correlation(other)) is not None] for members in latest]
        recognised = {number: max(several) for number, several in enumerate(likeness) if several}
        if recognised:
            best = max(recognised, key=lambda number: recognised[number])
            scene = best if recognised[best] >= _SAME else len(latest)
        if scene == len(latest):
            latest.append(deque(maxlen=_COMPARED))
        latest[scene].append(own)
        found[frame] = scene
    return found


def _smooth_terms(known: NDArray[np.bool_]) -> Array:
    """Return what lens, rows and columns may do, (blocks that are known, terms): a quadratic surface and all lines."""
    row, column = np.nonzero(known)
    y, x = (2.0 * at / max(size - 1, 1) - 1.0 for at, size in zip((row, column), known.shape, strict=True))
    surface = np.column_stack([x * y, x * x * y, x * y * y, x * x * y * y])
    return np.hstack([np.eye(known.shape[0])[row], np.eye(known.shape[1])[column], surface])
