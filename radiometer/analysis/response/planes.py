"""Several planes of the same photographs fitted together: one set of exposures, a curve for each plane."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from radiometer.analysis.response.fit import information
from radiometer.analysis.response.left_out import prediction_error_dn
from radiometer.analysis.response.samples import ResponseSamples
from radiometer.analysis.response.settle import Choices, FittedResponse, fit_with, given_labels, refit, settle
from radiometer.typing import Array

# Fewer rows than these are strays (one of a flea3 plane was off by a stop and a third).
_FEWEST_ROWS: Final = 4


@dataclass(frozen=True, slots=True, eq=False)
class Plane:
    """One colour of the photographs."""

    samples: ResponseSamples  # its rows, with their quadrants
    start: Array  # a first estimate of g at every digital number, rising


@dataclass(frozen=True, slots=True, eq=False)
class JointFit:
    """A curve for every plane under exposures that all of them share."""

    fits: tuple[FittedResponse, ...]  # the fits, each at the shared exposures of the freed labels
    log_ratios: Array  # ln of real over stated exposure of the freed labels
    u_log_ratios: Array  # their standard uncertainties, from the fits and from how far the planes disagree

    @classmethod
    def of(cls, fits: Sequence[FittedResponse]) -> JointFit:
        """Return what fits with the same freed labels say together.

        The planes share nothing but the labels: the joint maximum of the likelihood is the mean of their labels,
        weighted by the inverse of each one's covariance. Each curve is that of its plane at this mean. A plane that
        cannot determine the labels (`determines_labels`) takes them from those that can, if any.
        """
        count = len(fits[0].choices.free)
        if not count:
            return cls(tuple(fits), np.empty(0), np.empty(0))
        telling = [one for one in fits if determines_labels(one)] or fits
        values = np.array([one.fit.time_modes[:count] for one in telling])
        known = np.array([information(one.label_covariance) for one in telling])
        covariance = np.linalg.inv(known.sum(axis=0))
        mean = covariance @ np.einsum("pij,pj->i", known, values)
        off = values - mean
        # Planes that disagree beyond their uncertainty widen that of the mean (Birge ratio).
        excess = np.einsum("pij,pi,pj->", known, off, off) / max(count * (len(telling) - 1), 1)
        u = np.sqrt(np.diag(covariance) * max(1.0, float(excess)))
        shared = fits if len(fits) == 1 else [given_labels(one, mean) for one in fits]
        return cls(tuple(shared), np.asarray(mean), np.asarray(u))


def determines_labels(fitted: FittedResponse) -> bool:
    """Return whether a plane determines the exposures of its freed frames at all.

    The curve and the exposures may both be multiplied by any power: what holds the exponent are pixels that two frames
    with trusted labels show. Where hardly any are, least squares takes a flat curve and makes all exposures equal, sure
    of it. A row or two of the freed frame itself may be strays.
    """
    rows, freed = fitted.samples, np.array(fitted.choices.free)
    trusted = ~np.isin(rows.frame, freed)
    log_time, group = rows.log_time[trusted], rows.group[trusted]
    earliest, latest = np.full(rows.group_count, np.inf), np.full(rows.group_count, -np.inf)
    np.minimum.at(earliest, group, log_time)
    np.maximum.at(latest, group, log_time)
    of_freed = np.bincount(rows.frame, minlength=rows.frame_log_time.size)[freed]
    return bool(of_freed.min() >= _FEWEST_ROWS and np.sum(latest > earliest) >= _FEWEST_ROWS)


def settle_planes(planes: Sequence[Plane], free: tuple[int, ...] = ()) -> JointFit:
    """Return the joint fit with the exposures of some frames freed; see `settle`."""
    return JointFit.of([settle(plane.samples, plane.start, free) for plane in planes])


def fit_planes(planes: Sequence[Plane], choices: Choices) -> JointFit:
    """Return the joint fit under given choices."""
    return JointFit.of([fit_with(plane.samples, plane.start, choices) for plane in planes])


def without_shares(planes: Sequence[Plane], joint: JointFit) -> list[JointFit]:
    """Return the same fit without each share of the picture in turn; a plane without enough there stays as it is."""
    parts = []
    for share in range(len(planes[0].samples.without_share)):
        several = zip(planes, joint.fits, strict=True)
        parts.append(JointFit.of([refit(one.samples.without_share[share], fit) or fit for one, fit in several]))
    return parts


@dataclass(frozen=True, slots=True, eq=False)
class LeftOut:
    """How well the digital numbers of each share are predicted by fits that have not seen it."""

    # Sum of the sizes of the errors of each share's rows by frame, over all planes, shape (shares, frames)
    error_dn: Array
    rows: Array  # how many rows these are, likewise

    @classmethod
    def of(cls, planes: Sequence[Plane], parts: Sequence[JointFit]) -> LeftOut:
        """Return the errors of the shares.

        Args:
            planes: The planes, with their shares.
            parts: The fit without each share, as of `without_shares`.
        """
        frames = planes[0].samples.frame_log_time.size
        error_dn, rows = np.zeros((len(parts), frames)), np.zeros((len(parts), frames))
        for share, part in enumerate(parts):
            for plane, fitted in zip(planes, part.fits, strict=True):
                test = plane.samples.shares[share]
                errors = np.abs(prediction_error_dn(test, fitted.log_exposure, fitted.fit.log_time_errors))
                known = np.isfinite(errors)
                error_dn[share] += np.bincount(test.frame[known], errors[known], frames)
                rows[share] += np.bincount(test.frame[known], minlength=frames)
        return cls(error_dn, rows)

    def mean_dn(self, *frames: int) -> float:
        """Return the mean size of the error in DN over all shares, of some frames or, where none is named, of all."""
        of = list(frames) or slice(None)
        return float(self.error_dn[:, of].sum() / max(self.rows[:, of].sum(), 1.0))

    def means_without_one_dn(self, frame: int) -> Array:
        """Return the mean size of a frame's errors in DN over all shares but each that shows it in turn."""
        seen = self.rows[:, frame] > 0
        error_dn, rows = self.error_dn[seen, frame], self.rows[seen, frame]
        return np.asarray((error_dn.sum() - error_dn) / np.maximum(rows.sum() - rows, 1.0))
