"""Response recovery after Mitsunaga and Nayar 1999: a polynomial, recovered together with the exposure ratios."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import NDArray
from scipy.optimize import least_squares

from radiometer.analysis.response.curves import finished_curve, supported_range
from radiometer.analysis.response.debevec1997 import curve_debevec1997
from radiometer.analysis.response.estimate import ResponseEstimate, compare_thirds
from radiometer.analysis.response.noise import ASSUMPTION, mean_exposure_dn, noise_of, row_variance, value_at
from radiometer.analysis.response.samples import ResponseSamples, gather_samples, u_by_groups
from radiometer.data.frame import Bracket
from radiometer.data.response_curve import ResponseCurve
from radiometer.errors import MeasurementError, UsageError
from radiometer.one_thread import on_one_blas_thread
from radiometer.statistics.least_squares import solve
from radiometer.typing import Array

# Closer to black, in parts of full scale, the last stops' small H would pull at the ratios.
LEAST_PART = 0.02
# Weight of the row that holds the product of all ratios: firm compared with the data, not singular.
_FIRM = 1e7
_GAUGE_ROUNDS, _GAUGE_MET = 4, 1e-6
# Where f falls below this part of the first estimate its logarithm is held: a fit must be able to come back.
_LEAST_PART_OF_START = 1e-3
METHOD = "mitsunaga1999"
OF_VALUES, OF_FIRST_ESTIMATE = "digital number", "first estimate of the exposure"
_ORDERS = {OF_VALUES: range(1, 11), OF_FIRST_ESTIMATE: range(1, 9)}
# Held-out errors within this factor of the least count as equal; the lowest order of them is taken.
_AS_GOOD = 1.02
# A polynomial of the digital number, as in the paper, is taken where its held-out error is within this factor.
_GOOD_ENOUGH = 1.1
# Rounds in which first estimate and ratios follow each other, and the change of ln ratios that ends them.
_ROUNDS, _SETTLED = 6, 2e-4
_ORDER_WHILE_SETTLING = 4
# Relative residual above which a polynomial does not describe the response.
_GOOD_FIT = 0.01


@dataclass(frozen=True, slots=True, eq=False)
class Pairs:
    """Groups seen in two frames that follow one another, one row each."""

    shorter: Array  # digital number of the mean exposure in the shorter frame, shape (rows,)
    longer: Array  # in the longer frame
    pair: NDArray[np.intp]  # index of the pair among `frames`
    sigma: Array  # standard deviation of the difference of ln H
    group: NDArray[np.intp]  # group of pixels
    nominal_log_ratio: Array  # ln of longer over shorter stated exposure of every pair, shape (pairs,)
    frames: NDArray[np.intp]  # index of every pair's shorter frame

    @classmethod
    def of(cls, samples: ResponseSamples, start: Array, frames: NDArray[np.intp] | None = None) -> Pairs:
        """Return the pairs of a set of samples.

        Args:
            start: A first estimate of g at every digital number.
            frames: Shorter frames of the requested pairs; None for all that occur.
        """
        limits = samples.limits
        shifted = mean_exposure_dn(samples.dn, samples.variance, start, limits)
        dn = np.clip(shifted, limits.black_dn, limits.saturated_dn)
        variance = row_variance(samples, dn, start, noise_of(samples, dn, start))
        follows = (np.diff(samples.group) == 0) & (np.diff(samples.frame) == 1)
        first = np.flatnonzero(follows)
        before = samples.frame[first]
        present = np.unique(before) if frames is None else frames
        clear = dn[first] > limits.black_dn + LEAST_PART * ((1 << samples.bit_depth) - 1)
        first = first[np.isin(before, present) & clear]
        return cls(
            shorter=dn[first],
            longer=dn[first + 1],
            pair=np.searchsorted(present, samples.frame[first]),
            sigma=np.sqrt(variance[first] + variance[first + 1]),
            group=samples.group[first],
            nominal_log_ratio=samples.frame_log_time[present + 1] - samples.frame_log_time[present],
            frames=present,
        )

    def part(self, keep: NDArray[np.bool_]) -> Pairs:
        """Return the rows to keep."""
        rows: dict[str, Any] = {n: getattr(self, n)[keep] for n in ("shorter", "longer", "pair", "sigma", "group")}
        return replace(self, **rows)

    def log_ratios(self, log_exposure: Array) -> Array:
        """Return ln of the exposure ratio of every pair as a curve g has it; the stated one where it has no rows."""
        step = value_at(log_exposure, self.longer) - value_at(log_exposure, self.shorter)
        weight = np.bincount(self.pair, self.sigma**-2.0, self.frames.size)
        found = np.bincount(self.pair, step * self.sigma**-2.0, self.frames.size) / np.maximum(weight, 1e-300)
        return np.where(weight > 0, found, self.nominal_log_ratio)


@dataclass(frozen=True, slots=True, eq=False)
class Gauge:
    """What fixes the exponent γ of curve and ratios."""

    held: dict[int, float]  # ln ratio of the pairs that are known, by their position
    total: float | None  # sum of all ln ratios that is held; None where ratios are known
    text: str  # the same in words

    @classmethod
    def of(cls, pairs: Pairs, known: Mapping[int, float] | None) -> Gauge:
        """Return the gauge for known ratios, or that of the stated times without any.

        Args:
            pairs: The pairs.
            known: Longer over shorter exposure by the index of the shorter frame.

        Raises:
            UsageError: If a known ratio names no pair or is not above 1.
        """
        if not known:
            return cls({}, float(pairs.nominal_log_ratio.sum()), "the product of the stated exposure times")
        position = {int(frame): at for at, frame in enumerate(pairs.frames)}
        for index, ratio in known.items():
            if index not in position or not ratio > 1.0:
                raise UsageError(
                    f"known exposure ratio {ratio:g} of pair {index}: expected a ratio above 1 of one of the pairs "
                    f"{', '.join(map(str, position))}"
                )
        held = {position[index]: float(np.log(ratio)) for index, ratio in known.items()}
        return cls(held, None, "the known ratio of pair " + ", ".join(map(str, known)))

    def exponent(self, log_ratios: Array) -> float:
        """Return the factor that brings ln ratios to what is known of them."""
        if self.total is not None:
            return self.total / float(log_ratios.sum())
        places = list(self.held)
        return float(np.sum(list(self.held.values())) / max(float(log_ratios[places].sum()), 1e-3))


def with_log_ratios(samples: ResponseSamples, pairs: Pairs, log_ratios: Array) -> ResponseSamples:
    """Return the samples with exposure times that have these ratios; the first of every bracket stays."""
    step = np.diff(samples.frame_log_time)
    step[pairs.frames] = log_ratios
    times = samples.frame_log_time[0] + np.concatenate([[0.0], np.cumsum(step)])
    return replace(samples, frame_log_time=times, log_time=times[samples.frame])


@dataclass(frozen=True, slots=True, eq=False)
class Polynomial:
    """f = 1 + Σ c_n (T_n(2x − 1) − T_n(2x_mid − 1)) and its exposure ratios."""

    argument: Array  # x at every digital number, rising from 0 to 1
    coefficients: Array  # c_n for n = 1 … order
    log_ratios: Array  # ln of longer over shorter exposure of every pair
    residual_rms: float = float("nan")  # root mean square of the residuals in ln H, weighted by their noise
    reduced_chi2: float = float("nan")  # of the residuals

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


@on_one_blas_thread
def recover_response_mitsunaga1999(
    brackets: Bracket | Sequence[Bracket], *, known_ratios: Mapping[int, float] | None = None
) -> ResponseEstimate:
    """Recover H = f(M) as a polynomial, f(M_mid) = 1, and the exposure ratios of the frames.

    Finds the coefficients and the ratios R_i,i+1 (shorter over longer exposure) for which f(M_p,i) and
    R_i,i+1 f(M_p,i+1) agree best. Changed from the paper: coefficients and ratios are found in one non-linear fit
    instead of in turns. Pixels are means of equally bright ones. Residuals are those of ln f, in units of the noise
    that the stack shows. So dark, flat and nearly clipped parts count by their information. Chebyshev polynomials
    span the same curves with better numbers. Where no polynomial of M up to order 10 follows the response, f is a
    polynomial of a first estimate of the exposure, which holds the kinks that polynomials cannot: Debevec and Malik's
    curve, made anew with the recovered ratios until both stay. Argument and order are those of least error on
    held-out pixels. Exposure times serve as a start only. Known ratios fix γ after the fit, in which all pairs count
    alike: held in the fit, they would take up what the polynomial cannot follow.

    Gauge: without any known ratio f and R are determined up to f^γ, R^γ only. γ is fixed by the ratios in
    `known_ratios` where given, else by the product of the stated times.

    Args:
        brackets: One bracket or several taken with the same response.
        known_ratios: Longer over shorter exposure by the index of the pair (0: the two shortest frames of the first
            bracket); None to hold the product of all ratios at that of the stated times.

    Raises:
        InputError: If the brackets do not fit together or hold one exposure only.
        MeasurementError: If everything is clipped or no order gives a rising curve.
        UsageError: If a known ratio names no pair or is not above 1.

    Source: T. Mitsunaga, S. K. Nayar, CVPR 1999, equations (5)–(10).
    """
    samples = gather_samples(brackets)
    situation = _settled(samples, known_ratios)
    argument, order = _best(situation)
    here = situation.fit(argument, order)
    size = 1 << samples.bit_depth

    def values(part: ResponseSamples) -> Array:
        inner = situation.of_part(part, argument).fit(argument, order)
        return np.concatenate([inner.log_curve(), inner.log_ratios])

    u = u_by_groups(samples, values)
    misfit, ratio_misfit = _misfit(situation, argument, order, here)
    _refuse_flat(here.log_curve()[slice(*supported_range(samples))], situation.pairs)
    shared = _off_the_first(situation, here) if situation.gauge.total is not None else np.zeros(size)
    if argument == OF_FIRST_ESTIMATE:
        shared = np.hypot(shared, situation.first.u_log_exposure)
    thirds = [_curve(samples, values(samples.third(k))[:size], u[:size] * 3**0.5, order) for k in range(3)]
    ratios = np.exp(here.log_ratios)
    curve = _curve(samples, here.log_curve(), np.sqrt(u[:size] ** 2 + misfit**2 + shared**2), order)
    return ResponseEstimate.of(
        samples,
        curve,
        METHOD,
        residual_rms_log=here.residual_rms,
        smoothing=float(order),
        stability=compare_thirds(thirds, curve),
        exposure_ratios=ratios,
        u_exposure_ratios=ratios * np.hypot(u[size:], ratio_misfit),
        gauge=f"g(M_mid) = 0; exponent γ fixed by {situation.gauge.text}",
        notes=_notes(here.residual_rms),
        details={
            "order": order,
            "polynomial_of": argument,
            "chebyshev_coefficients": [float(c) for c in here.coefficients],
            "reduced_chi2": here.reduced_chi2,
        },
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Situation:
    """Samples with their recovered times, the first estimate of the curve that belongs to them, and their pairs."""

    samples: ResponseSamples
    first: ResponseCurve
    pairs: Pairs
    gauge: Gauge

    def argument(self, name: str) -> Array:
        """Return what the polynomial is of, 0 to 1, at every digital number."""
        g = self.first.log_exposure
        return np.linspace(0.0, 1.0, g.size) if name == OF_VALUES else np.asarray(np.exp(g - g[-1]))

    def fit(self, argument: str, order: int, pairs: Pairs | None = None) -> Polynomial:
        return fit_polynomial(
            self.pairs if pairs is None else pairs, self.argument(argument), order, self.gauge, self.first.log_exposure
        )

    def of_part(self, part: ResponseSamples, argument: str) -> _Situation:
        """Return the same for a part of the pixels."""
        times = self.samples.frame_log_time
        timed = replace(part, frame_log_time=times, log_time=times[part.frame])
        first = self.first
        if argument == OF_FIRST_ESTIMATE:
            first = curve_debevec1997(timed, smoothing=float(first.provenance.parameters["smoothing"]))
        return replace(self, samples=timed, first=first, pairs=Pairs.of(timed, first.log_exposure, self.pairs.frames))


def _settled(samples: ResponseSamples, known: Mapping[int, float] | None) -> _Situation:
    """Return times and first estimate that agree with each other and with what is known."""
    first = curve_debevec1997(samples)
    pairs = Pairs.of(samples, first.log_exposure)
    gauge = Gauge.of(pairs, known)
    log_ratios = pairs.nominal_log_ratio * gauge.exponent(pairs.nominal_log_ratio)
    for _ in range(_ROUNDS):
        samples = with_log_ratios(samples, pairs, log_ratios)
        first = curve_debevec1997(samples)
        pairs = Pairs.of(samples, first.log_exposure, pairs.frames)
        found = _Situation(samples, first, pairs, gauge).fit(OF_FIRST_ESTIMATE, _ORDER_WHILE_SETTLING).log_ratios
        change = float(np.max(np.abs(found - log_ratios)))
        log_ratios = found
        if change < _SETTLED:
            break
    return _Situation(samples, first, pairs, gauge)


def _best(situation: _Situation) -> tuple[str, int]:
    """Return argument and lowest order whose held-out error is as good as the least, among those that rise."""
    pairs = situation.pairs
    train, test = pairs.part(pairs.group % 2 == 0), pairs.part(pairs.group % 2 == 1)
    chosen: dict[str, tuple[float, int]] = {}
    for argument, orders in _ORDERS.items():
        errors: dict[int, float] = {}
        for order in orders:
            fit = situation.fit(argument, order, train)
            if fit.rises(pairs):
                errors[order] = fit.misfit(test)
        if errors:
            least = min(errors.values())
            order = min(order for order, error in errors.items() if error <= least * _AS_GOOD)
            chosen[argument] = (errors[order], order)
    if not chosen:
        raise MeasurementError(
            "no polynomial of order 1 to 10 gives a rising response on these frames; use another method (auto)"
        )
    least = min(error for error, _ in chosen.values())
    argument = next(name for name, (error, _) in chosen.items() if error <= least * _GOOD_ENOUGH)
    return argument, chosen[argument][1]


def _misfit(situation: _Situation, argument: str, order: int, here: Polynomial) -> tuple[Array, Array]:
    """Return how far curve and ln ratios of the neighbouring orders differ: what this order cannot determine."""
    near = [situation.fit(argument, o) for o in (order - 2, order - 1, order + 1, order + 2) if o >= 1]
    of_curve = [np.abs(fit.log_curve() - here.log_curve()) for fit in near]
    of_ratios = [np.abs(fit.log_ratios - here.log_ratios) for fit in near]
    return np.asarray(np.max(of_curve, axis=0)), np.asarray(np.max(of_ratios, axis=0))


def _refuse_flat(log_exposure: Array, pairs: Pairs) -> None:
    """Refuse a curve that explains nothing: a constant makes any two frames agree.

    Raises:
        MeasurementError: If ln H over all supported values spans less than the smallest step between two frames.
    """
    span, least = float(np.ptp(log_exposure)), float(np.min(pairs.nominal_log_ratio))
    if not span >= least:
        raise MeasurementError(
            f"mitsunaga1999 finds no response: its best polynomial spans {span:.2g} in ln H over all values, while "
            f"frames that differ by {least:.2g} show different values; use another method (auto)"
        )


def _off_the_first(situation: _Situation, here: Polynomial) -> Array:
    """Return the polynomial's distance from the first estimate, beyond three standard uncertainties of that."""
    first = situation.first
    gap = np.abs(here.log_curve() - first.log_exposure)
    u = first.u_log_exposure
    return np.where(np.isfinite(u), np.maximum(gap - 3.0 * np.where(np.isfinite(u), u, 0.0), 0.0), 0.0)


def _notes(residual_rms: float) -> tuple[str, ...]:
    if residual_rms <= _GOOD_FIT:
        return ()
    return (
        f"no polynomial follows this response: the frames disagree by {100 * residual_rms:.1f} % through the best "
        "one, and the ratios may be off by as much; use auto",
    )


def _curve(samples: ResponseSamples, g: Array, u: Array, order: int) -> ResponseCurve:
    low, high = supported_range(samples)
    # Below the values that were fitted, or where the polynomial comes to nothing, it does not describe the response.
    least = max(low, samples.limits.black_dn + int(LEAST_PART * g.size))
    negligible = np.flatnonzero(g[: high + 1] < g[high] + np.log(1e-5))
    first = max(least, int(negligible[-1]) + 1 if negligible.size else 0)
    return finished_curve(
        g,
        u,
        (min(first, high - 4), high),
        method=METHOD,
        channel=samples.channel,
        black_dn=samples.limits.no_light_dn,
        parameters={"order": order},
        assumptions=(ASSUMPTION,),
    )
