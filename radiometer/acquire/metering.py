"""Metering: how bright every pixel is, from a few trial exposures."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from radiometer.acquire.exposure_plan import ExposureWindow
from radiometer.data import Frame, Patch, SensorNoise
from radiometer.data.pile_up import with_white_levels
from radiometer.devices import Camera

FIRST_TRIAL_S = 0.01  # the middle of usual ranges, 10 µs to 10 s, by ratio
# From one trial to the next: well inside the dynamic range of any sensor, so that no pixel falls between.
TRIAL_RATIO = 32.0


@dataclass(frozen=True, slots=True, eq=False)
class SceneRates:
    """How bright a scene is."""

    # Signal above black in DN per s at gain 0 dB, shape (height, width); infinite where a pixel clips even at the
    # shortest exposure, 0 where it never rose above the noise
    rates_dn_per_s: NDArray[np.float64]
    trials: tuple[Frame, ...]  # the frames taken to find out


def meter(camera: Camera, region: Patch | None = None, *, longest_s: float = math.inf) -> SceneRates:
    """Measure the brightness of every pixel of a region with as few trial exposures as it takes.

    Args:
        camera: An open camera; its gain and black level stay as they are.
        region: Pixels that matter; None for the whole frame.

    Returns:
        Rates over the region's pixels.

    Raises:
        DeviceError: If the camera fails.
    """
    limits = camera.capabilities.exposure_s
    longest = min(limits[1], longest_s)
    # A bound is reached when it was asked for: a camera that rounds exposure times may never state it.
    shortest = last = min(max(FIRST_TRIAL_S, limits[0]), longest)
    trials = [_trial(camera, last)]
    while _clipped(camera, trials[-1], region).any() and shortest > limits[0]:
        shortest = max(shortest / TRIAL_RATIO, limits[0])
        trials.append(_trial(camera, shortest))
    rates = _rates(camera, trials, region)
    while (todo := _lost_in_noise(camera, trials, region)).any() and last < longest:
        last = min(last * TRIAL_RATIO, longest)
        trials.append(_trial(camera, last))
        rates = _rates(camera, trials, region)
    rates[todo] = 0.0
    return SceneRates(rates, tuple(trials))


def _trial(camera: Camera, exposure_s: float) -> Frame:
    camera.configure(replace(camera.settings, exposure_s=exposure_s))
    return camera.capture(1)[0]


def _window(camera: Camera, frame: Frame) -> ExposureWindow:
    return ExposureWindow.of(camera.description, frame.settings.gain_db, frame.settings.black_level_dn or 0.0)


def _signal(camera: Camera, frame: Frame, region: Patch | None) -> NDArray[np.float64]:
    """Return what light adds to the digital numbers: black level and expected dark signal taken off."""
    dn = frame.dn if region is None else frame.dn[region.slices]
    noise, settings = SensorNoise.of(camera.description), frame.settings
    dark_dn = noise.dark_e(settings.exposure_s, settings.temperature_c) * noise.gain_dn_per_e(settings.gain_db)
    return dn.astype(np.float64) - ((settings.black_level_dn or 0.0) + dark_dn)


def _clipped(camera: Camera, frame: Frame, region: Patch | None) -> NDArray[np.bool_]:
    dn = frame.dn if region is None else frame.dn[region.slices]
    return np.asarray((_signal(camera, frame, region) > _window(camera, frame).highest_dn) | (dn >= frame.saturated_dn))


def _lost_in_noise(camera: Camera, trials: list[Frame], region: Patch | None) -> NDArray[np.bool_]:
    """Tell which pixels even the longest trial did not lift above five times its noise."""
    longest = max(trials, key=lambda frame: frame.settings.exposure_s)
    noise = SensorNoise.of(camera.description)
    settings = longest.settings
    dark_e = noise.dark_e(settings.exposure_s, settings.temperature_c)
    floor = 5.0 * math.sqrt(float(noise.variance_dn2(0.0, settings.gain_db, dark_e)))
    return np.asarray(_signal(camera, longest, region) < floor)


def _rates(camera: Camera, trials: list[Frame], region: Patch | None) -> NDArray[np.float64]:
    """Return each pixel's rate from the longest trial in which it does not clip."""
    rates = np.full(_signal(camera, trials[0], region).shape, np.inf)
    for frame in sorted(with_white_levels(trials), key=lambda f: f.settings.effective_exposure_s):
        usable = ~_clipped(camera, frame, region)
        signal = _signal(camera, frame, region)
        rates[usable] = signal[usable] / frame.settings.effective_exposure_s
    return rates
