"""Puts measured and predicted statistics on one scale: standardised residuals, whitened, in one vector.

Means of one capture share its repeatability (a common relative error) and are whitened together; variances are
compared as logarithms; the rest is in units of its standard uncertainty. The weights never come from the
prediction under test, so that two models compared on one `Comparison` differ in log-likelihood by Δχ²/2.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radiometer.reconciliation.design import COMB_PERIODS, CaptureStatistics, Design
from radiometer.reconciliation.lines import RowBins, wave_power
from radiometer.reconciliation.repeatability import Darkness, steady_wander2
from radiometer.reconciliation.shared_errors import (
    ANSCOMBE,
    Part,
    Repeatability,
    band_excess,
    common_of_rows,
    errors_of_darkness,
    line_excess,
    mixing_of_bands,
    mixing_of_lines,
    of_fair_tiles,
    phases_of_wave,
    relative_bands,
    relative_flicker,
    renewed_patterns,
    shared_errors,
    unsteady_phases,
    whiteners,
    with_heavy_rows,
)
from radiometer.reconciliation.statistics import STATISTICS, Given, Prediction, Scale, Scatter, family_of, named
from radiometer.statistics.chances import deviances, followed_scores, log_bias, sine_freedom
from radiometer.typing import Array, Mask

CAPTURE_BLOCKS: Final = named(given=Given.CAPTURE)
FAMILY: Final = {name: family_of(name) for name in STATISTICS}
_LOGARITHMS: Final = (*named(scale=Scale.LOGARITHM), *named(scale=Scale.LINES))
_LIGHT_U_REL: Final = 3e-3  # how well the light of one tile is taken to be known where its variance hangs on it
_WANDERS: Final = 61  # relative variances tried, ten to a decade
_LEAST_RATIO: Final = 0.1  # of a profile of lines to its pixels: a trial may predict lines calmer than any are
_FALSE_OUTLIERS: Final = 0.02  # expected in a capture without hot pixels; keeps the square root finite


@dataclass(frozen=True, eq=False)
class Comparison:
    """Measured statistics with their fixed weights."""

    design: Design  # captures and tiles
    seen: CaptureStatistics  # what was measured
    usable: Mapping[str, Mask]  # which entries of each block count
    deviation: Mapping[str, Array]  # standard uncertainty of each entry (of its logarithm for variances)
    # Of the statistics whose entries share errors: (captures, entries, entries) inverse Cholesky factor of the
    # covariance
    whiteners: Mapping[str, Array]
    cuts: Mapping[str, slice]  # rows of each block in the vector
    flicker2: Array  # (captures,) relative variance of a whole frame by the accepted effects, by chance and by order
    wander2: float  # the same of the source itself, whatever the exposure, up to what its stated reproducibility allows
    rows2: Array  # (captures,) row noise of the accepted effects in DN²
    common_of_rows: Array  # (captures,) what 1 DN² of row noise adds to the ratio of the frame-common fluctuation
    bands2: Array  # (captures,) relative variance of the accepted effects' wave along the rows
    band_frequency: float  # periods of that wave per row

    @property
    def size(self) -> int:
        """Return the length of the vector, masked entries included."""
        return int(max(cut.stop for cut in self.cuts.values()))

    def residual(self, prediction: Prediction) -> Array:
        """Return measured minus predicted, whitened, (entries,) or (entries, models); 0 for what does not count."""
        return self.changes({name: self._compared(name) for name in self.cuts}, prediction)

    def expected(self, prediction: Prediction) -> dict[str, Array]:
        """Return what a model expects of each statistic, on the scale on which it is compared."""
        return {name: self._expected(name, prediction) for name in self.cuts}

    def changes(self, base: Mapping[str, Array], several: Prediction) -> Array:
        """Return what is `expected` of one model less what others expect, whitened, (entries, models).

        It is exactly 0 where they expect the same.
        """
        models = several.mean.shape[:-2]
        found = np.zeros((self.size, *models))
        for name, cut in self.cuts.items():
            differs = base[name] - self._expected(name, several)
            if differs.any():
                shape = self.usable[name].shape
                own = differs if differs.ndim > len(shape) or not models else np.broadcast_to(differs, models + shape)
                moved = np.moveaxis(own, 0, -1) if models else own
                is_lone = STATISTICS[name].scale is Scale.SCORE and name not in self.whiteners  # of unit variance
                found[cut].reshape(*shape, *models)[...] = moved if is_lone else self.whiten(name, moved)
        return found

    def whiten(self, block: str, values: Array) -> Array:
        """Return raw changes of a block (axes as the block, more may follow) in whitened units."""
        if block in self.whiteners:
            return self._whitened(block, values)
        mask, sigma = self.usable[block], self.deviation[block]
        extra = (None,) * (values.ndim - mask.ndim)
        return np.where(mask[(..., *extra)], values / sigma[(..., *extra)], 0.0)

    def whitened(self, name: str, part: Part) -> Array:
        """Return what a unit of each z of a shared error does to a statistic, (entries, n) whitened."""
        columns = part.columns
        if self.usable[name].ndim == 1:
            return self.whiten(name, columns[:, 0])
        return self.whiten(name, columns).reshape(-1, columns.shape[-1])

    def degrees(self, block: str) -> int:
        """Return how many entries of a block count."""
        return int(self.usable[block].sum())

    def capture_of_rows(self) -> NDArray[np.intp]:
        """Return for each entry of the vector the capture that it belongs to."""
        captures = np.arange(len(self.design.captures))
        entries = (int(np.prod(row.shape(self.design)[1:])) for row in STATISTICS.values())
        return np.concatenate([np.repeat(captures, count) for count in entries])

    def counts(self) -> Mask:
        """Return for each entry of the vector whether it counts."""
        return np.concatenate([self.usable[name].ravel() for name in self.cuts])

    def _whitened(self, block: str, values: Array) -> Array:
        mask = self.usable[block]
        extra = (None,) * (values.ndim - 2)
        columns = np.where(mask[(..., *extra)], values, 0.0).reshape(*mask.shape, -1)
        return np.asarray(np.matmul(self.whiteners[block], columns).reshape(values.shape))

    def _bands(self, prediction: Prediction) -> Array:
        bands2 = relative_bands(prediction)
        if not (bands2.any() or prediction.row_variance.any() or prediction.mixes):
            return self._calm_bands
        power = self.band_power(bands2, prediction.band_frequency)
        if prediction.mixes:
            power = power + mixing_of_bands(prediction, self.design)
        return self.band_scores(power, prediction.row_variance)

    @cached_property
    def _calm_common(self) -> Array:
        return self.common_scores(np.zeros_like(self.flicker2), np.zeros(len(self.design.captures)))

    @cached_property
    def _calm_bands(self) -> Array:
        return self.band_scores(np.zeros_like(self.seen.bands_of_rows), np.zeros(len(self.design.captures)))

    def _compared(self, name: str) -> Array:
        """Return what was measured, on the scale on which it is compared; of scores 0, for they hold it already."""
        scale = STATISTICS[name].scale
        if scale is Scale.SCORE:
            return np.zeros(self.usable[name].shape)
        if scale is Scale.ROOT:
            return np.asarray(2.0 * np.sqrt(getattr(self.seen, name) + ANSCOMBE))
        return self._log_seen[name] if name in self._log_seen else self._seen[name]

    def _expected(self, name: str, prediction: Prediction) -> Array:
        """Return the same of what is expected; axes that are missing are those of what models have in common."""
        scale = STATISTICS[name].scale
        if scale is Scale.SCORE:
            return -(self._common if name == "common" else self._bands)(prediction)
        if scale is Scale.LINES:
            return np.log(self._excess(name, prediction))
        if scale is Scale.COMB:
            return self._comb(prediction)
        expected: Array = getattr(prediction, name)
        if scale is Scale.LOGARITHM:
            return np.asarray(np.log(np.maximum(expected, 1e-12)))
        if scale is Scale.ROOT:
            return np.asarray(2.0 * np.sqrt(_FALSE_OUTLIERS + np.maximum(expected, 0.0) + ANSCOMBE))
        return expected

    @cached_property
    def _seen(self) -> dict[str, Array]:
        return {name: np.where(mask, getattr(self.seen, name), 0.0) for name, mask in self.usable.items()}

    @cached_property
    def _log_seen(self) -> dict[str, Array]:
        """Return the logarithms of measured variances, freed of the bias that few degrees of freedom give."""
        found = {}
        for name in _LOGARITHMS:
            mask = self.usable[name]
            dof = np.where(mask, getattr(self.seen, f"{name}_dof"), 10.0)
            seen = np.where(mask, getattr(self.seen, name), 1.0)
            found[name] = np.log(np.maximum(seen, 1e-12)) - log_bias(dof)
        return found

    def _common(self, prediction: Prediction) -> Array:
        flicker2 = self.flicker_of(prediction)
        if not (flicker2.any() or prediction.row_variance.any()):
            return self._calm_common
        return self.common_scores(flicker2, prediction.row_variance)

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
        expected = 1.0 + row_variance[..., None] * self.seen.bands_of_rows + power
        known = self.bands2.any() or self.rows2.any()
        accepted = 1.0 + self.rows2[:, None] * self.seen.bands_of_rows + self._accepted_bands if known else None
        return followed_scores(self.seen.bands, expected, accepted, self.band_freedom, self.usable["bands"])

    def band_power(self, bands2: Array, frequency: float) -> Array:
        """Return what a wave along the rows adds to the ratios of the bands, (captures, orders)."""
        if not bands2.any():
            return np.zeros_like(self.seen.bands_of_rows)
        return np.asarray(bands2[..., None] * wave_power(self._bins, self.seen.bands_basis, frequency)[0])

    def flicker_of(self, prediction: Prediction) -> Array:
        """Return the relative variance that all light of a frame has in common, bands included, (captures,).

        Chance is in the weights too, once it is accepted; what follows the order of the frames is not.
        """
        chance = relative_flicker(prediction) + _common_bands(self.design, self.seen, prediction)
        return chance + of_fair_tiles(prediction, prediction.ordered_variance) + self._first_of_two(prediction)

    def _first_of_two(self, prediction: Prediction) -> Array:
        """Return what a first frame that differs adds to it where there are but two frames, (captures,)."""
        two = self.design.frame_count == 2
        if not (two.any() and prediction.first.any()):
            return np.zeros(prediction.signal.shape[:-1])
        light, variance = prediction.signal * prediction.gain[..., None], self.seen.variance
        known = self.usable["first"] & (variance > 0)
        weight = np.where(known, light * self.seen.pixels / np.where(known, variance, 1.0), 0.0)
        whole = np.maximum(np.sum(weight * light, axis=-1), 1e-300)
        return np.where(
            two, np.square(np.sum(weight * np.where(known, prediction.first, 0.0), axis=-1) / whole) / 2.0, 0.0
        )

    def common_deviance(self, prediction: Prediction) -> float:
        """Return the deviance of the frame-common fluctuation: −2·ln of its exact likelihood but for a constant."""
        return float(np.sum(self.deviances_of_flicker(self.flicker_of(prediction), prediction.row_variance)))

    def deviances_of_flicker(self, flicker2: Array, row_variance: Array) -> Array:
        """Return the same for a relative variance of the light, (…, captures), with row noise in DN², (captures,)."""
        expected = self._expected_common(flicker2, row_variance)
        return deviances(self.seen.common, expected, self._common_freedom, self.usable["common"])

    def band_deviance(self, prediction: Prediction) -> float:
        """Return the same of the bands."""
        steady = 1.0 + prediction.row_variance[..., None] * self.seen.bands_of_rows
        steady = steady + (mixing_of_bands(prediction, self.design) if prediction.mixes else 0.0)
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

    @property
    def share_of_bands(self) -> Array:
        """Return the share of the accepted wave in the ratios of the bands, (captures, orders)."""
        return self._accepted_bands / (1.0 + self._accepted_bands)

    @cached_property
    def band_freedom(self) -> Array:
        """Return how many degrees of freedom each ratio of the bands has, (captures, orders)."""
        return sine_freedom(self.design.frame_count[:, None], self.share_of_bands)

    def _excess(self, name: str, prediction: Prediction) -> Array:
        """Return what a variance ratio is expected to be: 1 without any common part."""
        excess = line_excess(self.design, self.seen, prediction, name)
        if prediction.mixes:
            excess = excess + mixing_of_lines(prediction, self.design, name)
        whole = 1.0 + excess + band_excess(self.design, self.seen, prediction).get(name, 0.0)
        return np.asarray(np.maximum(whole, _LEAST_RATIO))

    def _comb(self, prediction: Prediction) -> Array:
        """Return the amplitude at each period of a histogram that fills the first codes of each step only."""
        step, kept = round(prediction.comb_step), prediction.comb_kept
        filled = np.minimum(np.arange(step), kept - 1.0)
        there = [step > 1 and step % period == 0 for period in COMB_PERIODS]
        waves = (np.mean(np.cos(2.0 * np.pi * filled / period)) for period in COMB_PERIODS)
        return np.array([float(wave) if shown else 0.0 for wave, shown in zip(waves, there, strict=True)])


def compare(
    design: Design,
    seen: CaptureStatistics,
    base: Prediction,
    sensitivity: Array,
    repeatability: Repeatability,
    variance_response: Array,
    floors: Mapping[str, Array],
    usable: Mapping[str, Mask],
    darkness: Darkness | None,
) -> Comparison:
    """Return the measured statistics with weights.

    Args:
        base: Prediction that shows which entries are free of clipping and how far means respond to light.
        sensitivity: (captures, tiles) d(mean)/d(log light) in DN, model-predicted.
        repeatability: Capture-to-capture and frame-to-frame scatter.
        variance_response: (captures, tiles) d(ln variance)/d(log light); large where a well fills up.
        floors: Standard uncertainty of the accepted effects' own form, by block.
        usable: Entries that count, by block.
        darkness: How far darkness differs from frame to frame; None where it does not.
    """
    mask = dict(usable)
    if repeatability.row_variance.any():
        seen = with_heavy_rows(design, seen, base)
    deviation = _deviations(Scatter(design, seen, base, mask["variance"]), repeatability, variance_response, floors)
    none, of_rows = (
        np.zeros(len(design.captures)),
        common_of_rows(design, seen, np.where(mask["mean"], sensitivity, 0.0)),
    )
    bands = (repeatability.bands2, repeatability.band_frequency)
    plain = Comparison(
        design, seen, mask, deviation, {}, _cuts(design), none, 0.0, repeatability.row_variance, of_rows, *bands
    )
    plain = replace(plain, flicker2=plain.flicker_of(base))
    plain = replace(plain, wander2=_steady_wander2(plain, base))
    repeatability = replace(repeatability, flicker2=repeatability.flicker2 + plain.wander2)
    errors = shared_errors(design, base, mask, sensitivity, repeatability, _of_noise(variance_response))
    if repeatability.bands2.any():
        share, frequency = plain.share_of_bands, plain.band_frequency
        errors = (*errors, phases_of_wave(design, seen.bands_basis, mask["bands"], share, frequency))
    if darkness is not None:
        errors = (*errors, *errors_of_darkness(design, mask, darkness))
    return replace(plain, whiteners=whiteners(errors, deviation, mask))


def _deviations(
    scatter: Scatter, repeatability: Repeatability, variance_response: Array, floors: Mapping[str, Array]
) -> dict[str, Array]:
    found = {name: row.sigma(scatter) for name, row in STATISTICS.items()}
    given = (scatter.design, scatter.seen, scatter.base)
    by_light = _of_noise(max(repeatability.tau, _LIGHT_U_REL) * variance_response)
    for further in (unsteady_phases(*given), renewed_patterns(*given), by_light, floors):
        found |= {name: np.hypot(found[name], values) for name, values in further.items()}
    return found


def _of_noise(response: Array) -> dict[str, Array]:
    return {name: response for name, row in STATISTICS.items() if row.follows_light}


def _common_bands(design: Design, seen: CaptureStatistics, prediction: Prediction) -> Array:
    bands2 = relative_bands(prediction)
    if not prediction.waves:
        return bands2
    return np.asarray(bands2 * wave_power(RowBins.of(design), seen.bands_basis, prediction.band_frequency)[1])


def _steady_wander2(plain: Comparison, base: Prediction) -> float:
    tried = np.array((0.0, *np.geomspace(1e-9, 1e-3, _WANDERS)))
    deviances = plain.deviances_of_flicker(plain.flicker_of(base) + tried[:, None], base.row_variance)
    lit = plain.usable["common"] & ~plain.design.closed & (plain.design.source_level > 0)
    declared = plain.design.header.source.reproducibility_u_rel
    return steady_wander2(tried, deviances[:, lit], plain.design.exposure_s[lit], declared)


def _cuts(design: Design) -> dict[str, slice]:
    cuts, start = {}, 0
    for name, row in STATISTICS.items():
        cuts[name] = slice(start, start + int(np.prod(row.shape(design))))
        start = cuts[name].stop
    return cuts
