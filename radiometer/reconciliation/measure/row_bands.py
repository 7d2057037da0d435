"""Light that moves from row to row within a frame: which spatial frequencies of the rows hold it.

Of each frame a = (light of a row − its mean over the frames) / light is taken, tiles weighted by their information.
It is projected on smooth functions of the row: cosines of rising order, orthonormal under the weights, the constant
first. Without bands each coefficient is white noise of variance 1. A wave of ν periods per row at a random phase adds
A²/2·|z|² to the variance of one whose projection of exp(2πi·ν·y) is z.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radiometer.reconciliation.measure.design import Design, TileGroup
from radiometer.typing import Array, Mask

_MOST_BINS: Final = 240  # rows of a large frame are gathered to so many
_MOST_ORDERS: Final = 96
_ROWS_PER_ORDER: Final = 3.0
_INDEPENDENT: Final = 0.05  # share of a function that the lower ones must leave of it


@dataclass(frozen=True, slots=True, eq=False)
class RowBins:
    """The rows that tiles cover, gathered to a few hundred at most."""

    step: int  # rows in each
    number: int  # number of bins over the whole frame
    orders: int  # number of smooth functions, the constant left out

    @classmethod
    def of(cls, design: Design) -> RowBins:
        """Return the bins of a design's rows."""
        height = design.shape[0]
        step = -(-height // _MOST_BINS)
        spans = {(tile.y // step, (tile.y + tile.height - 1) // step) for tile in design.tiles}
        covered = {number for first, last in spans for number in range(first, last + 1)}
        return cls(step, -(-height // step), int(np.clip(len(covered) / _ROWS_PER_ORDER, 1, _MOST_ORDERS)))

    @property
    def middle(self) -> Array:
        """Return the middle row of each bin."""
        return np.asarray((np.arange(self.number) + 0.5) * self.step - 0.5, dtype=np.float64)


def row_light(
    bins: RowBins,
    groups: Sequence[TileGroup],
    row_sums: Sequence[Sequence[Array]],
    known: Sequence[Mask],
    means: Array,
    variance: Array,
    black_dn: float,
    *,
    structured: bool,
) -> dict[str, Array | float]:
    """Return the statistics `bands…` and `row_temporal_light` of one capture; NaN where it has no light to show them.

    The first frame of three or more is left out: it may differ for another reason.

    Args:
        bins: Bins of rows.
        groups: Groups of tiles.
        row_sums: Per group and frame, the sums of deviations from the tile's mean along each row, (tiles, height).
        known: Per group, the pixels that the sums hold, (tiles, height, width).
        means: (frames, tiles) mean of each tile in DN.
        variance: (tiles,) temporal variance of a pixel in DN², NaN where a tile does not count.
        black_dn: Black level in DN; NaN where unknown.
        structured: Whether the tiles show a scene, of which each row has its own light.
    """
    black = black_dn if np.isfinite(black_dn) else float(np.min(means.mean(axis=0)))
    later = slice(1 if means.shape[0] > 2 else 0, None)
    frames = means[later].shape[0]
    moved, weight = np.zeros((frames, bins.number)), np.zeros(bins.number)
    pulled, light_of_rows, inverse = (np.zeros(bins.number) for _ in range(3))
    if frames > 1:
        usable = np.nan_to_num(variance) > 0
        usable &= means.mean(axis=0) > black
        for group, sums, good in zip(groups, row_sums, known, strict=True):
            chosen = usable[group.index]
            if not chosen.any():
                continue
            pixels = good.sum(axis=2)[chosen]
            every = np.array(sums)[:, chosen] + means[:, group.index[chosen], None] * pixels
            white = _white(np.array(sums)[:, chosen], pixels, variance[group.index[chosen]], group.width)
            share = np.where(pixels > 0, 1.0 / white[:, None], 0.0)
            light = every.mean(axis=0) / np.maximum(pixels, 1) - black
            light = light if structured else np.broadcast_to(light.mean(axis=1, keepdims=True), light.shape)
            where = (group.rows[chosen] // bins.step).ravel()
            change = every[later] - every[later].mean(axis=0)
            for frame in range(frames):
                np.add.at(moved[frame], where, (change[frame] * light * share).ravel())
            np.add.at(weight, where, (pixels * light**2 * share).ravel())
            np.add.at(pulled, where, (pixels * light * share).ravel())
            of_all = np.broadcast_to(
                1.0 / variance[group.index[chosen], None], pixels.shape
            )  # as the rows' profile has it
            np.add.at(light_of_rows, where, (pixels * light * of_all).ravel())
            np.add.at(inverse, where, (pixels * of_all).ravel())
    lines = inverse > 0
    light_dn2 = float(np.mean(light_of_rows[lines] ** 2 / inverse[lines])) / bins.step if lines.any() else 0.0
    return _projected(bins, moved, weight, pulled) | {"row_temporal_light": light_dn2}


def _white(sums: Array, pixels: NDArray[np.intp], variance: Array, width: int) -> Array:
    """Return the temporal variance of a pixel within its row in DN², (tiles,)."""
    frames, held = sums.shape[0], pixels.sum(axis=1)
    if frames < 2 or width < 3:
        return variance
    shared = np.sum((sums - sums.mean(axis=0)) ** 2 / np.maximum(pixels, 1), axis=(0, 2)) / (frames - 1)
    own = (variance * (held - 1.0) - shared) / np.maximum(held - pixels.shape[1], 1)
    return np.asarray(np.where(own > 0, own, variance))


def _projected(bins: RowBins, moved: Array, weight: Array, pulled: Array) -> dict[str, Array | float]:
    ratio, of_rows = np.full(bins.orders, np.nan), np.zeros(bins.orders)
    basis = np.zeros((bins.orders + 1, bins.number))
    seen = np.flatnonzero(weight > 0)
    frames = moved.shape[0]
    if seen.size > 2 and frames > 1:
        root = np.sqrt(weight[seen])
        turns = np.outer((seen + 0.5) / bins.number, np.arange(bins.orders + 1))
        columns = root[:, None] * np.cos(np.pi * turns)
        columns = columns[:, : min(bins.orders + 1, seen.size)]
        directions, upper = np.linalg.qr(columns)
        own = np.abs(np.diag(upper)) > _INDEPENDENT * np.linalg.norm(columns, axis=0)
        basis[: own.size, seen] = np.where(own[:, None], (directions * np.sign(np.diag(upper))).T * root, 0.0)
        coefficients = moved[:, seen] @ (basis[:, seen] / weight[seen]).T
        power = np.sum(coefficients**2, axis=0) / (frames - 1)
        ratio = np.where(basis.any(axis=1), power, np.nan)[1:]
        of_rows = np.sum((basis[1:, seen] * pulled[seen] / weight[seen]) ** 2, axis=1)
    return {"bands": ratio, "bands_basis": basis, "bands_of_rows": of_rows}


def wave_power(bins: RowBins, basis: Array, frequency: float) -> tuple[Array, Array]:
    """Return what a wave along the rows adds to the statistics, per unit of its relative variance.

    Args:
        bins: Bins of rows.
        basis: (captures, 1 + orders, bins) functions of the rows, the constant first.
        frequency: Periods per row.

    Returns:
        (captures, orders) added to the ratios of the bands, and (captures,) share of the wave that the whole frame
        has in common.
    """
    wave = np.exp(2j * np.pi * frequency * bins.middle) * np.sinc(frequency * bins.step)
    power = np.square(basis @ wave.real) + np.square(basis @ wave.imag)
    whole = np.square(basis[:, 0].sum(axis=1))
    return power[:, 1:], np.divide(power[:, 0], whole, out=np.ones_like(whole), where=whole > 0)


@dataclass(frozen=True, slots=True, eq=False)
class TileBands:
    """Trace of a wave along the rows in each tile, (tiles,), amplitudes or shares of the wave's variance."""

    mean: Array  # amplitude of the tile's mean
    rise: Array  # amplitude of its rise from the centre to the bottom edge
    within: Array  # variance from row to row about the mean
    rough: Array  # the same about a quadratic
    lag: Array  # covariance of neighbouring rows about the mean
    even: Array  # part of `within` that is even about the tile's middle
    middle: Array  # middle row
    frequency: float  # periods per row

    @classmethod
    def of(cls, design: Design, frequency: float) -> TileBands:
        """Return the shares of a design's tiles."""
        if not frequency:  # all rows go together
            one, nothing = np.ones(len(design.tiles)), np.zeros(len(design.tiles))
            return cls(one, nothing, nothing, nothing, nothing, nothing, nothing, 0.0)
        heights = np.array([tile.height for tile in design.tiles])
        figures = {int(height): _of_height(int(height), frequency) for height in np.unique(heights)}
        mean, rise, within, rough, lag, even = np.array([figures[int(height)] for height in heights]).T
        middle = np.array([tile.y + (tile.height - 1) / 2 for tile in design.tiles])
        return cls(mean, rise, within, rough, lag, even, middle, frequency)

    def quadratures(self, amplitude: Array) -> Array:
        """Return such amplitudes of the tiles for the two phases of a wave, (tiles, 2)."""
        turns = 2.0 * np.pi * self.frequency * self.middle
        return np.asarray(amplitude[:, None] * np.column_stack([np.cos(turns), np.sin(turns)]))

    def unsteadiness(self, frames: Array) -> Array:
        """Return the relative standard deviation of `within` over the phases of a few frames, (captures, tiles).

        A tile shows E·cos²θ + O·sin²θ of a wave of phase θ; over n frames, their mean taken out, cos² scatters by
        Var = ¼·(2/(n − 1) − 3/(2n)) and Cov(cos², sin²) = −1/(8n).
        """
        n = np.maximum(frames, 2.0)[:, None]
        odd = self.within - self.even
        spread = (self.even**2 + odd**2) * (2.0 / (n - 1.0) - 1.5 / n) - self.even * odd / n
        return np.asarray(np.sqrt(np.maximum(spread, 0.0)) / np.maximum(self.within, 1e-12))


def _of_height(height: int, frequency: float) -> tuple[float, ...]:
    y = np.arange(height) - (height - 1) / 2
    even, odd = np.cos(2 * np.pi * frequency * y), np.sin(2 * np.pi * frequency * y)
    u = y / (height / 2)
    mean, rise = float(even.mean()), float(odd @ u / max(float(u @ u), 1e-12))
    even = even - mean
    curved = u**2 - np.mean(u**2)
    bent = even - curved * float(even @ curved / max(float(curved @ curved), 1e-12))
    rough = float(np.mean(bent**2) + np.mean((odd - rise * u) ** 2))
    lag = float(np.mean(even[1:] * even[:-1] + odd[1:] * odd[:-1])) if height > 1 else 0.0
    within_even, within_odd = float(np.mean(even**2)), float(np.mean(odd**2))
    return mean, rise, within_even + within_odd, rough, lag, within_even
