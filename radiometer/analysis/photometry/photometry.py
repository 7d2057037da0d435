"""Radiance and luminance, photopic and scotopic: conversions through V(λ) and V′(λ)."""

from __future__ import annotations

import math
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from radiometer.analysis.photometry.spectra import Spectrum, table
from radiometer.errors import InputError

KM_LM_PER_W: Final = 683.0  # maximum photopic luminous efficacy, at 540 THz (SI, candela)
KM_SCOTOPIC_LM_PER_W: Final = 1700.05  # CIE S 010, K'm at 507 nm
Observer = Literal["photopic", "photopic_gaussian", "scotopic"]

_COLUMNS: Final = {"photopic": "photopic_cie1924", "scotopic": "scotopic_cie1951"}


def luminous_efficiency(observer: Observer = "photopic") -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return (wavelength in nm, relative luminous efficiency) of an observer.

    Args:
        observer: "photopic" for the tabulated CIE 1924 V(λ), "scotopic" for CIE 1951 V′(λ), "photopic_gaussian"
            for the thesis's V(λ) = 1.018·exp(−285.4·(λ/µm − 0.559)²).

    Source: CIE 018:2019; thesis equation (2.9).
    """
    wavelength, columns = table("luminous_efficiency.csv")
    if observer == "photopic_gaussian":
        return wavelength, 1.018 * np.exp(-285.4 * (wavelength * 1e-3 - 0.559) ** 2)
    return wavelength, columns[_COLUMNS[observer]]


def luminous_efficacy_lm_per_w(spectrum: Spectrum, observer: Observer = "photopic") -> float:
    """Return the luminous efficacy of radiation in lm/W: K·∫S·V dλ / ∫S dλ over the spectrum's band.

    Args:
        spectrum: Relative spectrum of the source.
        observer: Whose efficiency; K is 683 lm/W photopic, 1700.05 lm/W scotopic.

    Raises:
        InputError: If the spectrum is outside the visible range.
    """
    constant = KM_SCOTOPIC_LM_PER_W if observer == "scotopic" else KM_LM_PER_W
    efficacy = constant * spectrum.integral(*luminous_efficiency(observer)) / spectrum.integral()
    if efficacy <= 0.0:
        low, high = spectrum.band_nm
        raise InputError(f"spectrum {spectrum.name!r} ({low:g} to {high:g} nm) holds no visible light")
    return efficacy


def holds_visible_light(spectrum: Spectrum) -> bool:
    """Return whether a spectrum has a luminance: near-infrared and ultraviolet have a radiance only."""
    return spectrum.integral(*luminous_efficiency()) > 0.0


def luminance_cd_m2(radiance_w_sr_m2: float, spectrum: Spectrum, observer: Observer = "photopic") -> float:
    """Return the luminance in cd·m⁻² of a radiance in W·sr⁻¹·m⁻² with a given spectrum."""
    return radiance_w_sr_m2 * luminous_efficacy_lm_per_w(spectrum, observer)


def radiance_w_sr_m2(luminance_cd_m2: float, spectrum: Spectrum, observer: Observer = "photopic") -> float:
    """Return the radiance in W·sr⁻¹·m⁻² of a luminance in cd·m⁻² with a given spectrum.

    Source: L_e = L_v·∫S dλ / (K·∫S·V dλ).
    """
    return luminance_cd_m2 / luminous_efficacy_lm_per_w(spectrum, observer)


def radiance_thesis_w_sr_m2_um(luminance_cd_m2: float) -> float:
    """Return the thesis's conversion of luminance, which is a *spectral* radiance in W·sr⁻¹·m⁻²·µm⁻¹.

    It divides by ∫V dλ in µm, so its result is the radiance per µm of an equal-energy spectrum, not a radiance.

    Args:
        luminance_cd_m2: Luminance in cd·m⁻².

    Source: thesis equation (2.10), L_e = L_v/(683·0.1068).
    """
    return luminance_cd_m2 / (KM_LM_PER_W * 0.1068)


def retinal_illuminance_td(luminance_cd_m2: float, pupil_diameter_mm: float) -> float:
    """Return the retinal illuminance in trolands: luminance × pupil area in mm².

    Args:
        luminance_cd_m2: Luminance (photopic or scotopic, and so the trolands) in cd·m⁻².
        pupil_diameter_mm: Diameter of the eye's pupil in mm, 1 to 10.

    Raises:
        InputError: If the pupil is outside 1 to 10 mm.
    """
    if not 1.0 <= pupil_diameter_mm <= 10.0:
        raise InputError(f"pupil diameter {pupil_diameter_mm:g} mm is out of range; allowed is 1 to 10 mm")
    return luminance_cd_m2 * math.pi / 4.0 * pupil_diameter_mm**2


def spectral_mismatch_factor(
    source: Spectrum,
    calibration_source: Spectrum,
    response_nm: NDArray[np.float64],
    response: NDArray[np.float64],
    observer: Observer | None = None,
) -> float:
    """Return what a reading must be multiplied by where the source is not the one of the calibration.

    Args:
        source: Spectrum of the source that is read.
        calibration_source: Spectrum that the scale holds for.
        response_nm: Ascending wavelengths of the camera's spectral response in nm.
        response: Its relative response (per watt).
        observer: Observer for luminance; None for radiance over each spectrum's band.

    Raises:
        InputError: If the camera does not respond to one of the spectra.

    Source: CIE 179:2007, F = [∫S_s·v / ∫S_s·r]·[∫S_c·r / ∫S_c·v] with v = 1 for radiance.
    """
    weighting = luminous_efficiency(observer) if observer else (None, None)
    signal, signal_calibration = (one.integral(response_nm, response) for one in (source, calibration_source))
    if signal <= 0.0 or signal_calibration <= 0.0:
        raise InputError("the camera's spectral response is zero over one of the spectra; extend its table")
    ratio = source.integral(*weighting) / signal
    return ratio * signal_calibration / calibration_source.integral(*weighting)
