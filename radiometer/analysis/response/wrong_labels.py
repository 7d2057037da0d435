"""Exposure labels that are not the real exposure: named only where unseen parts of the picture are predicted better."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radiometer.analysis.response.left_out import error_dn, prediction_error_dn
from radiometer.analysis.response.planes import (
    JointFit,
    Plane,
    errors_of_quadrants,
    fit_planes,
    settle_planes,
    without_quadrants,
)
from radiometer.analysis.response.samples import ResponseSamples
from radiometer.analysis.response.settle import Choices, FittedResponse, settle
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

    @property
    def log_ratio(self) -> tuple[float, float]:
        """Return ln of real over stated exposure and its standard uncertainty."""
        return math.log(self.ratio), self.u_ratio / self.ratio


def find_wrong_labels(planes: Sequence[Plane]) -> tuple[WrongLabel, ...]:
    """Return the frames whose label is wrong, in the order in which they were found.

    One label after the other is freed, the same for all planes. It stays freed where in every quadrant of the picture,
    left out of the fit, its frame is predicted better by the others, by a factor in all, and the other frames no worse;
    most labels must be right, or a flat curve with exposures of its own fits best. Frames that show next to nothing do
    not count: of fewer than four that show something no label can be told.

    Args:
        planes: Colours of the same photographs, in the same order of frames; those without quadrants say nothing.
    """
    most = most_wrong_labels(planes)
    settled = [pair for one in planes for pair in _settled(one)] if most else []
    if not settled:
        return ()
    thin = [plane for plane, _ in settled]
    found: list[WrongLabel] = []
    now = _Tried.of(thin, JointFit.of([fitted for _, fitted in settled]))
    while len(found) < most:
        freed = tuple(label.frame for label in found)
        tried = [_freed(thin, (*freed, k), now) for k in _candidates(thin, freed)]
        options = sorted((one for one in tried if one is not None), key=lambda one: one[0].gain)
        if not options or not _convincing(thin, *options[0], now):
            break
        best = options[0]
        rivals = [label for label, _ in options[1:] if label.gain <= _AS_WELL * best[0].gain]
        found.append(replace(best[0], rivals=tuple((label.frame, label.ratio) for label in rivals)))
        now = best[1]
    return _together(found, now)


def most_wrong_labels(planes: Sequence[Plane]) -> int:
    """Return how many labels could be told to be wrong: at most a third of the frames that show something.

    Args:
        planes: Colours of the same photographs.
    """
    frames = int(np.sum(_rows_of_frames(planes) >= _FEWEST_ROWS))
    return max((frames - 1) // 3, 1) if frames > 3 else 0


def _settled(plane: Plane) -> list[tuple[Plane, FittedResponse]]:
    """Return a plane's thinned samples with their fit; nothing where the plane is too dark or too small for one."""
    if len(plane.samples.without_quadrant) < _FEWEST_QUADRANTS:
        return []
    thin = replace(plane, samples=thinned(plane.samples))
    try:
        return [(thin, settle(thin.samples, thin.start))]
    except MeasurementError:
        return []


@dataclass(frozen=True, slots=True, eq=False)
class _Tried:
    """A joint fit, the same without each quadrant, and how well these are predicted."""

    joint: JointFit
    parts: list[JointFit]
    error: float

    @classmethod
    def of(cls, planes: Sequence[Plane], joint: JointFit) -> _Tried:
        parts = without_quadrants(planes, joint)
        return cls(joint, parts, float(np.nansum(errors_of_quadrants(planes, parts))))

    def log_ratio(self, place: int) -> tuple[float, float]:
        """Return ln of real over stated exposure of one freed label and its standard uncertainty."""
        values = np.array([part.log_ratios[place] for part in self.parts])
        of_places = (values.size - 1) * float(values.var()) if values.size > 1 else 0.0
        return float(self.joint.log_ratios[place]), float(np.hypot(np.sqrt(of_places), self.joint.u_log_ratios[place]))


def _rows_of_frames(planes: Sequence[Plane]) -> NDArray[np.intp]:
    """Return how many rows of each frame the plane holds that shows most of it."""
    frames = planes[0].samples.frame_log_time.size
    return np.asarray(np.max([np.bincount(plane.samples.frame, minlength=frames) for plane in planes], axis=0))


def _candidates(planes: Sequence[Plane], freed: tuple[int, ...]) -> list[int]:
    """Return the frames whose freed labels leave the least error within the fit, best first."""
    frames = planes[0].samples.frame_log_time.size
    rows = _rows_of_frames(planes)
    errors = {}
    for frame in range(frames):
        if rows[frame] < _FEWEST_ROWS or frame in freed:
            continue
        try:
            joint = fit_planes(planes, Choices(smoothing=_SEARCH_SMOOTHING, free=(*freed, frame)))
        except MeasurementError:
            continue
        errors[frame] = sum(
            error_dn(prediction_error_dn(one.samples, one.log_exposure, one.fit.log_time_errors)) for one in joint.fits
        )
    return sorted(errors, key=lambda frame: errors[frame])[:_TRIED]


def _freed(planes: Sequence[Plane], free: tuple[int, ...], now: _Tried) -> tuple[WrongLabel, _Tried] | None:
    """Return the last of the freed labels as it came out, and the fit."""
    try:
        tried = _Tried.of(planes, settle_planes(planes, free))
    except MeasurementError:
        return None
    value, u = tried.log_ratio(len(free) - 1)
    return WrongLabel(free[-1], float(np.exp(value)), float(np.exp(value) * u), tried.error / now.error), tried


def _convincing(planes: Sequence[Plane], label: WrongLabel, tried: _Tried, now: _Tried) -> bool:
    """Tell whether a label is wrong: large enough, and what was left out is predicted better without it."""
    size = abs(np.log(label.ratio))
    if size < max(SMALLEST_LABEL_ERROR, _SIGMA * label.u_ratio / label.ratio) or label.gain > 1.0:
        return False
    before, after = (errors_of_quadrants(planes, one.parts, label.frame) for one in (now, tried))
    both = np.isfinite(before) & np.isfinite(after)
    seen = both.any(axis=0)
    if int(seen.sum()) < _FEWEST_QUADRANTS:
        return False
    then, since = (np.where(both, one, 0.0).sum(axis=0)[seen] for one in (before, after))
    return bool(since.sum() <= _LEAST_GAIN_OF_FRAME * then.sum() and np.all(since <= then))


def _together(found: Sequence[WrongLabel], last: _Tried) -> tuple[WrongLabel, ...]:
    """Return the labels with their ratios as they came out together: one found later moves those before."""
    pairs = [last.log_ratio(place) for place in range(len(found))]
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
