"""Exposure labels that are not the real exposure: named only where unseen parts of the picture are predicted better."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radiometer.analysis.response.left_out import prediction_error_dn
from radiometer.analysis.response.planes import JointFit, LeftOut, Plane, fit_planes, settle_planes, without_shares
from radiometer.analysis.response.samples import ResponseSamples
from radiometer.analysis.response.settle import Choices, FittedResponse, fit_with, settle
from radiometer.errors import MeasurementError
from radiometer.typing import Array

# What is found must lower the error of predicting left-out quadrants to this part of what it was.
LEAST_GAIN: Final = 0.9
# A label is wrong only where the error of predicting its own frame falls to this part. All frames together must gain as
# well, but in a long bracket most of them have little to do with it, and one that shows little counts for little there.
_LEAST_GAIN_OF_FRAME: Final = 0.8
# Nor where it falls by less than the rounding to whole numbers may shift all that a frame shows.
_LEAST_FALL_DN: Final = 0.5
# ln of real over stated exposure from which a label is wrong (a ninth of a stop); below, shutters scatter.
SMALLEST_LABEL_ERROR: Final = 0.08
# Shutters are off by a time besides, the same in all exposures. Where the frames do not show it, so much is allowed:
# at 1/8000 s a third of a stop is then no wrong label.
UNSTATED_OFFSET_S: Final = 30e-6
# It must stand out of its uncertainty by this factor. This is 95 % where four shares show it (Student's t, three
# degrees of freedom). Where the fit shows it, one frame in some 400 does so by chance.
_SIGMA: Final = 3.0
# An exposure known to no better than this in ln, a factor of e, is not known.
_NOTHING_KNOWN: Final = 1.0
# The search, whose curves are smoother, looks at errors from half of that size.
_SMALLEST_SEARCHED: Final = 0.5 * SMALLEST_LABEL_ERROR
# A frame is the rival of another where freed in its place it predicts both of them, left out, within that same margin.
_AS_WELL: Final = 1.0 / _LEAST_GAIN_OF_FRAME
# λ of the search, smooth enough that a curve cannot follow a wrong label; the best are fitted with a separate one.
_SEARCH_SMOOTHING: Final = 1e3
_TRIED: Final = 3
_FEWEST_ROWS: Final = 4
# What one share of the picture shows alone convinces of nothing: others must show the frame, too.
_FEWEST_SHARES: Final = 2
# Groups that the search looks at.
_SEARCHED_GROUPS: Final = 96


@dataclass(frozen=True, slots=True)
class WrongLabel:
    """A frame whose exposure is not what its label says."""

    frame: int  # index of the frame over all brackets
    ratio: float  # real over stated exposure
    u_ratio: float  # its standard uncertainty, from leaving out quadrants and from the fit
    gain: float  # prediction error of left-out quadrants with the exposure freed, over that before
    # Other frames, with their ratios, whose freed exposure predicts nearly as well: it may be one of them
    rivals: tuple[tuple[int, float], ...] = ()

    @property
    def log_ratio(self) -> tuple[float, float]:
        """Return ln of real over stated exposure and its standard uncertainty."""
        return math.log(self.ratio), self.u_ratio / self.ratio


def find_wrong_labels(planes: Sequence[Plane], shutter_s: float = UNSTATED_OFFSET_S) -> tuple[WrongLabel, ...]:
    """Return the frames whose label is wrong, in the order in which they were found.

    One label after the other is freed, the same for all planes. Shares of the picture are left out of the fit in
    turn. The label stays freed where they are then predicted better in its frame, by a factor and whichever share is
    not counted, and no worse over all frames. Most labels must be right, or a flat curve with free exposures fits
    best. Frames that show next to nothing do not count: with fewer than four that show something, no label can be
    judged.

    Args:
        planes: Colours of the same photographs, in the same order of frames; those without shares say nothing.
        shutter_s: Time in s by which all exposures may differ from their labels, as in `smallest_label_error`.
    """
    most = most_wrong_labels(planes)
    settled = [pair for one in planes for pair in settled_thin(one)] if most else []
    if not settled:
        return ()
    thin = [plane for plane, _ in settled]
    found: list[WrongLabel] = []
    now = _Tried.of(thin, JointFit.of([fitted for _, fitted in settled]))
    while len(found) < most:
        freed = tuple(label.frame for label in found)
        options = [one for k in _candidates(thin, freed) for one in _freed(thin, (*freed, k), now)]
        convincing = [one for one in options if _convincing(*one, now, shutter_s)]
        if not convincing:
            break
        best = min(convincing, key=lambda one: one[0].gain)
        others = [one for one in options if one[0] is not best[0]]
        rivals = [label for label, tried in others if _as_well(label, tried, *best, shutter_s)]
        found.append(replace(best[0], rivals=tuple((label.frame, label.ratio) for label in rivals)))
        now = best[1]
    return _together(found, now)


def freed_one_by_one(planes: Sequence[Plane], wrong: tuple[int, ...] = ()) -> list[tuple[float, float]]:
    """Return for each frame ln of real over stated exposure where its label, too, is freed, and its u.

    What the other frames show of it, including the curve that they leave open; infinite u where nothing does.

    Args:
        planes: Colours of the same photographs, as for `find_wrong_labels`.
    """
    settled = [pair for one in planes for pair in settled_thin(one, wrong)]
    frames = planes[0].samples.frame_log_time.size
    if not settled:
        return [(0.0, math.inf)] * frames
    thin = [plane for plane, _ in settled]
    rows = _rows_of_frames(thin)

    def by_others(frame: int) -> tuple[float, float]:
        free = (*(one for one in wrong if one != frame), frame)
        if rows[frame] < _FEWEST_ROWS:
            return 0.0, math.inf
        try:
            fits = [fit_with(p.samples, f.log_exposure, replace(f.choices, free=free)) for p, f in settled]
            value, u = _Tried.of(thin, JointFit.of(fits)).log_ratio(len(free) - 1)
        except MeasurementError:
            return 0.0, math.inf
        return (value, u) if u < _NOTHING_KNOWN else (0.0, math.inf)

    return [by_others(frame) for frame in range(frames)]


def smallest_label_error(seconds: float, shutter_s: float = UNSTATED_OFFSET_S) -> float:
    """Return ln of real over stated exposure from which the label of so long an exposure counts as wrong.

    Args:
        seconds: The exposure in s.
        shutter_s: Time in s by which all exposures may differ from their labels.
    """
    return SMALLEST_LABEL_ERROR + shutter_s / seconds


def most_wrong_labels(planes: Sequence[Plane]) -> int:
    """Return how many labels could be found wrong: at most a third of the frames that show something.

    Args:
        planes: Colours of the same photographs.
    """
    frames = int(np.sum(_rows_of_frames(planes) >= _FEWEST_ROWS))
    return max((frames - 1) // 3, 1) if frames > 3 else 0


def settled_thin(
    plane: Plane, free: tuple[int, ...] = (), without: Sequence[int] = ()
) -> list[tuple[Plane, FittedResponse]]:
    """Return a plane's thinned samples without some frames, and their fit; nothing where it is too dark or small."""
    if not plane.samples.shares:
        return []
    try:
        samples = thinned(plane.samples)
        if without:
            samples = samples.changed(lambda one: one.kept(~np.isin(one.frame, list(without))))
        return [(replace(plane, samples=samples), settle(samples, plane.start, free))]
    except MeasurementError:
        return []


