"""Exposure labels that are not the real exposure: named only where unseen parts of the picture are predicted better."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radiometer.analysis.response.left_out import error_dn, prediction_error_dn
from radiometer.analysis.response.samples import ResponseSamples
from radiometer.analysis.response.settle import Choices, FittedResponse, error_of_quadrants, fit_with, refit, settle
from radiometer.errors import MeasurementError

Array = NDArray[np.float64]

# What is found must lower the error of predicting left-out quadrants to this part of what it was.
LEAST_GAIN: Final = 0.9
# A label is wrong only where the error of predicting its own frame falls to this part. The other frames, predicted with
# it, must gain as well, but in a long bracket most of them have little to do with it.
_LEAST_GAIN_OF_FRAME: Final = 0.8
# ln of real over stated exposure from which a label is wrong (a ninth of a stop); below, shutters scatter.
SMALLEST_LABEL_ERROR: Final = 0.08
# It must stand out of its own uncertainty by this factor (95 %): what convinces is the prediction.
_SIGMA: Final = 2.0
# Frames that the best does not beat by that same margin, in left-out quadrants, are its rivals.
_AS_WELL: Final = 1.0 / _LEAST_GAIN_OF_FRAME
# λ of the search, smooth enough that a curve cannot follow a wrong label; the best are fitted with one of their own.
_SEARCH_SMOOTHING: Final = 1e3
_TRIED: Final = 3
_FEWEST_ROWS: Final = 4
_FEWEST_QUADRANTS: Final = 3
# Groups that the search looks at.
_SEARCHED_GROUPS: Final = 96


@dataclass(frozen=True, slots=True)
class WrongLabel:
    """A frame whose exposure is not what its label says.

    Attributes:
        frame: Index of the frame over all brackets.
        ratio: Real over stated exposure.
        u_ratio: Its standard uncertainty, from leaving out quadrants and from the fit.
        gain: Prediction error of left-out quadrants with the exposure freed, over that before.
        rivals: Other frames, with their ratios, whose freed exposure predicts nearly as well: it may be one of them.
    """

    frame: int
    ratio: float
    u_ratio: float
    gain: float
    rivals: tuple[tuple[int, float], ...] = ()


def find_wrong_labels(samples: ResponseSamples, start: Array) -> tuple[WrongLabel, ...]:
    """Return the frames whose label is wrong, in the order in which they were found.

    One label after the other is freed. It stays freed where in every quadrant of the picture, left out of the fit, its
    frame is predicted better by the others, by a factor in all, and the other frames no worse; most labels must be
    right, or a flat curve with exposures of its own fits best.

    Args:
        samples: The rows, with their quadrants.
        start: A first estimate of g at every digital number.
    """
    if len(samples.without_quadrant) < 3:
        return ()
    thin = thinned(samples)
    most = max((samples.frame_log_time.size - 1) // 3, 1) if samples.frame_log_time.size > 3 else 0
    found: list[WrongLabel] = []
    now = settle(thin, start)
    while len(found) < most:
        freed = tuple(label.frame for label in found)
        tried = [_freed(thin, start, (*freed, k), now) for k in _candidates(thin, start, freed)]
        options = sorted((one for one in tried if one is not None), key=lambda one: one[0].gain)
        if not options or not _convincing(thin, *options[0], now):
            break
        best = options[0]
        rivals = [label for label, _ in options[1:] if label.gain <= _AS_WELL * best[0].gain]
        found.append(replace(best[0], rivals=tuple((label.frame, label.ratio) for label in rivals)))
        now = best[1]
    return _together(thin, start, found)


def _candidates(samples: ResponseSamples, start: Array, freed: tuple[int, ...]) -> list[int]:
    """Return the frames whose freed labels leave the least error within the fit, best first."""
    rows = np.bincount(samples.frame, minlength=samples.frame_log_time.size)
    errors = {}
    for frame in range(rows.size):
        if rows[frame] < _FEWEST_ROWS or frame in freed:
            continue
        try:
            fitted = fit_with(samples, start, Choices(smoothing=_SEARCH_SMOOTHING, free=(*freed, frame)))
        except MeasurementError:
            continue
        errors[frame] = error_dn(prediction_error_dn(fitted.samples, fitted.log_exposure, fitted.fit.log_time_errors))
    return sorted(errors, key=lambda frame: errors[frame])[:_TRIED]


def _freed(
    samples: ResponseSamples, start: Array, free: tuple[int, ...], now: FittedResponse
) -> tuple[WrongLabel, FittedResponse] | None:
    """Return the last of the freed labels as it came out, and the fit."""
    try:
        fitted = settle(samples, start, free)
    except MeasurementError:
        return None
    gain = float(error_of_quadrants(samples, fitted).sum() / error_of_quadrants(samples, now).sum())
    value, u = _log_ratios(samples, fitted, len(free) - 1)
    return WrongLabel(free[-1], float(np.exp(value)), float(np.exp(value) * u), gain), fitted


def _convincing(samples: ResponseSamples, label: WrongLabel, fitted: FittedResponse, now: FittedResponse) -> bool:
    """Tell whether a label is wrong: large enough, and what was left out is predicted better without it."""
    size = abs(np.log(label.ratio))
    if size < max(SMALLEST_LABEL_ERROR, _SIGMA * label.u_ratio / label.ratio) or label.gain > 1.0:
        return False
    before, after = (error_of_quadrants(samples, one, label.frame) for one in (now, fitted))
    both = np.isfinite(before) & np.isfinite(after)
    if int(both.sum()) < _FEWEST_QUADRANTS:
        return False
    better = after[both].sum() <= _LEAST_GAIN_OF_FRAME * before[both].sum()
    return bool(better and np.all(after[both] <= before[both]))


def _log_ratios(samples: ResponseSamples, fitted: FittedResponse, place: int) -> tuple[float, float]:
    """Return ln of real over stated exposure of one freed label and its standard uncertainty."""
    parts = [part for part in (refit(one, fitted) for one in samples.without_quadrant) if part is not None]
    values = np.array([part.fit.time_modes[place] for part in parts])
    of_places = (values.size - 1) * float(values.var()) if values.size > 1 else 0.0
    row = fitted.fit.basis_size + place
    return float(fitted.fit.time_modes[place]), float(np.sqrt(of_places + fitted.fit.inverse[row, row]))


def _together(samples: ResponseSamples, start: Array, found: list[WrongLabel]) -> tuple[WrongLabel, ...]:
    """Return the labels with their ratios as they came out together: one found later moves those before."""
    if not found:
        return ()
    fitted = settle(samples, start, tuple(label.frame for label in found))
    pairs = [_log_ratios(samples, fitted, place) for place in range(len(found))]
    return tuple(
        replace(label, ratio=float(np.exp(value)), u_ratio=float(np.exp(value) * u))
        for label, (value, u) in zip(found, pairs, strict=True)
    )


def thinned(samples: ResponseSamples) -> ResponseSamples:
    """Return every n-th group of the samples and of their quadrants: enough to search in.

    Args:
        samples: The rows, with their quadrants.
    """

    def part(one: ResponseSamples) -> ResponseSamples:
        step = max(1, one.group_count // _SEARCHED_GROUPS)
        return one.kept(one.group % step == 0)

    try:
        return replace(
            part(samples),
            without_quadrant=tuple(part(one) for one in samples.without_quadrant),
            quadrants=tuple(part(one) for one in samples.quadrants),
        )
    except MeasurementError:
        return samples
