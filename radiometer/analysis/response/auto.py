"""The best estimate of a response: penalised maximum likelihood under a noise model taken from the stack itself."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final

import numpy as np

from radiometer.analysis.response.basis import ValueBasis, unseen_factor
from radiometer.analysis.response.curves import finished_curve, supported_range
from radiometer.analysis.response.debevec1997 import curve_debevec1997
from radiometer.analysis.response.estimate import Agreement, ResponseEstimate, inner_range, spread_rms
from radiometer.analysis.response.fit import ResponseFit
from radiometer.analysis.response.left_out import dial_step_dn, error_dn, follow_no_curve, prediction_error_dn
from radiometer.analysis.response.noise import ASSUMPTION
from radiometer.analysis.response.planes import Plane
from radiometer.analysis.response.samples import ResponseSamples, gather_samples
from radiometer.analysis.response.settle import Choices, FittedResponse, error_of_quadrants, fit_with, refit, settle
from radiometer.analysis.response.shutter_offset import Exposures, find_exposures, with_offset
from radiometer.analysis.response.wrong_labels import WrongLabel, thinned
from radiometer.data.frame import Bracket
from radiometer.data.response_curve import ResponseCurve
from radiometer.errors import MeasurementError
from radiometer.one_thread import on_one_blas_thread
from radiometer.statistics.scale import jackknife_u
from radiometer.typing import Array

# Frames are left out one by one up to this many, then every so many together.
FRAME_FOLDS: Final = 8
# λ is tried at these multiples of the one of the restricted likelihood.
_FACTORS: Final = (1.0, 1e-2, 1e2)
# Another λ must lower the error of prediction to this part; what predicts within the second factor of the best counts
# as predicting as well.
_LEAST_GAIN: Final = 0.97
_AS_WELL: Final = 1.1
# A smoother curve is no worse in DN within the chance of frames that it was fitted to.
_AS_GOOD: Final = 1.01
# Of a step between exposures, in stops: dials keep their stops to less.
_STEP_TOLERANCE: Final = 0.02
# Up to so many neighbouring groups that count as one, the restricted likelihood needs no judge.
MANY_AS_ONE: Final = 3.0
# Unless the rows, less one for each group, are hardly more than the coefficients: a curve through all of them (two
# frames) leaves no noise, and λ may be too small by orders of magnitude.
_FEW_ROWS: Final = 2.0
_FACTORS_OF_FEW: Final = (*_FACTORS, 1e4, 1e6)
# λ of a first curve, relative to tr(N)/tr(P): from one that follows every mean to a parabola over the basis variable.
_START_SMOOTHINGS: Final = (1e-2, 1.0, 1e2, 1e3, 1e4, 1e5, 1e6)
METHOD = "auto"
_FEW_TONES: Final = (
    "the picture has few tones, or some in one part only: the frames agree, and between tones the curve follows from "
    "its smoothness. A scene with more tones gives a curve that is known better"
)
# Noise decides which pixels of an even field are its brighter ones. It moves the mean of such a group by up to so much
# of a pixel's noise: 0.33 on simulated screens, where pictures with flare, movement or processing have 0.6 to 1.5.
_SORTED_BY_NOISE: Final = 0.35
_AS_STATED = "exposure times as stated"
# Times are freed only where the error of predicting left-out quadrants falls to this part.
_LEAST_GAIN_OF_TIMES = 0.9


@dataclass(frozen=True, slots=True, eq=False)
class Judged:
    """A fit and its rivals."""

    best: FittedResponse  # the fit that predicts best
    other_smoothness: tuple[FittedResponse, ...] = ()  # fits with another λ that predict as well
    other_labels: tuple[FittedResponse, ...] = ()  # fits with another label freed that predict as well

    def u_among(self, rivals: tuple[FittedResponse, ...]) -> Array:
        """Return the rms distance of g − g(M_mid) of the best and its rivals from the best: any of them may be true."""
        apart = np.array([one.relative - self.best.relative for one in (self.best, *rivals)])
        return np.asarray(np.sqrt(np.mean(apart**2, axis=0)))


def judge_by_prediction(
    samples: ResponseSamples, start: Array, found: FittedResponse, labels: tuple[WrongLabel, ...] = ()
) -> Judged:
    """Return the fit whose λ predicts left-out quadrants and frames best, and what predicts them as well.

    Args:
        start: A first estimate of g at every digital number.
        found: The fit with the λ of the restricted likelihood.
        labels: Wrong labels that it has freed; frames that may be wrong in their place make rivals too.
    """
    rivals = tuple(_with_other_labels(samples, start, labels))
    few = found.fit.normal.freedom < _FEW_ROWS * found.fit.basis_size or _is_flattened(samples, found)
    doubtful = few or found.choices.inflation > MANY_AS_ONE
    if not doubtful or not samples.without_quadrant or found.choices.smoothing is None:
        return Judged(found, other_labels=rivals)
    thin = thinned(samples)
    errors: dict[float, float] = {}
    for factor in _FACTORS_OF_FEW if few else _FACTORS:
        try:
            errors[factor] = _error(thin, fit_with(thin, found.log_exposure, _smoother(found, factor)))
        except MeasurementError:
            continue
    if 1.0 not in errors:
        return Judged(found, other_labels=rivals)
    best = min(errors, key=lambda factor: errors[factor])
    best = best if errors[best] <= _LEAST_GAIN * errors[1.0] else 1.0
    fits = {
        factor: found if factor == 1.0 else fit_with(samples, found.log_exposure, _smoother(found, factor))
        for factor in errors
        if errors[factor] <= _AS_WELL * errors[best]
    }
    chosen = fits.pop(best)
    return Judged(chosen, tuple(fits.values()), rivals)


def _is_flattened(samples: ResponseSamples, found: FittedResponse) -> bool:
    """Return whether a smoother curve predicts these very frames as well in DN: noise may have made flat parts.

    Errors in ln H are the least where a curve is flat. Where a wave that the frames do not show makes it flat, the
    restricted likelihood takes the wave for what the data call for.
    """
    if found.choices.smoothing is None:
        return False
    smoother = (fit_with(samples, found.log_exposure, _smoother(found, factor)) for factor in _FACTORS_OF_FEW[-3:])
    own, *others = (
        error_dn(prediction_error_dn(samples, one.log_exposure, one.fit.log_time_errors)) for one in (found, *smoother)
    )
    return min(others) <= _AS_GOOD * own


def without_frames(samples: ResponseSamples, found: FittedResponse) -> Iterator[tuple[int, FittedResponse]]:
    """Yield every n-th frame's fold and the fit without it, for each n-th."""
    folds = frame_folds(samples)
    for fold in range(folds if samples.frame_log_time.size > 2 else 0):
        keep = samples.frame % folds != fold
        if np.unique(samples.frame[keep]).size < 2:
            continue
        try:
            part = refit(samples.kept(keep), found)
        except MeasurementError:
            continue
        if part is not None:
            yield fold, part


