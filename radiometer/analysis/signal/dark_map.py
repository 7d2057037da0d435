"""The dark signal of every pixel of a light frame, as dark frames of its exposure or of others show it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radiometer.analysis.signal.model import (
    DarkLevel,
    SignalModel,
    is_cut_off,
    matching_darks,
    picked,
    seconds_at_reference,
    signal_of,
    warmed_signal,
)
from radiometer.data import Frame, FrameSettings

# One ordinary pixel in 16 000 is farther from the others by chance, and then has its own noise counted.
_HOT_SIGMAS: Final = 4.0
_PIXELS_OF_THE_MIDDLE: Final = 1 << 16  # their median is known to a 200th of their noise


@dataclass(frozen=True, slots=True, eq=False)
class DarkMap:
    """The dark signal x of a light frame by pixel."""

    signal: NDArray[np.float32]  # of every pixel, flat; size 1 where one level holds for all
    variance: float = 0.0  # of the signal of an ordinary pixel, by the noise of dark frames
    # The same of hot pixels, with the shot noise of their own dark current, flat; 0 at all others; size 1 without any
    variance_hot: NDArray[np.float32] = field(default_factory=lambda: np.zeros(1, np.float32))
    unknown: NDArray[np.intp] = field(default_factory=lambda: np.empty(0, np.intp))  # full in every dark frame


def dark_map(settings: FrameSettings, dark_frames: Sequence[Frame], model: SignalModel, level: DarkLevel) -> DarkMap:
    """Return the dark signal x of every pixel of a light frame.

    Dark frames of the same exposure show it. Those of other exposures show how much more dark current a pixel has than
    the others: that part grows with time, so that it is a straight line through zero over exposure.

    Args:
        settings: Of the light frame.
        dark_frames: Frames with the shutter closed.
        level: Dark level of the light frame: the mean of pixels that fill up in none of the dark frames.
    """
    matching = matching_darks(settings, dark_frames)
    if not matching:
        return _by_rates(settings, dark_frames, model, level)
    total = warmed_signal(matching[0], settings, model, level.black).ravel().astype(np.float32)
    for frame in matching[1:]:
        total += warmed_signal(frame, settings, model, level.black).ravel().astype(np.float32)
    total /= np.float32(len(matching))
    variance = (float(model.variance(0.0, settings)) + level.variance) / len(matching)
    above = total - np.float32(_middle(total))
    hot = above > _HOT_SIGMAS * np.sqrt(variance)
    if not hot.any():
        return DarkMap(total, variance)
    of_shot = above / np.float32(model.electrons_per_unit * len(matching))
    return DarkMap(total, variance, np.where(hot, of_shot, np.float32(0.0)))


def _by_rates(settings: FrameSettings, dark_frames: Sequence[Frame], model: SignalModel, level: DarkLevel) -> DarkMap:
    here = seconds_at_reference(settings, model)
    # Bias frames are too short for any dark current.
    usable = [
        one
        for one in dark_frames
        if one.settings.gain_db == settings.gain_db
        and seconds_at_reference(one.settings, model) > 0.0
        and not is_cut_off(one)
    ]
    whole = never_full(usable, model)
    if not usable or not whole.any():
        return DarkMap(np.full(1, level.signal, np.float32))
    rate, weight, noise, cubes = (np.zeros(whole.size, np.float32) for _ in range(4))
    for one in usable:
        time, signal = seconds_at_reference(one.settings, model), signal_of(one, model, settings)
        known = (one.dn < model.saturation_dn(one.settings, within_data=False)).ravel()
        rate += known * (time * (signal - signal[whole].mean()).ravel()).astype(np.float32)
        weight += np.float32(time**2) * known
        own = float(model.variance(0.0, one.settings)) + level.variance * time / here
        noise += np.float32(time**2 * own) * known
        cubes += np.float32(time**3) * known
    shown = weight > 0.0
    square = np.where(shown, weight, np.float32(1.0)) ** 2
    rate, noise = rate / np.sqrt(square), noise / square
    above = rate - np.float32(_middle(rate[shown]))
    hot = shown & (np.abs(above) > _HOT_SIGMAS * np.sqrt(noise))
    ordinary = shown & ~hot
    of_noise = float(noise[ordinary].mean()) if ordinary.any() else float(noise[shown].mean())
    differ = max(float(np.var(rate[ordinary])) - of_noise, 0.0) if ordinary.any() else 0.0
    if differ <= of_noise:  # what each pixel shows of itself is mostly noise
        rate[~hot] = rate[ordinary].mean() if ordinary.any() else 0.0
        if not hot.any() and shown.all():
            return DarkMap(np.full(1, level.signal, np.float32), here**2 * differ)
    rate[~shown] = rate[ordinary].mean() if ordinary.any() else 0.0
    variance = here**2 * min(differ, of_noise)
    of_shot = np.maximum(rate, 0.0) * cubes / (square * np.float32(model.electrons_per_unit))
    variance_hot = np.where(hot, np.maximum(here**2 * (noise + of_shot) - variance, 1e-30), 0.0)
    own = level.signal + here * rate
    return DarkMap(np.asarray(own, dtype=np.float32), variance, variance_hot.astype(np.float32), np.flatnonzero(~shown))


def _middle(values: NDArray[np.float32]) -> float:
    return float(np.median(values[:: max(1, values.size // _PIXELS_OF_THE_MIDDLE)]))


def never_full(dark_frames: Sequence[Frame], model: SignalModel) -> NDArray[np.bool_]:
    """Return the pixels that fill up in none of the dark frames, shape (height, width); empty without any frame."""
    limits = [model.saturation_dn(one.settings, within_data=False) for one in dark_frames]
    below = [one.dn < limit for one, limit in zip(dark_frames, limits, strict=True)]
    return np.asarray(np.all(below, axis=0)) if below else np.empty(0, np.bool_)


def without_full(dark_frames: Sequence[Frame], model: SignalModel) -> list[Frame]:
    """Return dark frames without the pixels that fill up in one: a mean over these would be too low in the longest.

    Where all or none do, the frames are as they were.
    """
    whole = never_full(dark_frames, model)
    return [picked(one, whole) for one in dark_frames] if whole.any() and not whole.all() else list(dark_frames)
