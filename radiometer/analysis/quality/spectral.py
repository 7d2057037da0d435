"""f1′: how far a camera's spectral responsivity is from V(λ)."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from radiometer.analysis.photometry.photometry import luminous_efficiency
from radiometer.analysis.photometry.spectra import spectrum
from radiometer.analysis.quality.indices import Figure
from radiometer.data.calibration_sections import SpectralResponse

_STEP_NM: Final = 1.0
_DRAWS: Final = 2000
# Errors of a digitised curve go together over about this width.
_CORRELATED_NM: Final = 50.0


def v_lambda_mismatch(response: SpectralResponse) -> Figure:
    """Return f1′ of a spectral response, with what its own uncertainty makes of it.

    Args:
        response: Relative responsivity per watt; it counts as 0 outside its wavelengths, and all of it counts.

    Source: ISO/CIE 19476; CIE S 023: s* = s·∫S_A·V dλ / ∫S_A·s dλ with CIE illuminant A, f1′ = ∫|s* − V| dλ / ∫V dλ.
    """
    wavelength_nm, v = luminous_efficiency()
    low = min(float(wavelength_nm[0]), response.wavelength_nm[0])
    high = max(float(wavelength_nm[-1]), response.wavelength_nm[-1])
    grid = np.arange(low, high + _STEP_NM, _STEP_NM)
    observer = np.interp(grid, wavelength_nm, v, left=0.0, right=0.0)
    own = np.interp(grid, response.wavelength_nm, response.relative, left=0.0, right=0.0)
    value = float(_mismatch(own[np.newaxis], observer, grid)[0])
    drawn = _mismatch(own * _errors(grid, response.u_rel), observer, grid)
    return Figure(value, float(np.std(drawn)), remarks=(f"responsivity known to {100 * response.u_rel:.2g} %",))


def _mismatch(
    own: NDArray[np.float64], observer: NDArray[np.float64], grid: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return f1′ of each row of responsivities on an even grid."""
    light = spectrum("cie_a")
    power = np.interp(grid, light.wavelength_nm, light.power, left=0.0, right=0.0)
    matched = own * ((power @ observer) / (own @ power))[:, np.newaxis]
    return np.asarray(np.abs(matched - observer).sum(axis=1) / observer.sum())


def _errors(grid: NDArray[np.float64], u_rel: float) -> NDArray[np.float64]:
    """Return factors 1 + error that go together over some 50 nm, shape (draws, wavelengths)."""
    rng = np.random.default_rng(0)
    knots = np.arange(grid[0], grid[-1] + _CORRELATED_NM, _CORRELATED_NM)
    errors = rng.normal(0.0, u_rel, (_DRAWS, knots.size))
    return 1.0 + np.stack([np.interp(grid, knots, row) for row in errors])
