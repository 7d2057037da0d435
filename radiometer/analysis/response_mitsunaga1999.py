"""Response recovery after Mitsunaga and Nayar 1999: a polynomial, with the exposure ratios recovered beside it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import NDArray
from scipy.optimize import least_squares

from radiometer.analysis.response_curves import finished_curve, supported_range
from radiometer.analysis.response_debevec1997 import curve_debevec1997
from radiometer.analysis.response_estimate import ResponseEstimate, compare_thirds
from radiometer.analysis.response_jackknife import jackknife
from radiometer.analysis.response_noise_shift import ASSUMPTION, mean_exposure_dn
from radiometer.analysis.response_samples import ResponseSamples, gather_samples
from radiometer.analysis.response_threads import on_one_blas_thread
from radiometer.data.bracket import Bracket
from radiometer.data.response_curve import ResponseCurve
from radiometer.errors import MeasurementError, UsageError

Array = NDArray[np.float64]

METHOD = "mitsunaga1999"
_ORDERS = range(1, 11)
# Held-out errors within this factor of the least count as equal; the lowest order of them is taken.
_AS_GOOD = 1.02
_LEAST_PART = 0.02
# Relative residual above which a polynomial does not describe the response.
_GOOD_FIT = 0.03
# Exposure, relative to that of the middle value, below which read noise and misfit outweigh shot noise.
_DARK = 0.1
# Weight of the row that holds the product of all ratios: firm beside the data, not singular.
_FIRM = 1e4


def recover_response_mitsunaga1999(
    brackets: Bracket | Sequence[Bracket], *, known_ratios: Mapping[int, float] | None = None
) -> ResponseEstimate:
    """Recover H = f(M) as a polynomial, f(1) = 1 on M scaled to [0, 1], and the exposure ratios of the frames.

    Minimises Σ_i Σ_p [ f(M_p,i) − R_i,i+1 f(M_p,i+1) ]² over the coefficients and the ratios R_i,i+1 (shorter over
    longer exposure) together. Changed from the paper: coefficients and ratios are found in one non-linear fit
    instead of in turns; pixels are means of equally bright ones; residuals are weighted for shot noise; Chebyshev
    polynomials span the same curves with better numbers. The order, 1 to 10, is the one of least error on held-out
    pixels. Exposure times are not needed, only the order from dark to light.

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
    start = curve_debevec1997(samples).log_exposure
    pairs = _Pairs.of(samples, start)
    gauge = _Gauge.of(pairs, known_ratios)
    order = _best_order(pairs, gauge)
    fit = _fit(pairs, order, gauge)
    size = 1 << samples.bit_depth

    def values(part: ResponseSamples) -> Array:
        inner = _fit(_Pairs.of(part, start, pairs.frames), order, gauge, fit.coefficients, fit.log_ratios)
        return np.concatenate([_log_curve(inner.coefficients, size), inner.log_ratios])

    u = jackknife(samples, values)
    misfit, ratio_misfit = _misfit(pairs, order, gauge, size)
    total = np.hypot(u[:size], misfit)
    curve = _curve(samples, fit.coefficients, total, order)
    thirds = [
        _curve(part, _fit(_Pairs.of(part, start, pairs.frames), order, gauge).coefficients, u[:size] * 3**0.5, order)
        for part in (samples.third(k) for k in range(3))
    ]
    ratios = np.exp(fit.log_ratios)
    return ResponseEstimate(
        curve=curve,
        method=METHOD,
        pixel_count=samples.pixel_count,
        group_count=samples.group_count,
        sample_count=int(samples.pixels.sum()),
        residual_rms_log=fit.residual_rms,
        smoothing=float(order),
        stability=compare_thirds(thirds),
        exposure_ratios=ratios,
        u_exposure_ratios=ratios * np.hypot(u[size:], ratio_misfit),
        gauge=f"g(M_mid) = 0; exponent γ fixed by {gauge.text}",
        notes=_notes(fit.residual_rms),
        details={"order": order, "chebyshev_coefficients": [float(c) for c in fit.coefficients]},
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Pairs:
    """Groups seen in two frames that follow one another: scaled values, pair index, weight."""

    shorter: Array
    longer: Array
    pair: NDArray[np.intp]
    weight: Array
    group: NDArray[np.intp]
    nominal_log_ratio: Array
    frames: NDArray[np.intp]

    @classmethod
    def of(cls, samples: ResponseSamples, start: Array, frames: NDArray[np.intp] | None = None) -> _Pairs:
        full_scale = float((1 << samples.bit_depth) - 1)
        dn = np.clip(mean_exposure_dn(samples.dn, samples.variance, start, samples.limits), 0.0, full_scale)
        follows = (np.diff(samples.group) == 0) & (np.diff(samples.frame) == 1)
        first = np.flatnonzero(follows)
        before = samples.frame[first]
        present = np.unique(before) if frames is None else frames
        # A polynomial on M cannot follow the last stops above black, and their small H would pull at the ratios.
        kept = np.isin(before, present) & (dn[first] > samples.limits.black_dn + _LEAST_PART * full_scale)
        first, before = first[kept], before[kept]
        log_h = np.interp(dn[first], np.arange(start.size), start)
        return cls(
            shorter=dn[first] / full_scale,
            longer=dn[first + 1] / full_scale,
            pair=np.searchsorted(present, before),
            weight=np.sqrt(samples.pixels[first] / (np.exp(log_h) + _DARK)),
            group=samples.group[first],
            nominal_log_ratio=(samples.frame_log_time[present + 1] - samples.frame_log_time[present]),
            frames=present,
        )

    def part(self, keep: NDArray[np.bool_]) -> _Pairs:
        return _Pairs(
            self.shorter[keep],
            self.longer[keep],
            self.pair[keep],
            self.weight[keep],
            self.group[keep],
            self.nominal_log_ratio,
            self.frames,
        )


@dataclass(frozen=True, slots=True, eq=False)
class _Gauge:
    """Which ln ratios are held, and in words."""

    held: dict[int, float]
    total: float | None
    text: str

    @classmethod
    def of(cls, pairs: _Pairs, known: Mapping[int, float] | None) -> _Gauge:
        if known is None or not known:
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


@dataclass(frozen=True, slots=True, eq=False)
class _Fit:
    coefficients: Array
    log_ratios: Array
    residual_rms: float


def _design(scaled: Array, order: int) -> Array:
    """Return T_n(2m − 1) − 1 for n = 1 … order: f = 1 + design·c has f(1) = 1 by itself."""
    return np.asarray(chebyshev.chebvander(2.0 * scaled - 1.0, order)[:, 1:] - 1.0)


def _fit(
    pairs: _Pairs, order: int, gauge: _Gauge, coefficients: Array | None = None, log_ratios: Array | None = None
) -> _Fit:
    short, long = _design(pairs.shorter, order), _design(pairs.longer, order)
    count = pairs.nominal_log_ratio.size
    free = np.array([k for k in range(count) if k not in gauge.held], dtype=np.intp)
    held = np.array([gauge.held.get(k, 0.0) for k in range(count)])
    ratios = pairs.nominal_log_ratio if log_ratios is None else log_ratios
    start_c = _linear(pairs, short, long, ratios) if coefficients is None else coefficients

    def unpack(parameters: Array) -> tuple[Array, Array]:
        log_r = held.copy()
        log_r[free] = parameters[order:]
        return parameters[:order], log_r

    def residual(parameters: Array) -> Array:
        c, log_r = unpack(parameters)
        rows = pairs.weight * (1.0 + short @ c - np.exp(-log_r[pairs.pair]) * (1.0 + long @ c))
        firm = [] if gauge.total is None else [_FIRM * (float(log_r.sum()) - gauge.total)]
        return np.concatenate([rows, firm])

    def jacobian(parameters: Array) -> Array:
        c, log_r = unpack(parameters)
        shrink = np.exp(-log_r[pairs.pair])
        by_c = pairs.weight[:, None] * (short - shrink[:, None] * long)
        by_r = (pairs.weight * shrink * (1.0 + long @ c))[:, None] * (pairs.pair[:, None] == free[None, :])
        rows = np.hstack([by_c, by_r])
        if gauge.total is None:
            return rows
        firm = np.concatenate([np.zeros(order), np.full(free.size, _FIRM)])
        return np.vstack([rows, firm])

    first = np.concatenate([start_c, ratios[free]])
    found = least_squares(residual, first, jac=jacobian, method="lm", xtol=1e-12, ftol=1e-12, max_nfev=200)
    c, log_r = unpack(found.x)
    relative = residual(found.x)[: pairs.pair.size] / pairs.weight / np.maximum(1.0 + short @ c, 1e-3)
    return _Fit(c, log_r, float(np.sqrt(np.mean(relative**2))))


def _linear(pairs: _Pairs, short: Array, long: Array, log_ratios: Array) -> Array:
    """Return the coefficients at given ratios: the paper's inner step."""
    shrink = np.exp(-log_ratios[pairs.pair])
    rows = pairs.weight[:, None] * (short - shrink[:, None] * long)
    return np.asarray(np.linalg.lstsq(rows, -pairs.weight * (1.0 - shrink), rcond=None)[0])


def _best_order(pairs: _Pairs, gauge: _Gauge) -> int:
    """Return the lowest order whose held-out error is as good as the least, among those that rise."""
    train, test = pairs.part(pairs.group % 2 == 0), pairs.part(pairs.group % 2 == 1)
    errors: dict[int, float] = {}
    for order in _ORDERS:
        fit = _fit(train, order, gauge)
        if not _rises(fit.coefficients, pairs):
            continue
        shrink = np.exp(-fit.log_ratios[test.pair])
        short = 1.0 + _design(test.shorter, order) @ fit.coefficients
        long = 1.0 + _design(test.longer, order) @ fit.coefficients
        errors[order] = float(np.sum((test.weight * (short - shrink * long)) ** 2))
    if not errors:
        raise MeasurementError(
            "no polynomial of order 1 to 10 gives a rising response on these frames; use another method (auto)"
        )
    least = min(errors.values())
    return min(order for order, error in errors.items() if error <= least * _AS_GOOD)


def _misfit(pairs: _Pairs, order: int, gauge: _Gauge, size: int) -> tuple[Array, Array]:
    """Return how far curve and ln ratios of the neighbouring orders lie away: what this order cannot tell."""
    here = _fit(pairs, order, gauge)
    near = [_fit(pairs, o, gauge) for o in (order - 2, order - 1, order + 1, order + 2) if o >= 1]
    curve = _log_curve(here.coefficients, size)
    of_curve = [np.abs(_log_curve(fit.coefficients, size) - curve) for fit in near]
    of_ratios = [np.abs(fit.log_ratios - here.log_ratios) for fit in near]
    return np.asarray(np.max(of_curve, axis=0)), np.asarray(np.max(of_ratios, axis=0))


def _notes(residual_rms: float) -> tuple[str, ...]:
    if residual_rms <= _GOOD_FIT:
        return ()
    return (
        f"no polynomial up to order {_ORDERS[-1]} follows this response: the frames disagree by "
        f"{100 * residual_rms:.1f} % through the best one, and the ratios may be off by as much; use auto",
    )


def _rises(coefficients: Array, pairs: _Pairs) -> bool:
    low, high = float(pairs.shorter.min()), float(pairs.longer.max())
    f = 1.0 + _design(np.linspace(low, high, 256), coefficients.size) @ coefficients
    # At the dark end, where f is next to nothing, a polynomial may ripple below the noise.
    return bool(np.all(np.diff(f) > -1e-3 * float(f[-1])) and f[-1] > 0 and f[128] > 0)


def _log_curve(coefficients: Array, size: int) -> Array:
    f = 1.0 + _design(np.arange(size) / (size - 1.0), coefficients.size) @ coefficients
    g = np.log(np.maximum(f, 1e-9))
    return np.asarray(g - g[size // 2])


def _curve(samples: ResponseSamples, coefficients: Array, u: Array, order: int) -> ResponseCurve:
    g = _log_curve(coefficients, 1 << samples.bit_depth)
    low, high = supported_range(samples)
    # Below the values that were fitted, or where the polynomial comes to nothing, it does not describe the response.
    least = max(low, samples.limits.black_dn + int(_LEAST_PART * g.size))
    negligible = np.flatnonzero(g[: high + 1] < g[high] + np.log(1e-5))
    first = max(least, int(negligible[-1]) + 1 if negligible.size else 0)
    return finished_curve(
        g,
        u,
        (min(first, high - 4), high),
        method=METHOD,
        channel=samples.channel,
        parameters={"order": order},
        assumptions=(ASSUMPTION,),
        black_dn=samples.limits.black_dn,
    )
