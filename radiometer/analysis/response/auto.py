"""The best estimate of a response: penalised maximum likelihood under a noise model taken from the stack itself."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from radiometer.analysis.response.basis import ValueBasis, hat_weight
from radiometer.analysis.response.curves import finished_curve, rising, supported_range
from radiometer.analysis.response.debevec1997 import curve_debevec1997
from radiometer.analysis.response.estimate import ResponseEstimate, Stability, compare_thirds, inner_range
from radiometer.analysis.response.fit import ResponseFit, fit_response, time_error_modes
from radiometer.analysis.response.noise import LogNoise, fit_log_noise
from radiometer.analysis.response.noise_shift import ASSUMPTION, mean_exposure_dn
from radiometer.analysis.response.samples import ResponseSamples, gather_samples
from radiometer.analysis.response.threads import on_one_blas_thread
from radiometer.analysis.response.unseen import unseen_factor
from radiometer.analysis.response.weights import group_residual, noise_of, row_variance, slope_at, value_at
from radiometer.data.bracket import Bracket
from radiometer.data.response_curve import ResponseCurve

Array = NDArray[np.float64]

METHOD = "auto"
# Disjoint thirds of the pixels that differ by more than this, in ln H, are worth a note.
_THIRDS_AGREE = 0.01
# Below this the rounding to whole numbers is a large part of the exposure; the cut is made on the value that the
# other frames predict, because a cut on the noisy value itself would keep the brighter half.
_LEAST_PREDICTED_DN = 6.0


def recover_response_auto(brackets: Bracket | Sequence[Bracket]) -> ResponseEstimate:
    """Recover g(M) = ln f⁻¹(M) as the penalised maximum-likelihood curve of all unclipped pixels.

    Maximises Σ over groups and frames of the Gaussian likelihood of ln H, with ln E of every group eliminated, minus
    λ times the bend of g. Its variances are those of shot noise, read noise and rounding, with amplitudes fitted to
    the stack's own residuals; λ, and errors of the exposure times where these raise the likelihood clearly, come from
    the restricted likelihood. Starts from Debevec and Malik's curve.

    The bend is the third difference over the basis variable. Frames at whole stops leave a wave in ln H with a
    period of one stop undetermined, whatever the method: there the curve is as smooth as the data allow. Other
    ratios (say 1.6) determine it. The stated uncertainty holds the noise of the pixels and, beside it, what smoothness
    decided where the data did not; disjoint parts of the pixels share the latter, so they are compared by the former.

    Args:
        brackets: One bracket or several taken with the same response, 8 to 16 bits; fitted jointly.

    Returns:
        The curve, relative, with g(M_mid) = 0, and its diagnostics.

    Raises:
        InputError: If the brackets do not fit together or hold one exposure only.
        MeasurementError: If everything is clipped or the exposures do not overlap.

    Source: restricted likelihood of smoothing, Wood 2011, J. R. Stat. Soc. B 73, 3–36; noise after EMVA 1288.
    """
    return solve_auto(gather_samples(brackets))


@on_one_blas_thread
def solve_auto(samples: ResponseSamples) -> ResponseEstimate:
    """Recover the response from gathered samples; see `recover_response_auto`."""
    result = _fit(samples, curve_debevec1997(samples).log_exposure)
    thirds, open_in_a_third = [], 0.0
    if samples.group_count >= 60:
        parts = [samples.third(k) for k in range(3)]
        fits = [_fit(p, result.log_exposure, result.noise, result.fit.time_spread) for p in parts]
        thirds = [fit.curve(part, fit.u_pixels) for fit, part in zip(fits, parts, strict=True)]
        open_in_a_third = fits[0].rms_inside(fits[0].u_least)
    curve = result.curve(samples, result.u_log_exposure)
    stability = compare_thirds(thirds, curve) if thirds else None
    fit, times = result.fit, samples.frame_log_time
    ratios, u_ratios = _exposure_ratios(fit, times)
    return ResponseEstimate(
        curve=curve,
        method=METHOD,
        pixel_count=samples.pixel_count,
        group_count=result.samples.group_count,
        sample_count=int(result.samples.pixels.sum()),
        residual_rms_log=result.residual_rms_log,
        smoothing=fit.smoothing,
        stability=stability,
        exposure_ratios=ratios,
        u_exposure_ratios=u_ratios,
        gauge=_gauge(fit),
        notes=(*_notes(fit, samples), *_note_on_thirds(stability, open_in_a_third)),
        details={
            "noise": result.noise.to_mapping(),
            "reduced_chi2": fit.reduced_chi2,
            "median_u_of_pixels": float(np.median(result.u_pixels[inner_range(supported_range(result.samples))])),
            "least_u_of_a_third": open_in_a_third,
            "time_spread": fit.time_spread,
            "log_time_errors": [float(error) for error in _log_time_errors(fit, times)],
        },
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Result:
    samples: ResponseSamples
    fit: ResponseFit
    noise: LogNoise
    log_exposure: Array
    u_pixels: Array
    u_shared: Array
    u_least: Array  # that no method gets below which knows the noise and how smooth the curve is (van Trees)

    @property
    def u_log_exposure(self) -> Array:
        """Return the standard uncertainty from the pixels' noise and from what all pixels share."""
        return np.hypot(self.u_pixels, self.u_shared)

    def rms_inside(self, u: Array) -> float:
        """Return the root mean square over 5–95 % of the supported range."""
        return float(np.sqrt(np.mean(u[inner_range(supported_range(self.samples))] ** 2)))

    @property
    def residual_rms_log(self) -> float:
        normal = self.fit.normal
        residual = normal.residuals(self.fit.solution)
        return float(np.sqrt(normal.weight @ residual**2 / normal.weight.sum()))

    def curve(self, samples: ResponseSamples, u: Array) -> ResponseCurve:
        times = "exposure times as stated" if not self.fit.time_spread else "exposure times right on average"
        return finished_curve(
            self.log_exposure,
            u,
            supported_range(self.samples),
            method=METHOD,
            channel=samples.channel,
            black_dn=samples.limits.black_dn,
            parameters={"smoothing": self.fit.smoothing, "time_spread": self.fit.time_spread},
            assumptions=(ASSUMPTION, times),
        )


