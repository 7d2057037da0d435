"""The smoothness of a response judged by prediction: what of a stack was left out, quadrants and frames, in DN."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from radiometer.analysis.response.left_out import error_dn, prediction_error_dn
from radiometer.analysis.response.samples import ResponseSamples
from radiometer.analysis.response.settle import Choices, FittedResponse, error_of_quadrants, fit_with, refit, settle
from radiometer.analysis.response.wrong_labels import WrongLabel, thinned
from radiometer.errors import MeasurementError
from radiometer.typing import Array

# Frames are left out one by one up to this many, then every so many together.
FRAME_FOLDS: Final = 8
# λ is tried at these multiples of the one of the restricted likelihood.
_FACTORS: Final = (1.0, 1e-2, 1e2)
# Another λ must lower the error of prediction to this part; what predicts within the second factor of the best counts
# as predicting as well.
_LEAST_GAIN: Final = 0.97
_AS_WELL: Final = 1.1
# Up to so many neighbouring groups that count as one, the restricted likelihood needs no judge.
MANY_AS_ONE: Final = 3.0
# Unless the rows, less one for each group, are hardly more than the coefficients: a curve through all of them (two
# frames) leaves no noise, and λ may be too small by orders of magnitude.
_FEW_ROWS: Final = 2.0
_FACTORS_OF_FEW: Final = (*_FACTORS, 1e4, 1e6)


@dataclass(frozen=True, slots=True, eq=False)
class Judged:
    """A fit and its rivals.

    Attributes:
        best: The fit that predicts best.
        other_smoothness: Fits with another λ that predict as well.
        other_labels: Fits with another label freed that predict as well.
    """

    best: FittedResponse
    other_smoothness: tuple[FittedResponse, ...] = ()
    other_labels: tuple[FittedResponse, ...] = ()

    def u_among(self, rivals: tuple[FittedResponse, ...]) -> Array:
        """Return the rms distance of g − g(M_mid) of the best and its rivals from the best: any of them may be true."""
        apart = np.array([one.relative - self.best.relative for one in (self.best, *rivals)])
        return np.asarray(np.sqrt(np.mean(apart**2, axis=0)))


def judge_by_prediction(
    samples: ResponseSamples, start: Array, found: FittedResponse, labels: tuple[WrongLabel, ...] = ()
) -> Judged:
    """Return the fit whose λ predicts left-out quadrants and frames best, and what predicts them as well.

    Args:
        samples: The rows, with their quadrants.
        start: A first estimate of g at every digital number.
        found: The fit with the λ of the restricted likelihood.
        labels: Wrong labels that it has freed; frames that may be wrong in their place make rivals too.
    """
    rivals = tuple(_with_other_labels(samples, start, labels))
    few = found.fit.normal.freedom < _FEW_ROWS * found.fit.basis_size
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


def without_frames(samples: ResponseSamples, found: FittedResponse) -> Iterator[tuple[int, FittedResponse]]:
    """Yield every n-th frame's fold and the fit without it, for each n-th.

    Args:
        samples: The rows.
        found: The fit to all of them.
    """
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
