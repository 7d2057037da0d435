"""Finds where measured and simulated disagree, without any idea of why: axes, smooth bases on them, and tests.

Score tests of smooth trends: each statistic along each covariate, in three forms (in proportion to the light, as a
constant in DN, as a constant in electrons). The residual and the trends are first freed of all that the nuisances
can explain. Bonferroni over all tests holds the false-alarm rate.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.polynomial import legendre
from scipy.special import chdtrc, gammaln

from radiometer.reconciliation.comparison import CAPTURE_BLOCKS, FAMILY, Comparison
from radiometer.reconciliation.design import Design
from radiometer.reconciliation.linear import LinearFit
from radiometer.reconciliation.state import FitState, LinearTerm
from radiometer.reconciliation.statistics import ADDITIVE, MULTIPLICATIVE, STATISTICS, Prediction
from radiometer.reconciliation.thresholds import SIGNIFICANCE
from radiometer.reconciliation.tile_model import TileModel
from radiometer.statistics.chances import chi2_beyond, ranks
from radiometer.typing import Array
from simulators.effects.catalogue import CatalogueEffect

DEGREE: Final = 4
_MOST_LEVELS: Final = 8  # a covariate with fewer distinct values is treated level by level
_FEWEST_PER_WAVE: Final = 6  # captures
_MOST_WAVES: Final = 16
_LEVELLED: Final = ("gain_db", "f_number", "source_level", "pattern")


@dataclass(frozen=True, slots=True, eq=False)
class Covariate:
    """One axis: a value per capture and tile."""

    name: str  # name as in result files
    value: Array  # (captures, tiles)
    per_capture: bool  # whether all tiles of a capture share it
    waves: int = 0  # number of half waves that its basis holds in place of low polynomials; 0 for those

    def basis(self) -> Array:
        """Return smooth functions of the covariate, (captures, tiles, terms), the constant left out."""
        flat = self.value.ravel()
        levels = np.unique(np.round(flat, 9))
        if levels.size < 2:
            return np.zeros((*self.value.shape, 0))
        if self.waves:
            half_turns = np.pi * 0.5 * (_linear_axis(flat) + 1.0)
            columns = [np.cos(k * half_turns) for k in range(1, self.waves + 1)]
            return np.stack(columns, axis=-1).reshape(*self.value.shape, -1)
        if levels.size <= _MOST_LEVELS or (self.name in _LEVELLED and levels.size <= 2 * _MOST_LEVELS):
            columns = [(np.abs(flat - level) < 1e-8).astype(np.float64) for level in levels[1:]]
            return np.stack(columns, axis=-1).reshape(*self.value.shape, -1)
        u = 0.5 * (_linear_axis(ranks(np.round(flat, 9))) + _linear_axis(flat))  # repeats differ in their last bits
        columns = [np.asarray(legendre.legval(u, np.eye(DEGREE + 1)[k])) for k in range(1, DEGREE + 1)]
        return np.stack(columns, axis=-1).reshape(*self.value.shape, -1)


def _linear_axis(values: Array) -> Array:
    return np.asarray(2.0 * (values - values.min()) / max(np.ptp(values), 1e-30) - 1.0)


def covariates(model: TileModel, prediction: Prediction) -> dict[str, Covariate]:
    """Return all covariates that vary within a capture set, by name."""
    design = model.design
    found = {}
    for covariate in (*_of_captures(design, prediction), *_of_tiles(model), _signal(prediction)):
        if np.isfinite(covariate.value).all() and np.ptp(covariate.value) > 1e-9:
            found[covariate.name] = covariate
    return found


def _of_captures(design: Design, prediction: Prediction) -> list[Covariate]:
    ones = np.ones((1, len(design.tiles)))

    def wide(name: str, values: Array) -> Covariate:
        return Covariate(name, values[:, None] * ones, per_capture=True)

    warm = design.temperature_c
    order = np.argsort([capture.frames[0] for capture in design.captures])
    level = np.log10(1.0 + prediction.signal.mean(axis=1))
    before = np.zeros_like(level)
    before[order[1:]] = level[order[:-1]]
    waves = min(_MOST_WAVES, len(design.captures) // _FEWEST_PER_WAVE)
    return [
        wide("exposure_s", np.log10(design.exposure_s)),
        wide("gain_db", design.gain_db),
        wide("f_number", np.log2(design.f_number)),
        wide("temperature_C", warm if np.isfinite(warm).all() else np.zeros_like(level)),
        wide("source_level", design.source_level),
        wide("timestamp_s", design.timestamp_s),
        wide("pattern", np.where(design.closed, 0, design.pattern_index).astype(np.float64)),
        wide("previous_frame", before),
        *([replace(wide("time_waves", design.timestamp_s), waves=waves)] if waves > DEGREE else []),
    ]


def _of_tiles(model: TileModel) -> list[Covariate]:
    design = model.design
    ones = np.ones((len(design.captures), 1))
    geometry = model.context.geometry
    x, y = geometry.x_px.mean(axis=-1), geometry.y_px.mean(axis=-1)
    radius = geometry.field_radius().mean(axis=-1)
    patch = np.log10(np.maximum(model.radiance, 1e-30))[design.pattern_index]
    lit = np.where(design.closed[:, None], patch.mean(), patch)
    return [
        Covariate("patch_level", lit, per_capture=False),
        Covariate("field_radius", radius * ones, per_capture=False),
        Covariate("image_x", x * ones, per_capture=False),
        Covariate("image_y", y * ones, per_capture=False),
        Covariate("half_x", (x > design.shape[1] / 2.0) * ones, per_capture=False),
        Covariate("half_y", (y > design.shape[0] / 2.0) * ones, per_capture=False),
    ]


def _signal(prediction: Prediction) -> Covariate:
    return Covariate("signal", np.log10(10.0 + np.maximum(prediction.signal, 0.0)), per_capture=False)


_DRAWS: Final = 2000
_DRAWN_WITH: Final = 20261122  # the same draws for the same data
_FEWEST_BEYOND: Final = 8  # draws, below which they tell the chance no better than the bound does
_OWN_DIRECTION: Final = 1e-4  # share of a trend that the nuisances must leave
# A disagreement that is the same everywhere has no covariate of its own; this is where its statistic lies.
_AXIS_OF_CONSTANT: Final = {
    "mean": "signal",
    "slope_x": "image_x",
    "slope_y": "image_y",
    "first": "previous_frame",
    "common": "exposure_s",
    "row_temporal": "image_y",
    "bands": "image_y",
    "columns": "image_x",
    "rows": "image_y",
    "edge": "image_x",
    "outliers": "exposure_s",
    "unsteady": "gain_db",
}
_AXIS_OF_SHAPE: Final = {"time_waves": "timestamp_s", "half_x": "image_x", "half_y": "image_y"}
_AS_SEEN: Final = {"screen_x": "image_x", "screen_y": "image_y"}


@dataclass(frozen=True, slots=True)
class Disagreement:
    """One test."""

    block: str  # statistic
    where: str  # covariate
    form: str  # form of the trend
    chi2: float  # what the trend would explain
    rank: int  # its free parameters
    p_value: float  # chance of that much without a disagreement

    @property
    def log_p(self) -> float:
        """Return ln p, finite also where p underflows."""
        if self.p_value > 1e-280:
            return float(np.log(self.p_value))
        half = self.chi2 / 2.0
        return float(-half + (self.rank / 2.0 - 1.0) * np.log(half) - gammaln(self.rank / 2.0))

    @property
    def order(self) -> float:
        """Return ln p by which tests are ranked, to eight digits.

        An offset with the gain and one without are the same at a single gain: rounding must not choose between them.
        """
        return float(f"{self.log_p:.8g}")

    @property
    def family(self) -> str:
        """Return the statistic without its direction."""
        return FAMILY.get(self.block, self.block)


@dataclass(frozen=True, slots=True, eq=False)
class Basis:
    """The trend of one test."""

    block: str  # statistic
    where: str  # covariate
    form: str  # form of the trend
    columns: Array  # (entries of the block, terms) whitened


def localise(state: FitState) -> tuple[Disagreement, ...]:
    """Return all tests, the most significant first; of forms that are one and the same here, as rows list them."""
    tests = (score(state, basis, state.fit) for basis in _trend_bases(state))
    return tuple(sorted((test for test in tests if test is not None), key=lambda test: test.order))


def _trend_bases(state: FitState) -> Iterator[Basis]:
    axes = covariates(state.model, state.prediction)
    for block, row in STATISTICS.items():
        if not state.comparison.usable[block].any():
            continue
        for name, form in itertools.product((n for n in row.along if n == "constant" or n in axes), row.forms):
            columns = _whitened_basis(
                state.comparison, state.prediction, state.sensitivity, block, form, axes.get(name)
            )
            if columns.shape[1]:
                yield Basis(block, name, form, columns)


def score(state: FitState, basis: Basis, fit: LinearFit) -> Disagreement | None:
    """Return the test of one trend on top of a linear fit; None where the fit leaves nothing of the trend."""
    explained, rank = fit.score(state.comparison.cuts[basis.block], basis.columns)
    if not rank:
        return None
    return Disagreement(basis.block, basis.where, basis.form, explained, rank, chi2_beyond(explained, rank))


def significant(tests: Sequence[Disagreement]) -> tuple[Disagreement, ...]:
    """Return the tests that stand out at the level of `SIGNIFICANCE` after Bonferroni's correction."""
    limit = np.log(SIGNIFICANCE / max(len(tests), 1))
    return tuple(test for test in tests if test.log_p < limit)


