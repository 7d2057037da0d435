"""Frames and readings corrected for what was found of their camera."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radiometer.data import Bracket, FoundEffects, Frame, FrameSettings
from radiometer.units import gain_factor

_ROUNDS = 12  # each leaves a part a₂ of the error, some per cent


def corrected_settings(settings: FrameSettings, found: FoundEffects, black_dn: float) -> FrameSettings:
    """Return the settings that a frame was really taken with.

    Args:
        settings: As stated.
        found: What was found of the camera.
        black_dn: Black level in DN of a frame that does not state its own.
    """
    black = black_dn if settings.black_level_dn is None else settings.black_level_dn
    further_s = found.exposure_further_s if settings.gain_db > found.exposure_above_db else 0.0
    return replace(
        settings,
        exposure_s=max(settings.exposure_s + found.exposure_offset_s + further_s, 1e-9),
        gain_db=_real_gain_db(settings.gain_db, found),
        black_level_dn=black + found.black_offset_dn + _amplified_dn(settings.gain_db, found),
    )


def _real_gain_db(gain_db: float, found: FoundEffects) -> float:
    table = float(np.interp(gain_db, found.gains_db, found.gain_errors_rel)) if found.gains_db else 0.0
    return gain_db * (1.0 + found.gain_error_rel) + 20.0 * math.log10(1.0 + table)


def _amplified_dn(gain_db: float, found: FoundEffects) -> float:
    """Return what the gain adds to the black level in DN."""
    more = max(gain_factor(gain_db - found.black_from_db), 1.0) - 1.0
    return found.black_slope_dn * (more + found.black_bend * more**2)


def straightened(signal: ArrayLike, found: FoundEffects, electrons_per_unit: float) -> NDArray[np.float64]:
    """Return a linear sensor's signal without the bend that was found, of any shape.

    Args:
        signal: x above black at 0 dB, as it came through the bend.
        found: What was found of the camera.
        electrons_per_unit: Electrons per unit of x.
    """
    seen = np.asarray(signal, dtype=np.float64)
    straight = seen
    if found.well_a2 == 0.0 and found.well_a3 == 0.0:
        return straight
    for _ in range(_ROUNDS):
        z = np.clip(straight * electrons_per_unit / found.well_e, 0.0, 1.2)
        straight = seen / (1.0 - found.well_a2 * z - found.well_a3 * z**2)
    return straight


def corrected_frames(
    frames: Bracket | Iterable[Frame], found: FoundEffects, black_dn: float
) -> Bracket | Iterable[Frame]:
    """Return frames with the settings they were really taken with; the same frames where nothing was found.

    Args:
        frames: As stated; a bracket stays one.
        found: What was found of the camera.
        black_dn: Black level in DN of frames that do not state their own.
    """
    if found == FoundEffects():
        return frames
    if isinstance(frames, Bracket):
        return Bracket.from_frames(_each(frames.every_frame, found, black_dn), frames.origin)
    return _each(frames, found, black_dn)


def _each(frames: Iterable[Frame], found: FoundEffects, black_dn: float) -> Iterator[Frame]:
    for frame in frames:
        yield replace(frame, settings=corrected_settings(frame.settings, found, black_dn))


def temperature_factor(found: FoundEffects, here_c: float | None, there_c: float | None) -> float:
    """Return what a reading is multiplied by for the warmth of the sensor: responsivity at calibration over now.

    Args:
        found: What was found of the camera.
        here_c: Temperature at the reading in °C; None where unknown.
        there_c: At calibration.
    """
    if here_c is None or there_c is None:
        return 1.0
    here, there = (
        1.0 + found.temperature_slope_per_k * warmer + found.temperature_bend_per_k2 * warmer**2
        for warmer in (here_c - 25.0, there_c - 25.0)
    )
    return there / here


def without_glare(glare: float, surround_at_calibration: float) -> tuple[float, float]:
    """Return (a, b) of L = a·r − b·M: the reading r and the picture's mean M, both as a scale with glare gives them.

    A picture with glare is m = (1 − g)·L + g·M; its mean stays M. The scale was got on a source that was seen as m₀
    before a mean of S₀·m₀, so that r = m·(1 − g·S₀)/(1 − g), and L = (m − g·M)/(1 − g) follows.

    Args:
        glare: g, the part of the picture's mean that is spread over it.
        surround_at_calibration: S₀.
    """
    gain = 1.0 / (1.0 - glare * surround_at_calibration)
    return gain, gain * glare
