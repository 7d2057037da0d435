"""Contribution of each frame to the merge: exposure, noise without light, where it clips, its dark level."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from radiometer.analysis.signal.dark_map import dark_map, without_full
from radiometer.analysis.signal.lens import lens_factor_sr
from radiometer.analysis.signal.model import SignalModel, dark_levels
from radiometer.analysis.signal.situation import Situation
from radiometer.data import Frame, FrameSettings
from radiometer.typing import Array
from radiometer.units import gain_factor

# Below this many sigma of read noise above zero the black level cuts noise off, and the number 0 says little.
_BLACK_HEADROOM_SIGMA = 4.0
# An end of a frame that is off by less than this of its noise moves a pixel by less than its own noise.
_MOVED_SIGMA = 0.1


@dataclass(frozen=True, slots=True, eq=False)
class FrameTerms:
    """One frame's constants."""

    settings: FrameSettings  # of the frame
    exposure: float  # exposure time in s, times the lens factor in sr where that counts
    gain: float  # gain factor
    variance: float  # variance of x without light
    low_dn: int  # lowest digital number that is used
    high_dn: int  # digital number from which the frame clips
    clips_at: float  # x at clipping
    sigma_clip: float  # standard deviation of x there
    cut_at: float  # x below which the frame is cut off at black; -inf where no number is
    sigma_cut: float  # standard deviation of x there
    dark: NDArray[np.float32]  # dark signal x: of the whole frame (size 1) or of every pixel (flat)
    u_dark: float  # uncertainty of the dark signal that all frames share
    black_dn: float  # black level in DN
    u_unstated: float = 0.0  # standard uncertainty of the signal of a dark current that nothing states
    level: float = 0.0  # dark signal x that both ends are counted from: the whole frame's
    has_single_dark: bool = False  # whether one dark frame alone gives its dark signal
    dark_variance: float = 0.0  # variance of every pixel's `dark`, within `variance`; frames of one exposure share it
    # Variance of a hot pixel's `dark` beyond that, flat; 0 at all others, size 1 where there are none
    variance_hot: NDArray[np.float32] = field(default_factory=lambda: np.zeros(1, np.float32))
    unknown: NDArray[np.intp] = field(default_factory=lambda: np.empty(0, np.intp))  # pixels without a dark signal


def frame_terms(
    settings: FrameSettings,
    situation: Situation,
    dark_frames: Sequence[Frame],
    *,
    through_lens: bool,
    masked_dn: float | None = None,
    darkest: float = math.inf,
) -> FrameTerms:
    """Return the constants of a light frame.

    Args:
        dark_frames: Frames with the shutter closed; those of the same exposure are taken off pixel by pixel.
        through_lens: Whether the exposure carries the lens factor of the frame's f-number.
        masked_dn: What masked pixels of the frame read in DN; None where it is not stated.
        darkest: Signal x of its darkest pixels; inf where it is not known.
    """
    model = situation.model
    gain = gain_factor(settings.gain_db)
    whole = without_full(dark_frames, model)
    level = dark_levels([settings], whole, model, situation.black, masked_dn=(masked_dn,), darkest=(darkest,))[0]
    by_pixel = dark_map(settings, dark_frames, model, level)
    dark, extra = by_pixel.signal, by_pixel.variance
    of_frames = math.sqrt(max(level.u_independent**2 - (extra / dark.size if dark.size > 1 else 0.0), 0.0))
    low, high = _lowest_dn(model, settings), math.ceil(model.saturation_dn(settings))
    clips_at = float(model.at_dn(model.table(settings), high - 0.5)) - level.signal
    cut_at = float(model.at_dn(model.table(settings), low - 0.5)) - level.signal if low > 0 else -math.inf
    return FrameTerms(
        settings,
        settings.exposure_s * (lens_factor_sr(situation.lens, settings.f_number) if through_lens else 1.0),
        gain,
        _dark_variance(model, settings, gain) + level.variance + extra,
        low,
        high,
        clips_at,
        float(np.sqrt(model.variance(clips_at, settings) + level.variance)),
        cut_at,
        float(np.sqrt(model.variance(max(cut_at, 0.0), settings) + level.variance)),
        dark,
        math.hypot(math.sqrt(max(level.u_common**2 - level.u_unstated**2, 0.0)), of_frames),
        model.black_of(settings),
        level.u_unstated,
        level.signal,
        level.is_single,
        extra,
        by_pixel.variance_hot,
        by_pixel.unknown,
    )


def longest_of(terms: Sequence[FrameTerms]) -> int:
    """Return which frame has the longest exposure, the first of several: below a curve's data it counts as well."""
    return max(range(len(terms)), key=lambda k: terms[k].exposure)