def frame_folds(samples: ResponseSamples) -> int:
    """Return into how many folds the frames fall."""
    return min(samples.frame_log_time.size, FRAME_FOLDS)


def _error(samples: ResponseSamples, fitted: FittedResponse) -> float:
    """Return the mean size of the prediction error in DN, of left-out quadrants and of left-out frames."""
    of_frames = []
    for fold, part in without_frames(samples, fitted):
        errors = prediction_error_dn(samples, part.log_exposure, fitted.fit.log_time_errors)
        own = errors[samples.frame % frame_folds(samples) == fold]
        of_frames += [error_dn(own)] if np.any(np.isfinite(own)) else []
    of_quadrants = error_of_quadrants(samples, fitted)
    return float(np.nanmean(of_quadrants)) + (float(np.mean(of_frames)) if of_frames else 0.0)


def _smoother(found: FittedResponse, factor: float) -> Choices:
    return replace(found.choices, smoothing=factor * (found.choices.smoothing or 1.0))


def _with_other_labels(
    samples: ResponseSamples, start: Array, labels: tuple[WrongLabel, ...]
) -> Iterator[FittedResponse]:
    """Yield the fit with each rival freed in the place of its label."""
    for label in labels:
        for frame, _ in label.rivals:
            try:
                yield settle(samples, start, tuple(frame if one is label else one.frame for one in labels))
            except MeasurementError:
                continue


