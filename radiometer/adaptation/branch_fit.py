"""Fits one branch model to a threshold series: variable projection from many starts, with a robust loss.

The models are the Mahroo–Lamb–Pugh family: a cone branch, then rods in one (S2) or two (S2, S3) straight lines, the
latter down to the end of the test or to a final threshold.

    log10 threshold = θ1 + θ2·exp(−min(t, α)/τ) + S2·(min(max(t, α), β) − α) + S3·(min(max(t, β), γ) − β)

θ1 cone plateau, θ2 cone amplitude, τ cone time constant, α rod–cone break, S2 slope, β rod–rod break, S3 slope, γ when
the final threshold is reached. Without rods α is infinite; with S2 alone β is; γ is where S3 goes on to the end. At
fixed τ, α, β and γ the model is linear in the rest.

Source: Mahroo and Lamb 2004 (J Physiol 554:417) and Lamb and Pugh 2004 (Prog Retin Eye Res 23:307), in the form of
Kelly's R package `Dark`. Changed: from the break on the cone term is held, for the rods that decide then do not follow
the cones' late decay; S3 is the slope itself, not the change of slope; and S3 may end at the dark-adapted threshold.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import islice, pairwise
from typing import Any, Final

import numpy as np
from scipy.optimize import minimize

from radiometer.adaptation.threshold_series import ThresholdSeries
from radiometer.errors import MeasurementError
from radiometer.statistics.least_squares import solve
from radiometer.statistics.model_choice import aicc
from radiometer.statistics.scale import robust_sigma
from radiometer.typing import Array

HUBER: Final = 2.5  # residuals beyond so many robust standard deviations count less (Huber 1964)
# What the weights leave of the mean square of normal residuals: E[min(1, k/|r|)·r²] = 1 − 2·Q(k).
HUBER_CONSISTENCY: Final = 1.0 - math.erfc(HUBER / math.sqrt(2.0))
REWEIGHTINGS: Final = 4
REFINED: Final = 4
_FAR: Final = 1e12


@dataclass(frozen=True, slots=True)
class BranchModel:
    """One member of the family."""

    name: str  # name in reports
    linear: tuple[str, ...]  # parameters in which it is linear, in the order of the basis' columns
    nonlinear: tuple[str, ...]  # the others: time constant, breaks
    meaning: str  # what its branches are

    @property
    def parameters(self) -> tuple[str, ...]:
        """Return the names of all parameters."""
        return (*self.linear, *self.nonlinear)

    def basis(self, time_min: Array, nonlinear: Array) -> Array:
        """Return the columns that the linear parameters multiply.

        Args:
            time_min: Times in min, shape (n,).
            nonlinear: Values of the nonlinear parameters in min, shape (…, p).

        Returns:
            Shape (…, n, number of linear parameters).
        """
        tau = nonlinear[..., 0, np.newaxis]
        breaks = [nonlinear[..., place, np.newaxis] for place in range(1, len(self.nonlinear))]
        ends = [*breaks, np.full_like(tau, np.inf)]  # what goes on to the end of the test has its end at infinity
        columns = [
            np.ones(np.broadcast_shapes(tau.shape, time_min.shape)),
            np.exp(-np.minimum(time_min, ends[0]) / tau),
        ]
        for early, late in islice(pairwise(ends), len(self.linear) - len(columns)):
            columns.append(np.minimum(np.maximum(time_min, early), late) - early)
        return np.stack(columns, axis=-1)

    def threshold(self, time_min: Array, values: dict[str, float]) -> Array:
        """Return log10 thresholds at times in min for named parameters."""
        nonlinear = np.array([values[name] for name in self.nonlinear])
        linear = np.array([values[name] for name in self.linear])
        return np.asarray(self.basis(time_min, nonlinear) @ linear, dtype=np.float64)

    def starts(self, time_min: Array) -> Array:
        """Return a grid of nonlinear parameters to start from, shape (starts, p)."""
        first, last = float(time_min[0]), float(time_min[-1])
        length = last - first
        finer = 1 if len(self.nonlinear) < 4 else 2  # every further break multiplies the starts
        taus = np.geomspace(0.02 * length, 0.6 * length, 10 // finer)
        alphas = np.linspace(first + 0.08 * length, last - 0.1 * length, 36 // finer)
        betas = np.linspace(first + 0.2 * length, last - 0.05 * length, 18 // finer)
        grids = [taus, alphas, betas, np.linspace(first + 0.4 * length, last - 0.05 * length, 9)]
        mesh = np.stack(np.meshgrid(*grids[: len(self.nonlinear)], indexing="ij"), axis=-1)
        flat = mesh.reshape(-1, len(self.nonlinear))
        for place in range(1, len(self.nonlinear)):
            apart = 0.05 * length if place > 1 else 0.0
            flat = flat[flat[:, place] > flat[:, place - 1] + apart]
        return flat

    def allowed(self, time_min: Array, nonlinear: Array) -> bool:
        """Return whether nonlinear parameters make sense for these times: breaks inside, in order, settled cones."""
        first, last = float(time_min[0]), float(time_min[-1])
        tau, breaks = nonlinear[0], nonlinear[1:]
        inside = all(first < b < last for b in breaks) and all(early < late for early, late in pairwise(breaks))
        slowest = 2.0 * (last - first) if not len(breaks) else breaks[0]
        return bool(0.01 * (last - first) < tau < slowest and inside)


ONE_BRANCH: Final = BranchModel(
    "one-branch", ("plateau", "amplitude"), ("tau_min",), "one exponential branch: cones alone, or rods alone"
)
CONE_S2: Final = BranchModel(
    "cone+S2",
    ("plateau", "amplitude", "s2_slope_per_min"),
    ("tau_min", "break_min"),
    "cones to their plateau, then rods in one straight line",
)
CONE_S2_S3: Final = BranchModel(
    "cone+S2+S3",
    ("plateau", "amplitude", "s2_slope_per_min", "s3_slope_per_min"),
    ("tau_min", "break_min", "rod_rod_break_min"),
    "cones to their plateau, then rods in two straight lines",
)
CONE_S2_S3_FINAL: Final = BranchModel(
    "cone+S2+S3+final",
    ("plateau", "amplitude", "s2_slope_per_min", "s3_slope_per_min"),
    ("tau_min", "break_min", "rod_rod_break_min", "final_from_min"),
    "cones to their plateau, then rods in two straight lines to their final threshold",
)
MODELS: Final = (ONE_BRANCH, CONE_S2, CONE_S2_S3, CONE_S2_S3_FINAL)


@dataclass(frozen=True, slots=True, eq=False)
class BranchFit:
    """A fitted branch model."""

    model: BranchModel  # which one
    series: ThresholdSeries  # what it was fitted to
    values: dict[str, float]  # parameters by name
    weights: Array  # weight of each threshold: 1/σ² relative, less where robustness has taken some off, shape (n,)
    sum_of_squares: float  # weighted sum of squared residuals
    aicc: float  # akaike's information criterion, corrected for small samples (Hurvich and Tsai 1989)

    @property
    def has_break(self) -> bool:
        """Return whether it has a rod–cone break."""
        return "break_min" in self.values

    @property
    def degrees_of_freedom(self) -> int:
        """Return the number of thresholds less that of the parameters."""
        return self.series.time_min.size - len(self.model.parameters)

    @property
    def sigma(self) -> float:
        """Return the standard deviation of a threshold of weight 1, in log10 units."""
        return float(np.sqrt(self.sum_of_squares / (self.degrees_of_freedom * HUBER_CONSISTENCY)))

    def threshold(self, time_min: Array) -> Array:
        """Return fitted log10 thresholds at times in min."""
        return self.model.threshold(time_min, self.values)


def fit_model(series: ThresholdSeries, model: BranchModel, weights: Array | None = None) -> BranchFit:
    """Return the least-squares fit of a model, outliers weighed down after Huber 1964.

    Args:
        weights: Weights to keep as they are, such as those of another model's fit; found from the residuals where None.

    Raises:
        MeasurementError: If there are not more thresholds than parameters.
    """
    count = series.time_min.size
    if count <= len(model.parameters) + 1:
        raise MeasurementError(
            f"{count} thresholds are too few for the {len(model.parameters)} parameters of {model.name}"
        )
    prior = prior_weights(series)
    nonlinear = _best_of_grid(series, model, prior if weights is None else weights)
    if weights is None:
        weights = prior
        for _ in range(REWEIGHTINGS):
            nonlinear = refine(series.time_min, series.log_threshold, model, weights, nonlinear)
            _, linear = project(series.time_min, series.log_threshold, model, weights, nonlinear)
            weights = prior * _huber(series, model, prior, nonlinear, linear)
    nonlinear = refine(series.time_min, series.log_threshold, model, weights, nonlinear)
    total, linear = project(series.time_min, series.log_threshold, model, weights, nonlinear)
    values = dict(zip(model.parameters, map(float, (*linear, *nonlinear)), strict=True))
    return BranchFit(model, series, values, weights, total, aicc(total, count, len(model.parameters) + 1))


def prior_weights(series: ThresholdSeries) -> Array:
    """Return the weight of each threshold by its stated uncertainty, 1 for the best, shape (n,)."""
    if series.sigma is None:
        return np.ones(series.time_min.size)
    return np.asarray((series.sigma.min() / series.sigma) ** 2, dtype=np.float64)


def project(
    time_min: Array, log_threshold: Array, model: BranchModel, weights: Array, nonlinear: Array
) -> tuple[float, Array]:
    """Return the weighted sum of squares at fixed nonlinear parameters, and the best linear ones."""
    basis = model.basis(time_min, nonlinear)
    linear = solve(basis, log_threshold, weights)
    residuals = log_threshold - basis @ linear
    return float(weights @ residuals**2), linear


def refine(time_min: Array, log_threshold: Array, model: BranchModel, weights: Array, start: Array) -> Array:
    """Return nonlinear parameters of least weighted sum of squares near a start (Nelder and Mead 1965)."""

    def cost(nonlinear: Any) -> float:
        if not model.allowed(time_min, nonlinear):
            return _FAR
        return project(time_min, log_threshold, model, weights, nonlinear)[0]

    found = minimize(
        cost, np.ravel(start), method="Nelder-Mead", options={"xatol": 1e-4, "fatol": 1e-9, "maxiter": 400}
    )
    return np.asarray(found.x if found.fun < cost(start) else start, dtype=np.float64)


def _best_of_grid(series: ThresholdSeries, model: BranchModel, weights: Array) -> Array:
    """Return the best of a few refined starts of the grid."""
    starts = model.starts(series.time_min)
    basis = model.basis(series.time_min, starts)
    weighted = basis * weights[:, np.newaxis]
    normal = np.einsum("sni,snj->sij", weighted, basis) + 1e-9 * np.eye(basis.shape[-1])
    linear = np.linalg.solve(normal, np.einsum("sni,n->si", weighted, series.log_threshold)[..., np.newaxis])
    residuals = series.log_threshold - (basis @ linear)[..., 0]
    order = np.argsort((residuals**2) @ weights)[: REFINED * 8 : 8]
    refined = [refine(series.time_min, series.log_threshold, model, weights, starts[index]) for index in order]
    return min(refined, key=lambda x: project(series.time_min, series.log_threshold, model, weights, x)[0])


def _huber(series: ThresholdSeries, model: BranchModel, prior: Array, nonlinear: Array, linear: Array) -> Array:
    residuals = np.sqrt(prior) * (series.log_threshold - model.basis(series.time_min, nonlinear) @ linear)
    free = residuals.size / (residuals.size - len(model.parameters))  # a fit's residuals are smaller than the errors
    spread = robust_sigma(residuals, 0.0) * float(np.sqrt(free))
    if spread == 0.0:
        return np.ones_like(residuals)
    return np.minimum(1.0, HUBER * spread / np.maximum(np.abs(residuals), 1e-300))
