"""Finds where measured and simulated disagree, without any idea of why.

Score tests of smooth trends: each statistic along each covariate, in three forms (in proportion to the light, as a
constant in DN, as a constant in electrons). The residual and the trends are first freed of all that the nuisances
can explain. Bonferroni over all tests holds the false-alarm rate.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.special import gammaln
from scipy.stats import chi2

from radiometer.reconcile.comparison import CAPTURE_BLOCKS, FAMILY, Comparison
from radiometer.reconcile.covariates import Covariate, covariates
from radiometer.reconcile.design import Array
from radiometer.reconcile.state import FitState
from radiometer.reconcile.terms import LinearTerm
from radiometer.reconcile.tile_model import Prediction

MULTIPLICATIVE: Final = "multiplicative"
ADDITIVE: Final = "additive"
ADDITIVE_GAIN: Final = "additive × gain"
SIGNIFICANT: Final = 0.005  # chance of any false alarm among all tests of one pass; a search makes two or more

_CAPTURE_AXES: Final = (
    "exposure_s",
    "gain_db",
    "f_number",
    "temperature_C",
    "source_level",
    "timestamp_s",
    "pattern",
    "previous_frame",
)
_TILE_AXES: Final = ("signal", "patch_level", "field_radius", "image_x", "image_y")
_FORMS_OF_MEAN: Final = (MULTIPLICATIVE, ADDITIVE, ADDITIVE_GAIN)

# Statistic → (axes, forms). A trend must be possible physically: hot pixels do not depend on the f-number.
_TESTS: Final[dict[str, tuple[tuple[str, ...], tuple[str, ...]]]] = {
    "mean": ((*_CAPTURE_AXES, *_TILE_AXES, "constant"), _FORMS_OF_MEAN),
    "slope_x": (("constant", "image_x", "image_y", "field_radius", "f_number", "exposure_s"), (MULTIPLICATIVE,)),
    "slope_y": (("constant", "image_x", "image_y", "field_radius", "f_number", "exposure_s"), (MULTIPLICATIVE,)),
    "variance": (("signal", "gain_db", "exposure_s", "temperature_C", "image_y"), (MULTIPLICATIVE, ADDITIVE_GAIN)),
    "spatial": (("signal", "gain_db", "exposure_s", "temperature_C", "image_y"), (MULTIPLICATIVE, ADDITIVE_GAIN)),
    "neighbour_x": (("constant", "signal", "gain_db"), (MULTIPLICATIVE,)),
    "neighbour_y": (("constant", "signal", "gain_db"), (MULTIPLICATIVE,)),
    "first": (("constant", "previous_frame"), (MULTIPLICATIVE,)),
    "common": (("constant", "exposure_s", "source_level"), (MULTIPLICATIVE,)),
    "row_temporal": (("constant", "gain_db", "exposure_s"), (MULTIPLICATIVE,)),
    "columns": (("constant", "gain_db", "exposure_s"), (MULTIPLICATIVE,)),
    "rows": (("constant", "gain_db", "exposure_s"), (MULTIPLICATIVE,)),
    "edge": (("constant", "f_number"), (MULTIPLICATIVE,)),
    "outliers": (("constant", "exposure_s", "temperature_C"), (MULTIPLICATIVE,)),
    "comb": (("constant",), (MULTIPLICATIVE,)),
}


@dataclass(frozen=True, slots=True)
class Disagreement:
    """One test.

    Attributes:
        block: Statistic.
        where: Covariate.
        form: Form of the trend.
        chi2: What the trend would explain.
        rank: Its free parameters.
        p_value: Chance of that much without a disagreement.
    """

    block: str
    where: str
    form: str
    chi2: float
    rank: int
    p_value: float

    @property
    def log_p(self) -> float:
        """Return ln p, finite also where p underflows."""
        if self.p_value > 1e-280:
            return float(np.log(self.p_value))
        half = self.chi2 / 2.0
        return float(-half + (self.rank / 2.0 - 1.0) * np.log(half) - gammaln(self.rank / 2.0))

    @property
    def family(self) -> str:
        """Return the statistic without its direction."""
        return FAMILY.get(self.block, self.block)


def localise(state: FitState) -> tuple[Disagreement, ...]:
    """Return all tests, the most significant first."""
    axes = covariates(state.model, state.prediction)
    found = []
    for block, (names, forms) in _TESTS.items():
        if not state.comparison.usable[block].any():
            continue
        for name in names:
            if name != "constant" and name not in axes:
                continue
            for form in forms:
                test = _test(state, block, name, form, axes.get(name))
                if test is not None:
                    found.append(test)
    return tuple(sorted(found, key=lambda test: test.log_p))


def significant(tests: Sequence[Disagreement]) -> tuple[Disagreement, ...]:
    """Return the tests that stand out at the level of `SIGNIFICANT` after Bonferroni's correction."""
    limit = np.log(SIGNIFICANT / max(len(tests), 1))
    return tuple(test for test in tests if test.log_p < limit)


def _test(state: FitState, block: str, name: str, form: str, axis: Covariate | None) -> Disagreement | None:
    basis = whitened_basis(state.comparison, state.prediction, state.sensitivity, block, form, axis)
    if not basis.shape[1]:
        return None
    explained, rank = state.fit.score(state.comparison.cuts[block], basis)
    if not rank:
        return None
    return Disagreement(block, name, form, explained, rank, float(chi2.sf(explained, rank)))


def whitened_basis(
    comparison: Comparison,
    prediction: Prediction,
    sensitivity: Array,
    block: str,
    form: str,
    axis: Covariate | None,
) -> Array:
    """Return the whitened columns of a smooth trend in one block, (entries of the block, terms)."""
    captures, tiles = prediction.mean.shape
    smooth = np.ones((captures, tiles, 1)) if axis is None else axis.basis()
    if block == "comb":
        return _flat(comparison.whiten(block, np.ones((*comparison.usable[block].shape, 1))))
    if block in CAPTURE_BLOCKS:
        values = smooth[:, 0, :] if axis is None or axis.per_capture else smooth.mean(axis=1)
        return comparison.whiten(block, values)
    return _flat(comparison.whiten(block, smooth * _form(block, form, prediction, sensitivity)[:, :, None]))


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
    size = whitened_basis(state.comparison, state.prediction, state.sensitivity, test.block, test.form, axis).shape[1]

    def build(comparison: Comparison, prediction: Prediction, sensitivity: Array) -> Array:
        part = whitened_basis(comparison, prediction, sensitivity, test.block, test.form, axis)
        columns = np.zeros((comparison.size, part.shape[1]))
        columns[comparison.cuts[test.block]] = part
        return columns

    name = f"{test.block} | {test.where} | {test.form}"
    return LinearTerm(name, build, np.full(size, np.inf), test.block, test.where, test.form)
