"""What a fixed pattern does that a variance cannot tell: the one pattern that this camera happens to have.

A pattern of known variance still shifts each tile's mean, tilts it, and has by chance a little more or less spread
than expected, in every capture alike. These are fitted beside an accepted fixed-pattern effect, with the prior that
its variance gives, so that they neither pass for another effect nor let one hide.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radiometer.reconcile.fit.comparison import Comparison
from radiometer.reconcile.fit.terms import ColumnBuilder, LinearTerm
from radiometer.reconcile.measure.design import Array, Design
from radiometer.reconcile.measure.edges import SHARPEST
from radiometer.reconcile.measure.layout import tile_groups
from radiometer.reconcile.measure.reduce import CaptureStatistics
from radiometer.reconcile.model.tile_model import Prediction
from simulators.effects.catalogue import CatalogueEffect
from simulators.effects.context import ExposureContext

_EDGES: Final = 5.0  # √(number of edges that average out), few to be safe
_LEAST_STEP: Final = 0.1  # of the brightest light, where all patches are alike
_TREND_TERMS: Final = 3  # of a tile's lines: constant, slope and curvature are taken out
_SMALLEST_SHARE: Final = 1e-6
_FIXED_BLOCKS: Final = ("spatial", "columns", "rows")

Unit = Callable[[Prediction], Array]


def realisation_terms(
    effects: Sequence[CatalogueEffect],
    prediction: Prediction,
    seen: CaptureStatistics,
    design: Design,
    context: ExposureContext,
) -> tuple[LinearTerm, ...]:
    """Return the realisation terms of the fixed-pattern effects among the accepted ones.

    Args:
        effects: The accepted effects.
        prediction: Expected statistics with them.
        seen: What was measured.
        design: Captures and tiles.
        context: The captures as the effects see them.
    """
    patterns = [effect for effect in effects if effect.block in _FIXED_BLOCKS]
    limited = bool(prediction.limit_variance.any())
    if not patterns and not limited:
        return ()
    pixels = np.maximum(seen.pixels.max(axis=0), 2.0)
    own = [(effect, effect.pattern_e(context)) for effect in patterns]
    plain = [effect for effect, electrons in own if electrons is None]
    additive = any(not effect.proportional for effect in plain)
    terms: list[LinearTerm] = []
    others = np.zeros_like(prediction.fixed)
    for effect, electrons in own:
        if electrons is not None:
            unit = _unit_of_electrons(np.broadcast_to(electrons, (*prediction.mean.shape, 1))[:, :, 0])
            others = others + unit(prediction) ** 2
            terms += _offset_terms(effect.name, unit, np.ones(len(design.tiles)), (0.0, 0.0), pixels, design)
    if limited:
        others = others + prediction.limit_variance
        terms += _offset_terms("uneven limit", _unit_of_limit, np.ones(len(design.tiles)), (0.0, 0.0), pixels, design)
    fixed = prediction.fixed - others
    if any(effect.proportional for effect in plain):
        # Purest in bright captures, but for full wells, which hide it.
        light = _unit_of_light(prediction)
        bright, relative = light > 0.2 * light.max(axis=0), fixed / np.maximum(light**2, 1e-30)
        white = np.array([np.median(column[mask]) for column, mask in zip(relative.T, bright.T, strict=True)])
        terms += _offset_terms("proportional pattern", _unit_of_light, white, (0.0, 0.0), pixels, design)
    if additive:
        lines = _line_variances(prediction)
        relative = fixed / np.maximum(_unit_of_gain(prediction) ** 2, 1e-30) - sum(lines)
        white = relative[np.argmin(prediction.signal, axis=0), np.arange(pixels.size)]  # purest in the darkest
        terms += _offset_terms("additive pattern", _unit_of_gain, white, lines, pixels, design)
    terms.append(_spread_term(seen, max((effect.excess_kurtosis() for effect in patterns), default=0.0)))
    for name in ("columns", "rows"):
        terms.append(_line_spread_term(name, seen))
        if additive and float(np.max(_lines(name, prediction))) > 0:
            terms.append(_tile_line_spread_term(name, seen, design))
    return tuple(terms)


def edge_terms(usable: NDArray[np.bool_]) -> tuple[LinearTerm, ...]:
    """Return the term for what all borders share, whatever the blur: none is quite straight, and the source's least so.

    Args:
        usable: (captures,) whether a capture's borders tell anything.
    """

    def build(comparison: Comparison, prediction: Prediction, sensitivity: Array) -> Array:
        return _placed(comparison, "edge", comparison.whiten("edge", np.ones((len(comparison.design.captures), 1))))

    return (LinearTerm("borders", build, np.array([SHARPEST])),) if usable.any() else ()


def _offset_terms(
    name: str, unit: Unit, white: Array, lines: tuple[float, float], pixels: Array, design: Design
) -> list[LinearTerm]:
    """Return the terms for what a pattern does to means, slopes and edges.

    Args:
        name: What the pattern is called.
        unit: Gives (captures, tiles) DN per unit of the pattern for a prediction.
        white: (tiles,) variance from pixel to pixel in squared units.
        lines: Variance of rows and of columns in squared units.
        pixels: (tiles,) pixels that count.
        design: Captures and tiles.
    """
    (rows_e2, columns_e2), white = lines, np.maximum(white, 1e-14)
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
        LinearTerm(f"{name}: mean", _builder("mean", unit, _root(mean)), ones),
        LinearTerm(f"{name}: tilt x", _builder("slope_x", unit, _root(tilt_x)), ones),
        LinearTerm(f"{name}: tilt y", _builder("slope_y", unit, _root(tilt_y)), ones),
        LinearTerm(f"{name}: edges", _edge_builder(unit), np.array([line])),
    ]


def _root(covariance: Array) -> Array:
    """Return a matrix whose product with its transpose is the covariance.

    Tiles of a grid share all their lines: where there is hardly a pattern beside that of lines, they move as one.
    """
    try:
        return np.asarray(np.linalg.cholesky(covariance), dtype=np.float64)
    except np.linalg.LinAlgError:
        values, vectors = np.linalg.eigh(covariance)
        return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)), dtype=np.float64)


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


def _unit_of_gain(prediction: Prediction) -> Array:
    return np.asarray(np.broadcast_to(prediction.gain[:, None], prediction.mean.shape))


def _unit_of_light(prediction: Prediction) -> Array:
    return prediction.signal * prediction.gain[:, None]


def _unit_of_limit(prediction: Prediction) -> Array:
    return np.asarray(np.sqrt(prediction.limit_variance))


def _unit_of_electrons(electrons: Array) -> Unit:
    return lambda prediction: electrons * prediction.gain[:, None]


def _builder(block: str, unit: Unit, root: Array) -> ColumnBuilder:
    """Return the columns of a pattern whose shifts of the tiles have the covariance root·rootᵀ."""

    def build(comparison: Comparison, prediction: Prediction, sensitivity: Array) -> Array:
        raw = unit(prediction)[:, :, None] * root[None]
        return _placed(comparison, block, comparison.whiten(block, raw))

    return build


def _edge_builder(unit: Unit) -> ColumnBuilder:
    """Return the column of what a fixed pattern in the lines along edges feigns of blur."""

    def build(comparison: Comparison, prediction: Prediction, sensitivity: Array) -> Array:
        light = np.max(_unit_of_light(prediction), axis=1)
        step = np.maximum(np.maximum(np.std(prediction.mean, axis=1), _LEAST_STEP * light), 1e-9)
        size = np.sqrt(np.mean(np.square(unit(prediction)), axis=1))
        return _placed(comparison, "edge", comparison.whiten("edge", (size / step / _EDGES)[:, None]))

    return build


def _spread_term(seen: CaptureStatistics, excess_kurtosis: float) -> LinearTerm:
    """Return the term for the chance spread of each tile's own pixels, alone and times that of lines.

    A variance of n values scatters by √((2 + κ)/n), κ their excess kurtosis.
    """
    freedom = np.maximum(np.nanmedian(seen.spatial_dof, axis=0), 2.0)

    def build(comparison: Comparison, prediction: Prediction, sensitivity: Array) -> Array:
        lines = prediction.fixed_row_variance + prediction.fixed_column_variance
        white = np.maximum(prediction.fixed - lines[:, None], 0.0)
        share = np.sqrt(white * (white + 2.0 * lines[:, None])) / np.maximum(prediction.spatial, 1e-30)
        captures, tiles = share.shape
        raw = np.zeros((captures, tiles, tiles))
        raw[:, np.arange(tiles), np.arange(tiles)] = share
        return _placed(comparison, "spatial", comparison.whiten("spatial", raw))

    return LinearTerm("pattern spread", build, np.sqrt((2.0 + excess_kurtosis) / freedom))


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
