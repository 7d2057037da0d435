"""What a user must know about a patch reading."""

from __future__ import annotations

import datetime as dt

import numpy as np

from radiometer.analysis.patch.contributions import PatchSituation, budget_terms, local_scatter
from radiometer.analysis.uncertainty.budget import combined_u
from radiometer.data import Flag

_NOISE_FLOOR_SIGMA = 2.0
_NONUNIFORM_REL = 0.05


def reading_flags(situation: PatchSituation, now: dt.datetime) -> tuple[Flag, ...]:
    """Return the flags of a reading, sorted by name.

    Args:
        situation: What the reading was made from.
        now: Time the calibration's age is counted to, with time zone.
    """
    calibration, estimate = situation.calibration, situation.estimate
    found = {
        Flag.SATURATED: not situation.frames[0].unclipped,
        Flag.BELOW_NOISE: situation.value < _NOISE_FLOOR_SIGMA * _floor(situation),
        Flag.EXTRAPOLATED: _extrapolates(situation),
        Flag.NONUNIFORM: _is_nonuniform(situation),
        Flag.FLICKER: estimate.flickers,
        Flag.UNCALIBRATED: calibration is None or not calibration.absolute,
        Flag.STALE_CALIBRATION: calibration is not None and calibration.is_stale(now),
    }
    return tuple(sorted(flag for flag, raised in found.items() if raised))


def _floor(situation: PatchSituation) -> float:
    """Return the standard uncertainty that is left without light: noise and dark level, in the reading's unit."""
    named = ("repeatability", "dark and black level")
    return combined_u(term for term in budget_terms(situation) if term.name in named)


def _extrapolates(situation: PatchSituation) -> bool:
    """Tell whether the frames that carry most of the estimate lie outside the response curve's data."""
    if situation.model.linear:
        return False
    low, high = situation.model.valid_dn
    share = situation.estimate.coefficients * situation.estimate.expected
    means = np.array([float(np.mean(frame.dn[situation.good])) for frame in situation.frames])
    outside = (means < low) | (means > high)
    return bool(np.abs(share[outside]).sum() > 0.5 * np.abs(share).sum())


def _is_nonuniform(situation: PatchSituation) -> bool:
    """Tell whether radiance changes over the patch by more than noise and 5 %."""
    pixels, good = situation.estimate.pixel_rates, situation.good
    scatter, pairs = local_scatter(pixels, good)
    if pairs < 8:
        return False
    noise = max(scatter, situation.estimate.u_pixel) ** 2
    slow = float(np.var(pixels[good])) - noise * (1.0 + 6.0 * np.sqrt(3.0 / good.sum()))
    structure = max(slow, scatter**2 - situation.estimate.u_pixel**2 * (1.0 + 6.0 * np.sqrt(3.0 / good.sum())))
    return bool(structure > (_NONUNIFORM_REL * situation.estimate.rate) ** 2)
