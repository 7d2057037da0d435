"""Puts measured and predicted statistics on one scale: standardised residuals, whitened, in one vector.

Means of one capture share its repeatability (a common relative error) and are whitened together; variances are
compared as logarithms; the rest stands in units of its own standard uncertainty. The weights never come from the
prediction under test, so that two models compared on one `Comparison` differ in log-likelihood by Δχ²/2.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radiometer.reconcile.measure.design import Array, Design
from radiometer.reconcile.measure.reduce import CaptureStatistics
from radiometer.reconcile.measure.row_bands import RowBins, wave_correlation, wave_power
from radiometer.reconcile.measure.sums import COMB_PERIODS
from radiometer.reconcile.measure.usable import Mask, usable_entries
from radiometer.reconcile.model.tile_model import Prediction
from radiometer.reconcile.noise.repeatability import steady_wander2
from radiometer.reconcile.noise.row_scatter import RowScatter, effective, line_excess, mixing_of_bands, mixing_of_lines
from radiometer.reconcile.noise.scatter import (
    Repeatability,
    band_excess,
    common_of_rows,
    relative_bands,
    relative_flicker,
    standard_uncertainties,
    whitener,
    whitener_of_rows,
    whitener_of_tilts,
)
from radiometer.reconcile.noise.variance_scores import (
    deviances,
    followed_scores,
    frames_counted,
    log_bias,
    sine_freedom,
)

TILE_BLOCKS: Final = ("mean", "slope_x", "slope_y", "variance", "spatial", "neighbour_x", "neighbour_y", "first")
CAPTURE_BLOCKS: Final = ("common", "row_temporal", "columns", "rows", "edge", "outliers")
FAMILY: Final[dict[str, str]] = {
    "slope_x": "slope",
    "slope_y": "slope",
    "neighbour_x": "neighbour",
    "neighbour_y": "neighbour",
}
_LIGHT_U_REL: Final = 3e-3  # how well the light of one tile is taken to be known where its variance hangs on it
_TOGETHER: Final = 0.85  # of the correlation of one wave's scores that is trusted: a cube root is no square
_WANDERS: Final = 61  # relative variances tried, ten to a decade
_FALSE_OUTLIERS: Final = 0.02  # expected in a capture without hot pixels; keeps the square root finite


@dataclass(frozen=True, eq=False)
class Comparison:
    """Measured statistics with their fixed weights.

    Attributes:
        design: Captures and tiles.
        seen: What was measured.
        usable: Which entries of each block count.
        deviation: Standard uncertainty of each entry (of its logarithm for variances).
        whiteners: Of the blocks whose tiles scatter together (`mean`, `first`): (captures, tiles, tiles) inverse
            Cholesky factor of the covariance.
        cuts: Where each block lies in the vector.
        flicker2: (captures,) relative variance from frame to frame of the accepted effects, of a whole frame.
        wander2: The same of the source itself, whatever the exposure, up to what its stated reproducibility allows.
        rows2: (captures,) row noise of the accepted effects in DN².
        common_of_rows: (captures,) what 1 DN² of row noise adds to the ratio of the frame-common fluctuation.
        bands2: (captures,) relative variance of the accepted effects' wave along the rows.
        band_frequency: Periods of that wave per row.
    """

    design: Design
    seen: CaptureStatistics
    usable: Mapping[str, Mask]
    deviation: Mapping[str, Array]
    whiteners: Mapping[str, Array]
    cuts: Mapping[str, slice]
    flicker2: Array
    wander2: float
    rows2: Array
    common_of_rows: Array
    bands2: Array
    band_frequency: float

    @property
    def size(self) -> int:
        """Return the length of the vector, masked entries included."""
        return int(max(cut.stop for cut in self.cuts.values()))

    def residual(self, prediction: Prediction) -> Array:
        """Return measured minus predicted, whitened; 0 where an entry does not count."""
        pieces = [self._tile_block(name, prediction) for name in TILE_BLOCKS]
        pieces += [self._capture_block(name, prediction) for name in CAPTURE_BLOCKS]
        pieces.append(self._comb(prediction))
        pieces.append(self._together("bands", self._bands(prediction)))
        return np.concatenate([piece.ravel() for piece in pieces])

    def whiten(self, block: str, values: Array) -> Array:
        """Return raw changes of a block (axes as the block, more may follow) in whitened units."""
        if block in self.whiteners:
            return self._whitened(block, values)
        mask, sigma = self.usable[block], self.deviation[block]
        extra = (None,) * (values.ndim - mask.ndim)
        return np.where(mask[(..., *extra)], values / sigma[(..., *extra)], 0.0)

    def degrees(self, block: str) -> int:
        """Return how many entries of a block count."""
        return int(self.usable[block].sum())

    def capture_of_rows(self) -> NDArray[np.intp]:
        """Return for each entry of the vector the capture that it belongs to."""
        captures = np.arange(len(self.design.captures))
        tiles = len(self.design.tiles)
        per_tile = [np.repeat(captures, tiles)] * len(TILE_BLOCKS)
        per_capture = [captures] * len(CAPTURE_BLOCKS)
        return np.concatenate(
            [*per_tile, *per_capture, np.repeat(captures, len(COMB_PERIODS)), np.repeat(captures, self._bins.orders)]
        )

    def counts(self) -> Mask:
        """Tell for each entry of the vector whether it counts."""
        return np.concatenate([self.usable[name].ravel() for name in self.cuts])

    def _whitened(self, block: str, values: Array) -> Array:
        mask = self.usable[block]
        extra = (None,) * (values.ndim - 2)
        columns = np.where(mask[(..., *extra)], values, 0.0).reshape(*mask.shape, -1)
        return np.asarray(np.matmul(self.whiteners[block], columns).reshape(values.shape))

    def _bands(self, prediction: Prediction) -> Array:
        bands2 = relative_bands(prediction)
        if not (bands2.any() or prediction.row_variance.any() or prediction.mixed_x.any()):
            return self._calm_bands
        power = self.band_power(bands2, prediction.band_frequency)
        if prediction.mixed_x.any():
            power = power + mixing_of_bands(prediction, self.design)
        return self.band_scores(power, prediction.row_variance)

    @cached_property
    def _calm_common(self) -> Array:
        """Return the scores of the frame-common fluctuation where nothing is predicted to move whole frames."""
        return self.common_scores(np.zeros_like(self.flicker2), np.zeros(len(self.design.captures)))

    @cached_property
    def _calm_bands(self) -> Array:
        """Return the scores of the bands where nothing is predicted to move the rows."""
        return self.band_scores(np.zeros_like(self.seen.bands_of_rows), np.zeros(len(self.design.captures)))

    def _together(self, block: str, scores: Array) -> Array:
        return self._whitened(block, scores) if block in self.whiteners else scores

    def _tile_block(self, name: str, prediction: Prediction) -> Array:
        seen, expected = getattr(self.seen, name), getattr(prediction, name)
        if name in ("variance", "spatial"):
            difference = self._log_seen[name] - np.log(np.maximum(expected, 1e-12))
        else:
            difference = np.where(self.usable[name], seen, 0.0) - expected
        return self.whiten(name, difference)

    @cached_property
    def _log_seen(self) -> dict[str, Array]:
        """Return the logarithms of measured variances, freed of the bias that few degrees of freedom give."""
        found = {}
        for name in ("variance", "spatial", "row_temporal", "columns", "rows"):
            mask = self.usable[name]
            dof = np.where(mask, getattr(self.seen, f"{name}_dof"), 10.0)
            seen = np.where(mask, getattr(self.seen, name), 1.0)
            found[name] = np.log(np.maximum(seen, 1e-12)) - log_bias(dof)
        return found

    def _capture_block(self, name: str, prediction: Prediction) -> Array:
        mask, sigma, seen = self.usable[name], self.deviation[name], getattr(self.seen, name)
        if name == "edge":
            return np.where(mask, (seen - prediction.edge) / sigma, 0.0)
        if name == "outliers":
            expected = _FALSE_OUTLIERS + np.maximum(prediction.outliers, 0.0)
            return np.where(mask, 2.0 * (np.sqrt(seen + 0.375) - np.sqrt(expected + 0.375)) / sigma, 0.0)
        if name == "common":
            flicker2 = self.flicker_of(prediction)
            if not (flicker2.any() or prediction.row_variance.any()):
                return self._calm_common
            return self.common_scores(flicker2, prediction.row_variance)
        return np.where(mask, (self._log_seen[name] - np.log(self._excess(name, prediction))) / sigma, 0.0)

    def common_scores(self, flicker2: Array, row_variance: Array) -> Array:
        """Return the residual of the frame-common fluctuation for a relative variance of the light, (captures,).

        Row noise does not quite average out over the rows, and counts with it (in DN²).
        """
        expected = self._expected_common(flicker2, row_variance)
        known = self.flicker2.any() or self.rows2.any()
        accepted = self._expected_common(self.flicker2, self.rows2) if known else None
        return followed_scores(self.seen.common, expected, accepted, self._common_freedom, self.usable["common"])

    def _expected_common(self, flicker2: Array, row_variance: Array) -> Array:
        return 1.0 + row_variance * self.common_of_rows + (flicker2 + self.wander2) / self._common_unit

    def band_scores(self, power: Array, row_variance: Array) -> Array:
        """Return the residual of the bands for what a wave along the rows adds to their ratios, (captures, orders)."""
        expected = 1.0 + row_variance[:, None] * self.seen.bands_of_rows + power
        known = self.bands2.any() or self.rows2.any()
        accepted = 1.0 + self.rows2[:, None] * self.seen.bands_of_rows + self._accepted_bands if known else None
        return followed_scores(self.seen.bands, expected, accepted, self.band_freedom, self.usable["bands"])

    def band_power(self, bands2: Array, frequency: float) -> Array:
        """Return what a wave along the rows adds to the ratios of the bands, (captures, orders)."""
        if not bands2.any():
            return np.zeros_like(self.seen.bands_of_rows)
        return np.asarray(bands2[:, None] * wave_power(self._bins, self.seen.bands_basis, frequency)[0])

    def whitener_of_bands(self) -> Array:
        """Return the inverse Cholesky factors of the bands' scores: those of one wave follow the same few phases."""
        frames, mask = frames_counted(self.design.frame_count), self.usable["bands"]
        share = np.where(mask, self._accepted_bands / (1.0 + self._accepted_bands), 0.0)
        together = wave_correlation(self._bins, self.seen.bands_basis, self.band_frequency, frames)
        covariance = _TOGETHER * share[:, :, None] * share[:, None, :] * together
        index = np.arange(mask.shape[1])
        covariance[:, index, index] = 1.0
        return np.asarray(np.linalg.inv(np.linalg.cholesky(covariance)))

    def flicker_of(self, prediction: Prediction) -> Array:
        """Return the relative variance that all light of a frame has in common, bands included, (captures,)."""
        return relative_flicker(prediction) + _common_bands(self.design, self.seen, prediction)

    def common_deviance(self, prediction: Prediction) -> float:
        """Return the deviance of the frame-common fluctuation: −2·ln of its exact likelihood but for a constant."""
        return float(np.sum(self.common_deviances(prediction)))

    def common_deviances(self, prediction: Prediction) -> Array:
        """Return what each capture adds to it, (captures,)."""
        return self.deviances_of_flicker(self.flicker_of(prediction), prediction.row_variance)

    def deviances_of_flicker(self, flicker2: Array, row_variance: Array) -> Array:
        """Return the same for a relative variance of the light, (…, captures), beside row noise in DN², (captures,)."""
        expected = self._expected_common(flicker2, row_variance)
        return deviances(self.seen.common, expected, self._common_freedom, self.usable["common"])

    def band_deviance(self, prediction: Prediction) -> float:
        """Return the same of the bands."""
        steady = 1.0 + prediction.row_variance[:, None] * self.seen.bands_of_rows
        steady = steady + (mixing_of_bands(prediction, self.design) if prediction.mixed_x.any() else 0.0)
        expected = steady + self.band_power(relative_bands(prediction), prediction.band_frequency)
        return float(np.sum(deviances(self.seen.bands, expected, self.band_freedom, self.usable["bands"])))

    @cached_property
    def _bins(self) -> RowBins:
        return RowBins.of(self.design)

    @cached_property
    def _common_unit(self) -> Array:
        return np.where(np.isfinite(self.seen.common_unit), self.seen.common_unit, 1.0)

    @cached_property
    def _common_freedom(self) -> Array:
        share = self.flicker2 / (self.flicker2 + self._common_unit)
        return sine_freedom(self.design.frame_count, share)

    @cached_property
    def _accepted_bands(self) -> Array:
        return self.band_power(self.bands2, self.band_frequency)

    @cached_property
    def band_freedom(self) -> Array:
        """Return how many degrees of freedom each ratio of the bands has, (captures, orders)."""
        share = self._accepted_bands / (1.0 + self._accepted_bands)
        return sine_freedom(self.design.frame_count[:, None], share)

    def _excess(self, name: str, prediction: Prediction) -> Array:
        """Return what a variance ratio is expected to be: 1 without any common part."""
        excess = line_excess(self.design, self.seen, prediction, name)
        if prediction.mixed_x.any():
            excess = excess + mixing_of_lines(prediction, self.design, name)
        return np.asarray(1.0 + excess + band_excess(self.design, self.seen, prediction).get(name, 0.0))

    def _comb(self, prediction: Prediction) -> Array:
        expected = np.array([_comb_of(round(prediction.comb_step), prediction.comb_kept, p) for p in COMB_PERIODS])
        return np.where(self.usable["comb"], (self.seen.comb - expected) / self.deviation["comb"], 0.0)