def _fit(
    samples: ResponseSamples, start: Array, noise: LogNoise | None = None, time_spread: float | None = None
) -> _Result:
    samples = _above_black(samples, start)
    limits = samples.limits
    shifted = mean_exposure_dn(samples.dn, samples.variance, start, limits)
    dn = np.clip(shifted, limits.black_dn, limits.saturated_dn)
    found = noise or noise_of(samples, dn, start)
    fit = fit_response(samples, dn, row_variance(samples, dn, start, found), time_spread=time_spread)
    if noise is None and fit.time_spread:
        # Wrong times looked like noise before: take the noise from what is left, and fit once more.
        g = _values(samples, fit.coefficients)
        left = fit.normal.residuals(fit.solution)
        found = fit_log_noise(left, fit.leverage(), value_at(g, dn), slope_at(g, dn, samples), samples.pixels)
        fit = fit_response(samples, dn, row_variance(samples, dn, g, found), time_spread=fit.time_spread)
    basis = ValueBasis(samples.bit_depth, limits)
    from_middle = basis.all_values().toarray()
    from_middle -= from_middle[from_middle.shape[0] // 2].copy()

    def u_of(covariance: Array) -> Array:
        inner = covariance[: basis.size, : basis.size]
        return np.asarray(np.sqrt(np.maximum(np.einsum("ij,ij->i", from_middle @ inner, from_middle), 0.0)))

    g = _values(samples, fit.coefficients)
    # Wrong times leave the exponent of the curve as uncertain as the mean of so many of them.
    u_exponent = fit.time_spread / float(np.linalg.norm(samples.frame_log_time - samples.frame_log_time.mean()))
    posterior = fit.inverse[: basis.size, : basis.size]
    factor = unseen_factor(fit.coefficients, posterior, basis, supported_range(samples))
    u_shared = np.hypot(factor * u_of(fit.smoothness_covariance()), (g - g[g.size // 2]) * u_exponent)
    return _Result(samples, fit, found, g, u_of(fit.covariance()), u_shared, u_of(fit.inverse))


def _values(samples: ResponseSamples, coefficients: Array) -> Array:
    g = np.asarray(ValueBasis(samples.bit_depth, samples.limits).all_values() @ coefficients)
    return rising(g, np.ones_like(g), supported_range(samples), samples.limits.black_dn)


def _above_black(samples: ResponseSamples, log_exposure: Array) -> ResponseSamples:
    """Return the rows whose predicted value is clear of black, groups with one such row left out."""
    weight = (hat_weight(samples.dn, samples.limits) ** 2 + 1e-6) * samples.pixels
    log_h = value_at(log_exposure, samples.dn)
    predicted_log_h = log_h - group_residual(samples, log_h, weight)[0]
    predicted_dn = np.interp(predicted_log_h, log_exposure, np.arange(log_exposure.size))
    keep = predicted_dn > samples.limits.black_dn + _LEAST_PREDICTED_DN
    return samples.kept(keep)


def _log_time_errors(fit: ResponseFit, log_time: Array) -> Array:
    """Return ln of true over stated exposure time of every frame."""
    return time_error_modes(log_time) @ fit.time_modes if fit.time_spread else np.zeros(log_time.size)


def _exposure_ratios(fit: ResponseFit, log_time: Array) -> tuple[Array, Array]:
    ratios = np.exp(np.diff(log_time + _log_time_errors(fit, log_time)))
    if not fit.time_spread:
        return ratios, np.zeros(log_time.size - 1)
    errors = fit.covariance()[fit.basis_size :, fit.basis_size :]
    step = np.diff(time_error_modes(log_time), axis=0)
    return ratios, np.asarray(ratios * np.sqrt(np.maximum(np.einsum("ij,ij->i", step @ errors, step), 0.0)))


def _gauge(fit: ResponseFit) -> str:
    if not fit.time_spread:
        return "g(M_mid) = 0; exposure ratios as given"
    return "g(M_mid) = 0; exposure times fitted, right on average (this fixes the exponent)"


def _notes(fit: ResponseFit, samples: ResponseSamples) -> tuple[str, ...]:
    notes = []
    if fit.time_spread:
        errors = _log_time_errors(fit, samples.frame_log_time)
        worst = int(np.argmax(np.abs(errors)))
        notes.append(
            f"the exposure times differ from their labels by some {100 * fit.time_spread:.2g} %; most for "
            f"{np.exp(samples.frame_log_time[worst]):.4g} s, which is "
            f"{np.exp(samples.frame_log_time[worst] + errors[worst]):.4g} s"
        )
    if _at_whole_stops(samples):
        notes.append(
            "all exposures are whole stops apart: a wave of one stop's period in ln H cannot be seen in these data and "
            "is kept as small as the curve's smoothness allows; one frame a third of a stop off would show it"
        )
    if fit.reduced_chi2 > 2.0:
        notes.append(
            f"the frames disagree by {np.sqrt(fit.reduced_chi2):.1f} times their noise: movement, changing light or "
            "processing that depends on the picture; the uncertainty holds this as far as it is random"
        )
    return tuple(notes)


def _note_on_thirds(stability: Stability | None, open_in_a_third: float) -> tuple[str, ...]:
    if stability is None or stability.rms_log <= _THIRDS_AGREE:
        return ()
    return (
        f"curves from disjoint thirds of the pixels differ by {100 * stability.rms_log:.1f} % (rms; "
        f"{100 * stability.largest_log:.1f} % at most): the noise of so many pixels and the smoothness of the curve "
        f"leave ln H open by {100 * open_in_a_third:.1f} % in each, whatever the method; u_log_exposure says where",
    )


def _at_whole_stops(samples: ResponseSamples) -> bool:
    stops = np.diff(np.sort(samples.frame_log_time)) / np.log(2.0)
    return bool(np.all(np.abs(stops - np.round(stops)) < 0.02))
