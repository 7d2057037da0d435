"""Response recovery after Mitsunaga and Nayar 1999: a polynomial, recovered together with the exposure ratios."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from radiometer.analysis.response.curves import finished_curve, supported_range
from radiometer.analysis.response.debevec1997 import curve_debevec1997
from radiometer.analysis.response.estimate import ResponseEstimate, compare_thirds
from radiometer.analysis.response.noise_shift import ASSUMPTION
from radiometer.analysis.response.pairs import LEAST_PART, Gauge, Pairs, with_log_ratios
from radiometer.analysis.response.polynomial import Polynomial, fit_polynomial
from radiometer.analysis.response.samples import ResponseSamples, gather_samples, u_by_groups
from radiometer.data.bracket import Bracket
from radiometer.data.response_curve import ResponseCurve
from radiometer.errors import MeasurementError
from radiometer.one_thread import on_one_blas_thread
from radiometer.typing import Array

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
    return solve_mitsunaga1999(gather_samples(brackets), known_ratios=known_ratios)


@on_one_blas_thread
def solve_mitsunaga1999(
    samples: ResponseSamples, *, known_ratios: Mapping[int, float] | None = None
) -> ResponseEstimate:
    """Recover the response from gathered samples; see `recover_response_mitsunaga1999`.

    Raises:
        MeasurementError: If no order gives a rising curve.
        UsageError: If a known ratio names no pair or is not above 1.
    """
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
    return ResponseEstimate(
        curve=curve,
        method=METHOD,
        pixel_count=samples.pixel_count,
        group_count=samples.group_count,
        sample_count=int(samples.pixels.sum()),
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
        black_dn=samples.limits.black_dn,
        parameters={"order": order},
        assumptions=(ASSUMPTION,),
    )
