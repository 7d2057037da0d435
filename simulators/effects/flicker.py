"""What is left of a periodic modulation of light after averaging over an exposure."""

from __future__ import annotations

from typing import Any, Final, cast

import numpy as np

from simulators.effects.context import ExposureContext, Signal

_HARMONICS: Final = 12


def _amplitudes(duty: float) -> list[tuple[int, float]]:
    """Return (harmonic, amplitude) of a wave of unit modulation: a sine for duty 0, a switched one otherwise."""
    if duty <= 0:
        return [(1, 1.0)]
    return [(k, 2.0 * float(np.sin(np.pi * k * duty)) / (np.pi * k * duty)) for k in range(1, _HARMONICS + 1)]


def flicker_variance(exposure_s: Any, frequency_hz: float, duty: float) -> Any:
    """Return the relative variance from frame to frame for unit modulation and random phase.

    Each harmonic of amplitude c is averaged over the exposure to c·sinc(k·f·t) and has a random phase: variance c²/2.

    Args:
        exposure_s: Exposure time in s.
        frequency_hz: Frequency of the modulation in Hz.
        duty: Share of the period that the source is on; 0 for a sine.
    """
    parts = [0.5 * np.square(c * np.sinc(k * frequency_hz * exposure_s)) for k, c in _amplitudes(duty)]
    return sum(parts[1:], parts[0])


def flicker_sample(
    signal: Signal,
    context: ExposureContext,
    rng: np.random.Generator,
    modulation: float,
    frequency_hz: float,
    duty: float,
) -> Signal:
    """Return the light of one frame that begins at a random phase of the modulation; never below zero."""
    phase, exposure_s = rng.random(), context.settings.exposure_s
    wave = sum(
        c * np.sinc(k * frequency_hz * exposure_s) * np.cos(2.0 * np.pi * k * (frequency_hz * exposure_s / 2 + phase))
        for k, c in _amplitudes(duty)
    )
    return cast(Signal, (signal * max(0.0, 1.0 + modulation * float(wave))).astype(signal.dtype))
