"""A nearly linear response: a straight line through black, with a spline for what it misses."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.sparse as sp
from scipy.interpolate import BSpline
from scipy.optimize import minimize_scalar

from radiometer.analysis.response.curves import finished_curve, supported_range
from radiometer.analysis.response.debevec1997 import curve_debevec1997
from radiometer.analysis.response.estimate import ResponseEstimate, compare_thirds, inner_range
from radiometer.analysis.response.fit import NormalEquations, PenalisedSolution, eliminate_groups, solve_penalised
from radiometer.analysis.response.samples import ResponseSamples, gather_samples
from radiometer.data.frame import Bracket
from radiometer.data.response_curve import ResponseCurve
from radiometer.one_thread import on_one_blas_thread
from radiometer.typing import Array

METHOD = "linear_spline"
_PIECES = 20  # each a twentieth of full scale: finer than real curves bend
# Misfit is averaged over this part of the range.
_MISFIT_WINDOWS = 8
# Misfit, in ln H, above which a sensor is not nearly linear.
_NEARLY_LINEAR = 0.005
# What a fit to means of rounded numbers can be off by in ln H.
_LEAST_U_LOG = 1e-4


@on_one_blas_thread
def recover_response_linear_spline(brackets: Bracket | Sequence[Bracket]) -> ResponseEstimate:
    """Recover g(M) = ln(M − M_black) + s(M) with a cubic spline s that is zero unless the data call for it.

    For sensors that are linear but for a little bend near black and saturation. Elsewhere the spline is too coarse:
    its distance from Debevec and Malik's finer curve is added to the uncertainty, and a note reports it. Black is the
    stated black level, or the value that makes the frames agree best. The roughness of s is its first difference, so
    that the strongest smoothing leaves the straight line itself; λ comes from the restricted likelihood, rows
    weighted for shot noise.

    Args:
        brackets: One bracket or several taken with the same response.

    Raises:
        InputError: If the brackets do not fit together or hold one exposure only.
        MeasurementError: If everything is clipped or the exposures do not overlap.

    Source: own; the penalised spline after Eilers & Marx 1996, Stat. Sci. 11, 89–121.
    """
    samples = gather_samples(brackets)
    black = _black(samples)
    finer = curve_debevec1997(samples)
    curve, normal, solution = _solve(samples, black, finer=finer)
    misfit = _misfit(curve.log_exposure, finer, supported_range(samples))[inner_range(supported_range(samples))]
    thirds = [_solve(samples.third(k), black, solution.smoothing)[0] for k in range(3)]
    deviation = _spline(samples, np.arange(1 << samples.bit_depth, dtype=np.float64)) @ solution.coefficients
    low, high = curve.valid_dn or (0, curve.log_exposure.size - 1)
    return ResponseEstimate.of(
        samples,
        curve,
        METHOD,
        residual_rms_log=normal.rms(solution.coefficients),
        smoothing=solution.smoothing,
        stability=compare_thirds(thirds, curve),
        notes=_notes(float(np.sqrt(np.mean(misfit**2)))),
        details={
            "black_dn": black,
            "largest_deviation_from_linear": float(np.ptp(deviation[low : high + 1])),
            "reduced_chi2": solution.residual_variance,
        },
    )


def _misfit(log_exposure: Array, finer: ResponseCurve, valid_dn: tuple[int, int]) -> Array:
    """Return the distance of a curve from a finer one at each digital number or, if larger, around it."""
    from scipy.ndimage import uniform_filter1d

    known = finer.valid_dn or valid_dn  # outside it the finer curve is a straight line
    low, high = max(valid_dn[0], known[0]), min(valid_dn[1], known[1])
    inside = np.zeros(log_exposure.size)
    inside[low : high + 1] = 1.0
    square = inside * (log_exposure - log_exposure[finer.mid_dn] - finer.log_exposure) ** 2
    width = max((high - low) // _MISFIT_WINDOWS, 1)
    around = uniform_filter1d(square, width, mode="constant") / np.maximum(
        uniform_filter1d(inside, width, mode="constant"), 1.0 / inside.size
    )
    away = np.arange(log_exposure.size) != finer.mid_dn
    return np.asarray(np.sqrt(np.maximum(square, around) + _LEAST_U_LOG**2) * away)


def _notes(misfit: float) -> tuple[str, ...]:
    if misfit <= _NEARLY_LINEAR:
        return ()
    return (
        f"this response is not nearly linear: a line with a coarse spline deviates from it by {100 * misfit:.1f} "
        "% (rms), "
        "which u_log_exposure holds; use auto",
    )


def _black(samples: ResponseSamples) -> float:
    """Return the stated black level, or the one of least residual over the dark quarter of the range."""
    if samples.limits.no_light_dn > 0:
        return samples.limits.no_light_dn
    lowest = float(samples.dn.min())
    reach = 0.25 * (samples.limits.saturated_dn - samples.limits.black_dn)

    def misfit(black: float) -> float:
        normal = _normal(samples, black)
        return float(normal.square)

    found = minimize_scalar(misfit, bounds=(-reach, lowest - 0.5), method="bounded", options={"xatol": 1e-3})
    return float(found.x)


def _normal(samples: ResponseSamples, black: float) -> NormalEquations:
    signal = np.maximum(samples.dn - black, 0.25)
    # Shot noise: the variance of ln H goes as 1/H.
    weight = samples.pixels * signal / samples.limits.saturated_dn
    return eliminate_groups(_spline(samples, samples.dn), samples.log_time - np.log(signal), weight, samples.group)


def _spline(samples: ResponseSamples, dn: Array) -> sp.csr_array:
    scaled = dn / ((1 << samples.bit_depth) - 1.0)
    knots = np.arange(-3, _PIECES + 4) / _PIECES
    return sp.csr_array(BSpline.design_matrix(np.clip(scaled, 0.0, 1.0), knots, 3))


def _solve(
    samples: ResponseSamples, black: float, smoothing: float | None = None, *, finer: ResponseCurve | None = None
) -> tuple[ResponseCurve, NormalEquations, PenalisedSolution]:
    normal = _normal(samples, black)
    every = np.arange(1 << samples.bit_depth, dtype=np.float64)
    basis = _spline(samples, every)
    middle = np.asarray(basis[[every.size // 2], :].toarray())[0]
    bent = np.diff(np.eye(_PIECES + 3), axis=0)
    solution = solve_penalised(normal, bent.T @ bent, middle, smoothing, order=1)
    from_middle = basis.toarray() - middle
    covariance = normal.covariance(solution.coefficients, solution.inverse)
    if finer is not None:  # parts of the pixels share what smoothing bent
        covariance = covariance + solution.residual_variance * normal.smoothness(solution.inverse)
    u = np.sqrt(np.maximum(np.einsum("ij,ij->i", from_middle @ covariance, from_middle), 0.0))
    g = np.log(np.maximum(every - black, 0.25)) + basis @ solution.coefficients
    if finer is not None:
        u = np.hypot(u, _misfit(g, finer, supported_range(samples)))
    curve = finished_curve(
        g,
        u,
        supported_range(samples),
        method=METHOD,
        channel=samples.channel,
        black_dn=black,
        parameters={"smoothing": solution.smoothing, "black_dn": black},
        assumptions=("the sensor is linear but for a smooth deviation",),
    )
    return curve, normal, solution