def _comb_of(step: int, kept: float, period: int) -> float:
    """Return the amplitude at a period of a histogram that fills the first codes of each step only."""
    if step == 1 or step % period:
        return 0.0
    return float(np.mean(np.cos(2.0 * np.pi * np.minimum(np.arange(step), kept - 1.0) / period)))


def compare(
    design: Design,
    seen: CaptureStatistics,
    base: Prediction,
    sensitivity: Array,
    repeatability: Repeatability,
    variance_response: Array | None = None,
    floors: Mapping[str, Array] | None = None,
    usable: Mapping[str, Mask] | None = None,
) -> Comparison:
    """Return the measured statistics with weights.

    Args:
        design: Captures and tiles.
        seen: What was measured.
        base: Prediction that tells which entries are free of clipping and how far means respond to light.
        sensitivity: (captures, tiles) d(mean)/d(log light) in DN, model-predicted.
        repeatability: Capture-to-capture and frame-to-frame scatter.
        variance_response: (captures, tiles) d(ln variance)/d(log light); large where a well fills up.
        floors: Standard uncertainty of the accepted effects' own form, by block.
        usable: Entries that count; found anew from `base` where missing.
    """
    mask = dict(usable or usable_entries(design, seen, base))
    if repeatability.row_variance.any():
        seen = effective(design, seen, base)
    deviation = standard_uncertainties(design, seen, base, mask, sensitivity, repeatability)
    if variance_response is not None:
        for name in ("variance", "spatial"):
            light_u_rel = max(repeatability.tau, _LIGHT_U_REL)
            deviation[name] = np.hypot(deviation[name], light_u_rel * variance_response)
    floors = floors or {}
    for name in deviation:
        if name in floors:
            deviation[name] = np.hypot(deviation[name], floors[name])
    of_rows = common_of_rows(design, seen, mask["mean"], sensitivity)
    common = repeatability.flicker2 + _common_bands(design, seen, base)
    bands = (repeatability.bands2, repeatability.band_frequency)
    plain = Comparison(
        design, seen, mask, deviation, {}, _cuts(design), common, 0.0, repeatability.row_variance, of_rows, *bands
    )
    plain = replace(plain, wander2=_steady_wander2(plain, base))
    repeatability = replace(repeatability, flicker2=repeatability.flicker2 + plain.wander2)
    frames = design.frame_count
    shares = {  # of what a frame's tiles share: in the mean of all frames, and in the first less the mean of the others
        "mean": (repeatability.tau**2, 1.0 / frames),
        "first": (0.0, 1.0 + 1.0 / np.maximum(frames - 1.0, 1.0)),
    }
    whiteners = {
        name: whitener(design, deviation[name], mask[name], sensitivity, repeatability, *share)
        for name, share in shares.items()
    }
    if repeatability.bands2.any() or repeatability.row_variance.any():
        tilts = (design, deviation["slope_y"], mask["slope_y"], sensitivity, repeatability, 1.0 / frames)
        whiteners["slope_y"] = whitener_of_tilts(*tilts)
    if repeatability.row_variance.any():
        rows = RowScatter.of(design, base)
        whiteners |= {name: whitener_of_rows(name, deviation[name], mask[name], rows) for name in rows.moved}
    if repeatability.bands2.any():
        whiteners["bands"] = plain.whitener_of_bands()
    return replace(plain, whiteners=whiteners)


