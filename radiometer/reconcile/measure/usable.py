"""Which statistics count: not clipped, with freedom left, and not formed by the spacing of the codes."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radiometer.reconcile.measure.design import Array, Design
from radiometer.reconcile.measure.layout import tile_groups
from radiometer.reconcile.measure.reduce import CaptureStatistics
from radiometer.reconcile.measure.sums import COMB_PERIODS
from radiometer.reconcile.model.tile_model import Prediction

Mask = NDArray[np.bool_]

_CLIP_SIGMAS: Final = 5.0
_ZERO_SIGMAS: Final = 4.0  # what is cut off below 0 moves a mean by 7e-6 of the noise
_FEW: Final = 1e-3  # share of clipped samples that does not count as clipping
_COARSE_DN: Final = 0.05  # by which rounding may move a mean where a variance still scatters as a normal one (σ = 0.3)
_FEWEST_CODES: Final = 500  # samples that a histogram needs
_CLEAR_COMB: Final = 0.7  # amplitude from which a spacing of codes is beyond doubt
_CLEAR_LIGHT: Final = 3.0  # sigmas of one pixel by which the brightest patch must stand out to have borders
_SHOT_NOISE: Final = 4.0  # times the read noise's variance
_READ_NOISE_LEFT: Final = 0.5  # of its variance, below which the converter hides it
_FINE_NOISE: Final = 0.5  # standard deviation over code spacing that statistics need to be nearly normal


def usable_entries(design: Design, seen: CaptureStatistics, base: Prediction) -> dict[str, Mask]:
    """Return which entries of each block count: not clipped as measured or predicted, and with freedom left."""
    full_scale = design.header.camera.full_scale_dn
    inside = np.ones(seen.mean.shape, dtype=np.bool_)
    noise = np.where(np.isfinite(seen.variance), seen.variance, base.variance) + np.maximum(
        np.nan_to_num(base.fixed), 0.0
    )
    sigma, above_zero = _CLIP_SIGMAS * np.sqrt(noise), _ZERO_SIGMAS * np.sqrt(noise)
    # What is predicted to clip but was not seen to clip stays in: it is what a lower full well looks like.
    inside &= (seen.mean - above_zero > 0) & (seen.mean + sigma < full_scale) & (seen.high < _FEW) & (seen.low < _FEW)
    inside &= ~partly_at_the_top(design, seen, base)
    inside &= base.mean - _ZERO_SIGMAS * np.sqrt(base.variance + base.fixed) > 0
    step = seen_step(seen)
    fine = base.variance > (_FINE_NOISE * step) ** 2 if step > 1 else np.ones_like(inside)
    inside &= fine
    free = inside & ~_at_the_knee(design, base)
    many = np.broadcast_to((design.frame_count > 1)[:, None], inside.shape)
    free &= ~_cut_off(design, seen, base)
    noisy = free & many & (np.nan_to_num(seen.variance) > 0) & (base.rounding < _COARSE_DN)
    spread = free & (seen.spatial_dof > 4) & (seen.spatial > 0) & (base.rounding < _COARSE_DN)
    any_tile = inside.any(axis=1)
    calm = base.variance > step**2 if step > 1 else fine  # lines of pixels feel the spacing sooner
    whole = many[:, 0] & calm.all(axis=1)
    even = ~(design.source_level > 0) | design.uniform  # without light a scene shows nothing but the sensor
    patched = any_tile & calm.all(axis=1) & even
    dividing = np.array([step == 1 or step % period == 0 for period in COMB_PERIODS])
    return {
        "mean": inside,
        "slope_x": inside,
        "slope_y": inside,
        "variance": noisy,
        "spatial": spread,
        "neighbour_x": noisy & np.isfinite(seen.neighbour_x),
        "neighbour_y": noisy & np.isfinite(seen.neighbour_y),
        "first": inside & many,
        "common": whole & np.isfinite(seen.common) & (base.signal.max(axis=1) > 0),
        "row_temporal": whole & (seen.row_temporal_dof > 4) & (np.nan_to_num(seen.row_temporal) > 0),
        "columns": patched & (seen.columns_dof > 4) & (np.nan_to_num(seen.columns) > 0),
        "rows": patched & (seen.rows_dof > 4) & (np.nan_to_num(seen.rows) > 0),
        "edge": np.isfinite(seen.edge_u) & any_tile & _has_borders(base),
        "outliers": patched,
        # In a scene the bright rows of a tile are noisier than its mean noise, by which bands are weighed.
        "bands": np.isfinite(seen.bands) & (design.uniform & whole & ~_at_the_knee(design, base).any(axis=1))[:, None],
        "comb": ((seen.comb_count > _FEWEST_CODES) & _below_the_top(seen))[:, None] & dividing,
    }


def partly_at_the_top(design: Design, seen: CaptureStatistics, base: Prediction) -> Mask:
    """Tell which tiles of a scene are uneven and reach the brightest that was seen at their gain, within the noise.

    If that is where the camera saturates, part of such a tile does and part does not, and nothing tells which part.
    Where samples reach full scale the top is known, and what is clipped there has been counted. Patches are even.
    """
    if design.uniform:
        return np.zeros(seen.mean.shape, dtype=np.bool_)
    uneven = structure_dn2(design, seen) > base.variance * (1.0 + 1.0 / design.frame_count[:, None])
    found = np.zeros(uneven.shape, dtype=np.bool_)
    for gain_db in np.unique(design.gain_db):
        lit = ((design.gain_db == gain_db) & (design.source_level > 0))[:, None] & (seen.pixels > 0)
        if not lit.any() or float(seen.high[lit].max()) > _FEW:
            continue
        top = float(seen.peak[lit].max())
        noise = float(np.max(base.variance, where=lit & (base.mean <= top), initial=0.0))
        found |= lit & uneven & (seen.peak > top - _CLIP_SIGMAS * np.sqrt(noise))
    return found


def _below_the_top(seen: CaptureStatistics) -> Mask:
    """Tell which captures do not show the highest code of all: where light is cut off, few codes occur at the top."""
    highest = np.nan_to_num(seen.peak).max(axis=1)
    return np.asarray(highest < highest.max() - 1.0)


def seen_step(seen: CaptureStatistics) -> int:
    """Return the spacing of codes as far as the histograms tell it, 1 where all codes occur.

    Where it is wide, noise below half of it leaves nothing normal of a tile, and periods that do not divide it show
    the shape of an honest histogram at an alias.
    """
    many = seen.comb_count > _FEWEST_CODES
    if not many.any():
        return 1
    shown = np.median(seen.comb[many], axis=0) > _CLEAR_COMB
    return math.lcm(*(period for period, clear in zip(COMB_PERIODS, shown, strict=True) if clear))


def _cut_off(design: Design, seen: CaptureStatistics, base: Prediction) -> Mask:
    """Tell where light should bring noise and not even read noise is seen: nearly all samples show the highest code.

    What is left there are a few samples, whose variance and correlations are far from normal.
    """
    read_e = design.header.camera.read_noise_e
    dark = design.closed | ~(design.source_level > 0)
    seen_e2 = np.nan_to_num(seen.variance[dark] / base.gain[dark, None] ** 2, nan=np.inf)
    least_e2 = float(np.min(seen_e2, initial=np.inf)) if read_e is None else read_e**2
    if not np.isfinite(least_e2):
        return np.zeros(base.signal.shape, dtype=np.bool_)
    hidden = np.nan_to_num(seen.variance) < _READ_NOISE_LEFT * least_e2 * base.gain[:, None] ** 2
    return np.asarray(hidden & (base.signal > _SHOT_NOISE * least_e2))


def _at_the_knee(design: Design, base: Prediction) -> Mask:
    """Tell where the declared full well just begins to bite: there the variance hangs on the light level."""
    well = design.header.camera.full_well_e
    if well is None:
        return np.zeros(base.signal.shape, dtype=np.bool_)
    sigma = np.sqrt(np.maximum(base.signal, 1.0))
    return np.asarray(np.abs(base.signal - well) < _CLIP_SIGMAS * sigma)


def structure_dn2(design: Design, seen: CaptureStatistics) -> Array:
    """Return the variance of the time mean from pixel to pixel with the tile's tilt, in DN², (captures, tiles)."""
    tilts = [
        (slope * length) ** 2 for slope, length in zip((seen.slope_x, seen.slope_y), slope_lengths(design), strict=True)
    ]
    return np.asarray(np.nan_to_num(seen.spatial + sum(tilts) / np.maximum(seen.pixels, 1.0)))


def _has_borders(base: Prediction) -> NDArray[np.bool_]:
    """Tell in which captures patches can have borders of light: in the others the steps are those of a pattern."""
    light = np.max(base.signal * base.gain[:, None], axis=1)
    return np.asarray(light > _CLEAR_LIGHT * np.sqrt(np.median(base.variance, axis=1)))


def slope_lengths(design: Design) -> tuple[Array, Array]:
    """Return the length of the tilts over each tile: a coefficient divided by it is the rise from centre to edge."""
    x, y = np.empty(len(design.tiles)), np.empty(len(design.tiles))
    for group in tile_groups(design):
        x[group.index], y[group.index] = group.slope_norm
    return x, y