def recover_response_auto(brackets: Bracket | Sequence[Bracket]) -> ResponseEstimate:
    """Recover g(M) = ln f⁻¹(M) as the penalised maximum-likelihood curve of all unclipped pixels.

    Maximises Σ over groups and frames of the Gaussian likelihood of ln H, with ln E of every group eliminated, minus
    λ times the bend of g. Its variances are those of shot noise, read noise and rounding, with amplitudes fitted to
    the stack's residuals. λ comes from the restricted likelihood. So do errors of the exposure times, where they
    clearly raise it. Starts from Debevec and Malik's curve. Where left-out frames are predicted better with it, all
    exposures are longer than their labels by one time, the shutter's offset (`find_offset`).

    The bend is the third difference over the basis variable. Frames at whole stops leave a wave in ln H with a
    period of one stop undetermined, whatever the method: there the curve is as smooth as the data allow. Other
    ratios (say 1.6) determine it. The stated uncertainty combines the noise of the pixels and what smoothness decided
    where the data did not. Disjoint parts of the pixels share the second term, so they are compared by the first
    alone.

    Args:
        brackets: One bracket or several taken with the same response, 8 to 16 bits; fitted jointly.

    Returns:
        The curve, relative, with g(M_mid) = 0, and its diagnostics.

    Raises:
        InputError: If the brackets do not fit together or hold one exposure only.
        MeasurementError: If everything is clipped or the exposures do not overlap.

    Source: restricted likelihood of smoothing, Wood 2011, J. R. Stat. Soc. B 73, 3–36; noise after EMVA 1288.
    """
    return solve_colours_auto([gather_samples(brackets)])[0]


def recover_colours_auto(colours: Sequence[Bracket | Sequence[Bracket]]) -> list[ResponseEstimate]:
    """Recover the responses of the colours of the same photographs: a curve for each, one set of exposures.

    Args:
        colours: One bracket or several of each colour, the same photographs in the same order.

    Returns:
        An estimate for each colour, as by `recover_response_auto`; the shutter's offset and wrong labels are
        determined from all colours together.

    Raises:
        InputError: If the brackets do not fit together or hold one exposure only.
        MeasurementError: If everything of a colour is clipped or its exposures do not overlap.
    """
    samples = [gather_samples(brackets) for brackets in colours]
    return solve_colours_auto(samples)


@on_one_blas_thread
def solve_colours_auto(samples: Sequence[ResponseSamples]) -> list[ResponseEstimate]:
    """Recover the responses of several colours from gathered samples; see `recover_colours_auto`."""
    planes = [Plane(one, _start(one)) for one in samples]
    found = find_exposures(planes)
    # A colour by itself finds its labels again; several hold each other to what they found together.
    known = tuple(label.log_ratio for label in found.wrong) if len(planes) > 1 else ()
    return [_estimate(plane, found, known) for plane in planes]


def _start(samples: ResponseSamples) -> Array:
    """Return g of the smoothest of Debevec and Malik's curves that predict frames from each other nearly as any does.

    Their λ follows from errors in ln H. These are the least where a curve is flat, and a wave that the frames do not
    show (one exposure step long) makes it flat where the noise is. Errors in DN grow there instead.
    """
    curves = [curve_debevec1997(samples).log_exposure]
    for smoothing in _START_SMOOTHINGS:
        try:
            curves.append(curve_debevec1997(samples, smoothing=smoothing).log_exposure)
        except MeasurementError:
            continue
    errors = [error_dn(prediction_error_dn(samples, one)) for one in curves]
    return curves[max(n for n, error in enumerate(errors) if error <= _AS_WELL * min(errors))]


def _estimate(plane: Plane, exposures: Exposures, known: tuple[tuple[float, float], ...]) -> ResponseEstimate:
    samples, start, wrong = exposures.timed(plane.samples), plane.start, exposures.wrong
    offset, stated_s = exposures.offset, plane.samples.exposures_s
    free = tuple(label.frame for label in wrong)
    settled = _with_times(samples, settle(samples, start, free, known=known))
    judged = judge_by_prediction(samples, start, settled, wrong)
    result = judged.best
    parts = _Parts.of(samples, result)
    fit, times = result.fit, samples.frame_log_time
    shared = np.hypot(_u_shared(samples, judged), judged.u_among(judged.other_labels))
    of_parts = parts.u_log_exposure(result)
    u_curve = np.sqrt(of_parts**2 + shared**2 + _u_of_offset(samples, result, exposures) ** 2)
    curve = _with_offset_stated(_curve(samples, result, u_curve), exposures, fit.log_time_errors, stated_s)
    ratios, u_ratios = _exposure_ratios(fit, times, parts)
    if offset is not None:
        u_ratios = np.hypot(u_ratios, ratios * np.abs(np.diff(1.0 / samples.exposures_s)) * offset.u_seconds)
    found_labels = [exposures.of_printed(label, stated_s) for label in wrong]
    inner = inner_range(supported_range(result.samples))
    return ResponseEstimate.of(
        result.samples,
        curve,
        METHOD,
        residual_rms_log=result.residual_rms_log,
        smoothing=fit.smoothing,
        stability=None,
        exposure_ratios=ratios,
        u_exposure_ratios=u_ratios,
        gauge=_gauge(fit),
        notes=(
            *_offset_note(exposures, plane.samples),
            *_notes(result, plane.samples, found_labels, parts, exposures.stated),
        ),
        agreement=parts.agreement(inner),
        details={
            "noise": result.noise.to_mapping(),
            "reduced_chi2": fit.reduced_chi2,
            "median_u_of_pixels": float(np.median(result.u_of(fit.covariance())[inner])),
            "groups_that_count_as_one": result.choices.inflation,
            "time_spread": fit.time_spread,
            "log_time_errors": [float(error) for error in fit.log_time_errors],
            "wrong_labels": [
                {"frame": label.frame, "ratio": label.ratio, "u_ratio": label.u_ratio} for label in found_labels
            ],
            **_offset_parameters(exposures),
        },
    )


