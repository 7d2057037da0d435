"""Radiant flux through the sensor: formula (2.13) of the thesis, and the merged bracket."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from radiometer.analysis.merge.bracket import repair_defects
from radiometer.analysis.reading.budget import frame_u_rel, spectral_u_rel
from radiometer.analysis.signal.dark_map import dark_map, without_full
from radiometer.analysis.signal.lens import known_f_number
from radiometer.analysis.signal.model import (
    SignalModel,
    dark_levels,
    signal_model,
    some_lit_pixels,
    temperature_factor,
    with_found_code_step,
)
from radiometer.analysis.signal.situation import situation_of
from radiometer.data import (
    BlackLevel,
    Frame,
    FrameSettings,
    LensDescription,
    Patch,
    PixelMask,
    Quantity,
    SensorNoise,
)
from radiometer.data.setup import Setup
from radiometer.errors import CalibrationError, MeasurementError
from radiometer.units import photon_energy_j

_DESCRIPTION_U_REL = 0.03  # assumed: data sheets state typical values of a model
_EXPOSURE_U_REL = 1e-4  # assumed of a camera's clock: 100 ppm is the coarsest crystal in use


@dataclass(frozen=True, slots=True, eq=False)
class FluxScale:
    """What turns digital numbers into exposure on the sensor."""

    model: SignalModel  # linear signal behind the digital numbers
    black: BlackLevel  # black level
    joule_per_m2: float  # exposure per unit of the signal in J·m⁻²
    u_rel: float  # its relative standard uncertainty
    pixel_area_m2: float  # area of the sensor that one stored pixel covers in m²
    lens: LensDescription  # the lens in use, as far as capture or calibration state it
    assumptions: tuple[str, ...] = ()  # what was assumed rather than measured


@dataclass(frozen=True, slots=True, eq=False)
class SensorFlux:
    """Flux through the sensor, by the thesis and by the merged bracket."""

    # (exposure in s, flux in W by (2.13), share of pixels left out) of every light frame, short ones first
    thesis: tuple[tuple[float, float, float], ...]
    irradiance: NDArray[np.float64]  # merged irradiance in W·m⁻², shape of the region
    merged_w: float  # its sum over pixels in W, background included
    u_noise_w: float  # standard uncertainty of that sum due to noise in W
    background_w: float  # flux of the background over the same pixels in W
    u_background_w: float  # its standard uncertainty in W
    background_source: str  # where the background comes from
    clipped_everywhere: int  # pixels that clip in every frame


def flux_scale(
    setup: Setup, settings: Sequence[FrameSettings] = (), responsivity_u_rel: float | None = None
) -> FluxScale:
    """Return the scale of a calibration, or else the one that the camera's description gives.

    Without a calibration H = x·c·h·c₀/(λ·η·A): conversion gain c, quantum efficiency η, pixel area A, wavelength λ.

    Args:
        settings: Of the light frames, which a calibration is compared with as for a radiance.
        responsivity_u_rel: Relative standard uncertainty of η/c where it was measured; None takes 3 %.

    Raises:
        CalibrationError: If the calibration is of another camera, is relative, or holds for radiance only; or if
            there is none and the description leaves out a figure.
    """
    camera, wavelength_nm = setup.camera, setup.source.wavelength_nm if setup.source else None
    spacing_um = camera.pixel_spacing_um or camera.pixel_pitch_um
    if spacing_um is None:
        raise CalibrationError("the flux needs the pixel's area: give camera.pixel_pitch_um in the capture")
    area_m2 = (spacing_um * 1e-6) ** 2
    if setup.calibration is not None:
        return _of_calibration(setup, settings, area_m2)
    eta, c, pitch_um = camera.quantum_efficiency, camera.conversion_gain_e_per_dn, camera.pixel_pitch_um
    if eta is None or c is None or pitch_um is None or wavelength_nm is None:
        of_colour = "" if camera.channel is None else f" of {camera.channel} pixels (camera.channel)"
        raise CalibrationError(
            f"no calibration, and the capture does not state quantum_efficiency{of_colour}, conversion_gain_e_per_dn, "
            "pixel_pitch_um and source.wavelength_nm: give --calibration, add them, or give --camera-file"
        )
    black = BlackLevel(dn=camera.black_level_dn or 0.0)
    joule = c * photon_energy_j(wavelength_nm) / (eta * (pitch_um * 1e-6) ** 2)
    model = signal_model(camera, None, SensorNoise.of(camera), black.dn)
    if responsivity_u_rel is not None:
        return FluxScale(model, black, joule, responsivity_u_rel, area_m2, setup.lens)
    note = f"scale from the camera's description, taken as known to {100 * _DESCRIPTION_U_REL:g} %"
    return FluxScale(model, black, joule, _DESCRIPTION_U_REL, area_m2, setup.lens, (note,))


def _of_calibration(setup: Setup, settings: Sequence[FrameSettings], area_m2: float) -> FluxScale:
    situation, calibration = situation_of(setup), setup.calibration
    assert calibration is not None
    if not calibration.absolute or calibration.scale.f_number is None:
        raise CalibrationError(
            "this calibration holds no exposure on the sensor (it is relative, or was made without an f-number); "
            "calibrate with a known radiance and a stated f-number"
        )
    lens, stated = situation.lens, situation.stated
    numbers = {known_f_number(calibration, one, lens) for one in settings}
    u_rel = math.hypot(
        calibration.scale.u_rel,
        spectral_u_rel(calibration, stated, spectrum_stated=setup.spectrum_stated),
        frame_u_rel(setup, lens, numbers, settings),
    )
    temperatures = [one.temperature_c for one in settings if one.temperature_c is not None]
    here_c = sum(temperatures) / len(temperatures) if temperatures and len(temperatures) == len(settings) else None
    warm = temperature_factor(calibration.found, here_c, calibration.scale.conditions.temperature_c)
    joule = situation.scale * warm
    return FluxScale(situation.model, situation.black, joule, u_rel, area_m2, lens, situation.assumptions)


def sensor_flux(frames: Sequence[Frame], scale: FluxScale, region: Patch | None = None) -> SensorFlux:
    """Return the flux through the sensor by (2.13) for each frame, and from all of them together.

    Merging takes Σ(f(M) − dark)·H₁/Σt over the frames in which a pixel does not clip. The background comes from
    frames with the source off (shutter open) where there are any, else from the outermost twentieth of the frame.

    Args:
        frames: Light frames of the lit source, frames with source level 0, and dark frames, in any order.
        region: Where the source and all its glow are; None for the whole frame.

    Raises:
        MeasurementError: If no frame shows the lit source, or it clips everywhere.
    """
    dark = [f for f in frames if f.settings.is_dark]
    lit = sorted(_open(frames, lit=True), key=lambda f: f.settings.effective_exposure_s)
    if not lit:
        raise MeasurementError("there is no frame of the lit source with the shutter open")
    if region is not None and not region.fits(lit[0].shape):
        raise MeasurementError(
            f"the region {region.x},{region.y},{region.width},{region.height} is not on the frame of "
            f"{lit[0].shape[1]} × {lit[0].shape[0]} pixels"
        )
    scale = replace(scale, model=with_found_code_step(scale.model, (some_lit_pixels(one).dn for one in lit)))
    whole = _merged(lit, dark, scale)
    off = _open(frames, lit=False)
    background, u_background, origin = _background(whole, _merged(off, dark, scale) if off else None, region)
    inside = whole.cut(region)
    area = scale.pixel_area_m2
    clipped = int(np.count_nonzero(inside.time == 0))
    if clipped == inside.time.size:
        raise MeasurementError("every pixel clips in every frame; take shorter exposures")
    return SensorFlux(
        thesis=tuple(_thesis(f, scale, region) for f in lit),
        irradiance=inside.irradiance,
        merged_w=float(inside.irradiance.sum()) * area,
        u_noise_w=math.sqrt(float(inside.variance.sum())) * area,
        background_w=float(background.sum()) * area,
        u_background_w=u_background * area,
        background_source=origin,
        clipped_everywhere=clipped,
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Map:
    """Irradiance in W·m⁻², its variance, and the exposure time in s that went into each pixel."""

    irradiance: NDArray[np.float64]
    variance: NDArray[np.float64]
    time: NDArray[np.float64]

    def cut(self, region: Patch | None) -> _Map:
        if region is None:
            return self
        return _Map(self.irradiance[region.slices], self.variance[region.slices], self.time[region.slices])


def _open(frames: Sequence[Frame], *, lit: bool) -> list[Frame]:
    return [f for f in frames if not f.settings.is_dark and (f.settings.source_level > 0) == lit]


def _merged(frames: list[Frame], dark: list[Frame], scale: FluxScale) -> _Map:
    model = scale.model
    levels = dark_levels([f.settings for f in frames], without_full(dark, model), model, scale.black)
    signal, variance, time = (np.zeros(frames[0].shape) for _ in range(3))
    unknown = np.zeros(frames[0].shape, bool)
    shortest = np.zeros(frames[0].shape)
    alike = Counter((one.settings.exposure_s, one.settings.gain_db) for one in frames)
    for frame, level in zip(frames, levels, strict=True):
        by_pixel = dark_map(frame.settings, dark, model, level)
        own, hot = (
            one.reshape(frame.shape) if one.size > 1 else one for one in (by_pixel.signal, by_pixel.variance_hot)
        )
        x = model.table(frame.settings)[frame.dn] - own
        missing = np.isin(np.arange(frame.dn.size), by_pixel.unknown).reshape(frame.shape)
        unknown |= missing
        good = (frame.dn < model.saturation_dn(frame.settings)) & ~missing
        signal += np.where(good, x, 0.0)
        # Lights of one exposure share the noise of its dark frames.
        of_dark = (by_pixel.variance + hot) * alike[frame.settings.exposure_s, frame.settings.gain_db]
        of_hot = np.where(hot > 0.0, np.maximum(own - level.signal, 0.0) / model.electrons_per_unit, 0.0)
        own_noise = model.variance(np.maximum(x, 0.0), frame.settings) + level.variance + of_hot
        variance += np.where(good, own_noise + of_dark, 0.0)
        time += np.where(good, frame.settings.exposure_s, 0.0)
        if frame is frames[0]:
            shortest = x / frame.settings.exposure_s
    known = time > 0
    seconds = np.where(known, time, 1.0)
    irradiance = np.where(known, signal / seconds, shortest) * scale.joule_per_m2
    variance = variance / seconds**2 * scale.joule_per_m2**2
    if (filled := unknown & ~known).any():
        u, mask = np.sqrt(variance), np.where(known | filled, 0, PixelMask.SATURATED).astype(np.uint8)
        repair_defects(irradiance, u, mask, [(int(x), int(y)) for y, x in np.argwhere(filled)])
        variance, time = u**2, np.where(filled, frames[0].settings.exposure_s, time)
    return _Map(irradiance, variance, time)


def _background(whole: _Map, off: _Map | None, region: Patch | None) -> tuple[NDArray[np.float64], float, str]:
    """Return background irradiance over the region, the standard uncertainty of its sum, and where it is from."""
    shape = whole.cut(region).irradiance.shape
    if off is not None:
        inside = off.cut(region)
        return inside.irradiance, math.sqrt(float(inside.variance.sum())), "frames with the source off"
    height, width = whole.irradiance.shape
    rim = max(1, min(height, width) // 20)
    edge = np.ones(whole.irradiance.shape, dtype=bool)
    edge[rim : height - rim, rim : width - rim] = False
    values = whole.irradiance[edge]
    level = float(np.median(values))
    # Four sides that differ show how uneven the background is: half their spread is taken as its uncertainty.
    sides = (whole.irradiance[:rim], whole.irradiance[-rim:], whole.irradiance[:, :rim], whole.irradiance[:, -rim:])
    medians = [float(np.median(side)) for side in sides]
    count = shape[0] * shape[1]
    u_level = max((max(medians) - min(medians)) / 2, float(np.std(values)) / math.sqrt(values.size))
    # A few bright pixels, hot ones or the source itself, are no level: what they add per pixel may be all over.
    u_level = math.hypot(u_level, float(np.mean(values)) - level)
    return np.full(shape, level), u_level * count, "outermost twentieth of the frame"


def _thesis(frame: Frame, scale: FluxScale, region: Patch | None) -> tuple[float, float, float]:
    """Return exposure, flux by (2.13), and the share of pixels at 0 or full scale that it leaves out."""
    dn = frame.dn if region is None else frame.dn[region.slices]
    kept = (dn > 0) & (dn < frame.saturated_dn)
    exposure = scale.model.table(frame.settings)[dn[kept]] * scale.joule_per_m2
    flux = float(exposure.sum()) / frame.settings.exposure_s * scale.pixel_area_m2
    return frame.settings.exposure_s, flux, 1.0 - float(kept.mean())


def scale_u_rel(scale: FluxScale) -> float:
    """Return the relative standard uncertainty that scale and exposure times give a flux."""
    return math.hypot(scale.u_rel, _EXPOSURE_U_REL)


def as_quantity(value_w: float, scale: FluxScale, *absolute_u_w: float) -> Quantity:
    """Return a flux in W with the uncertainty of the scale and further ones in W."""
    return Quantity(value_w, math.hypot(value_w * scale_u_rel(scale), *absolute_u_w), "W")
