"""Frames and readings corrected for what was found of their camera."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

from radiometer.data import Bracket, FoundEffects, Frame, FrameSettings


def corrected_settings(settings: FrameSettings, found: FoundEffects, black_dn: float) -> FrameSettings:
    """Return the settings that a frame was really taken with.

    Args:
        settings: As stated.
        found: What was found of the camera.
        black_dn: Black level in DN of a frame that does not state its own.
    """
    black = black_dn if settings.black_level_dn is None else settings.black_level_dn
    return replace(
        settings,
        exposure_s=max(settings.exposure_s + found.exposure_offset_s, 1e-9),
        gain_db=settings.gain_db * (1.0 + found.gain_error_rel),
        black_level_dn=black + found.black_offset_dn,
    )


def corrected_frames(frames: Iterable[Frame], found: FoundEffects, black_dn: float) -> Iterable[Frame]:
    """Return frames with the settings they were really taken with; the same frames where nothing was found.

    Args:
        frames: As stated; a bracket stays one.
        found: What was found of the camera.
        black_dn: Black level in DN of frames that do not state their own.
    """
    if found == FoundEffects():
        return frames
    if isinstance(frames, Bracket):
        return Bracket.from_frames(_each((*frames.frames, *frames.dark_frames), found, black_dn), frames.origin)
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
    slope = found.temperature_slope_per_k
    return (1.0 + slope * (there_c - 25.0)) / (1.0 + slope * (here_c - 25.0))


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
