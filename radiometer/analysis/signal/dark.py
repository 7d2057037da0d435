"""The signal without light in each frame: from dark frames or masked pixels, else from black level and model."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from radiometer.analysis.signal.model import SignalModel
from radiometer.data import BlackLevel, Calibration, Frame, FrameSettings
from radiometer.data.reading import Patch
from radiometer.units import gain_factor

_SAME_EXPOSURE_REL = 0.01
_OTHER_EXPOSURE_REL = 0.05  # dark frames that differ by less say nothing of the dark current
_AS_WARM_K = 3.0  # a third more dark current, or a third less
_U_DOUBLING_K = 1.0  # dark currents in silicon double within 6 to 8 K
_OTHER = "dark frames of other exposures"
# Dark current of machine-vision sensors near 40 °C where a data sheet says nothing: 0 to some 20 e⁻/s.
UNKNOWN_DARK_E_PER_S = 10.0
# Masked pixels against those next to them: half a digital number (a rectangle), and a tenth of the modelled dark
# signal.
_MASKED_U_DN = 0.29
_MASKED_U_REL = 0.1


@dataclass(frozen=True, slots=True)
class DarkLevel:
    """Dark signal of one light frame in the unit of x at 0 dB.

    Attributes:
        signal: Expected dark signal.
        u_independent: Standard uncertainty that this frame's dark level has for itself.
        u_common: Standard uncertainty shared with all other frames.
        source: "dark frames", "masked pixels" or "black level".
    """

    signal: float
    u_independent: float
    u_common: float
    source: str


def dark_levels(
    settings: Sequence[FrameSettings],
    dark_frames: Sequence[Frame],
    model: SignalModel,
    black: BlackLevel,
    patch: Patch | None = None,
    masked_dn: Sequence[float | None] = (),
) -> list[DarkLevel]:
    """Return the dark level of every light frame.

    A dark frame of the same exposure and gain is used as it is; so are masked pixels of the frame itself. Dark
    frames of other exposures correct the black level, with the modelled dark current taken off theirs. Without any,
    black level and model stand alone.

    Args:
        settings: Of the light frames.
        dark_frames: Frames with the shutter closed.
        model: Signal model of the camera.
        black: Black level of the calibration, with its uncertainty.
        patch: Part of the picture to take the mean over; None for all of it.
        masked_dn: What masked pixels read in every light frame in DN, where known.
    """
    masked = masked_dn or (None,) * len(settings)
    return [_level(one, dark_frames, model, black, patch, dn) for one, dn in zip(settings, masked, strict=True)]


def _level(
    settings: FrameSettings,
    dark_frames: Sequence[Frame],
    model: SignalModel,
    black: BlackLevel,
    patch: Patch | None,
    masked_dn: float | None,
) -> DarkLevel:
    if matching := matching_darks(settings, dark_frames):
        return _from_frames(settings, matching, model, patch)
    if masked_dn is not None:
        return _from_masked(settings, masked_dn, model)
    if same_gain := [frame for frame in dark_frames if frame.settings.gain_db == settings.gain_db]:
        return _from_other_exposures(settings, same_gain, model, black, patch)
    return _from_model(settings, model, black)


def matching_darks(settings: FrameSettings, dark_frames: Sequence[Frame]) -> list[Frame]:
    """Return the dark frames of the same exposure, gain and, where both are known, temperature."""
    return [
        frame
        for frame in dark_frames
        if abs(frame.settings.exposure_s / settings.exposure_s - 1.0) <= _SAME_EXPOSURE_REL
        and frame.settings.gain_db == settings.gain_db
        and _as_warm(frame.settings.temperature_c, settings.temperature_c)
    ]


def _as_warm(one_c: float | None, other_c: float | None) -> bool:
    return one_c is None or other_c is None or abs(one_c - other_c) <= _AS_WARM_K


def _from_frames(settings: FrameSettings, frames: list[Frame], model: SignalModel, patch: Patch | None) -> DarkLevel:
    table = model.table(settings)
    means, count = [], 0
    for frame in frames:
        region = frame.dn if patch is None else frame.dn[patch.slices]
        means.append(float(table[region].mean()))
        count += region.size
    sigma = float(np.sqrt(model.variance(0.0, settings) / count))
    return DarkLevel(float(np.mean(means)), sigma, 0.0, "dark frames")


def _from_masked(settings: FrameSettings, masked_dn: float, model: SignalModel) -> DarkLevel:
    """Return the dark signal that masked pixels show; they are not the pixels that see light, and differ a little."""
    signal = float(model.at_dn(model.table(settings), masked_dn))
    step = float(model.at_dn(model.slope, model.black_dn)) / gain_factor(settings.gain_db)
    u = math.hypot(_MASKED_U_DN * step, _MASKED_U_REL * model.modelled_dark(settings))
    return DarkLevel(signal, 0.0, u, "masked pixels")


def _from_other_exposures(
    settings: FrameSettings, frames: list[Frame], model: SignalModel, black: BlackLevel, patch: Patch | None
) -> DarkLevel:
    """Return the dark signal that dark frames of other exposures or temperatures show.

    Two exposures or more determine black level and dark current. One corrects the black level, and the dark current
    is the modelled one.
    """
    measured = [_from_frames(frame.settings, [frame], model, patch) for frame in frames]
    times = np.array([_seconds_at_reference(frame.settings, model) for frame in frames])
    signals = np.array([level.signal for level in measured])
    here = _seconds_at_reference(settings, model)
    noise = float(np.sqrt(np.sum([level.u_independent**2 for level in measured]))) / len(frames)
    if np.ptp(times) > _OTHER_EXPOSURE_REL * times.max():
        middle, spread = float(times.mean()), float(np.sum((times - times.mean()) ** 2))
        rate = float(np.sum((times - middle) * signals)) / spread
        level = float(signals.mean()) + rate * (here - middle)
        lacking = signals - signals.mean() - rate * (times - middle)
        scatter = max(noise * math.sqrt(len(frames)), float(np.sqrt(np.sum(lacking**2) / max(len(frames) - 2, 1))))
        u = scatter * math.sqrt(1.0 / len(frames) + (here - middle) ** 2 / spread)
        return DarkLevel(level, 0.0, math.hypot(u, rate * _u_seconds(settings, frames, model)), _OTHER)
    modelled = [model.modelled_dark(frame.settings) for frame in frames]
    offset = float(np.mean(signals - np.array(modelled)))
    dark = model.modelled_dark(settings)
    u_rate = black.dark_u_rel * abs(dark - float(np.mean(modelled)))
    if "dark_current_e_per_s" in model.noise.assumed:
        u_rate = UNKNOWN_DARK_E_PER_S * abs(here - float(times.mean())) / model.electrons_per_unit
    return DarkLevel(dark + offset, 0.0, float(np.hypot(noise, u_rate)), _OTHER)


def _seconds_at_reference(settings: FrameSettings, model: SignalModel) -> float:
    """Return the exposure in s that has the same dark signal at the temperature of the stated dark current."""
    return settings.exposure_s * model.noise.warmer_factor(settings.temperature_c)


def _u_seconds(settings: FrameSettings, frames: Sequence[Frame], model: SignalModel) -> float:
    """Return the standard uncertainty of that exposure due to the doubling temperature, where temperatures differ."""
    known = [frame.settings.temperature_c for frame in frames if frame.settings.temperature_c is not None]
    if settings.temperature_c is None or not known:
        return 0.0
    doublings = abs(settings.temperature_c - float(np.mean(known))) / model.noise.dark_doubling_k
    relative = math.log(2.0) * doublings * _U_DOUBLING_K / model.noise.dark_doubling_k
    return relative * _seconds_at_reference(settings, model)


def _from_model(settings: FrameSettings, model: SignalModel, black: BlackLevel) -> DarkLevel:
    dark = model.modelled_dark(settings)
    slope = float(model.at_dn(model.slope, model.black_dn))
    u_common = float(np.hypot(black.u_dn * slope, dark_u(settings, model, black)))
    return DarkLevel(dark, 0.0, u_common, "black level")


def black_from_darks(dark_frames: Sequence[Frame], calibration: Calibration) -> BlackLevel | None:
    """Return the black level that dark frames show; None without any.

    The dark signal of several exposure times is a straight line over time: its start is the black level. Of one time
    alone the modelled dark current is taken off.

    Args:
        dark_frames: Frames with the shutter closed; those of the lowest gain are used.
        calibration: Its noise model and the uncertainty of its black level.
    """
    if not dark_frames:
        return None
    lowest_db = min(frame.settings.gain_db for frame in dark_frames)
    used = [frame for frame in dark_frames if frame.settings.gain_db == lowest_db]
    times = np.array([frame.settings.exposure_s for frame in used])
    means = np.array([float(frame.dn.mean()) for frame in used])
    own, noise = calibration.black_level, calibration.noise
    gain = noise.gain_dn_per_e(lowest_db)
    if np.unique(times).size > 1:
        start = float(np.polynomial.polynomial.polyfit(times, means, 1)[0])
        return own.model_copy(update={"dn": max(start, 0.0)})
    modelled = gain * np.array([noise.dark_e(f.settings.exposure_s, f.settings.temperature_c) for f in used])
    unknown_e = UNKNOWN_DARK_E_PER_S if "dark_current_e_per_s" in noise.assumed else 0.0
    u_dark = math.hypot(gain * unknown_e * float(times[0]), own.dark_u_rel * float(modelled[0]))
    start = float(np.mean(means - modelled))
    return own.model_copy(update={"dn": max(start, 0.0), "u_dn": math.hypot(own.u_dn, u_dark)})


def dark_u(settings: FrameSettings, model: SignalModel, black: BlackLevel) -> float:
    """Return the standard uncertainty of a modelled dark signal; an unstated dark current may be some e⁻/s."""
    if "dark_current_e_per_s" in model.noise.assumed:
        return UNKNOWN_DARK_E_PER_S * settings.exposure_s / model.electrons_per_unit
    return black.dark_u_rel * model.modelled_dark(settings)
