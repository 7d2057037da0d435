"""Row noise as few rows and frames show it: their own chance variance moves every statistic that they touch.

A row's noise differs from frame to frame by one number. Over n frames its variance is known to √(2/(n − 1)) only, and
that deviation is the same in all tiles side by side and in all statistics: the pixels' variance, the correlation of
neighbours, the scatter of the rows' means. What is left of it in the mean of all frames does the same to the spatial
variance and to the rows' fixed profile.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np

from radiometer.reconcile.measure.design import Array, Design
from radiometer.reconcile.measure.reduce import CaptureStatistics
from radiometer.reconcile.measure.row_bands import RowBins
from radiometer.reconcile.model.chain_steps import SURFACE_LINES, rough_share
from radiometer.reconcile.model.tile_model import Prediction
from radiometer.reconcile.noise.variance_scores import score_slope

if TYPE_CHECKING:
    from radiometer.reconcile.fit.comparison import Comparison

_LEAST_ROWS: Final = 1.0
_LEAST_RATIO: Final = 1e-6
_LEAST_EXCESS: Final = -0.9  # of a variance ratio, so that it stays positive


@dataclass(frozen=True, eq=False)
class RowScatter:
    """By how much the chance variance of the rows' noise moves the logarithms of the tiles' statistics.

    Attributes:
        moved: By block, (captures, tiles) change per relative change of the rows' variance.
        spread: By block, (captures,) relative variance of what one row shows.
        overlap: By block, (tiles, tiles) covariance of what two tiles see of it, of `spread`.
    """

    moved: Mapping[str, Array]
    spread: Mapping[str, Array]
    overlap: Mapping[str, Array]

    @classmethod
    def of(cls, design: Design, base: Prediction) -> RowScatter:
        """Return the scatter for the row noise that a prediction holds."""
        height, width = (np.array([getattr(tile, n) for tile in design.tiles], np.float64) for n in ("height", "width"))
        frames = np.maximum(design.frame_count, 2.0)
        within, rough = 1.0 - 1.0 / height, rough_share(height, width)
        lines = base.row_variance[:, None]
        share = lines * within / base.variance
        left = lines / design.frame_count[:, None] * rough / base.spatial
        free, bent = (np.sqrt(height / np.maximum(height - taken, _LEAST_ROWS)) for taken in (1, SURFACE_LINES))
        rows = row_overlap(design)
        once = rows * free[:, None] * free
        return cls(
            {"variance": share, "neighbour_x": share * (1.0 - share), "neighbour_y": share, "spatial": left},
            {
                "variance": 2.0 / (frames - 1.0),
                "neighbour_x": 2.0 / (frames - 1.0),
                "neighbour_y": 1.0 / (frames - 1.0),  # products of two rows, not squares of one
                "spatial": np.full(frames.shape, 2.0),
            },
            {"variance": once, "neighbour_x": once, "neighbour_y": once, "spatial": rows * bent[:, None] * bent},
        )

    def covariance(self, block: str) -> Array:
        """Return the covariance of a block's tiles in each capture, (captures, tiles, tiles)."""
        moved = self.moved[block]
        together = self.spread[block][:, None, None] * self.overlap[block]
        return np.asarray(moved[:, :, None] * moved[:, None, :] * together)


def line_excess(design: Design, seen: CaptureStatistics, prediction: Prediction, name: str) -> Array:
    """Return what noise and patterns of lines add to the ratio of a profile of lines, (captures,).

    The ratio is taken over the noise of the pixels, which holds the lines too. Row noise averages down over the frames
    of a capture but stays in their mean.

    Args:
        design: Captures and tiles.
        seen: What was measured.
        prediction: Expected statistics.
        name: row_temporal, rows or columns.
    """
    rows, columns = prediction.row_variance, prediction.fixed_column_variance
    lines = (rows,) if name == "row_temporal" else (rows, columns, prediction.fixed_row_variance)
    if not any(variance.any() for variance in lines):
        return np.zeros(rows.size)
    height, width = (np.array([getattr(tile, n) for tile in design.tiles]) for n in ("height", "width"))
    if name == "row_temporal":
        own, noise = rows, prediction.variance
        held = rows[:, None] * (1.0 - 1.0 / height)
    else:
        fixed_rows = prediction.fixed_row_variance + rows / design.frame_count
        own, noise = (columns if name == "columns" else fixed_rows), prediction.spatial
        held = columns[:, None] * rough_share(width, height) + fixed_rows[:, None] * rough_share(height, width)
    share = np.mean(held / noise**2, axis=1) / np.mean(1.0 / noise, axis=1)
    return np.asarray(np.maximum(own * getattr(seen, f"{name}_weight") - share, _LEAST_EXCESS))


def mixing_of_lines(prediction: Prediction, design: Design, name: str) -> Array:
    """Return by what neighbours that exchange charge raise the ratio of a profile of lines, (captures,).

    Along a line of w pixels that correlate by ρ the variance of the mean is 1 + 2ρ·(1 − 1/w) times that of white
    noise. A fixed profile holds the noise that the mean of the frames leaves.

    Args:
        prediction: Expected statistics.
        design: Captures and tiles.
        name: row_temporal, rows or columns.
    """
    length = np.array([tile.height if name == "columns" else tile.width for tile in design.tiles], np.float64)
    together = prediction.mixed_y if name == "columns" else prediction.mixed_x
    noise, share = prediction.variance, np.ones_like(prediction.variance)
    if name != "row_temporal":
        noise, share = prediction.spatial, prediction.variance / design.frame_count[:, None] / prediction.spatial
    more = 2.0 * together * share * (1.0 - 1.0 / length)
    return np.asarray(np.sum(more / noise, axis=1) / np.sum(1.0 / noise, axis=1))


