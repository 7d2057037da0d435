"""Corrects a reading for light of another spectrum than the camera was calibrated with."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radiometer.analysis.photometry.photometry import (
    MOST_UNKNOWN_REL,
    Spectrum,
    mean_weight,
    spectral_columns,
    spectrum,
)
from radiometer.errors import InputError

# Quantum efficiencies of silicon sensors vary by about a fifth between 450 and 650 nm (EMVA 1288 data sheets).
FLAT_QUANTUM_EFFICIENCY_U_REL: Final = 0.1
_DIM_REL: Final = 0.01  # of its peak: what an LED sends beyond counts less than the flat efficiency is known
_GRID_NM: Final = np.arange(380.0, 781.0, 1.0)  # steps of the tables of CIE 018:2019


def spectral_factor(calibrated: str, peak_nm: float | None, fwhm_nm: float, responsivity: Path | None = None) -> float:
    """Return what a reading is multiplied by: responsivity per watt at the calibration's light over the one at hand.

    A camera counts photons: with a flat quantum efficiency its responsivity per watt goes as λ. F = s̄_cal/s̄_light,
    s̄ = ∫S(λ)·s(λ) dλ / ∫S(λ) dλ.

    Args:
        calibrated: Name of the spectrum that the camera was calibrated with.
        peak_nm: Peak of the light at hand in nm; None for a white LED.
        fwhm_nm: Its full width at half maximum in nm.
        responsivity: CSV `wavelength_nm,responsivity` (per watt, relative); None: flat quantum efficiency.

    Raises:
        InputError: If spectrum or file cannot be used.
    """
    light = spectrum("white_led") if peak_nm is None else _gaussian(peak_nm, fwhm_nm)
    scale = spectrum(calibrated)
    grid_nm = np.unique(np.concatenate([_GRID_NM, light.wavelength_nm, scale.wavelength_nm]))
    sensitivity = grid_nm.copy() if responsivity is None else _read(responsivity, grid_nm, (light, scale))
    return _mean(scale, grid_nm, sensitivity) / _mean(light, grid_nm, sensitivity)


def _mean(light: Spectrum, grid_nm: NDArray[np.float64], sensitivity: NDArray[np.float64]) -> float:
    found = mean_weight(light, (grid_nm, sensitivity))
    if found.u > MOST_UNKNOWN_REL * found.value:
        raise InputError(f"spectrum {light.name!r} leaves the correction unknown to {100 * found.u_rel:.2g} %; "
                         "state it in finer steps")  # fmt: skip
    return found.value


def _gaussian(peak_nm: float, fwhm_nm: float) -> Spectrum:
    """Return an LED's light: over the visible band, and as far beyond it as the light reaches."""
    if fwhm_nm <= 0:
        return spectrum(f"line:{peak_nm:g}")
    reach_nm = np.arange(math.floor(peak_nm - 2 * fwhm_nm), math.ceil(peak_nm + 2 * fwhm_nm) + 1.0)
    band_nm = np.union1d(_GRID_NM, reach_nm)
    power = np.exp(-4.0 * math.log(2.0) * ((band_nm - peak_nm) / fwhm_nm) ** 2)
    return Spectrum(f"{peak_nm:g} nm", band_nm, power)


def _read(path: Path, grid_nm: NDArray[np.float64], lights: tuple[Spectrum, ...]) -> NDArray[np.float64]:
    names = ("responsivity", "relative_responsivity", "response", "relative", "value")
    wavelength_nm, columns = spectral_columns(path, {"responsivity": names})
    values = columns["responsivity"]
    if wavelength_nm[0] > 420 or wavelength_nm[-1] < 680 or values.min() < 0:
        raise InputError(f"{path}: the responsivity must be 0 or more and reach from 420 to 680 nm at least")
    for light in lights:
        _refuse_beyond(path, light, float(wavelength_nm[0]), float(wavelength_nm[-1]))
    return np.asarray(np.interp(grid_nm, wavelength_nm, values), dtype=np.float64)


def _refuse_beyond(path: Path, light: Spectrum, first_nm: float, last_nm: float) -> None:
    """Raise InputError where a light outside the visible band reaches beyond a table of responsivity."""
    lit_nm = light.wavelength_nm[light.power > _DIM_REL * light.power.max()]
    beyond = lit_nm[(lit_nm < min(_GRID_NM[0], first_nm)) | (lit_nm > max(_GRID_NM[-1], last_nm))]
    if beyond.size:
        raise InputError(
            f"{path}: the responsivity ends at {last_nm:g} nm, the light of {light.name} reaches {beyond[-1]:g} nm; "
            "extend the table"
        )