@dataclass(frozen=True, slots=True, eq=False)
class _Tried:
    """A joint fit, the same without each share of the picture, and how well these are predicted."""

    joint: JointFit
    parts: list[JointFit]
    left_out: LeftOut

    @classmethod
    def of(cls, planes: Sequence[Plane], joint: JointFit) -> _Tried:
        parts = without_shares(planes, joint)
        return cls(joint, parts, LeftOut.of(planes, parts))

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
    """Return the frames that their freed labels, moved by enough, bring closest to the fit, best first."""
    rows = _rows_of_frames(planes)
    before = _errors_of_frames(fit_planes(planes, Choices(smoothing=_SEARCH_SMOOTHING, free=freed)))
    left = {}
    for frame in np.flatnonzero(rows >= _FEWEST_ROWS):
        if frame in freed:
            continue
        try:
            joint = fit_planes(planes, Choices(smoothing=_SEARCH_SMOOTHING, free=(*freed, int(frame))))
        except MeasurementError:
            continue
        if abs(joint.log_ratios[-1]) >= _SMALLEST_SEARCHED:
            left[int(frame)] = float(_errors_of_frames(joint)[frame] / before[frame])
    return sorted(left, key=lambda frame: left[frame])[:_TRIED]


def _errors_of_frames(joint: JointFit) -> Array:
    """Return the mean size of the error in DN with which each frame is predicted from the others within the fit."""
    frames = joint.fits[0].samples.frame_log_time.size
    total, count = np.zeros(frames), np.zeros(frames)
    for one in joint.fits:
        errors = np.abs(prediction_error_dn(one.samples, one.log_exposure, one.fit.log_time_errors))
        known = np.isfinite(errors)
        total += np.bincount(one.samples.frame[known], errors[known], frames)
        count += np.bincount(one.samples.frame[known], minlength=frames)
    return np.asarray(np.maximum(total, 1e-9) / np.maximum(count, 1.0))


