"""Response recovery after Debevec and Malik 1997, for 8 to 16 bits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from radiometer.analysis.response.basis import ValueBasis, hat_weight, unseen_factor
from radiometer.analysis.response.curves import finished_curve, supported_range
from radiometer.analysis.response.estimate import ResponseEstimate, compare_thirds
from radiometer.analysis.response.fit import NormalEquations, PenalisedSolution, eliminate_groups, solve_penalised
from radiometer.analysis.response.noise import ASSUMPTION, mean_exposure_dn
from radiometer.analysis.response.samples import ResponseSamples, gather_samples
from radiometer.data.frame import Bracket
from radiometer.data.response_curve import ResponseCurve
from radiometer.errors import MeasurementError
from radiometer.one_thread import on_one_blas_thread

METHOD = "debevec1997"
# Hat weight that the first guess of other methods asks for: 4 % of the range away from black and from saturation.
_CLEAR_HAT = 0.08


@on_one_blas_thread
def recover_response_debevec1997(brackets: Bracket | Sequence[Bracket]) -> ResponseEstimate:
    """Recover g(M) = ln f⁻¹(M) with its standard uncertainty by Debevec and Malik's method.

    Minimises Σ_p Σ_i { w(M_pi) [ g(M_pi) − ln E_p − ln t_i ] }² + λ Σ_m [ w(m) g''(m) ]², g(M_mid) = 0, with the
    hat weight w. Changed from the paper: a "pixel" p is the mean of many pixels that are equally bright in every
    frame. So all pixels count. Here ln E_p is eliminated (Schur complement), so that only the curve is solved for.
    Restricted maximum likelihood chooses λ. The curve g is a cubic spline over ln[(M − M_min)/(M_max − M)]. Its
    smoothness is penalised over that variable instead of over M, where ln H is steep by nature. The curve is made
    monotonic. The uncertainty is the group-wise robust (sandwich) covariance with the smoothing term added, so it
    does not rest on a noise model.

    Args:
        brackets: One bracket or several taken with the same response, 8 to 16 bits.

    Returns:
        The curve, relative, with g(M_mid) = 0, and its diagnostics.

    Raises:
        InputError: If the brackets do not fit together or hold one exposure only.
        MeasurementError: If everything is clipped or the exposures do not overlap.

    Source: P. Debevec, J. Malik, SIGGRAPH 97, equations (3) and (4).
    """
    samples = gather_samples(brackets)
    samples = without_noise_shift(samples, curve_debevec1997(samples))
    curve, normal, solution = _solve(samples, None)
    parts = [samples.third(k) for k in range(3)] if samples.group_count >= 60 else []
    thirds = [_solve(part, solution.smoothing, of_pixels=True)[0] for part in parts]
    return ResponseEstimate.of(
        samples,
        curve,
        METHOD,
        residual_rms_log=normal.rms(solution.coefficients),
        smoothing=solution.smoothing,
        stability=compare_thirds(thirds, curve) if thirds else None,
        details={"effective_parameters": solution.effective_parameters},
    )


def curve_debevec1997(samples: ResponseSamples, *, smoothing: float | None = None) -> ResponseCurve:
    """Return the curve alone, for methods that start from it: from values clear of black and saturation.

    λ, relative to tr(N)/tr(P), may be given.
    A plateau close to white (film, some tone curves) would bend the whole curve by a wave of one stop's period.
    """
    try:
        return _solve(samples.kept(hat_weight(samples.dn, samples.limits) > _CLEAR_HAT), smoothing)[0]
    except MeasurementError:  # too few values for that luxury
        return _solve(samples, smoothing)[0]


def without_noise_shift(samples: ResponseSamples, first: ResponseCurve) -> ResponseSamples:
    """Return the samples with every mean digital number replaced by that of the mean exposure."""
    shifted = mean_exposure_dn(samples.dn, samples.variance, first.log_exposure, samples.limits)
    return replace(samples, dn=np.clip(shifted, samples.limits.black_dn, samples.limits.saturated_dn))


def _solve(
    samples: ResponseSamples, smoothing: float | None, *, of_pixels: bool = False
) -> tuple[ResponseCurve, NormalEquations, PenalisedSolution]:
    basis = ValueBasis(samples.bit_depth, samples.limits)
    hat = hat_weight(samples.dn, samples.limits)
    # Every pixel weighs the same: only then does the noise that chose a pixel's group cancel between the groups.
    normal = eliminate_groups(
        basis.design(samples.dn), samples.log_time, (hat**2 + 1e-9) * samples.pixels, samples.group
    )
    every = basis.all_values()
    middle = basis.values_at(basis.anchor_dn)
    solution = solve_penalised(normal, basis.roughness(), middle, smoothing)
    covariance = normal.covariance(solution.coefficients, solution.inverse)
    if not of_pixels:  # parts of the pixels share what smoothing bent
        posterior = solution.residual_variance * solution.inverse
        factor = unseen_factor(solution.coefficients, posterior, basis, supported_range(samples))
        covariance = covariance + factor**2 * solution.residual_variance * normal.smoothness(solution.inverse)
    if not np.all(np.isfinite(covariance)):
        raise MeasurementError(
            "the frames hold too few different pixel values for a response; photograph a scene with more tones"
        )
    from_middle = every.toarray() - middle
    variance = np.einsum("ij,ij->i", from_middle @ covariance, from_middle)
    curve = finished_curve(
        every @ solution.coefficients,
        np.sqrt(np.maximum(variance, 0.0)),
        supported_range(samples),
        method=METHOD,
        channel=samples.channel,
        black_dn=samples.limits.black_dn,
        assumptions=(ASSUMPTION,),
        parameters={"smoothing": solution.smoothing},
    )
    return curve, normal, solution
