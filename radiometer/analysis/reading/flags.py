"""Flags that a user must know about a patch reading."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from radiometer.analysis.reading.contributions import PatchSituation, local_scatter
from radiometer.analysis.uncertainty.budget import Term, combined_u
from radiometer.data import Flag

_NOISE_FLOOR_SIGMA = 2.0
_NONUNIFORM_REL = 0.05


# A contribution dominates from this part of the variance on, where it is more than a trifle.
_DOMINATES = 0.5
_TRIFLE_REL = 0.01
# From this on an undeclared natural fall-off is reported.
_FALLOFF_TOLD_REL = 0.002
# Frames that show whether the light flickers: these many; more where each is short against a period of mains light.
FEWEST_FRAMES = 3
FEWEST_SHORT_FRAMES = 5
SHORT_FRAME_S = 0.01
# A surround of which more than this clips everywhere may be of any brightness.
_SURROUND_CLIPS = 0.002


def reading_flags(situation: PatchSituation, terms: Sequence[Term]) -> tuple[Flag, ...]:
    """Return the flags of a reading, sorted by name.

    Args:
        situation: What the reading was made from.
        terms: Its budget.
    """
    calibration, estimate, now = situation.calibration, situation.estimate, situation.now
    found = {
        Flag.SATURATED: not situation.frames[0].unclipped,
        Flag.BELOW_NOISE: situation.value < _NOISE_FLOOR_SIGMA * _floor(terms),
        Flag.EXTRAPOLATED: _extrapolates(situation),
        Flag.NONUNIFORM: _is_nonuniform(situation),
        Flag.FLICKER: estimate.flickers or situation.shown.unsteady,
        Flag.UNCALIBRATED: calibration is None or not calibration.absolute,
        Flag.STALE_CALIBRATION: calibration is not None and calibration.is_stale(now),
    }
    if calibration is not None:
        found[Flag.FEW_FRAMES] = _too_few_frames(situation)
        found[Flag.STRAY_LIGHT] = situation.surround.clipped > _SURROUND_CLIPS
    raised = {flag for flag, here in found.items() if here} | _dominant(situation.value, terms)
    if Flag.BELOW_NOISE in raised:
        raised.discard(Flag.DARK_ASSUMED)  # noise and dark level are what it is below
    return tuple(sorted(raised))


def _floor(terms: Sequence[Term]) -> float:
    """Return the standard uncertainty that is left without light: noise and dark level, in the reading's unit."""
    named = ("repeatability", "dark and black level")
    return combined_u(term for term in terms if term.name in named)


def _dominant(value: float, terms: Sequence[Term]) -> set[Flag]:
    """Return the flags of contributions that make up most of the variance, and of a fall-off that was assumed."""
    whole, size = combined_u(terms), abs(value)
    found = {
        term.flag
        for term in terms
        if term.flag is not None and term.u > _TRIFLE_REL * size and term.u**2 >= _DOMINATES * whole**2
    }
    assumed = (term for term in terms if term.flag is Flag.FALLOFF_ASSUMED and term.u > _FALLOFF_TOLD_REL * size)
    return found | {Flag.FALLOFF_ASSUMED for _ in assumed}


def _too_few_frames(situation: PatchSituation) -> bool:
    """Return whether the frames are too few to show that the light is steady."""
    longest = max(frame.settings.exposure_s for frame in situation.frames)
    return len(situation.frames) < (FEWEST_FRAMES if longest >= SHORT_FRAME_S else FEWEST_SHORT_FRAMES)


def _extrapolates(situation: PatchSituation) -> bool:
    """Return whether the frames that carry most of the estimate are outside the response curve's data."""
    if situation.model.linear:
        return False
    low, high = situation.model.valid_dn
    share = situation.estimate.coefficients * situation.estimate.expected
    means = np.array([float(np.mean(frame.dn[situation.good])) for frame in situation.frames])
    outside = (means < low) | (means > high)
    return bool(np.abs(share[outside]).sum() > 0.5 * np.abs(share).sum())


def _is_nonuniform(situation: PatchSituation) -> bool:
    """Return whether radiance changes over the patch by more than noise and 5 %."""
    pixels, good = situation.estimate.pixel_rates, situation.good
    scatter, pairs = local_scatter(pixels, good)
    if pairs < 8:
        return False
    noise = max(scatter, situation.estimate.u_pixel) ** 2
    slow = float(np.var(pixels[good])) - noise * (1.0 + 6.0 * np.sqrt(3.0 / good.sum()))
    structure = max(slow, scatter**2 - situation.estimate.u_pixel**2 * (1.0 + 6.0 * np.sqrt(3.0 / good.sum())))
    return bool(structure > (_NONUNIFORM_REL * situation.estimate.rate) ** 2)
