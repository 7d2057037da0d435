"""The judge of a response: how well it predicts digital numbers that it has not seen."""

from __future__ import annotations

import math

import numpy as np

from radiometer.analysis.response.basis import hat_weight
from radiometer.analysis.response.noise import dn_at, slope_at, value_at
from radiometer.analysis.response.samples import ResponseSamples
from radiometer.typing import Array

# ln of the least step of a camera's dial, a third of a stop. Photographs agree with their labels where one is predicted
# from the others to less than half of what that step does: 21 clean real scenes have 0.03 to 0.3 of it.
_DIAL_STEP = math.log(2.0) / 3.0
_MOST_OF_STEP = 0.5
# What is less than so many standard deviations of the groups' means may be the noise of few pixels.
_CLEAR_OF_NOISE = 3.0


def prediction_error_dn(samples: ResponseSamples, log_exposure: Array, log_time_errors: Array | None = None) -> Array:
    """Return predicted minus found digital number of every row, predicted from the other frames of its group alone.

    ln E of a group is the mean over its other rows, weighted by 1/g'² (equal noise in digital numbers) and by the hat.
    Rows of groups that no other frame shows are NaN.

    Args:
        samples: Rows that the curve was not fitted to.
        log_exposure: g at every digital number.
        log_time_errors: ln of true over stated time of every frame; None where the labels are taken as they are.
    """
    time = samples.log_time if log_time_errors is None else samples.log_time + log_time_errors[samples.frame]
    log_h = value_at(log_exposure, samples.dn)
    weight = (hat_weight(samples.dn, samples.limits) ** 2 + 1e-6) / slope_at(log_exposure, samples.dn, samples) ** 2
    total = np.bincount(samples.group, weight)[samples.group]
    summed = np.bincount(samples.group, weight * (log_h - time))[samples.group]
    others = total - weight
    alone = others <= 1e-12 * total
    predicted = (summed - weight * (log_h - time)) / np.where(alone, 1.0, others) + time
    return np.where(alone, np.nan, dn_at(log_exposure, predicted) - samples.dn)


def error_dn(errors: Array) -> float:
    """Return the mean size of prediction errors in DN, rows without a prediction left out.

    The mean size, not the mean square: a few rows at edges and reflections would be the judge otherwise.
    """
    return float(np.nanmean(np.abs(errors)))


def dial_step_dn(samples: ResponseSamples, log_exposure: Array) -> float:
    """Return by how many DN a third of a stop more would change the rows, in the mean."""
    brighter = dn_at(log_exposure, value_at(log_exposure, samples.dn) + _DIAL_STEP)
    return float(np.mean(np.abs(brighter - samples.dn)))


def follow_no_curve(error: float, samples: ResponseSamples, log_exposure: Array) -> bool:
    """Return whether frames predict each other so badly that no single curve fits them under their labels.

    Args:
        error: Mean size in DN of the error with which rows are predicted from other frames.
        log_exposure: g at every digital number.
    """
    noise_dn = float(np.mean(np.sqrt(samples.variance / samples.pixels)))
    return error > max(_MOST_OF_STEP * dial_step_dn(samples, log_exposure), _CLEAR_OF_NOISE * noise_dn)
