"""What a fixed pattern does that a variance cannot tell: the one pattern that this camera happens to have.

A pattern of known variance still shifts each tile's mean, tilts it, and has by chance a little more or less spread
than expected, in every capture alike. These are fitted beside an accepted fixed-pattern effect, with the prior that
its variance gives, so that they neither pass for another effect nor let one hide.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from radiometer.reconcile.comparison import Comparison
from radiometer.reconcile.design import Array, Design
from radiometer.reconcile.statistics import CaptureStatistics
from radiometer.reconcile.terms import ColumnBuilder, LinearTerm
from radiometer.reconcile.tile_layout import tile_groups
from radiometer.reconcile.tile_model import Prediction
from simulators.effects.catalogue import CatalogueEffect

_EDGES: Final = 5.0  # √(number of edges that average out), few to be safe
_TREND_TERMS: Final = 3  # of a tile's lines: constant, slope and curvature are taken out
_SMALLEST_SHARE: Final = 1e-6
_FIXED_BLOCKS: Final = ("spatial", "columns", "rows")


def realisation_terms(
    effects: Sequence[CatalogueEffect], prediction: Prediction, seen: CaptureStatistics, design: Design
) -> tuple[LinearTerm, ...]:
    """Return the realisation terms of the fixed-pattern effects among the accepted ones."""
    if not design.uniform or not any(effect.block in _FIXED_BLOCKS for effect in effects):
        return ()
    pixels = np.maximum(seen.pixels.max(axis=0), 2.0)
    proportional = any(getattr(effect, "proportional", False) for effect in effects if effect.block in _FIXED_BLOCKS)
    additive = any(not getattr(effect, "proportional", False) for effect in effects if effect.block in _FIXED_BLOCKS)
    terms: list[LinearTerm] = []
    for name, wanted in (("proportional", proportional), ("additive", additive)):
        if wanted:
            terms += _offset_terms(name, prediction, pixels, design)
    terms.append(_spread_term(seen))
    for name in ("columns", "rows"):
        terms.append(_line_spread_term(name, seen))
        if additive and float(np.max(_lines(name, prediction))) > 0:
            terms.append(_tile_line_spread_term(name, seen, design))
    return tuple(terms)


def _offset_terms(name: str, prediction: Prediction, pixels: Array, design: Design) -> list[LinearTerm]:
    unit = _unit(name, prediction)
    rows_e2, columns_e2 = (0.0, 0.0) if name == "proportional" else _line_variances(prediction)
    relative = prediction.fixed / np.maximum(unit**2, 1e-30) - rows_e2 - columns_e2
    # A pattern in proportion to light shows purest in bright captures (but for full wells, which hide it), an
    # additive one in the darkest.
    bright = unit > 0.2 * unit.max(axis=0)
    if name == "proportional":
        white = np.array([np.median(column[mask]) for column, mask in zip(relative.T, bright.T, strict=True)])
    else:
        white = relative[np.argmin(prediction.signal, axis=0), np.arange(unit.shape[1])]
    white = np.maximum(white, 1e-14)
    rows, columns = shared_lines(design)
    height, width = (np.array([getattr(tile, n) for tile in design.tiles]) for n in ("height", "width"))
    lengths = np.empty((2, len(design.tiles)))
    for group in tile_groups(design):
        lengths[:, group.index] = np.array(group.slope_norm)[:, None]
    # The pixels of a row (column) move together, and with them every tile that it crosses.
    mean = np.diag(white / pixels) + rows_e2 * rows / _outer(height) + columns_e2 * columns / _outer(width)
    tilt_x = np.diag(white / lengths[0] ** 2) + columns_e2 * columns * _outer(np.sqrt(height) / lengths[0])
    tilt_y = np.diag(white / lengths[1] ** 2) + rows_e2 * rows * _outer(np.sqrt(width) / lengths[1])
    ones = np.ones(len(design.tiles))
    line = float(np.median(np.sqrt(white / np.sqrt(pixels) + rows_e2 + columns_e2)))
    return [
        LinearTerm(f"{name} pattern mean", _builder("mean", name, _root(mean)), ones),
        LinearTerm(f"{name} pattern tilt x", _builder("slope_x", name, _root(tilt_x)), ones),
        LinearTerm(f"{name} pattern tilt y", _builder("slope_y", name, _root(tilt_y)), ones),
        LinearTerm(f"{name} pattern at edges", _edge_builder(name), np.array([line])),
    ]


def _root(covariance: Array) -> Array:
    """Return a matrix whose product with its transpose is the covariance."""
    return np.asarray(np.linalg.cholesky(covariance), dtype=np.float64)


def _line_variances(prediction: Prediction) -> tuple[float, float]:
    """Return the variances of row and column patterns in e-²."""
    gain2 = prediction.gain**2
    return float(np.median(prediction.fixed_row_variance / gain2)), float(
        np.median(prediction.fixed_column_variance / gain2)
    )


def shared_lines(design: Design) -> tuple[Array, Array]:
    """Return which share of their rows and of their columns two tiles have in common, each (tiles, tiles)."""
    x, y, width, height = (
        np.array([getattr(tile, name) for tile in design.tiles]) for name in ("x", "y", "width", "height")
    )
    rows = np.minimum((y + height)[:, None], y + height) - np.maximum(y[:, None], y)
    columns = np.minimum((x + width)[:, None], x + width) - np.maximum(x[:, None], x)
    return np.maximum(rows, 0) / _outer(height), np.maximum(columns, 0) / _outer(width)


def _outer(length: Array) -> Array:
    """Return √(l_i·l_j), so that a tile shares all of its lines with itself."""
    return np.asarray(np.sqrt(length[:, None] * length[None, :]))


def _unit(name: str, prediction: Prediction) -> Array:
    gain = np.broadcast_to(prediction.gain[:, None], prediction.mean.shape)
    return np.asarray(prediction.signal * gain if name == "proportional" else gain)


def _builder(block: str, name: str, root: Array) -> ColumnBuilder:
    """Return the columns of a pattern whose shifts of the tiles have the covariance root·rootᵀ."""

    def build(comparison: Comparison, prediction: Prediction, sensitivity: Array) -> Array:
        raw = _unit(name, prediction)[:, :, None] * root[None]
        return _placed(comparison, block, comparison.whiten(block, raw))

    return build


def _edge_builder(name: str) -> ColumnBuilder:
    """Return the column of what a fixed pattern in the lines along edges feigns of blur."""

    def build(comparison: Comparison, prediction: Prediction, sensitivity: Array) -> Array:
        step = np.maximum(np.std(prediction.mean, axis=1), 1e-9)
        unit = np.sqrt(np.mean(np.square(_unit(name, prediction)), axis=1))
        return _placed(comparison, "edge", comparison.whiten("edge", (unit / step / _EDGES)[:, None]))

    return build


def _spread_term(seen: CaptureStatistics) -> LinearTerm:
    """Return the term for the chance spread of each tile's own pixels, alone and times that of lines."""
    freedom = np.maximum(np.nanmedian(seen.spatial_dof, axis=0), 2.0)

    def build(comparison: Comparison, prediction: Prediction, sensitivity: Array) -> Array:
        lines = prediction.fixed_row_variance + prediction.fixed_column_variance
        white = np.maximum(prediction.fixed - lines[:, None], 0.0)
        share = np.sqrt(white * (white + 2.0 * lines[:, None])) / np.maximum(prediction.spatial, 1e-30)
        captures, tiles = share.shape
        raw = np.zeros((captures, tiles, tiles))
        raw[:, np.arange(tiles), np.arange(tiles)] = share
        return _placed(comparison, "spatial", comparison.whiten("spatial", raw))

    return LinearTerm("pattern spread", build, np.sqrt(2.0 / freedom))