def _with_times(samples: ResponseSamples, found: FittedResponse) -> FittedResponse:
    """Return the fit with small errors of all exposure times freed where left-out quadrants are predicted better."""
    if np.unique(samples.frame_log_time).size < 4 or not samples.without_quadrant or not _overlaps(samples):
        return found
    loose = settle(samples, found.log_exposure, found.choices.free, None, found.choices.known)
    if not loose.fit.time_spread:
        return found
    before, after = error_of_quadrants(samples, found), error_of_quadrants(samples, loose)
    predicted_better = np.all(after <= before) and after.sum() <= _LEAST_GAIN_OF_TIMES * before.sum()
    return loose if predicted_better else found


def _overlaps(samples: ResponseSamples) -> bool:
    """Return whether some digital number occurs at two exposure times: an even field shows the curve or the times."""
    times = samples.frame_log_time[samples.frame]
    ranges = [(samples.dn[times == one].min(), samples.dn[times == one].max()) for one in np.unique(times)]
    return any(top >= bottom for (_, top), (bottom, _) in pairwise(ranges))


@dataclass(frozen=True, slots=True, eq=False)
class _Parts:
    """The same fit without each quadrant of the picture, and without some of the frames."""

    quadrants: tuple[FittedResponse, ...]
    frames: tuple[FittedResponse, ...]

    @classmethod
    def of(cls, samples: ResponseSamples, result: FittedResponse) -> _Parts:
        quadrants = (refit(part, result) for part in samples.without_quadrant)
        return cls(
            tuple(part for part in quadrants if part is not None),
            tuple(part for _, part in without_frames(samples, result)),
        )

    def u_log_exposure(self, result: FittedResponse) -> Array:
        """Return the standard uncertainty of g − g(M_mid) from pixels, places and frames."""
        u_pixels = result.u_of(result.fit.covariance())
        u_places = jackknife_u([part.relative for part in self.quadrants])
        u_frames = result.u_of(result.fit.frame_covariance(result.samples.frame))
        return np.asarray(np.hypot(np.maximum(u_pixels, u_places), u_frames))

    def agreement(self, inner: slice) -> Agreement | None:
        """Return how far the curves of quadrants and of frames differ; None where there are too few."""
        if not (self.quadrants and self.frames):
            return None
        return Agreement(
            *(spread_rms([part.relative[inner] for part in parts]) for parts in (self.quadrants, self.frames))
        )


