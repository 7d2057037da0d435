"""A polynomial inverse response fitted together with the exposure ratios of pairs of frames."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import NDArray
from scipy.optimize import least_squares

from radiometer.analysis.response.pairs import Gauge, Pairs
from radiometer.analysis.response.weights import value_at
from radiometer.statistics.least_squares import solve
from radiometer.typing import Array

# Weight of the row that holds the product of all ratios: firm compared with the data, not singular.
_FIRM = 1e7
_GAUGE_ROUNDS, _GAUGE_MET = 4, 1e-6
# Where f falls below this part of the first estimate its logarithm is held: a fit must be able to come back.
_LEAST_PART_OF_START = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class Polynomial:
    """f = 1 + Σ c_n (T_n(2x − 1) − T_n(2x_mid − 1)) and its exposure ratios.

    Attributes:
        argument: x at every digital number, rising from 0 to 1.
        coefficients: c_n for n = 1 … order.
        log_ratios: ln of longer over shorter exposure of every pair.
        residual_rms: Root mean square of the residuals in ln H, weighted by their noise.
        reduced_chi2: Of the residuals.
    """

    argument: Array
    coefficients: Array
    log_ratios: Array
    residual_rms: float = float("nan")
    reduced_chi2: float = float("nan")

    def values(self, dn: Array) -> Array:
        """Return f at digital numbers, whole or not."""
        return np.asarray(1.0 + design(self.argument, dn, self.coefficients.size) @ self.coefficients)

    def log_curve(self) -> Array:
        """Return g = ln f at every digital number, 0 at the middle."""
        g = np.log(np.maximum(self.values(np.arange(self.argument.size, dtype=np.float64)), 1e-9))
        return np.asarray(g - g[g.size // 2])

    def misfit(self, pairs: Pairs) -> float:
        """Return Σ [ (ln f(M_i) − ln f(M_i+1) + ln ratio)/σ ]² of pairs, these or others."""
        short, long = (np.log(np.maximum(self.values(dn), 1e-9)) for dn in (pairs.shorter, pairs.longer))
        return float(np.sum(((short - long + self.log_ratios[pairs.pair]) / pairs.sigma) ** 2))

    def rises(self, pairs: Pairs) -> bool:
        """Return whether f rises over the digital numbers of these pairs."""
        f = self.values(np.linspace(float(pairs.shorter.min()), float(pairs.longer.max()), 256))
        # At the dark end, where f is next to nothing, a polynomial may ripple below the noise.
        return bool(np.all(np.diff(f) > -1e-3 * float(f[-1])) and f[-1] > 0 and f[128] > 0)


def design(argument: Array, dn: Array, order: int) -> Array:
    """Return T_n(2x − 1) less its value at the middle digital number for n = 1 … order, shape (len(dn), order)."""
    x = value_at(argument, dn)
    middle = chebyshev.chebvander(np.array([2.0 * argument[argument.size // 2] - 1.0]), order)[:, 1:]
    return np.asarray(chebyshev.chebvander(2.0 * x - 1.0, order)[:, 1:] - middle)


def fit_polynomial(pairs: Pairs, argument: Array, order: int, gauge: Gauge, start: Array) -> Polynomial:
    """Return the polynomial and the ratios under which the pairs agree best, residuals in units of their noise.

    Known ratios are tied to one another, not to their values. What a polynomial cannot follow is much the same in
    every pair of frames. It would pull the free ratios away from fixed ones. The exponent that is left open is
    brought to 1 by the sum of all ln ratios, which is held.

    Args:
        pairs: The pairs.
        argument: x at every digital number, rising from 0 to 1.
        order: Order of the polynomial.
        gauge: What fixes the exponent.
        start: A first estimate of g at every digital number.
    """
    problem = _Problem.of(pairs, argument, order, gauge, start)
    log_ratios = pairs.log_ratios(start)
    log_ratios = log_ratios * gauge.exponent(log_ratios)
    parameters = np.concatenate([_like(argument, order, start, pairs), log_ratios[problem.free]])
    if gauge.held:
        parameters = np.append(parameters, 1.0)
    total = float(log_ratios.sum()) if gauge.total is None else gauge.total
    for _ in range(_GAUGE_ROUNDS):
        parameters = problem.solved(parameters, total)
        if not gauge.held or abs(parameters[-1] - 1.0) < _GAUGE_MET:
            break
        total /= float(parameters[-1])
    c, log_r = problem.unpack(parameters)
    square = problem.residual(parameters, total)[:-1] ** 2
    log_r[list(gauge.held)] = list(gauge.held.values())
    return Polynomial(
        argument,
        c,
        log_r,
        float(np.sqrt(square.sum() / np.sum(pairs.sigma**-2.0))),
        float(square.sum()) / max(square.size - parameters.size, 1),
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Problem:
    """Residuals and their derivatives over coefficients, free ln ratios and, with known ratios, their exponent."""

    pairs: Pairs
    short: Array
    long: Array
    least_short: Array
    least_long: Array
    free: NDArray[np.intp]
    by_ratio: Array

    @classmethod
    def of(cls, pairs: Pairs, argument: Array, order: int, gauge: Gauge, start: Array) -> _Problem:
        count = pairs.frames.size
        free = np.array([k for k in range(count) if k not in gauge.held], dtype=np.intp)
        of_parameters = np.eye(count)[:, free]
        if gauge.held:
            known = np.array([gauge.held.get(k, 0.0) for k in range(count)])
            of_parameters = np.hstack([of_parameters, known[:, None]])
        return cls(
            pairs,
            design(argument, pairs.shorter, order),
            design(argument, pairs.longer, order),
            _LEAST_PART_OF_START * np.exp(value_at(start, pairs.shorter) - start[start.size // 2]),
            _LEAST_PART_OF_START * np.exp(value_at(start, pairs.longer) - start[start.size // 2]),
            free,
            of_parameters,
        )

    def unpack(self, parameters: Array) -> tuple[Array, Array]:
        """Return coefficients and ln ratios."""
        order = self.short.shape[1]
        return parameters[:order], np.asarray(self.by_ratio @ parameters[order:])

    def residual(self, parameters: Array, total: float) -> Array:
        """Return the residuals in units of their noise, and at the end that of the sum of all ln ratios."""
        c, log_r = self.unpack(parameters)
        ratio = self._f(self.short, c, self.least_short) / self._f(self.long, c, self.least_long)
        rows = (np.log(ratio) + log_r[self.pairs.pair]) / self.pairs.sigma
        return np.append(rows, _FIRM * (float(log_r.sum()) - total))

    def jacobian(self, parameters: Array, total: float) -> Array:
        """Return the derivatives of the residuals; `total` has no part in them."""
        c, _ = self.unpack(parameters)
        by_c = self.short / self._f(self.short, c, self.least_short)[:, None]
        by_c -= self.long / self._f(self.long, c, self.least_long)[:, None]
        rows = np.hstack([by_c, self.by_ratio[self.pairs.pair]]) / self.pairs.sigma[:, None]
        return np.vstack([rows, np.concatenate([np.zeros(c.size), _FIRM * self.by_ratio.sum(axis=0)])])

    def solved(self, parameters: Array, total: float) -> Array:
        """Return the parameters of least squares from a start."""
        found = least_squares(
            self.residual, parameters, self.jacobian, args=(total,), method="lm", xtol=1e-10, ftol=1e-10, max_nfev=200
        )
        return np.asarray(found.x)

    @staticmethod
    def _f(rows: Array, coefficients: Array, least: Array) -> Array:
        return np.asarray(np.maximum(1.0 + rows @ coefficients, least))


def _like(argument: Array, order: int, start: Array, pairs: Pairs) -> Array:
    """Return the coefficients that come nearest to a first estimate of g where there are pairs."""
    dn = np.concatenate([pairs.shorter, pairs.longer])
    g = value_at(start, dn) - start[start.size // 2]
    shrink = np.exp(-g)
    rows = design(argument, dn, order) * shrink[:, None]
    return solve(rows, (np.exp(g) - 1.0) * shrink)
