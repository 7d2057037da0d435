"""How far each statistic of a model that is right would scatter: standard uncertainties and joint covariances."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.special import polygamma

from radiometer.reconcile.measure.design import Array, Design
from radiometer.reconcile.measure.reduce import CaptureStatistics
from radiometer.reconcile.measure.row_bands import TileBands
from radiometer.reconcile.measure.sums import COMB_PERIODS
from radiometer.reconcile.measure.usable import Mask, slope_lengths, structure_dn2
from radiometer.reconcile.model.tile_model import Prediction
from radiometer.reconcile.noise.row_scatter import RowScatter, row_overlap

_FAIR_SHARE: Final = 0.05  # of the brightest tile's light
_LEAST_EXCESS: Final = -0.9  # of a variance ratio, so that it stays positive
_LARGEST_COMB_COUNT: Final = 1e5  # beyond it the honest shape of a histogram itself would show
_ROUNDING_SHARE: Final = 0.1  # of what rounding may move a mean: counts of few electrons are not quite normal
_COMB_SQUARES: Final = np.array([1.0 if period == 2 else 0.5 for period in COMB_PERIODS])  # mean of cos²(2πn/period)


@dataclass(frozen=True, slots=True)
class Repeatability:
    """How far the light differs from one capture to the next, and from one frame to the next.

    Attributes:
        tau: Relative standard deviation from capture to capture.
        flicker2: (captures,) relative variance from frame to frame that an accepted effect predicts.
        row_variance: (captures,) row noise that an accepted effect predicts, in DN².
        bands2: (captures,) relative variance of light that goes as a wave along the rows.
        band_frequency: Periods of that wave per row.
    """

    tau: float
    flicker2: Array
    row_variance: Array
    bands2: Array
    band_frequency: float


def standard_uncertainties(
    design: Design,
    seen: CaptureStatistics,
    base: Prediction,
    usable: Mapping[str, Mask],
    sensitivity: Array,
    repeatability: Repeatability,
) -> dict[str, Array]:
    """Return the standard uncertainty of every entry by block, of variances that of the logarithm.

    Args:
        design: Captures and tiles.
        seen: What was measured; its own scatter from frame to frame gives the weights.
        base: Prediction, for what a measurement of few frames cannot tell.
        usable: Which entries count.
        sensitivity: (captures, tiles) d(mean)/d(log light) in DN.
        repeatability: Capture-to-capture and frame-to-frame scatter.
    """
    n = design.frame_count[:, None]
    noise = np.where(usable["variance"], seen.variance, base.variance)
    pixels = np.maximum(seen.pixels, 1.0)
    # A tile's time mean scatters from pixel to pixel by `spatial`; its slope's error follows from that.
    lengths = slope_lengths(design)
    kurtosis = np.clip(
        base.gain[:, None] ** 4 * np.maximum(base.signal, 0.0) / np.maximum(base.variance, 1e-12) ** 2, 0, 1
    )
    # Neighbours that move together average out less: a tile's mean scatters more than its pixels' variance tells.
    white_x = base.neighbour_x - base.row_variance[:, None] / np.maximum(base.variance, 1e-30)
    together = np.maximum(1.0 + 2.0 * (white_x + base.neighbour_y), 0.5)
    per_frame = noise * together / pixels
    first_share = 1.0 + 1.0 / np.maximum(n - 1.0, 1.0)
    beside_x, beside_y = _pair_shares(design)
    uneven = 1.0 if design.uniform else _unevenness(design, seen, base, noise)
    pairs = np.maximum(seen.variance_dof, 1.0) * pixels / np.maximum(pixels - 1.0, 1.0)
    counts = np.minimum(np.maximum(seen.comb_count, 1.0), _LARGEST_COMB_COUNT)[:, None]
    phases = _phase_scatter(design, seen, base)
    found = {
        "mean": np.hypot(np.sqrt(noise * together / (pixels * n)), _ROUNDING_SHARE * base.rounding),
        "slope_x": np.sqrt(noise * together / n) / lengths[0],
        "slope_y": np.sqrt(noise * together / n) / lengths[1],
        "variance": np.sqrt(log_variance(seen.variance_dof) * uneven + kurtosis / (pixels * n)),
        "spatial": np.sqrt(log_variance(seen.spatial_dof)),
        "neighbour_x": np.sqrt(uneven / (beside_x * pairs)),
        "neighbour_y": np.sqrt(uneven / (beside_y * pairs)),
        "first": np.sqrt(per_frame * first_share),
        "common": np.ones(len(design.captures)),
        "row_temporal": np.sqrt(log_variance(seen.row_temporal_dof)),
        "columns": np.sqrt(log_variance(seen.columns_dof)),
        "rows": np.sqrt(log_variance(seen.rows_dof)),
        "edge": np.where(np.isfinite(seen.edge_u), seen.edge_u, 1.0),
        "outliers": np.ones(len(design.captures)),
        "comb": np.sqrt(_COMB_SQUARES / counts + (0.0 if design.uniform else _scene_comb(design, seen, base) ** 2)),
        "bands": np.ones_like(seen.bands_of_rows),
    }
    return found | {name: np.hypot(found[name], scatter) for name, scatter in phases.items()}


def whitener(
    design: Design,
    deviation: Array,
    usable: Mask,
    sensitivity: Array,
    repeatability: Repeatability,
    tau2: float,
    share: Array,
) -> Array:
    """Return the inverse Cholesky factors of each capture's covariance: pixel noise, light and row noise in common."""
    common2 = tau2 + repeatability.flicker2 * share
    light = np.where(usable, sensitivity, 0.0)
    covariance = common2[:, None, None] * light[:, :, None] * light[:, None, :]
    if repeatability.row_variance.any():
        both = usable[:, :, None] & usable[:, None, :]
        rows = (repeatability.row_variance * share)[:, None, None] * row_overlap(design)
        covariance = covariance + np.where(both, rows, 0.0)
    if repeatability.bands2.any():
        bands = TileBands.of(design, repeatability.band_frequency)
        waves = light[:, :, None] * light[:, None, :] * bands.together(bands.mean)
        covariance = covariance + (repeatability.bands2 * share)[:, None, None] * waves
    return _inverse_root(covariance, deviation, usable)


