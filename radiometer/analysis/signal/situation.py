"""Inputs of merge and patch readings: the calibration's parts, or what replaces them without one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from radiometer.analysis.calibration.shared import (
    require_camera,
    require_channel,
    require_lens,
    require_place,
    require_response,
)
from radiometer.analysis.photometry.photometry import spectral_mismatch_factor, spectrum
from radiometer.analysis.signal.lens import lens_in_use
from radiometer.analysis.signal.model import SignalModel, signal_model
from radiometer.data import BlackLevel, Calibration, FlatField, Frame, LensDescription, SensorNoise, StatedUncertainties
from radiometer.data.setup import Setup
from radiometer.errors import CalibrationError, InputError

# Of a reading, that light beyond the table of a spectral response may move: below the 3 to 4 % of usual tables.
_BEYOND_TABLE_REL: Final = 0.01


@dataclass(frozen=True, slots=True)
class Situation:
    """What a measurement with a setup rests on: signal model, black level, stated uncertainties and scale."""

    setup: Setup  # camera, lens and calibration in use, and the light
    model: SignalModel  # signal model of the camera
    black: BlackLevel  # black level and its uncertainty
    stated: StatedUncertainties  # stated uncertainties
    scale: float  # radiance per unit of x per s and sr of the lens; 1 without a calibration
    lens: LensDescription  # the lens in use, with the transmittance that is part of the scale
    assumptions: tuple[str, ...]  # what was assumed rather than measured

    @property
    def calibration(self) -> Calibration | None:
        """Return the calibration in use; None for relative values."""
        return self.setup.calibration


def situation_of(setup: Setup, frame: Frame | None = None) -> Situation:
    """Return what a measurement with a setup rests on.

    Args:
        setup: Without a calibration the sensor counts as linear, and as typical where it is unknown.
        frame: One of the frames that are read, with the colour that it is of; None where there is none yet.

    Raises:
        CalibrationError: If the calibration is of another camera or lens.
        UsageError: If it is of another colour.
    """
    calibration, camera, lens = setup.calibration, setup.camera, setup.lens
    if calibration is None:
        noise, black = SensorNoise.of(camera), BlackLevel(dn=camera.black_level_dn or 0.0)
        stated = StatedUncertainties()
        model = signal_model(camera, None, noise, black.dn, stated.linearity_u_rel)
        assumed = ("response taken as linear", *noise.assumptions)
        return Situation(setup, model, black, stated, 1.0, lens, assumed)
    settings, of_curve = require_camera(calibration, camera), require_response(calibration.response, camera)
    if calibration.absolute:  # then the curve is that of the calibration's camera
        of_curve = require_channel(calibration, frame) if frame is not None else ()
    require_lens(calibration, lens)
    if calibration.flat_field is not None:
        require_place(calibration, lens)
    black, stated = calibration.black_level, calibration.uncertainties
    step_dn = camera.code_step_dn or calibration.camera.code_step_dn
    in_use = calibration.camera.model_copy(update={"code_step_dn": step_dn})
    model = signal_model(in_use, calibration.response, calibration.noise, black.dn, stated.linearity_u_rel)
    of_source = (f"spectrum {calibration.spectrum}",) if calibration.absolute else ()
    factor, correction = spectral_correction(calibration)
    of_light = setup.source.spectrum if setup.source else None
    doubt = contradicted(calibration.spectrum if calibration.absolute else None, of_light)
    assumed = (*of_source, *doubt, *correction, *settings, *of_curve, *calibration.noise.assumptions)
    scale, used = calibration.scale.value * factor, lens_in_use(calibration, lens)
    return Situation(setup, model, black, stated, scale, used, assumed)


def contradicted(used: str | None, stated: str | None) -> tuple[str, ...]:
    """Return what to say where the light counts as of another spectrum than bench or capture states.

    Args:
        used: Name of the spectrum that values are for; None where they are for none.
        stated: Name of the one that bench or capture states; None where neither does.
    """
    if stated is None or used is None or same_light(stated, used):
        return ()
    return (f"the light counts as {used}, though bench or capture states {stated}; values hold for {used} only",)


def same_light(first: str, second: str) -> bool:
    """Return whether two names mean one spectrum: "line:550" and "line:550.0" do."""
    if first == second:
        return True
    try:
        wavelengths_nm = [float(name.removeprefix("line:")) for name in (first, second)]
    except ValueError:
        return False
    return wavelengths_nm[0] == wavelengths_nm[1]


def spectral_correction(calibration: Calibration) -> tuple[float, tuple[str, ...]]:
    """Return the factor on readings of a source of another spectrum than the scale's, and what to say of it.

    It is 1 where the spectra are the same, and where the camera's spectral response is not known.

    Args:
        calibration: Scale with its spectrum, the source's spectrum, the spectral response.

    Raises:
        InputError: If a spectrum is unknown, or the camera does not respond to one, or light is beyond its response.
    """
    of_scale = calibration.scale.spectrum or calibration.spectrum
    if of_scale == calibration.spectrum or not calibration.absolute:
        return 1.0, ()
    response = calibration.spectral_response
    if response is None:
        return 1.0, (f"calibrated under {of_scale}; no spectral correction, the camera's response is unknown",)
    lights = spectrum(calibration.spectrum), spectrum(of_scale)
    table_nm, relative = np.array(response.wavelength_nm), np.array(response.relative)
    factor = spectral_mismatch_factor(*lights, table_nm, relative)
    # What a table does not state is unknown: as high as at its end, or nothing.
    further_nm = np.concatenate([[min(table_nm[0], 200.0) - 1.0], table_nm, [max(table_nm[-1], 2000.0) + 1.0]])
    off = abs(spectral_mismatch_factor(*lights, further_nm, np.pad(relative, 1, "edge")) / factor - 1.0)
    if off > _BEYOND_TABLE_REL:
        raise InputError(
            f"the camera's spectral response covers {table_nm[0]:g} to {table_nm[-1]:g} nm, and light beyond may move "
            f"the reading by {100 * off:.2g} %; extend the table, with 0 where the camera sees nothing"
        )
    by = f", by the {response.source}" if response.source else ""
    return factor, (f"calibrated under {of_scale}; spectral mismatch factor {factor:.4g} applied{by}",)


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
