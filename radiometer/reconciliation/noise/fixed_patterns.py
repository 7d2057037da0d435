"""Fits the fixed pattern that a camera happens to have, which a variance cannot describe.

A pattern of known variance still shifts each tile's mean, tilts it, and has by chance a little more or less spread
than expected, in every capture alike. These are fitted with an accepted fixed-pattern effect, with the prior that
its variance gives, so that they neither pass for another effect nor let one hide.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radiometer.reconciliation.measure.design import Design, slope_lengths
from radiometer.reconciliation.measure.edges import SHARPEST
from radiometer.reconciliation.measure.seen import CaptureStatistics
from radiometer.reconciliation.noise.shared_errors import Part
from radiometer.reconciliation.statistics import Prediction
from radiometer.typing import Array
from simulators.effects.catalogue import CatalogueEffect
from simulators.effects.context import ExposureContext

_EDGES: Final = 5.0  # √(number of edges that average out), few to be safe
_LEAST_STEP: Final = 0.1  # of the brightest light, where all patches are alike
_TREND_TERMS: Final = 3  # of a tile's lines: constant, slope and curvature are taken out
_SMALLEST_SHARE: Final = 1e-6
_FIXED: Final = ("spatial", "columns", "rows")


@dataclass(frozen=True, slots=True, eq=False)
class FixedError:
    """One source of error whose z are the same in all captures: y = f(θ) + B·z, fitted with its variance as prior."""

    name: str  # what it is
    # Gives what a unit of each z does, by statistic, for a prediction
    parts: Callable[[Prediction], Mapping[str, Part]]
    sigma: Array  # (n,) standard deviation of each z


Unit = Callable[[Prediction], Array]


def fixed_errors(
    effects: Sequence[CatalogueEffect],
    prediction: Prediction,
    seen: CaptureStatistics,
    design: Design,
    context: ExposureContext,
) -> tuple[FixedError, ...]:
    """Return what the fixed patterns of the accepted effects do."""
    patterns = [effect for effect in effects if effect.block in _FIXED]
    limited = bool(prediction.limit_variance.any())
    if not patterns and not limited:
        return ()
    pixels = np.maximum(seen.pixels.max(axis=0), 2.0)
    own = [(effect, effect.pattern_e(context)) for effect in patterns]
    plain = [effect for effect, electrons in own if electrons is None]
    additive = any(not effect.proportional for effect in plain)
    terms: list[FixedError] = []
    others = prediction.renewed_variance
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
        columns = zip(relative.T, bright.T, strict=True)
        white = np.array([np.median(column[mask]) if mask.any() else 0.0 for column, mask in columns])  # darks alone
        terms += _offset_terms("proportional pattern", _unit_of_light, white, (0.0, 0.0), pixels, design)
    if additive:
        lines = _line_variances(prediction)
        relative = fixed / np.maximum(_unit_of_gain(prediction) ** 2, 1e-30) - sum(lines)
        white = relative[np.argmin(prediction.signal, axis=0), np.arange(pixels.size)]  # purest in the darkest
        terms += _offset_terms("additive pattern", _unit_of_gain, white, lines, pixels, design)
    terms.append(_spread_of_pixels(seen, max((effect.excess_kurtosis() for effect in patterns), default=0.0)))
    for name in ("columns", "rows"):
        terms.append(_spread_of_lines(name, seen))
        if additive and float(np.max(_lines(name, prediction))) > 0:
            terms.append(_spread_of_lines_in_tiles(name, seen, design))
    return tuple(terms)


def renewed_patterns(design: Design, seen: CaptureStatistics, prediction: Prediction) -> dict[str, Array]:
    """Return how far a pattern that each setting has for itself scatters means, slopes and its spread, by statistic.

    The m captures of one setting have the same pattern: each counts as if it were √m times as uncertain, so that
    together they weigh as much as one of them.
    """
    pattern2 = prediction.renewed_variance
    if not pattern2.any():
        return {}
    alike = np.bincount(design.setting_id)[design.setting_id][:, None]
    sigma = np.sqrt(alike * pattern2)
    share = pattern2 / np.maximum(prediction.spatial, 1e-30)
    lengths = slope_lengths(design)
    return {
        "mean": sigma / np.sqrt(np.maximum(seen.pixels, 1.0)),
        "slope_x": sigma / lengths[0],
        "slope_y": sigma / lengths[1],
        "spatial": share * np.sqrt(2.0 * (alike - 1.0) / np.maximum(seen.spatial_dof, 1.0)),
    }


def error_of_borders(usable: NDArray[np.bool_]) -> tuple[FixedError, ...]:
    """Return what all borders share, whatever the blur: none is quite straight, and the source's least so.

    Args:
        usable: (captures,) whether a capture's borders carry information.
    """
    part = {"edge": _of_captures(np.ones((usable.size, 1)))}
    return (FixedError("borders", lambda prediction: part, np.array([SHARPEST])),) if usable.any() else ()


def _of_captures(columns: Array) -> Part:
    """Return a part of a statistic that captures have one figure of, from its columns, (captures, n)."""
    return Part(np.ones((columns.shape[0], 1)), columns[:, None, :])


def _offset_terms(
    name: str, unit: Unit, white: Array, lines: tuple[float, float], pixels: Array, design: Design
) -> list[FixedError]:
    """Return what a pattern does to means, slopes and edges.

    Args:
        name: What the pattern is called.
        unit: Gives (captures, tiles) DN per unit of the pattern for a prediction.
        white: (tiles,) variance from pixel to pixel in squared units.
        lines: Variance of rows and of columns in squared units.
        pixels: (tiles,) pixels that count.
    """
    (rows_e2, columns_e2), white = lines, np.maximum(white, 1e-14)
    rows, columns = shared_lines(design)
    height, width, lengths = design.tile_height, design.tile_width, slope_lengths(design)
    # The pixels of a row (column) move together, and with them every tile that it crosses.
    mean = np.diag(white / pixels) + rows_e2 * rows / _outer(height) + columns_e2 * columns / _outer(width)
    tilt_x = np.diag(white / lengths[0] ** 2) + columns_e2 * columns * _outer(np.sqrt(height) / lengths[0])
    tilt_y = np.diag(white / lengths[1] ** 2) + rows_e2 * rows * _outer(np.sqrt(width) / lengths[1])
    ones = np.ones(len(design.tiles))
    line = float(np.median(np.sqrt(white / np.sqrt(pixels) + rows_e2 + columns_e2)))
    return [
        FixedError(f"{name}: mean", _moving("mean", unit, _root(mean)), ones),
        FixedError(f"{name}: tilt x", _moving("slope_x", unit, _root(tilt_x)), ones),
        FixedError(f"{name}: tilt y", _moving("slope_y", unit, _root(tilt_y)), ones),
        FixedError(f"{name}: edges", _blurring(unit), np.array([line])),
    ]


def _root(covariance: Array) -> Array:
    """Return a matrix whose product with its transpose is the covariance.

    Tiles of a grid share all their lines: where there is hardly a pattern except that of lines, they move as one.
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
    x, y = (np.array([getattr(tile, name) for tile in design.tiles]) for name in ("x", "y"))
    width, height = design.tile_width, design.tile_height
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