def whitener_of_rows(block: str, deviation: Array, usable: Mask, scatter: RowScatter) -> Array:
    """Return the inverse Cholesky factors of a block whose tiles see the noise of the same rows."""
    both = usable[:, :, None] & usable[:, None, :]
    return _inverse_root(np.where(both, scatter.covariance(block), 0.0), deviation, usable)


def whitener_of_tilts(
    design: Design, deviation: Array, usable: Mask, sensitivity: Array, repeatability: Repeatability, share: Array
) -> Array:
    """Return the inverse Cholesky factors of the tilts' covariance: pixels, a wave along the rows, row noise."""
    light = np.where(usable, sensitivity, 0.0)
    bands = TileBands.of(design, repeatability.band_frequency)
    waves = light[:, :, None] * light[:, None, :] * bands.together(bands.rise)
    rows = np.where(usable[:, :, None] & usable[:, None, :], _row_tilts(design), 0.0)
    bands2, rows2 = (values * share for values in (repeatability.bands2, repeatability.row_variance))
    return _inverse_root(bands2[:, None, None] * waves + rows2[:, None, None] * rows, deviation, usable)


def _inverse_root(covariance: Array, deviation: Array, usable: Mask) -> Array:
    index = np.arange(usable.shape[1])
    covariance[:, index, index] += np.where(usable, deviation**2, 1.0)
    return np.asarray(np.linalg.inv(np.linalg.cholesky(covariance)))


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
    """Return what a wave along the rows adds to the ratios of the rows' profiles, by block, (captures,)."""
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


