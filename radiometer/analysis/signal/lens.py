"""From radiance in front of the lens to irradiance on the sensor, as a factor."""

from __future__ import annotations

import math
from collections.abc import Collection

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radiometer.analysis.calibration.shared import is_focused_alike, settle
from radiometer.data import Calibration, CameraDescription, FlatField, FrameSettings, LensDescription
from radiometer.errors import CalibrationError

_FOCUS = ("magnification", "pupil_magnification")


def lens_in_use(calibration: Calibration, lens: LensDescription) -> LensDescription:
    """Return the calibration's lens with all that the lens in use states of itself.

    These are f-number, transmittance and focus, and where the optical axis meets the frames, which may be cut.
    Where the lens in use says nothing of transmittance and magnification it is as it was at calibration. An f-number
    that it does not state stays unknown: it changes from picture to picture. So does the axis, which is then at the
    middle: frames of the calibration may have been cut.

    Raises:
        CalibrationError: If it states a transmittance and the calibration none, so that they cannot be compared.
    """
    stated = {name: getattr(lens, name) for name in _FOCUS if name in lens.model_fields_set}
    if lens.transmittance is not None:
        stated |= {"transmittance": lens.transmittance, "transmittance_u_rel": lens.transmittance_u_rel}
    if "transmittance" in stated and calibration.lens.transmittance is None and calibration.absolute:
        raise CalibrationError(
            f"the lens in use states a transmittance of {lens.transmittance:g}, the calibration states none: they "
            "cannot be compared. Calibrate with --bench or --camera, which state the lens; or write lens.transmittance "
            "into the calibration file"
        )
    handled = {name: getattr(lens, name) for name in ("since_calibration", "f_number", "principal_point_px")}
    return calibration.lens.model_copy(update={**stated, **handled})


def known_f_number(calibration: Calibration | None, settings: FrameSettings, lens: LensDescription) -> float | None:
    """Return the f-number of a frame: its own, else that of the lens in use; None only where values are relative.

    Args:
        calibration: The camera's calibration; None for relative values.

    Raises:
        CalibrationError: If frame or calibration do not say, and a radiance rests on it.
    """
    number = settings.f_number or lens.f_number
    if calibration is None or not calibration.absolute:
        return number
    settle("f-number", calibration.scale.f_number, number)
    return number


def lens_factor_sr(lens: LensDescription, f_number: float | None) -> float:
    """Return irradiance on the axis per radiance in sr: E/L = π·τ / (4·N²·(1 + m/p)²).

    Args:
        lens: Transmittance τ (1 where unknown), magnification m and pupil magnification p.
        f_number: N of the frame; None takes the lens's own, and 1 sr where that is unknown too (for relative values).

    Source: thesis equation (2.11), with transmittance and magnification added.
    """
    number = f_number if f_number is not None else lens.f_number
    if number is None:
        return 1.0
    return math.pi * (lens.transmittance or 1.0) / (4.0 * number**2 * lens.extension**2)


def flat_doubt(calibration: Calibration, lens: LensDescription, numbers: Collection[float | None]) -> float:
    """Return the part of a measured fall-off that is in doubt: half of it at another iris or focus, where it changes.

    Args:
        calibration: With a flat field.
    """
    flat = calibration.flat_field
    assert flat is not None
    return 0.0 if _is_iris(flat.f_number, numbers) and is_focused_alike(calibration, lens) else 0.5


def is_as_scaled(calibration: Calibration, lens: LensDescription, numbers: Collection[float | None]) -> bool:
    """Return whether iris and focus are those of the calibration's scale; so they count where its iris is unknown."""
    return _is_iris(calibration.scale.f_number, numbers) and is_focused_alike(calibration, lens)


def doubtful_loss(here: ArrayLike, there: float, *, same: bool) -> NDArray[np.float64]:
    """Return what a fall-off that was not measured brings to a value, as a factor of its relative uncertainty.

    Its error is the same function of place at calibration and here, where iris and focus are the same: then only the
    difference of the two losses counts. Else the lens vignettes otherwise, and both count.

    Args:
        here: Part that is lost of what remains, at the place of the value.
        there: The same at the place of the calibration.
        same: Whether iris and focus are those of the calibration.
    """
    return np.asarray(np.abs(np.subtract(here, there)) if same else np.hypot(here, there))


def relative_sensitivity(
    camera: CameraDescription,
    lens: LensDescription,
    flat_field: FlatField | None,
    shape: tuple[int, int],
    x_px: ArrayLike,
    y_px: ArrayLike,
) -> NDArray[np.float64]:
    """Return the sensitivity at pixel positions relative to the optical axis.

    A flat field is used where there is one; else the natural fall-off cos⁴α, declared or not, where focal length and
    pixel pitch are known; else 1. A lens that is focused near sees less of the field: tan α = r/(f·(1 + m/p)).

    Args:
        camera: Pixel pitch and spacing in µm.
        lens: Focal length in mm, principal point in pixels (the middle of the frame where unknown).
        flat_field: Measured sensitivity.
        shape: (height, width) of the frame.
    """
    x, y = np.broadcast_arrays(np.asarray(x_px, np.float64), np.asarray(y_px, np.float64))
    if flat_field is not None:
        return flat_field.at(x, y)
    pitch_um = camera.pixel_spacing_um or camera.pixel_pitch_um
    if lens.focal_length_mm is None or pitch_um is None:
        return np.ones(x.shape)
    centre = lens.principal_point_px or ((shape[1] - 1) / 2.0, (shape[0] - 1) / 2.0)
    distance_px = lens.extension * lens.focal_length_mm * 1e3 / pitch_um
    tan2 = ((x - centre[0]) ** 2 + (y - centre[1]) ** 2) / distance_px**2
    return np.asarray(1.0 / (1.0 + tan2) ** 2)


def falloff_known(camera: CameraDescription, lens: LensDescription) -> str:
    """Return what is known of the fall-off without a flat field: "cos4" (declared), "assumed" or "unknown"."""
    if lens.focal_length_mm is None or (camera.pixel_spacing_um or camera.pixel_pitch_um) is None:
        return "unknown"
    return "cos4" if lens.vignetting == "cos4" else "assumed"


def _is_iris(f_number: float | None, numbers: Collection[float | None]) -> bool:
    return f_number is None or all(n is not None and abs(n / f_number - 1.0) < 0.03 for n in numbers)
