"""What noise that lines of pixels share adds to the statistics: row noise, patterns, exchanged charge, waves of light.

Profiles of rows and columns are ratios over the noise of pixels, which holds the lines' too; bands are spatial
frequencies of the rows' light.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from radiometer.reconcile.measure.design import Array, Design
from radiometer.reconcile.measure.reduce import CaptureStatistics
from radiometer.reconcile.measure.row_bands import RowBins, TileBands
from radiometer.reconcile.model.tile_model import Prediction

_LEAST_EXCESS: Final = -0.9  # of a variance ratio, so that it stays positive
_FAIR_SHARE: Final = 0.05  # of the brightest tile's light


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
    if name == "row_temporal":
        own, noise = rows, prediction.variance
        held = rows[:, None] * (1.0 - 1.0 / design.tile_height)
    else:
        fixed_rows = prediction.fixed_row_variance + rows / design.frame_count
        own, noise = (columns if name == "columns" else fixed_rows), prediction.spatial
        held = columns[:, None] * design.rough_columns + fixed_rows[:, None] * design.rough_rows
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
    length = design.tile_height if name == "columns" else design.tile_width
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


def relative_bands(prediction: Prediction) -> Array:
    """Return the relative variance of the light that goes as a wave along the rows, (captures,)."""
    return _of_fair_tiles(prediction, prediction.band_variance)


def relative_flicker(prediction: Prediction) -> Array:
    """Return the relative variance that all light of a frame shares, (captures,).

    Of the tiles with a fair share of the light the one that shows most counts: a full well shows none.
    """
    return _of_fair_tiles(prediction, prediction.common_variance)


def _of_fair_tiles(prediction: Prediction, variance: Array) -> Array:
    if not variance.any():
        return np.zeros(variance.shape[0])
    light = np.maximum(prediction.signal * prediction.gain[:, None], 1e-12)
    fair = light >= _FAIR_SHARE * light.max(axis=1, keepdims=True)
    return np.asarray(np.max(np.where(fair, variance / light**2, 0.0), axis=1))


def band_excess(design: Design, seen: CaptureStatistics, prediction: Prediction) -> dict[str, Array]:
    """Return what a wave along the rows adds to the ratios of the rows' profiles, by statistic, (captures,)."""
    bands2 = relative_bands(prediction)
    if not bands2.any():
        return {}
    left = TileBands.of(design, prediction.band_frequency)
    temporal = bands2 * seen.row_temporal_light
    # The weights of the time mean's rows are those of the temporal profile but for the noise of a pixel.
    safe = np.where(seen.row_temporal_weight > 0, seen.row_temporal_weight, np.inf)
    steady = temporal * seen.rows_weight / safe / design.frame_count
    found = {}
    for name, excess, kept, noise in (
        ("row_temporal", temporal, left.within, prediction.variance),
        ("rows", steady, left.rough, prediction.spatial * design.frame_count[:, None]),
    ):
        # The noise of pixels that the ratio is taken over holds the wave too.
        held = np.mean(prediction.band_variance * kept / noise**2, axis=1) / np.mean(1.0 / noise, axis=1)
        found[name] = np.maximum(excess * float(kept.mean()) - held, _LEAST_EXCESS)
    return found


def line_weights(design: Design, base: Prediction) -> Array:
    """Return the share of each bin of rows in the rows' profiles, (captures, bins): tiles of little noise count more.

    The shares of a capture sum to 1.
    """
    held = design.tile_width[:, None] * design.tile_height[:, None] * rows_in_bins(design)
    found = (1.0 / base.variance) @ held
    return np.asarray(found / found.sum(axis=1, keepdims=True))


def rows_in_bins(design: Design) -> Array:
    """Return the share of each bin of rows in each tile, (tiles, bins)."""
    bins = RowBins.of(design)
    found = np.zeros((len(design.tiles), bins.number))
    np.add.at(found.T, np.arange(design.shape[0]) // bins.step, design.rows_of_tiles.T)
    return found


def with_heavy_rows(design: Design, seen: CaptureStatistics, base: Prediction) -> CaptureStatistics:
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


def common_of_rows(design: Design, seen: CaptureStatistics, light: Array) -> Array:
    """Return w·O·w / (w·s) for the weights w = s·n/σ² of the tiles' light s and the overlap O of their rows.

    Args:
        design: Captures and tiles.
        seen: What was measured.
        light: (captures, tiles) d(mean)/d(log light) in DN, 0 where a tile does not count.
    """
    light = np.where(np.nan_to_num(seen.variance) > 0, light, 0.0)
    weight = np.where(light > 0, light * seen.pixels / np.where(light > 0, seen.variance, 1.0), 0.0)
    information = np.sum(weight * light, axis=1)
    shaken = np.sum(np.square(weight @ design.rows_of_tiles), axis=1)
    return np.asarray(np.divide(shaken, information, out=np.zeros_like(shaken), where=information > 0))