def mixing_of_bands(prediction: Prediction, design: Design) -> Array:
    """Return by what such neighbours raise the ratios of the bands, (captures, orders).

    Bands of coarse rows gain more than those of fine ones, by 1 + 2ρ·cos(2πν) for ν periods per row.
    """
    bins = RowBins.of(design)
    weight = np.square(np.maximum(prediction.signal, 0.0)) / prediction.variance
    weight = weight / np.maximum(np.sum(weight, axis=1, keepdims=True), 1e-300)
    x, y = (np.sum(weight * mixed, axis=1)[:, None] for mixed in (prediction.mixed_x, prediction.mixed_y))
    turn = np.pi * np.arange(1, bins.orders + 1) / bins.number  # of one order from bin to bin
    inside, beside = 1.0 - 1.0 / bins.step, 1.0 / bins.step
    return np.asarray((1.0 + 2.0 * x) * (1.0 + 2.0 * y * (inside + beside * np.cos(turn))) - 1.0)


def line_weights(design: Design, base: Prediction) -> Array:
    """Return the share of each bin of rows in the rows' profiles, (captures, bins): tiles of little noise count more.

    The shares of a capture sum to 1.
    """
    bins = RowBins.of(design)
    found = np.zeros((len(design.captures), bins.number))
    for number, tile in enumerate(design.tiles):
        held = np.bincount(np.arange(tile.y, tile.y + tile.height) // bins.step, minlength=bins.number)
        found += tile.width * held / base.variance[:, number, None]
    return np.asarray(found / found.sum(axis=1, keepdims=True))


def effective(design: Design, seen: CaptureStatistics, base: Prediction) -> CaptureStatistics:
    """Return the statistics with the degrees of freedom of the rows' profiles that row noise leaves.

    Where it outweighs the pixels' noise, a profile follows its few heaviest rows.
    """
    weights = line_weights(design, base)
    lines = np.maximum(np.sum(weights > 0, axis=1), 1)
    changed = {}
    for name, variance in (("row_temporal", base.row_variance), ("rows", base.row_variance / design.frame_count)):
        more = (variance * getattr(seen, f"{name}_weight"))[:, None] * lines[:, None] * weights
        each = np.where(weights > 0, 1.0 + more, 0.0)
        share = np.sum(each, axis=1) ** 2 / (lines * np.sum(each**2, axis=1))
        changed[f"{name}_dof"] = getattr(seen, f"{name}_dof") * share
    return replace(seen, **changed)


def row_overlap(design: Design) -> Array:
    """Return how much of the row noise two tiles share: 1/height on the diagonal."""
    top = np.array([tile.y for tile in design.tiles])
    height = np.array([tile.height for tile in design.tiles])
    bottom = top + height
    common = np.minimum(bottom[:, None], bottom) - np.maximum(top[:, None], top)
    return np.asarray(np.maximum(common, 0) / (height[:, None] * height))


def shared_columns(comparison: Comparison, base: Prediction) -> tuple[dict[str, Array], ...]:
    """Return what the rows' chance variance does to all statistics at once, whitened, in families that are independent.

    Each family holds by block (captures, entries…, bins of rows) columns: changes per standard deviation of the
    variance that a bin of rows happens to show, first of what differs from frame to frame, then of what is left in the
    mean of the frames.

    Args:
        comparison: Measured statistics with their weights.
        base: The prediction, row noise included.
    """
    design, seen = comparison.design, comparison.seen
    if not base.row_variance.any():
        return ()
    scatter = RowScatter.of(design, base)
    bins = RowBins.of(design)
    of_tiles = np.zeros((len(design.tiles), bins.number))
    for number, tile in enumerate(design.tiles):
        np.add.at(of_tiles[number], np.arange(tile.y, tile.y + tile.height) // bins.step, 1.0 / tile.height)
    of_all = line_weights(design, base)
    height = np.array([tile.height for tile in design.tiles], dtype=np.float64)
    families = []
    for tiled, lined, taken, spread in (
        (("variance", "neighbour_x"), "row_temporal", 1, scatter.spread["variance"]),
        (("spatial",), "rows", SURFACE_LINES, scatter.spread["spatial"]),
    ):
        share = design.frame_count if lined == "rows" else 1.0
        more = base.row_variance / share * getattr(seen, f"{lined}_weight")
        # A row's noise times that of its pixels is shared too.
        crossed = 1.0 + 2.0 / np.maximum(more, _LEAST_RATIO)
        own = np.sqrt(spread * crossed / bins.step)[:, None, None]
        free = np.sqrt(height / np.maximum(height - taken, _LEAST_ROWS))
        columns = {
            name: comparison.whiten(name, scatter.moved[name][:, :, None] * (free[:, None] * of_tiles) * own)
            for name in tiled
        }
        whole = 1.0 + more + (base.fixed_row_variance * seen.rows_weight if lined == "rows" else 0.0)
        raw = (more / whole)[:, None] * of_all * float(np.median(free)) * own[:, 0]
        columns[lined] = comparison.whiten(lined, raw)
        if lined == "row_temporal":
            moved = base.row_variance[:, None] * seen.bands_of_rows
            moved = moved / (1.0 + moved) * score_slope(comparison.band_freedom)
            columns["bands"] = comparison.whiten("bands", moved[:, :, None] * of_all[:, None] * own)
        families.append(columns)
    return tuple(families)
