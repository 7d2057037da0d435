"""Brackets through a shutter whose exposures differ from their labels by one time, made without the analysis."""

from __future__ import annotations

from typing import Any

import numpy as np

from radiometer.analysis.response.debevec1997 import curve_debevec1997
from radiometer.analysis.response.planes import Plane
from radiometer.analysis.response.samples import gather_samples
from radiometer.data import Bracket, Frame, FrameSettings

# From 1/8192 s to 1/4 s in whole stops.
LABELS_S = 2.0 ** -np.arange(13, 1, -1)
SHAPE = (96, 128)


def scene(seed: int) -> tuple[np.ndarray, np.random.Generator]:
    """Return irradiance per second of every pixel, even in its logarithm over fifteen stops, and what draws noise."""
    rng = np.random.default_rng(seed)
    return np.exp(rng.uniform(-2.0, 8.5, SHAPE)), rng


def photographed(
    offset_s: float,
    wrong: int | None = None,
    ratio: float = 1.0,
    *,
    labels_s: Any = LABELS_S,
    gains: Any = None,
    scatter: float = 0.0,
    power: float = 0.6,
    seed: int = 0,
) -> Bracket:
    """Return 8-bit frames of a bent response, 0.8 DN of noise.

    Args:
        offset_s: Real less stated exposure in s, of all frames.
        wrong: A frame whose real exposure is besides `ratio` times that.
        ratio: As stated.
        labels_s: Stated exposures in s.
        gains: Gain factor of every frame; 1 where None.
        scatter: Standard deviation of ln of the real exposures about that.
        power: Of the response.
        seed: Of scene and noise.
    """
    light, rng = scene(seed)
    frames = []
    for number, label in enumerate(labels_s):
        gain = 1.0 if gains is None else gains[number]
        real = (label + offset_s) * (ratio if number == wrong else 1.0) * np.exp(scatter * rng.standard_normal())
        exposure = light * real * gain
        values = 255.0 * (exposure / (0.3 + exposure)) ** power + 0.8 * rng.standard_normal(SHAPE)
        settings = FrameSettings(float(label), gain_db=20.0 * float(np.log10(gain)))
        frames.append(Frame(np.clip(np.round(values), 0, 255).astype(np.uint8), 8, settings))
    return Bracket.from_frames(frames)


def plane(bracket: Bracket) -> Plane:
    """Return the samples of a bracket with a first estimate of its curve."""
    samples = gather_samples(bracket)
    return Plane(samples, curve_debevec1997(samples).log_exposure)
