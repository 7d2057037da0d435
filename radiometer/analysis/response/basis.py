"""The response's basis over digital numbers, and the values that no frame shows."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.interpolate import BSpline

from radiometer.analysis.response.estimate import inner_range
from radiometer.analysis.response.limits import ValueLimits
from radiometer.typing import Array

# Twice as many as real responses have bends: a wave of one stop's period must fit into the basis itself, or data that
# cannot see it seem to rule it out.
_SPLINE_PIECES = 112
_ORDER = 3
_ROUGHNESS_ORDER = 3
# Frames at whole stops do not show a wave of one stop's period, and real responses hold more of it than their
# smoothness elsewhere predicts. With this factor the mean squared error in units of u over the DoRF curves is about 1
# (benchmarks/response_accuracy.py states it).
_UNSEEN_WAVE: Final = 2.0


@dataclass(frozen=True, slots=True)
class ValueBasis:
    """A linear model g(M) = Σ_k c_k·b_k(M) on digital numbers, whole or not.

    Cubic B-splines on u(M) = ln[(M − M_min + a)/(M_max − M + a)]: over this u, g is nearly straight for gamma, linear
    and sigmoid responses alike. The knots are where ln H bends, close to black and to saturation. The number of
    unknowns is the same at 8 and at 16 bits.
    """

    bit_depth: int  # bits per digital number
    limits: ValueLimits  # black and saturation level

    @property
    def size(self) -> int:
        """Return the number of coefficients."""
        return _SPLINE_PIECES + _ORDER

    @property
    def anchor_dn(self) -> int:
        """Return the digital number whose g a fit holds at 0: M_mid, or the middle of the data where they end below it.

        What no frame shows is not known to any factor, and would make all of g so.
        """
        middle, low, high = 1 << (self.bit_depth - 1), self.limits.black_dn, self.limits.saturated_dn
        return middle if low < middle < high else (low + high) // 2

    def design(self, dn: NDArray[np.float64]) -> sp.csr_array:
        """Return the matrix of basis values, shape (len(dn), size), for digital numbers 0 to 2**bit_depth − 1."""
        u = self._stretched(dn)
        low, high = self._bounds()
        step = (high - low) / _SPLINE_PIECES
        knots = low + step * np.arange(-_ORDER, _SPLINE_PIECES + _ORDER + 1)
        # The last inner knot may be a rounding error below `high`.
        return sp.csr_array(BSpline.design_matrix(np.clip(u, knots[_ORDER], knots[-_ORDER - 1]), knots, _ORDER))

    def all_values(self) -> sp.csr_array:
        """Return the design for every digital number, shape (2**bit_depth, size)."""
        return _all_values(self)

    def values_at(self, dn: int) -> NDArray[np.float64]:
        """Return the basis values of one digital number, shape (size,)."""
        return np.asarray(self.all_values()[[dn], :].toarray()[0])

    def variances(self, covariance: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the variance of g at every digital number, shape (2**bit_depth,).

        Args:
            covariance: Of the coefficients, symmetric, shape (size, size).
        """
        every = self.all_values()
        # Four cubic B-splines reach a number, whatever its depth.
        columns, values = (part.reshape(-1, _ORDER + 1) for part in (every.indices, every.data))
        found = np.zeros(columns.shape[0])
        for i in range(_ORDER + 1):
            for j in range(i + 1):
                twice = 1.0 if i == j else 2.0
                found += twice * values[:, i] * values[:, j] * covariance[columns[:, i], columns[:, j]]
        return found

    @property
    def roughness_order(self) -> int:
        """Return the order of the difference that the roughness is made of."""
        return _ROUGHNESS_ORDER

    def roughness(self) -> NDArray[np.float64]:
        """Return P of cᵀPc = Σ (third difference of c)²: how the bend of g changes over u, shape (size, size).

        The third difference leaves the slow bend of real responses alone and acts on waves, above all on the wave
        of one stop's period that frames at whole stops cannot determine.
        """
        return _roughness(self.size)

    def _softening(self) -> float:
        # One part in 1024 of the range keeps the logarithm finite at both ends without bending the rest.
        return max(1.0, (self.limits.saturated_dn - self.limits.black_dn) / 1024.0)

    def _stretched(self, dn: NDArray[np.float64]) -> NDArray[np.float64]:
        low, high, a = self.limits.black_dn, self.limits.saturated_dn, self._softening()
        inside = np.clip(dn, low, high)
        return np.asarray(np.log((inside - low + a) / (high - inside + a)))

    def _bounds(self) -> tuple[float, float]:
        reach = float(np.log((self.limits.saturated_dn - self.limits.black_dn + self._softening()) / self._softening()))
        return -reach, reach


@lru_cache(maxsize=8)
def _all_values(basis: ValueBasis) -> sp.csr_array:
    return basis.design(np.arange(1 << basis.bit_depth, dtype=np.float64))


@lru_cache(maxsize=8)
def _roughness(size: int) -> NDArray[np.float64]:
    bent = np.diff(np.eye(size), _ROUGHNESS_ORDER, axis=0)
    roughness = np.asarray(bent.T @ bent)
    roughness.flags.writeable = False
    return roughness


def hat_weight(dn: NDArray[np.float64], limits: ValueLimits) -> NDArray[np.float64]:
    """Return the hat function, 1 in the middle and 0 at and beyond black and saturation.

    Source: Debevec & Malik 1997, equation (4), scaled to a maximum of 1.
    """
    half = 0.5 * (limits.saturated_dn - limits.black_dn)
    distance = np.minimum(dn - limits.black_dn, limits.saturated_dn - dn)
    return np.asarray(np.clip(distance / half, 0.0, 1.0))


def unseen_factor(coefficients: Array, covariance: Array, basis: ValueBasis, valid_dn: tuple[int, int]) -> float:
    """Return the factor on the standard uncertainty that smoothness decides, at least 2.

    One λ represents the whole curve. Where a few kinks hold most of the roughness, the mean understates what may
    have been smoothed away there: the squared third differences of the coefficients are weighted by themselves.

    Args:
        coefficients: Of the curve, shape (basis.size,).
        covariance: Their posterior covariance, shape (basis.size, basis.size).
        valid_dn: Lowest and highest digital number that data supported.
    """
    inner = inner_range(valid_dn)
    first, last = np.argmax(basis.design(np.array([inner.start, inner.stop - 1.0])).toarray(), axis=1)
    bent = np.diff(np.eye(basis.size), basis.roughness_order, axis=0)[first:last]
    if not bent.size:
        return _UNSEEN_WAVE
    square = (bent @ coefficients) ** 2 + np.einsum("ij,ij->i", bent @ covariance, bent)
    return float(_UNSEEN_WAVE * np.sqrt(np.mean(square**2)) / np.mean(square))
