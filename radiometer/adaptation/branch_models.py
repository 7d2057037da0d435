"""The Mahroo–Lamb–Pugh family: a cone branch, then rods in one (S2) or two (S2, S3) straight lines.

    log10 threshold = θ1 + θ2·exp(−min(t, α)/τ) + S2·(min(max(t, α), β) − α) + S3·max(t − β, 0)

θ1 cone plateau, θ2 cone amplitude, τ cone time constant, α rod–cone break, S2 slope, β rod–rod break, S3 slope.
Without rods α is infinite; with S2 alone β is. At fixed τ, α and β the model is linear in the rest.

Source: Mahroo and Lamb 2004 (J Physiol 554:417) and Lamb and Pugh 2004 (Prog Retin Eye Res 23:307), in the form of
Kelly's R package `Dark`. Changed: from the break on the cone term is held, for the rods that decide then do not follow
the cones' late decay; and S3 is the slope itself, not the change of slope.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np

from radiometer.typing import Array


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
        alpha = nonlinear[..., 1, np.newaxis] if len(self.nonlinear) > 1 else np.full_like(tau, np.inf)
        beta = nonlinear[..., 2, np.newaxis] if len(self.nonlinear) > 2 else np.full_like(tau, np.inf)
        columns = [np.ones(np.broadcast_shapes(tau.shape, time_min.shape)), np.exp(-np.minimum(time_min, alpha) / tau)]
        if len(self.nonlinear) > 1:
            columns.append(np.minimum(np.maximum(time_min, alpha), beta) - alpha)
        if len(self.nonlinear) > 2:
            columns.append(np.maximum(time_min - beta, 0.0))
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
        taus = np.geomspace(0.02 * length, 0.6 * length, 10)
        alphas = np.linspace(first + 0.08 * length, last - 0.1 * length, 36)
        grids = [taus, alphas, np.linspace(first + 0.2 * length, last - 0.05 * length, 18)]
        mesh = np.stack(np.meshgrid(*grids[: len(self.nonlinear)], indexing="ij"), axis=-1)
        flat = mesh.reshape(-1, len(self.nonlinear))
        flat = flat[flat[:, 0] < flat[:, 1]] if len(self.nonlinear) > 1 else flat
        return flat[flat[:, 2] > flat[:, 1] + 0.05 * length] if len(self.nonlinear) > 2 else flat

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
MODELS: Final = (ONE_BRANCH, CONE_S2, CONE_S2_S3)
