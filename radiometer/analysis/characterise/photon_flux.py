"""Photons that a pixel receives from a surface of known radiance."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from radiometer.analysis.signal.lens import falloff_known, lens_factor_sr, relative_sensitivity
from radiometer.data import (
    CameraDescription,
    FrameSettings,
    LensDescription,
    Patch,
    PatchDescription,
    SourceDescription,
)
from radiometer.units import photon_energy_j


@dataclass(frozen=True, slots=True)
class PhotonFlux:
    """Photons per pixel and second of exposure at source level 1.

    Attributes:
        per_s: Photons per pixel per second.
        u_rel: Relative standard uncertainty (radiance and transmittance).
    """

    per_s: float
    u_rel: float

    def photons(self, settings: FrameSettings) -> float:
        """Return the mean photons per pixel of a frame; none with the shutter closed."""
        return 0.0 if settings.is_dark else self.per_s * settings.exposure_s * settings.source_level


def photon_flux(
    patch: PatchDescription,
    pattern: str,
    camera: CameraDescription,
    lens: LensDescription,
    source: SourceDescription,
    f_number: float | None,
    shape: tuple[int, int],
) -> PhotonFlux | None:
    """Return the photon flux on the pixels of a patch of known radiance: μ̇_p = L·(E/L)·A·λ/(h·c).

    Args:
        patch: The patch with its radiance.
        pattern: Displayed pattern.
        camera: Gives the pixel pitch.
        lens: Gives transmittance, magnification and fall-off.
        source: Gives the wavelength.
        f_number: Of the frames.
        shape: (height, width) of the frames.

    Returns:
        None where radiance, f-number, pixel pitch or wavelength is unknown.

    Source: EMVA Standard 1288, release 4.0, equations (3) and (4).
    """
    known = patch.radiance_W_per_sr_m2
    radiance = known.get(pattern) if isinstance(known, dict) else known
    number = f_number if f_number is not None else lens.f_number
    if radiance is None or number is None or camera.pixel_pitch_um is None or source.wavelength_nm is None:
        return None
    irradiance = radiance * lens_factor_sr(lens, number) * _mean_sensitivity(patch.patch, camera, lens, shape)
    area_m2 = (camera.pixel_pitch_um * 1e-6) ** 2
    u_rel = math.hypot(patch.u_rel or 0.0, lens.transmittance_u_rel or 0.0, source.reproducibility_u_rel or 0.0)
    return PhotonFlux(irradiance * area_m2 / photon_energy_j(source.wavelength_nm), u_rel)


def _mean_sensitivity(patch: Patch, camera: CameraDescription, lens: LensDescription, shape: tuple[int, int]) -> float:
    x = np.arange(patch.x, patch.x + patch.width)[np.newaxis, :]
    y = np.arange(patch.y, patch.y + patch.height)[:, np.newaxis]
    if falloff_known(camera, lens) != "cos4":
        return 1.0
    return float(np.mean(relative_sensitivity(camera, lens, None, shape, x, y)))