def _freed(planes: Sequence[Plane], free: tuple[int, ...], now: _Tried) -> list[tuple[WrongLabel, _Tried]]:
    """Return the last of the freed labels as it came out, and the fit; nothing where there is none."""
    try:
        tried = _Tried.of(planes, settle_planes(planes, free))
    except MeasurementError:
        return []
    value, u = tried.log_ratio(len(free) - 1)
    gain = tried.left_out.mean_dn() / now.left_out.mean_dn()
    return [(WrongLabel(free[-1], float(np.exp(value)), float(np.exp(value) * u), gain), tried)]


def _convincing(label: WrongLabel, tried: _Tried, now: _Tried, shutter_s: float = UNSTATED_OFFSET_S) -> bool:
    """Return whether a label is wrong: large enough, and the left-out shares are predicted better without it."""
    size, u = np.abs(label.log_ratio)
    if size < max(_smallest(tried, label.frame, shutter_s), _SIGMA * u) or label.gain > 1.0:
        return False
    then, since = (one.left_out.means_without_one_dn(label.frame) for one in (now, tried))
    if then.size < _FEWEST_SHARES or not np.all(since <= then):
        return False
    before, after = (one.left_out.mean_dn(label.frame) for one in (now, tried))
    return after <= min(_LEAST_GAIN_OF_FRAME * before, before - _LEAST_FALL_DN)


def _smallest(tried: _Tried, frame: int, shutter_s: float) -> float:
    return smallest_label_error(float(tried.joint.fits[0].samples.exposures_s[frame]), shutter_s)


def _as_well(
    label: WrongLabel, tried: _Tried, best: WrongLabel, tried_best: _Tried, shutter_s: float = UNSTATED_OFFSET_S
) -> bool:
    """Return whether another label, wrong in place of the best, predicts both frames nearly as well."""
    if abs(label.log_ratio[0]) < _smallest(tried, label.frame, shutter_s):
        return False
    here, there = (one.left_out.mean_dn(label.frame, best.frame) for one in (tried, tried_best))
    return here <= _AS_WELL * there


def _together(found: Sequence[WrongLabel], last: _Tried) -> tuple[WrongLabel, ...]:
    """Return the labels with their ratios as they came out together: one found later moves those before."""
    pairs = [last.log_ratio(place) for place in range(len(found))]
    return tuple(
        replace(label, ratio=float(np.exp(value)), u_ratio=float(np.exp(value) * u))
        for label, (value, u) in zip(found, pairs, strict=True)
    )


def thinned(samples: ResponseSamples) -> ResponseSamples:
    """Return every n-th group of the samples and of their quadrants: enough to search in."""

    def part(one: ResponseSamples) -> ResponseSamples:
        step = max(1, one.group_count // _SEARCHED_GROUPS)
        return one.kept(one.group % step == 0)

    try:
        return samples.changed(part)
    except MeasurementError:
        return samples
