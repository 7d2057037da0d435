"""Linear additions to the residual: smooth empirical terms without a name, and realisations of fixed patterns."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from radiometer.reconciliation.fit.comparison import Comparison
from radiometer.reconciliation.noise.fixed_patterns import FixedError
from radiometer.reconciliation.prediction import Prediction
from radiometer.typing import Array

ColumnBuilder = Callable[[Comparison, Prediction, Array], Array]


@dataclass(frozen=True, slots=True, eq=False)
class LinearTerm:
    """Something that adds to the statistics in proportion to its coefficients."""

    name: str  # what it is, for messages
    # Gives its whitened columns, (entries, coefficients), for a comparison, prediction and sensitivity
    build: ColumnBuilder
    prior: Array  # (coefficients,) prior standard deviation; infinite for none
    block: str = ""  # statistic that it acts on
    where: str = ""  # covariate along which it acts
    form: str = ""  # multiplicative, additive, or additive × gain

    @classmethod
    def of(cls, error: FixedError) -> LinearTerm:
        """Return the term that fits an error which is the same in all captures."""

        def build(comparison: Comparison, prediction: Prediction, sensitivity: Array) -> Array:
            columns = np.zeros((comparison.size, error.sigma.size))
            for name, part in error.parts(prediction).items():
                columns[comparison.cuts[name]] = comparison.whitened(name, part)
            return columns

        return cls(error.name, build, error.sigma)

    @property
    def size(self) -> int:
        """Return the number of coefficients."""
        return int(self.prior.size)

    @property
    def is_smooth(self) -> bool:
        """Return whether it is an unnamed empirical term (and not a realisation of an accepted effect)."""
        return bool(self.where)


def inverse(prior: Array) -> Array:
    """Return 1/σ of parameters' priors; 0 for infinite ones."""
    return np.where(np.isfinite(prior), 1.0 / np.where(np.isfinite(prior), prior, 1.0), 0.0)


def prior_residual(prior: Array, values: Array) -> Array:
    """Return the residual of the priors' rows: each is an observation that its parameter is nothing."""
    return np.asarray(-values * inverse(prior))