def global_p_value(state: FitState, tests: Sequence[Disagreement]) -> float:
    """Return the chance that any of all tests is as significant as the best of these, without any disagreement.

    The tests are correlated: their columns overlap, and the nuisances take a part of each. Under no disagreement the
    whitened residual is normal, so that the products of all columns with it are normal too, with a covariance that is
    known; their draws give the distribution of the least p. Below the resolution of the draws, Bonferroni's bound
    holds.

    Source: N. Anau Montel, J. Alvey, C. Weniger, Phys. Rev. D 111 (2025) 083013, who ask many distortions at once and
    calibrate the least p by simulations.
    """
    if not tests:
        return 1.0
    bound = min(len(tests) * float(np.exp(tests[0].log_p)), 1.0)
    if bound < _FEWEST_BEYOND / _DRAWS:  # no draw would reach it
        return bound
    least = _least_of_draws(state, list(_trend_bases(state)))
    beyond = int(np.sum(least <= tests[0].log_p))
    return max(beyond, _FEWEST_BEYOND) / least.size


def _least_of_draws(state: FitState, bases: Sequence[Basis]) -> Array:
    """Return ln of the least p of all tests for residuals that are drawn without a disagreement, (draws,)."""
    fit, cuts = state.fit, state.comparison.cuts
    taken = [fit.half(fit.pull(basis.columns, cuts[basis.block].start)) for basis in bases]
    together = np.hstack(taken)
    covariance = -together.T @ together
    ends = np.cumsum([0, *(part.shape[1] for part in taken)])
    places = [slice(int(low), int(high)) for low, high in itertools.pairwise(ends)]
    for (first, a), (second, b) in itertools.product(zip(bases, places, strict=True), repeat=2):
        if first.block == second.block:
            covariance[a, b] += first.columns.T @ second.columns
    lengths = np.concatenate([np.linalg.norm(basis.columns, axis=0) for basis in bases])
    lengths = np.where(lengths > 0, lengths, 1.0)
    covariance = covariance / np.outer(lengths, lengths)
    values, vectors = np.linalg.eigh(covariance)
    # The symmetric root is the one that rounding does not turn where eigenvalues are equal.
    root = (vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T
    drawn = root @ np.random.default_rng(_DRAWN_WITH).standard_normal((root.shape[1], _DRAWS))
    least = np.zeros(_DRAWS)
    for place in places:
        own, directions = np.linalg.eigh(covariance[place, place])
        kept = own > _OWN_DIRECTION
        if kept.any():
            chi2 = np.sum((directions[:, kept].T @ drawn[place]) ** 2 / own[kept][:, None], axis=0)
            least = np.minimum(least, np.log(np.maximum(chdtrc(int(kept.sum()), chi2), 1e-300)))
    return least


def _whitened_basis(
    comparison: Comparison, prediction: Prediction, sensitivity: Array, block: str, form: str, axis: Covariate | None
) -> Array:
    captures, tiles = prediction.mean.shape
    smooth = np.ones((captures, tiles, 1)) if axis is None else axis.basis()
    if block == "comb":
        return _flat(comparison.whiten(block, np.ones((*comparison.usable[block].shape, 1))))
    if block == "bands":
        return _flat(comparison.whiten(block, _of_bands(comparison, axis)))
    if block in CAPTURE_BLOCKS:
        values = smooth[:, 0, :] if axis is None or axis.per_capture else smooth.mean(axis=1)
        return comparison.whiten(block, values)
    return _flat(comparison.whiten(block, smooth * _form(block, form, prediction, sensitivity)[:, :, None]))


def _of_bands(comparison: Comparison, axis: Covariate | None) -> Array:
    """Return the trend over captures and spatial frequencies; along the image these take the place of the rows."""
    captures, orders = comparison.usable["bands"].shape
    if axis is None:
        return np.ones((captures, orders, 1))
    if axis.per_capture:
        return np.repeat(axis.basis()[:, :1, :], orders, axis=1)
    return Covariate(axis.name, np.tile(np.arange(orders, dtype=np.float64), (captures, 1)), per_capture=False).basis()


def _form(block: str, form: str, prediction: Prediction, sensitivity: Array) -> Array:
    gain = np.broadcast_to(prediction.gain[:, None], sensitivity.shape)
    if block in ("variance", "spatial"):
        return np.ones_like(sensitivity) if form == MULTIPLICATIVE else gain**2 / getattr(prediction, block)
    if block.startswith("neighbour"):
        return np.ones_like(sensitivity)
    if form == MULTIPLICATIVE:
        return sensitivity
    return np.ones_like(sensitivity) if form == ADDITIVE else np.asarray(gain)


def _flat(values: Array) -> Array:
    return values.reshape(-1, values.shape[-1])


def smooth_term(state: FitState, test: Disagreement) -> LinearTerm:
    """Return the empirical term that takes up a disagreement without naming it."""
    axis = covariates(state.model, state.prediction).get(test.where)
    size = _whitened_basis(state.comparison, state.prediction, state.sensitivity, test.block, test.form, axis).shape[1]

    def build(comparison: Comparison, prediction: Prediction, sensitivity: Array) -> Array:
        part = _whitened_basis(comparison, prediction, sensitivity, test.block, test.form, axis)
        columns = np.zeros((comparison.size, part.shape[1]))
        columns[comparison.cuts[test.block]] = part
        return columns

    name = f"{test.block} | {test.where} | {test.form}"
    return LinearTerm(name, build, np.full(size, np.inf), test.block, test.where, test.form)


def axis_of(where: str, block: str) -> str:
    """Return the covariate of a test's axis."""
    return _AXIS_OF_CONSTANT.get(block, "signal") if where == "constant" else _AXIS_OF_SHAPE.get(where, where)


def places(state: FitState, most: int) -> tuple[Disagreement, ...]:
    """Return up to so many tests, each the most significant along a covariate that is not listed yet."""
    bases = tuple(_trend_bases(state))
    fit, found = state.fit, list[Disagreement]()
    for _ in range(most):
        taken = {axis_of(test.where, test.block) for test in found}
        left = [basis for basis in bases if axis_of(basis.where, basis.block) not in taken]
        rated = [(test, basis) for basis in left if (test := score(state, basis, fit)) is not None]
        if not rated:
            break
        test, basis = min(rated, key=lambda entry: entry[0].order)
        found.append(test)
        lengths = np.linalg.norm(basis.columns, axis=0)
        columns = np.zeros((state.comparison.size, int(np.sum(lengths > 0))))
        columns[state.comparison.cuts[basis.block]] = basis.columns[:, lengths > 0] / lengths[lengths > 0]
        fit = fit.extended(fit.followed(state.pad(columns)))
    return tuple(found)


def own_place(effect: CatalogueEffect) -> tuple[str, str]:
    """Return the covariate (as the picture shows it) and the statistic of an effect."""
    return _AS_SEEN.get(effect.where, effect.where), effect.block


def departing(tests: Sequence[Disagreement], effects: Sequence[CatalogueEffect]) -> list[str]:
    """Return the names of effects that leave structure in their own statistic and place.

    All tests together share one chance of a false alarm; the few that test whether an effect follows its law have a
    separate one. Another cause that looks much alike is found out there first.
    """
    found = []
    for effect in effects:
        own = [t for t in tests if (axis_of(t.where, t.block), t.family) == own_place(effect)]
        if any(test.p_value < SIGNIFICANCE / len(own) for test in own):
            found.append(effect.name)
    return found