def _common_bands(design: Design, seen: CaptureStatistics, prediction: Prediction) -> Array:
    """Return the relative variance of a wave along the rows that a whole frame has in common, (captures,)."""
    bands2 = relative_bands(prediction)
    if not bands2.any():
        return bands2
    return np.asarray(bands2 * wave_power(RowBins.of(design), seen.bands_basis, prediction.band_frequency)[1])


def _steady_wander2(plain: Comparison, base: Prediction) -> float:
    """Return the relative variance by which the source wanders from frame to frame, whatever the exposure."""
    tried = (0.0, *np.geomspace(1e-9, 1e-3, _WANDERS).tolist())
    deviances = np.array([replace(plain, wander2=wander2).common_deviances(base) for wander2 in tried])
    lit = plain.usable["common"] & ~plain.design.closed & (plain.design.source_level > 0)
    declared = plain.design.header.source.reproducibility_u_rel
    return steady_wander2(np.asarray(tried), deviances[:, lit], plain.design.exposure_s[lit], declared)


def _cuts(design: Design) -> dict[str, slice]:
    captures, tiles = len(design.captures), len(design.tiles)
    sizes = dict.fromkeys(TILE_BLOCKS, captures * tiles) | dict.fromkeys(CAPTURE_BLOCKS, captures)
    sizes["comb"] = captures * len(COMB_PERIODS)
    sizes["bands"] = captures * RowBins.of(design).orders
    cuts, start = {}, 0
    for name, size in sizes.items():
        cuts[name] = slice(start, start + size)
        start += size
    return cuts