def with_own_ends(
    terms: Sequence[FrameTerms], used: NDArray[np.uint16] | NDArray[np.uint64], begin: int, shot: float
) -> tuple[NDArray[np.intp], Array, Array]:
    """Return the pixels whose own dark signal moves where their frames clip, or adds noise, and by how much.

    Args:
        terms: Of all frames, in the order of their bits.
        used: Bits of the frames used in each pixel.
        begin: First of these pixels in the picture.
        shot: Variance of shot noise per unit of x.

    Returns:
        Places of the pixels; x by which the ends of each frame are lower there, and the variance of x that each has
        beyond that of other pixels, shape (pixels, frames).
    """
    uneven = [(k, one) for k, one in enumerate(terms) if one.dark.size > 1]
    moved = np.zeros(used.size, bool)
    for k, one in uneven:
        off = np.abs(one.dark[begin : begin + used.size] - np.float32(one.level))
        moved |= (off > _MOVED_SIGMA * one.sigma_clip) & (used >> used.dtype.type(k) & used.dtype.type(1) == 0)
        if one.low_dn > 0:
            moved |= off > _MOVED_SIGMA * one.sigma_cut
        if one.variance_hot.size > 1:
            moved |= one.variance_hot[begin : begin + used.size] > 0.0
    pixels = np.flatnonzero(moved)
    lower, noisier = np.zeros((2, pixels.size, len(terms)))
    alike = Counter((one.settings.exposure_s, one.settings.gain_db) for one in terms)
    for k, one in uneven:
        lower[:, k] = one.dark[begin + pixels] - one.level
        if one.variance_hot.size > 1:  # lights of one exposure share the dark frames' noise; each has its own
            of_dark = one.variance_hot[begin + pixels]
            of_light = np.where(of_dark > 0.0, shot * np.maximum(lower[:, k], 0.0), 0.0)
            noisier[:, k] = of_light + alike[one.settings.exposure_s, one.settings.gain_db] * of_dark
    return pixels, lower, noisier


def with_taps(terms: FrameTerms, frame: Frame, model: SignalModel) -> FrameTerms:
    """Return a frame's constants with the black level that each pixel has by its tap, where the frame holds it."""
    if frame.black_offset_dn is None:
        return terms
    slope = float(model.at_dn(model.slope, model.black_dn)) / terms.gain
    dark = np.asarray(terms.dark + slope * frame.black_offset_dn.ravel(), dtype=np.float32)
    return replace(terms, dark=dark, variance=terms.variance + (slope * frame.black_u_dn) ** 2)


def with_shared_darks(terms: Sequence[FrameTerms]) -> list[FrameTerms]:
    """Return frames in which the noise of dark frames counts as often as they share them: it does not average out."""
    alike = Counter((one.settings.exposure_s, one.settings.gain_db) for one in terms)
    others = [alike[one.settings.exposure_s, one.settings.gain_db] - 1 for one in terms]
    return [
        replace(one, variance=one.variance + more * one.dark_variance) for one, more in zip(terms, others, strict=True)
    ]


def with_excess(terms: FrameTerms, excess: Array, shot: float) -> FrameTerms:
    """Return a frame's constants with variances that are larger by two factors: with light, and without.

    Args:
        excess: The factors.
        shot: Variance of shot noise per unit of x, without the factor.
    """
    light, dark = excess

    def widened(sigma: float, signal: float) -> float:
        return math.sqrt(dark * sigma**2 + (light - dark) * shot * max(signal, 0.0))

    return replace(
        terms,
        variance=dark * terms.variance,
        dark_variance=dark * terms.dark_variance,
        sigma_clip=widened(terms.sigma_clip, terms.clips_at),
        sigma_cut=widened(terms.sigma_cut, terms.cut_at),
    )


def _dark_variance(model: SignalModel, settings: FrameSettings, gain: float) -> float:
    dark_e = model.noise.dark_e(settings.exposure_s, settings.temperature_c)
    quantisation = model.code_variance_dn2 / gain**2 if model.linear else 0.0
    return (model.noise.read_noise_e**2 + dark_e) / model.electrons_per_unit**2 + quantisation


def _lowest_dn(model: SignalModel, settings: FrameSettings) -> int:
    """Return the lowest digital number whose signal counts: all do where the black level keeps the noise whole.

    Where it cuts noise off, a mean over the numbers above 0 is too high; so is one through the straight line that
    continues a response curve below its data.
    """
    black = model.black_of(settings)
    if black >= _BLACK_HEADROOM_SIGMA * model.noise.read_noise_e * model.noise.gain_dn_per_e(settings.gain_db):
        return 0
    return 1 if model.linear else max(1, model.valid_dn[0] + round(black - model.black_dn))
