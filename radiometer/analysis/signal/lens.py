"""From radiance in front of the lens to irradiance on the sensor, as a factor."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radiometer.data import CameraDescription, FlatField, LensDescription


def lens_factor_sr(lens: LensDescription, f_number: float | None) -> float:
    """Return irradiance on the axis per radiance in sr: E/L = π·τ / (4·N²·(1 + m/p)²).

    Args:
        lens: Transmittance τ (1 where unknown), magnification m and pupil magnification p.
        f_number: N of the frame; None takes the lens's own, and 1 sr where that is unknown too (the lens is then
            part of the scale).

    Source: thesis equation (2.11), with transmittance and magnification added.
    """
    number = f_number if f_number is not None else lens.f_number
    if number is None:
        return 1.0
    near = 1.0 + lens.magnification / lens.pupil_magnification
    return math.pi * (lens.transmittance or 1.0) / (4.0 * number**2 * near**2)


def relative_sensitivity(
    camera: CameraDescription,
    lens: LensDescription,
    flat_field: FlatField | None,
    shape: tuple[int, int],
    x_px: ArrayLike,
    y_px: ArrayLike,
) -> NDArray[np.float64]:
    """Return the sensitivity at pixel positions relative to the optical axis.

    A flat field is used where there is one; else cos⁴α where the lens description says that it holds
    (`vignetting: cos4`) and focal length and pixel pitch are known; else 1.

    Args:
        camera: Pixel pitch and spacing in µm.
        lens: Focal length in mm, principal point in pixels (the middle of the frame where unknown).
        flat_field: Measured sensitivity.
        shape: (height, width) of the frame.
        x_px: Columns.
        y_px: Rows.
    """
    x, y = np.broadcast_arrays(np.asarray(x_px, np.float64), np.asarray(y_px, np.float64))
    if flat_field is not None:
        return flat_field.at(x, y)
    pitch_um = camera.pixel_spacing_um or camera.pixel_pitch_um
    if lens.vignetting != "cos4" or lens.focal_length_mm is None or pitch_um is None:
        return np.ones(x.shape)
    centre = lens.principal_point_px or ((shape[1] - 1) / 2.0, (shape[0] - 1) / 2.0)
    tan2 = ((x - centre[0]) ** 2 + (y - centre[1]) ** 2) * (pitch_um * 1e-3 / lens.focal_length_mm) ** 2
    return np.asarray(1.0 / (1.0 + tan2) ** 2)