def _u_shared(samples: ResponseSamples, judged: Judged) -> Array:
    """Return the standard uncertainty that smoothness and the exponent of the times decide: all pixels share it.

    What the posterior says of smoothness and what other λ would have made of the data are the same doubt twice: the
    larger counts.
    """
    result = judged.best
    fit, g = result.fit, result.log_exposure
    # Wrong times leave the exponent of the curve as uncertain as the mean of so many of them.
    u_exponent = fit.time_spread / float(np.linalg.norm(samples.frame_log_time - samples.frame_log_time.mean()))
    basis = ValueBasis(samples.bit_depth, samples.limits)
    posterior = fit.inverse[: basis.size, : basis.size]
    factor = unseen_factor(fit.coefficients, posterior, basis, supported_range(result.samples))
    of_exponent = (g - g[g.size // 2]) * u_exponent
    of_smoothness = np.maximum(
        factor * result.u_of(fit.smoothness_covariance()), judged.u_among(judged.other_smoothness)
    )
    return np.asarray(np.hypot(of_smoothness, of_exponent))


def _u_of_offset(samples: ResponseSamples, result: FittedResponse, exposures: Exposures) -> Array:
    """Return the standard uncertainty of g − g(M_mid) that the offset's makes: what one more u of it changes."""
    if exposures.offset is None:
        return np.zeros(result.log_exposure.size)
    moved = refit(with_offset(samples, exposures.offset.u_seconds), result)
    return np.zeros(result.log_exposure.size) if moved is None else np.abs(moved.relative - result.relative)


def _offset_parameters(exposures: Exposures) -> dict[str, float]:
    """Return the shutter's offset in the form that files hold; nothing where none was applied."""
    offset = exposures.offset
    if offset is None:
        return {}
    return {"shutter_offset_s": offset.seconds, "u_shutter_offset_s": offset.u_seconds}


def _with_offset_stated(curve: ResponseCurve, exposures: Exposures, errors: Array, stated_s: Array) -> ResponseCurve:
    """Return a curve whose provenance states the offset, and so the error of every label."""
    if exposures.offset is None:
        return curve
    whole = errors + exposures.offset.log_ratios(stated_s)
    origin = curve.provenance
    facts = {"log_time_errors": [float(error) for error in whole], **_offset_parameters(exposures)}
    text = f"all exposures {exposures.offset.in_words()} than stated, the shutter's offset found from these frames"
    assumed = (*(other for other in origin.assumptions if other != _AS_STATED), text)
    parameters = {**origin.parameters, **facts}
    return replace(curve, provenance=replace(origin, parameters=parameters, assumptions=assumed))


def _offset_note(exposures: Exposures, printed: ResponseSamples) -> tuple[str, ...]:
    offset = exposures.offset
    if offset is None:
        return ()
    shortest = int(np.argmin(printed.exposures_s))
    return (
        f"all exposures are {offset.in_words()} than their labels (the shutter's offset; "
        f"{_label(printed, shortest)} has "
        f"{1.0 + offset.seconds / printed.exposures_s[shortest]:.3f} of that); the exposures found were used",
    )


def _curve(samples: ResponseSamples, result: FittedResponse, u: Array) -> ResponseCurve:
    times = _AS_STATED if not result.fit.time_modes.size else "exposure times right on average"
    basis = ValueBasis(samples.bit_depth, samples.limits)
    return finished_curve(
        # As fitted, not yet levelled: what levelling changes is in its uncertainty.
        np.asarray(basis.all_values() @ result.fit.coefficients),
        u,
        supported_range(result.samples),
        method=METHOD,
        channel=samples.channel,
        black_dn=samples.limits.no_light_dn,
        parameters={
            "smoothing": result.fit.smoothing,
            "time_spread": result.fit.time_spread,
            "log_time_errors": [float(error) for error in result.fit.log_time_errors],
        },
        assumptions=(ASSUMPTION, times),
    )


def _exposure_ratios(fit: ResponseFit, log_time: Array, parts: _Parts) -> tuple[Array, Array]:
    ratios = np.exp(np.diff(log_time + fit.log_time_errors))
    if not fit.time_modes.size:
        return ratios, np.zeros(log_time.size - 1)
    errors = fit.covariance()[fit.basis_size :, fit.basis_size :]
    step = np.diff(fit.patterns, axis=0)
    of_pixels = np.einsum("ij,ij->i", step @ errors, step)
    of_places = jackknife_u([np.diff(part.fit.log_time_errors) for part in parts.quadrants]) ** 2
    return ratios, np.asarray(ratios * np.sqrt(np.maximum(of_pixels, of_places)))


def _gauge(fit: ResponseFit) -> str:
    if not fit.time_modes.size:
        return "g(M_mid) = 0; exposure ratios as given"
    return "g(M_mid) = 0; exposure times fitted, right on average (this fixes the exponent)"


def _notes(
    result: FittedResponse,
    samples: ResponseSamples,
    wrong: Sequence[WrongLabel],
    parts: _Parts,
    stated: str = "their labels",
) -> tuple[str, ...]:
    fit = result.fit
    notes = [
        f"the exposure labelled {_label(samples, label.frame)} is "
        f"{label.ratio:.3f} ± {label.u_ratio:.3f} of that; the exposure found was used" + _rivals(label, samples)
        for label in wrong
    ]
    if fit.time_spread:
        errors = fit.log_time_errors
        worst = int(np.argmax(np.abs(errors)))
        notes.append(
            f"the exposure times differ from {stated} by some {100 * fit.time_spread:.2g} %; most for "
            f"{_label(samples, worst)}, which has {np.exp(errors[worst]):.4g} of that"
        )
    if samples.edge_scatter:
        notes.append(
            f"equally bright pixels vary {np.sqrt(samples.edge_scatter):.2g} times as much at edges as on even ground "
            "(movement by parts of a pixel, resampling): the half of the pixels next to edges was left out"
        )
    if (step := _common_step(samples)) is not None:
        whole = abs(step - round(step)) < _STEP_TOLERANCE
        apart = "whole stops" if whole else f"multiples of {step:.3g} stops"
        period = "one stop" if whole and round(step) == 1 else f"{step:.3g} stops"
        notes.append(
            f"all exposures are {apart} apart: these data cannot show a wave in ln H with a period of {period}. It is "
            "kept as small as the curve's smoothness allows; one frame a third of a stop off would show it"
        )
    if (doubt := _no_curve(result)) is not None:
        notes.append(doubt)
    elif result.choices.inflation > MANY_AS_ONE:
        notes.append(_FEW_TONES if _frames_agree(result, samples) else _note_on_disagreement(result, parts))
    return tuple(notes)


def _frames_agree(result: FittedResponse, samples: ResponseSamples) -> bool:
    """Return whether a group's mean is predicted from the other frames as well as noise lets it, in every quadrant.

    Curves without one quadrant differ all the same where the picture has few tones, or shows some in one quadrant only:
    smoothness decides between tones.
    """

    def beyond_noise(part: ResponseSamples) -> float:
        error = prediction_error_dn(part, result.log_exposure, result.fit.log_time_errors)
        of_pixel = np.sqrt(np.maximum(part.variance, 1.0 / 12.0))
        return float(np.nanmedian(np.abs(error) / (of_pixel * np.hypot(2.0 / np.sqrt(part.pixels), _SORTED_BY_NOISE))))

    return all(beyond_noise(part) <= 1.0 for part in samples.quadrants or (samples,))


def _no_curve(result: FittedResponse) -> str | None:
    """Return what to say where no curve joins the frames under their labels; None where one does."""
    rows, g = result.samples, result.log_exposure
    error = error_dn(prediction_error_dn(rows, g, result.fit.log_time_errors))
    if not follow_no_curve(error, rows, g):
        return None
    return (
        "these frames follow no single curve with their exposures: a frame is predicted from the others to "
        f"{error:.2g} DN only, where a third of a stop is {dial_step_dn(rows, g):.2g} DN. Causes are another scene or "
        "light in some of them, movement, or wrong exposures. Do not rely on the curve, even within its uncertainty"
    )


def _rivals(label: WrongLabel, samples: ResponseSamples) -> str:
    others = ", ".join(f"{_label(samples, frame)} to {ratio:.3f}" for frame, ratio in label.rivals)
    return f"; changing instead {others} predicts nearly as well, and u includes the difference" if others else ""


def _label(samples: ResponseSamples, frame: int) -> str:
    if samples.frame_labels:
        return samples.frame_labels[frame]
    return f"{np.exp(samples.frame_log_time[frame]):.4g} s"


def _note_on_disagreement(result: FittedResponse, parts: _Parts) -> str:
    found = parts.agreement(inner_range(supported_range(result.samples)))
    what = "movement, changing light, flare, or processing that depends on the picture"
    if found is None:
        return f"the frames differ by more than their noise: {what}"
    return (
        f"the frames differ by more than their noise ({what}): curves without one quadrant of the picture differ by "
        f"{100 * found.quadrants_rms_log:.2g} %, without some of the frames by {100 * found.frames_rms_log:.2g} % "
        "(rms); u_log_exposure includes both"
    )


def _common_step(samples: ResponseSamples) -> float | None:
    """Return the largest step in stops that all exposures are multiples of; None where it is below a stop.

    Finer steps leave waves that are shorter than what bends real curves.
    """
    stops = np.diff(np.unique(samples.frame_log_time)) / np.log(2.0)
    stops = stops[stops > _STEP_TOLERANCE]
    for parts in (1, 2, 3):
        step = float(stops.min(initial=np.inf)) / parts
        counts = np.round(stops / step) if 1.0 - _STEP_TOLERANCE < step < np.inf else np.zeros(1)
        if counts.all() and np.all(np.abs(stops - counts * step) < _STEP_TOLERANCE):
            return float(np.sum(stops) / counts.sum())
    return None