def _moving(name: str, unit: Unit, root: Array) -> Callable[[Prediction], Mapping[str, Part]]:
    """Return what a pattern does whose shifts of the tiles have the covariance root·rootᵀ."""
    return lambda prediction: {name: Part(unit(prediction), root)}


def _blurring(unit: Unit) -> Callable[[Prediction], Mapping[str, Part]]:
    """Return what a fixed pattern in the lines along edges feigns of blur."""

    def parts(prediction: Prediction) -> Mapping[str, Part]:
        light = np.max(_unit_of_light(prediction), axis=1)
        step = np.maximum(np.maximum(np.std(prediction.mean, axis=1), _LEAST_STEP * light), 1e-9)
        size = np.sqrt(np.mean(np.square(unit(prediction)), axis=1))
        return {"edge": _of_captures((size / step / _EDGES)[:, None])}

    return parts


def _spread_of_pixels(seen: CaptureStatistics, excess_kurtosis: float) -> FixedError:
    """Return the chance spread of each tile's own pixels, alone and times that of lines.

    A variance of n values scatters by √((2 + κ)/n), κ their excess kurtosis.
    """
    freedom = np.maximum(np.nanmedian(seen.spatial_dof, axis=0), 2.0)

    def parts(prediction: Prediction) -> Mapping[str, Part]:
        lines = prediction.fixed_row_variance + prediction.fixed_column_variance
        white = np.maximum(prediction.fixed - lines[:, None], 0.0)
        share = np.sqrt(white * (white + 2.0 * lines[:, None])) / np.maximum(prediction.spatial, 1e-30)
        return {"spatial": Part(share, np.eye(share.shape[1]))}

    return FixedError("pattern spread", parts, np.sqrt((2.0 + excess_kurtosis) / freedom))


def _lines(name: str, prediction: Prediction) -> Array:
    """Return the variance of a pattern of columns or rows in DN², (captures,)."""
    return prediction.fixed_column_variance if name == "columns" else prediction.fixed_row_variance


def _spread_of_lines_in_tiles(name: str, seen: CaptureStatistics, design: Design) -> FixedError:
    """Return the chance spread of the few lines of a pattern that cross each tile, alike in every capture.

    Tiles side by side share it, and the spread of all lines is the mean of the tiles'.
    """
    rows, columns = shared_lines(design)
    free = np.maximum((design.tile_height if name == "rows" else design.tile_width) - _TREND_TERMS, 1.0)
    values, vectors = np.linalg.eigh(2.0 * (rows if name == "rows" else columns) / _outer(free))
    kept = values > _SMALLEST_SHARE * values.max()
    root = vectors[:, kept] * np.sqrt(values[kept])
    weight = getattr(seen, f"{name}_weight")

    def parts(prediction: Prediction) -> Mapping[str, Part]:
        lines = _lines(name, prediction)
        share = lines[:, None] / np.maximum(prediction.spatial, 1e-30)
        of_all = (lines * weight / (1.0 + lines * weight))[:, None] * root.mean(axis=0)
        return {"spatial": Part(share, root), name: _of_captures(of_all)}

    return FixedError(f"spread of {name} in tiles", parts, np.ones(root.shape[1]))


def _spread_of_lines(name: str, seen: CaptureStatistics) -> FixedError:
    """Return the chance spread of a white pattern's own row or column means, alike in every capture."""

    def parts(prediction: Prediction) -> Mapping[str, Part]:
        share = (prediction.fixed / np.maximum(prediction.spatial, 1e-30)).mean(axis=1)
        return {name: _of_captures(share[:, None])}

    dof = getattr(seen, f"{name}_dof")
    free = max(float(np.median(dof[dof > 0])) if (dof > 0).any() else 2.0, 2.0)
    return FixedError(f"pattern {name} spread", parts, np.array([np.sqrt(2.0 / free)]))
