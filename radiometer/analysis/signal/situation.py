"""Inputs of merge and patch readings: the calibration's parts, or what replaces them without one."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from radiometer.analysis.calibration.shared import Handling, require_camera, require_lens, settle
from radiometer.analysis.photometry.photometry import Observer, spectral_mismatch_factor
from radiometer.analysis.photometry.spectra import spectrum
from radiometer.analysis.photometry.unstated_light import plausible_responses, unstated_light_u_rel
from radiometer.analysis.signal.lens import lens_in_use
from radiometer.analysis.signal.model import SignalModel, signal_model
from radiometer.data import (
    BlackLevel,
    Calibration,
    FlatField,
    LensDescription,
    SensorNoise,
    StatedUncertainties,
)
from radiometer.data.setup import Setup
from radiometer.errors import CalibrationError

# A filter or lens of which only the nominal transmittance is known: sold to some ±10 %, taken as a rectangle.
FILTER_U_REL: Final = 0.1 / math.sqrt(3.0)


@dataclass(frozen=True, slots=True)
class Situation:
    """What a measurement with a setup rests on: signal model, black level, stated uncertainties and scale.

    Attributes:
        setup: Camera, lens and calibration in use, and the light.
        model: Signal model of the camera.
        black: Black level and its uncertainty.
        stated: Stated uncertainties.
        scale: Radiance per unit of x per s and sr of the lens; 1 without a calibration.
        lens: The lens in use, with the transmittance that is part of the scale.
        assumptions: What was assumed rather than measured.
    """

    setup: Setup
    model: SignalModel
    black: BlackLevel
    stated: StatedUncertainties
    scale: float
    lens: LensDescription
    assumptions: tuple[str, ...]

    @property
    def calibration(self) -> Calibration | None:
        """Return the calibration in use; None for relative values."""
        return self.setup.calibration


def situation_of(setup: Setup) -> Situation:
    """Return what a measurement with a setup rests on.

    Args:
        setup: Without a calibration the sensor counts as linear, and as typical where it is unknown.

    Raises:
        CalibrationError: If the calibration is of another camera or lens.
    """
    calibration, camera, lens = setup.calibration, setup.camera, setup.lens
    if calibration is None:
        noise, black = SensorNoise.of(camera), BlackLevel(dn=camera.black_level_dn or 0.0)
        stated = StatedUncertainties()
        model = signal_model(camera, None, noise, black.dn, stated.linearity_u_rel)
        assumed = ("response taken as linear", *(f"typical {name}" for name in noise.assumed))
        return Situation(setup, model, black, stated, 1.0, lens, assumed)
    require_camera(calibration, camera)
    require_lens(calibration, lens)
    black, stated = calibration.black_level, calibration.uncertainties
    model = signal_model(calibration.camera, calibration.response, calibration.noise, black.dn, stated.linearity_u_rel)
    of_source = (f"spectrum {calibration.spectrum}",) if calibration.absolute else ()
    factor, correction = spectral_correction(calibration)
    assumed = (*of_source, *correction, *(f"typical {name}" for name in calibration.noise.assumed))
    scale, used = calibration.scale.value * factor, lens_in_use(calibration, lens)
    return Situation(setup, model, black, stated, scale, used, assumed)


def spectral_correction(calibration: Calibration) -> tuple[float, tuple[str, ...]]:
    """Return the factor on readings of a source of another spectrum than the scale's, and what to say of it.

    It is 1 where the spectra are the same, and where the camera's spectral response is not known.

    Args:
        calibration: Scale with its spectrum, the source's spectrum, the spectral response.

    Raises:
        InputError: If a spectrum is unknown, or the camera does not respond to one.
    """
    of_scale = calibration.scale.spectrum or calibration.spectrum
    if of_scale == calibration.spectrum or not calibration.absolute:
        return 1.0, ()
    response = calibration.spectral_response
    if response is None:
        return 1.0, (f"calibrated under {of_scale}; no spectral correction, the camera's response is unknown",)
    factor = spectral_mismatch_factor(
        spectrum(calibration.spectrum),
        spectrum(of_scale),
        np.array(response.wavelength_nm),
        np.array(response.relative),
    )
    by = f", by the {response.source}" if response.source else ""
    return factor, (f"calibrated under {of_scale}; spectral mismatch factor {factor:.4g} applied{by}",)


def spectral_u_rel(calibration: Calibration, stated: StatedUncertainties, *, spectrum_stated: bool = True) -> float:
    """Return the relative standard uncertainty of the spectral assumption, that of a correction included.

    A radiance that came by way of a luminance carries that of the assumed spectrum's luminous efficacy as well. Where
    calibration and source differ in spectrum and the camera's response is unknown, the spread of plausible responses
    counts. It also bounds the uncertainty from a known response, because nearly alike spectra depend little on it.

    Args:
        calibration: The calibration, with the spectrum that the light is taken to have.
        stated: What is stated of the spectrum, and of its efficacy.
        spectrum_stated: Whether the spectrum of the light is stated. Where it is not, and no figure is stated, all
            kinds of light count.
    """
    of_scale = calibration.scale.spectrum or calibration.spectrum
    efficacy = stated.efficacy_u_rel if calibration.scale.quantity == "luminance" else 0.0
    of_light = stated.spectral_u_rel if spectrum_stated else unstated_u_rel(calibration, stated)
    if of_scale == calibration.spectrum or not calibration.absolute:
        return math.hypot(of_light, efficacy)
    response, unknown = calibration.spectral_response, unknown_mismatch_u_rel(calibration.spectrum, of_scale)
    own = min(response.u_rel, unknown) if response else unknown
    return math.hypot(of_light, efficacy, own)


def unstated_u_rel(calibration: Calibration, stated: StatedUncertainties, observer: Observer | None = None) -> float:
    """Return the relative standard uncertainty of light of unknown spectrum: as stated, or of all kinds of light.

    Args:
        calibration: The calibration, with the spectrum that the light is taken to have.
        stated: A figure of `spectral_u_rel` above 0 replaces it.
        observer: For a luminance, the observer; None for a radiance.
    """
    if stated.spectral_u_rel > 0.0 or not calibration.absolute:
        return stated.spectral_u_rel
    return unstated_light_u_rel(calibration.spectrum, calibration.spectral_response, observer)


def unknown_mismatch_u_rel(source: str, of_scale: str) -> float:
    """Return the root of the mean square of ln F over plausible responses of silicon behind a lens.

    Args:
        source: Name of the spectrum that is read.
        of_scale: Name of the spectrum of the calibration.
    """
    wavelength, responses = plausible_responses()
    light, reference = spectrum(source), spectrum(of_scale)
    factors = [spectral_mismatch_factor(light, reference, wavelength, response) for response in responses]
    return float(np.sqrt(np.mean(np.log(factors) ** 2)))


def f_number_u_rel(
    calibration: Calibration | None, stated: StatedUncertainties, numbers: set[float | None]
) -> tuple[float, str]:
    """Return the relative standard uncertainty that the f-number brings, and why.

    Args:
        calibration: The calibration; its scale knows the f-number it was got at.
        stated: Stated uncertainty of an f-number.
        numbers: f-numbers of the frames.
    """
    reference = calibration.scale.f_number if calibration else None
    if reference is None or all(n is not None and settle("f-number", reference, n) is Handling.KEPT for n in numbers):
        return 0.0, "same as at calibration, so it drops out"
    return 2.0 * stated.f_number_u_rel, "differs from the one at calibration"


def transmittance_u_rel(calibration: Calibration | None, lens: LensDescription) -> tuple[float, str]:
    """Return the relative standard uncertainty that the lens's transmittance brings, and why.

    Args:
        calibration: The calibration, with the lens that its scale was got through.
        lens: The lens in use, with the transmittance that is reckoned with.
    """
    if calibration is None:
        return 0.0, "no scale"
    if calibration.scale.method == "datasheet":
        return lens.transmittance_u_rel or 0.0, "datasheet"
    if lens.transmittance == calibration.lens.transmittance:
        return 0.0, "calibrated through the lens, so it drops out"
    parts = [_transmittance_u_rel(one) for one in (calibration.lens, lens)]
    note = f"{lens.transmittance:g} in use, {calibration.lens.transmittance:g} at calibration"
    return math.hypot(*parts), note


def _transmittance_u_rel(lens: LensDescription) -> float:
    stated = lens.transmittance_u_rel
    return FILTER_U_REL if stated is None else stated


def magnification_u_rel(calibration: Calibration | None, lens: LensDescription) -> tuple[float, str]:
    """Return the relative standard uncertainty that another focus than at calibration brings, and why.

    Args:
        calibration: The calibration, with the lens as it was focused.
        lens: The lens in use.
    """
    if calibration is None:
        return 0.0, "no scale"
    here, there = (one.magnification / one.pupil_magnification for one in (lens, calibration.lens))
    if here == there:
        return 0.0, "focused as at calibration, so it drops out"
    u = calibration.uncertainties.magnification_u_rel * abs(here - there)
    return 2.0 * u / (1.0 + here), f"magnification {here:.3g} in use, {there:.3g} at calibration"


def common_u_rel(situation: Situation) -> float:
    """Return the relative standard uncertainty that all pixels of a radiance map share, whatever its frames.

    Args:
        situation: What the map rests on.
    """
    stated, calibration = situation.stated, situation.calibration
    linearity = stated.linearity_u_rel if situation.model.linear else 0.0
    parts = [stated.exposure_u_rel, linearity]
    if calibration is not None:
        flat = calibration.flat_field.u_rel if calibration.flat_field else 0.0
        parts += [calibration.scale.u_rel, spectral_u_rel(calibration, stated), flat]
    return math.hypot(*parts)


def flat_field_for(calibration: Calibration | None, shape: tuple[int, int]) -> FlatField | None:
    """Return the flat field of a calibration for frames of (height, width); None where it has none.

    Raises:
        CalibrationError: If it was made from frames of another size.
    """
    flat = calibration.flat_field if calibration else None
    if flat is not None and flat.shape != shape:
        raise CalibrationError(
            f"the flat field was made from frames of {flat.shape[1]} × {flat.shape[0]} pixels, these have "
            f"{shape[1]} × {shape[0]}; capture with the same region and binning, or calibrate for these"
        )
    return flat