def _lines(block: str, prediction: Prediction) -> Array:
    """Return the variance of a pattern of columns or rows in DN², (captures,)."""
    return prediction.fixed_column_variance if block == "columns" else prediction.fixed_row_variance


def _tile_line_spread_term(block: str, seen: CaptureStatistics, design: Design) -> LinearTerm:
    """Return the term for the chance spread of the few lines of a pattern that cross each tile, alike in every capture.

    Tiles side by side share it, and the spread of all lines is the mean of the tiles'.
    """
    rows, columns = shared_lines(design)
    number = np.array([tile.height if block == "rows" else tile.width for tile in design.tiles], dtype=np.float64)
    free = np.maximum(number - _TREND_TERMS, 1.0)
    values, vectors = np.linalg.eigh(2.0 * (rows if block == "rows" else columns) / _outer(free))
    kept = values > _SMALLEST_SHARE * values.max()
    root = vectors[:, kept] * np.sqrt(values[kept])
    weight = getattr(seen, f"{block}_weight")

    def build(comparison: Comparison, prediction: Prediction, sensitivity: Array) -> Array:
        lines = _lines(block, prediction)
        share = lines[:, None] / np.maximum(prediction.spatial, 1e-30)
        of_tiles = comparison.whiten("spatial", share[:, :, None] * root)
        of_all = (lines * weight / (1.0 + lines * weight))[:, None] * root.mean(axis=0)
        return _placed(comparison, "spatial", of_tiles) + _placed(comparison, block, comparison.whiten(block, of_all))

    return LinearTerm(f"spread of {block} in tiles", build, np.ones(root.shape[1]))


def _line_spread_term(block: str, seen: CaptureStatistics) -> LinearTerm:
    """Return the term for the chance spread of a white pattern's own row or column means, alike in every capture."""

    def build(comparison: Comparison, prediction: Prediction, sensitivity: Array) -> Array:
        share = (prediction.fixed / np.maximum(prediction.spatial, 1e-30)).mean(axis=1)
        return _placed(comparison, block, comparison.whiten(block, share[:, None]))

    return LinearTerm(f"pattern {block} spread", build, np.array([_chance_spread(block, seen)]))


def _chance_spread(block: str, seen: CaptureStatistics) -> float:
    """Return the relative standard deviation of a variance of so many lines."""
    dof = getattr(seen, f"{block}_dof")
    return float(np.sqrt(2.0 / max(float(np.median(dof[dof > 0])) if (dof > 0).any() else 2.0, 2.0)))


def _placed(comparison: Comparison, block: str, whitened: Array) -> Array:
    columns = np.zeros((comparison.size, whitened.shape[-1]))
    columns[comparison.cuts[block]] = whitened.reshape(-1, whitened.shape[-1])
    return columns