def _phase_scatter(design: Design, seen: CaptureStatistics, base: Prediction) -> dict[str, Array]:
    """Return by how much few phases of a wave along the rows scatter the statistics, by block."""
    excess = band_excess(design, seen, base)
    if not excess:
        return {}
    left = TileBands.of(design, base.band_frequency)
    unsteady = left.unsteadiness(design.frame_count)
    within = base.band_variance * left.within / base.variance * unsteady
    rough = base.band_variance * left.rough / design.frame_count[:, None] / base.spatial
    lines = {name: np.maximum(more, 0.0) / (1.0 + more) for name, more in excess.items()}
    return {
        "variance": within,
        "neighbour_x": within,
        "neighbour_y": within,
        "spatial": rough,
        "row_temporal": lines["row_temporal"] * unsteady.max(axis=1),
        "rows": lines["rows"],
    }


def common_of_rows(design: Design, seen: CaptureStatistics, usable: Mask, sensitivity: Array) -> Array:
    """Return w·O·w / (w·s) for the weights w = s·n/σ² of the tiles' light s and the overlap O of their rows."""
    light = np.where(usable & (np.nan_to_num(seen.variance) > 0), sensitivity, 0.0)
    weight = np.where(light > 0, light * seen.pixels / np.where(light > 0, seen.variance, 1.0), 0.0)
    information = np.sum(weight * light, axis=1)
    shaken = np.einsum("ci,ij,cj->c", weight, row_overlap(design), weight)
    return np.asarray(np.divide(shaken, information, out=np.zeros_like(shaken), where=information > 0))


def _row_tilts(design: Design) -> Array:
    """Return what 1 DN² of row noise gives the covariance of two tiles' rises from centre to bottom edge."""
    tilts = np.zeros((len(design.tiles), design.shape[0]))
    for number, tile in enumerate(design.tiles):
        u = (2.0 * np.arange(tile.height) + 1.0) / tile.height - 1.0
        tilts[number, tile.y : tile.y + tile.height] = u / max(float(u @ u), 1e-12)
    return tilts @ tilts.T


def _unevenness(design: Design, seen: CaptureStatistics, base: Prediction, noise: Array) -> Array:
    """Return ⟨v²⟩/⟨v⟩² of the pixels' variances v in each tile of a scene: brighter pixels are noisier.

    The fewer pixels carry the noise, the less sure is its mean.
    """
    structure = structure_dn2(design, seen)
    lit = design.source_level[:, None] > 0
    return np.asarray(np.where(lit, 1.0 + base.gain[:, None] ** 2 * structure / np.maximum(noise, 1e-12) ** 2, 1.0))


def _scene_comb(design: Design, seen: CaptureStatistics, base: Prediction) -> Array:
    """Return how large a comb an honest histogram of a scene may show, (captures, periods).

    In a scene the light scatters the codes where noise need not: of pixels that all have the same phase Gaussian noise
    of variance v leaves exp(−2π²·v/period²). No pixel has less noise than the darkest tile; where no read noise is
    declared, the darkest as it was seen counts too, clipped or not.
    """
    declared = design.header.camera.read_noise_e is not None
    noise = base.variance if declared else np.fmin(base.variance, seen.variance)
    least_e2 = float(np.min(noise / base.gain[:, None] ** 2))
    least_dn2 = least_e2 * base.gain[:, None] ** 2
    return np.asarray(np.exp(-2.0 * np.pi**2 * least_dn2 / np.square(COMB_PERIODS)))


def _pair_shares(design: Design) -> tuple[Array, Array]:
    """Return the number of horizontal and of vertical neighbours in each tile over that of its pixels."""
    width, height = (np.array([getattr(tile, n) for tile in design.tiles]) for n in ("width", "height"))
    return 1.0 - 1.0 / width, 1.0 - 1.0 / height


def log_variance(dof: Array) -> Array:
    """Return Var[ln s²] for a variance estimated with so many degrees of freedom."""
    return np.asarray(polygamma(1, np.maximum(dof, 1.0) / 2.0))
