"""The time by which a shutter exposes longer than its labels say: one number for all frames of a bracket.

The gap between the two curtains passes a pixel in the time between their releases plus the difference of their
delays. The effective exposure is the label plus a constant, which matters in short exposures alone. It is applied
where left-out exposures are predicted better with the constant that the other exposures give.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radiometer.analysis.response.left_out import error_dn, prediction_error_dn
from radiometer.analysis.response.planes import Plane
from radiometer.analysis.response.samples import ResponseSamples
from radiometer.analysis.response.settle import FittedResponse, fit_with, refit, settle
from radiometer.analysis.response.wrong_labels import (
    LEAST_GAIN,
    UNSTATED_OFFSET_S,
    WrongLabel,
    find_wrong_labels,
    most_wrong_labels,
    settled_thin,
)
from radiometer.errors import MeasurementError
from radiometer.typing import Array

# The travel of curtains (5 to 7 ms over 20 to 24 mm) is adjusted to ± 0.3 ms. That of the first is adjusted against
# that of the second to 0.05 to 0.1 ms. Their delays cannot differ by more while they are. A worn shutter is out of
# adjustment, so that this is the prior's standard deviation, and three of it the bound. Source: service manuals as
# collected in github.com/srozum/film_camera_tester/wiki/Curtains-Travel-Times; effective exposure time as in ISO 516.
ADJUSTED_S: Final = 3e-4
# Longer exposures than this are changed by less than 3 % where the shutter is adjusted.
_LONGEST_S: Final = 0.01
# An exposure counts as moved from this part on; below, shutters scatter from one release to the next.
_MOVED: Final = 0.01
# It must stand out of its uncertainty by this factor, as a wrong label must.
_SIGMA: Final = 3.0
# Two exposures must be predicted, each from the others: one alone may have a wrong label.
_FEWEST_MOVED: Final = 2
# Fewer rows than these are strays.
_FEWEST_ROWS: Final = 4
# Steps of the fit, which is linear in the logarithm of the exposure; a step below this part of u changes nothing.
_STEPS: Final = 6
_SETTLED: Final = 0.05


@dataclass(frozen=True, slots=True)
class ShutterOffset:
    """The time by which all exposures of a bracket are longer than their labels."""

    seconds: float  # the time in s; negative for shorter exposures
    # Its standard uncertainty in s, from the fit, from shares of the picture and from exposures left out
    u_seconds: float
    gain: float  # mean error of left-out exposures that it moves, over that with the labels as they are

    def in_words(self) -> str:
        """Return the time in words: "29.6 ± 4.8 µs longer"."""
        size, u = 1e6 * abs(self.seconds), 1e6 * self.u_seconds
        return f"{size:.1f} ± {u:.1f} µs {'longer' if self.seconds > 0 else 'shorter'}"

    def log_ratios(self, exposures_s: Array) -> Array:
        """Return ln of real over stated exposure of stated exposure times in s."""
        return np.asarray(np.log1p(self.seconds / exposures_s))


@dataclass(frozen=True, slots=True)
class Exposures:
    """What photographs say of their exposures together."""

    offset: ShutterOffset | None  # the shutter's offset; None where none was taken
    wrong: tuple[WrongLabel, ...]  # labels that are wrong, their ratios to what the label and the offset make together

    @property
    def stated(self) -> str:
        """Return what the exposures were taken from, in words."""
        return "their labels" if self.offset is None else "their labels and the offset"

    @property
    def allowed_s(self) -> float:
        """Return by what time in s all exposures may still differ from label and offset."""
        return UNSTATED_OFFSET_S if self.offset is None else min(UNSTATED_OFFSET_S, _SIGMA * self.offset.u_seconds)

    def timed(self, samples: ResponseSamples) -> ResponseSamples:
        """Return samples whose exposures hold the offset."""
        return samples if self.offset is None else with_offset(samples, self.offset.seconds)

    def of_printed(self, label: WrongLabel, exposures_s: Array) -> WrongLabel:
        """Return a wrong label with its ratio, and its rivals with theirs, to the exposure times in s as stated."""
        if self.offset is None:
            return label
        factors = np.exp(self.offset.log_ratios(exposures_s)).tolist()
        own = factors[label.frame]
        rivals = tuple((frame, factors[frame] * ratio) for frame, ratio in label.rivals)
        return replace(label, ratio=own * label.ratio, u_ratio=own * label.u_ratio, rivals=rivals)


def find_exposures(planes: Sequence[Plane]) -> Exposures:
    """Return the shutter's offset and the labels that are wrong apart from it.

    A wrong label shows nothing of the offset. Where any are found, the offset comes from the other frames alone, and
    the labels are judged once more with it.

    Args:
        planes: Colours of the same photographs, in the same order of frames.
    """
    found = _judged(planes, find_offset(planes))
    if not found.wrong:
        return found
    return _judged(planes, find_offset(planes, tuple(label.frame for label in found.wrong)))


def _judged(planes: Sequence[Plane], offset: ShutterOffset | None) -> Exposures:
    found = Exposures(offset, ())
    timed = [replace(plane, samples=found.timed(plane.samples)) for plane in planes]
    return replace(found, wrong=find_wrong_labels(timed, found.allowed_s))


def is_possible(seconds: float, shortest_s: float) -> bool:
    """Return whether a shutter can expose longer by a time in s whose shortest label is `shortest_s`."""
    is_within_a_stop = -0.5 * shortest_s < seconds < shortest_s
    return is_within_a_stop and abs(seconds) < _SIGMA * ADJUSTED_S


def with_offset(samples: ResponseSamples, seconds: float) -> ResponseSamples:
    """Return samples whose exposures are all longer by a time in s."""
    return samples.timed(samples.frame_log_time + np.log1p(seconds / samples.exposures_s))


def find_offset(planes: Sequence[Plane], wrong: Sequence[int] = ()) -> ShutterOffset | None:
    """Return the time by which all exposures are longer than their labels; None where it cannot be determined.

    It must be plausible for a shutter and stand out of its uncertainty. Each exposure that it moves by a percent or
    more is left out in turn and predicted with the offset from the others. Their mean error must fall by a tenth, and
    it must fall whichever of them is not counted. Left-out shares of the picture must be predicted no worse over all
    frames, since all of them see what short exposures show.

    Args:
        planes: Colours of the same photographs, in the same order of frames.
        wrong: Frames that say nothing of it.
    """
    short = np.flatnonzero(planes[0].samples.exposures_s <= _LONGEST_S)
    short = short[~np.isin(short, list(wrong))]
    if short.size < _FEWEST_MOVED or not most_wrong_labels(planes):
        return None
    thin = [pair for plane in planes for pair in settled_thin(plane, without=wrong)]
    try:
        evidence = _Evidence.of([plane for plane, _ in thin], [fitted for _, fitted in thin])
        return evidence.offset(short) if evidence is not None else None
    except MeasurementError:
        return None


@dataclass(frozen=True, slots=True, eq=False)
class _Evidence:
    """What planes show of the offset."""

    planes: Sequence[Plane]  # the planes, exposures as labelled
    plain: Sequence[FittedResponse]  # their fits with these
    free: Sequence[FittedResponse]  # their fits with the offset free, about its value
    seconds: float  # the offset in s
    u_fit: float  # its standard uncertainty in s by the fit

    @classmethod
    def of(cls, planes: Sequence[Plane], plain: Sequence[FittedResponse]) -> _Evidence | None:
        """Return what planes show; None where there are none, or it leaves what is possible."""
        if not planes:
            return None
        shortest = float(min(plane.samples.exposures_s.min() for plane in planes))
        seconds = 0.0
        for _ in range(_STEPS):
            timed = [with_offset(plane.samples, seconds) for plane in planes]
            starts = [one.log_exposure for one in plain]
            fits = [settle(one, start, u_offset_s=ADJUSTED_S) for one, start in zip(timed, starts, strict=True)]
            step, u = _together(fits)
            seconds += step
            if not is_possible(seconds, shortest):
                return None
            if abs(step) <= _SETTLED * u:
                break
        return cls(planes, plain, fits, seconds, u)

    def offset(self, short: NDArray[np.intp]) -> ShutterOffset | None:
        """Return the offset where it is to be taken."""
        if abs(self.seconds) < _SIGMA * self.u_fit:
            return None
        left = [(frame, self._without(int(frame))) for frame in short]
        left_out = {int(frame): one for frame, one in left if one is not None}
        u = self._u([one[0] for one in left_out.values()])
        log_ratios = np.log1p(self.seconds / self.planes[0].samples.exposures_s)
        moved = [one[1:] for frame, one in left_out.items() if abs(log_ratios[frame]) >= _MOVED]
        if abs(self.seconds) < _SIGMA * u or len(moved) < _FEWEST_MOVED:
            return None
        before, after = np.array(moved).T
        without_one = after.sum() - after < before.sum() - before
        if after.sum() > LEAST_GAIN * before.sum() or not np.all(without_one) or not self._shares_no_worse():
            return None
        return ShutterOffset(self.seconds, u, float(after.sum() / before.sum()))

    def _u(self, without: Sequence[float]) -> float:
        """Return the standard uncertainty in s: of the fit or of places, and of frames.

        Args:
            without: The offset in s that the others give without each frame in turn.
        """
        parts = zip(*[plane.samples.without_share for plane in self.planes], strict=True)
        places = np.array([self._of_parts(part) for part in parts])
        of_places = float(np.sqrt((places.size - 1) * places.var()))
        count = max(len(without), 1)
        off = np.array(without) - self.seconds
        of_frames = float(np.sqrt((count - 1) / count * np.square(off).sum()))
        return float(np.hypot(max(self.u_fit, of_places), of_frames))

    def _of_parts(self, parts: Sequence[ResponseSamples]) -> float:
        """Return the offset in s that parts of the planes give."""
        fits = [refit(with_offset(part, self.seconds), one) or one for part, one in zip(parts, self.free, strict=True)]
        return self.seconds + _together(fits)[0]

    def _without(self, frame: int) -> tuple[float, float, float] | None:
        """Return what the other frames give: the offset in s, and a frame's errors in DN as labelled and with it.

        None where the others do not show the frame.
        """
        shown = [np.sum(plane.samples.frame == frame) >= _FEWEST_ROWS for plane in self.planes]
        if not any(shown):
            return None
        rest = [plane.samples.kept(plane.samples.frame != frame) for plane in self.planes]
        seconds = self.seconds
        for _ in range(2):  # the first step may be long
            fits = [
                fit_with(with_offset(p, seconds), f.log_exposure, f.choices)
                for p, f in zip(rest, self.free, strict=True)
            ]
            seconds += _together(fits)[0]
            if not is_possible(seconds, float(self.planes[0].samples.exposures_s.min())):
                return None
        labelled = [fit_with(p, f.log_exposure, f.choices) for p, f in zip(rest, self.plain, strict=True)]
        before, after = [], []
        for plane, plain, free in zip(self.planes, labelled, fits, strict=True):
            before.append(_errors(plane.samples, plain, frame))
            after.append(_errors(with_offset(plane.samples, seconds), free, frame))
        sizes = [np.abs(np.concatenate(errors)) for errors in (before, after)]
        if min(size.size for size in sizes) < _FEWEST_ROWS:
            return None
        return seconds, float(sizes[0].mean()), float(sizes[1].mean())

    def _shares_no_worse(self) -> bool:
        """Return whether left-out shares are predicted as well as with the labels as they are, or better."""
        before = [_error_of_shares(plane.samples, fit) for plane, fit in zip(self.planes, self.plain, strict=True)]
        after = []
        for plane, fit in zip(self.planes, self.free, strict=True):
            fixed = replace(fit, choices=replace(fit.choices, u_offset_s=0.0))
            after.append(_error_of_shares(with_offset(plane.samples, self.seconds), fixed))
        return sum(after) <= sum(before)


def _error_of_shares(samples: ResponseSamples, fitted: FittedResponse) -> float:
    """Return the mean size of the error in DN of left-out shares, each predicted by the same fit without it."""
    errors = []
    for train, test in zip(samples.without_share, samples.shares, strict=True):
        part = refit(train, fitted) or fitted
        errors.append(prediction_error_dn(test, part.log_exposure))
    return error_dn(np.concatenate(errors))


def _errors(samples: ResponseSamples, fitted: FittedResponse, frame: int) -> Array:
    """Return the errors in DN of a frame's rows, predicted from the others through a curve; unknown ones left out."""
    errors = prediction_error_dn(samples, fitted.log_exposure)[samples.frame == frame]
    return np.asarray(errors[np.isfinite(errors)])


def _together(fits: Sequence[FittedResponse]) -> tuple[float, float]:
    """Return the offset in s beyond the samples' times that planes give together, and its standard uncertainty.

    The mean by inverse variance; planes that disagree widen it (Birge ratio).
    """
    values, u = np.array([fit.offset_s for fit in fits]).T
    weight = u**-2.0
    mean = float(weight @ values / weight.sum())
    excess = float(weight @ (values - mean) ** 2) / max(len(fits) - 1, 1)
    return mean, float(np.sqrt(max(1.0, excess) / weight.sum()))
