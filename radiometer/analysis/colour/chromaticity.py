"""Tristimulus values, chromaticities, correlated colour temperature and Duv, each with its uncertainty.

Source: CIE 015:2018, the CIE 1931 standard observer (2°).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Final

import numpy as np
from scipy.interpolate import CubicSpline

from radiometer.analysis.photometry.photometry import KM_LM_PER_W, Spectrum, matching_functions
from radiometer.typing import Array
from radiometer.units import BOLTZMANN_J_K, PLANCK_J_S, SPEED_OF_LIGHT_M_S

QUANTITIES: Final = ("X", "Y", "Z", "x", "y", "u_prime", "v_prime", "cct", "duv")
# Columns over X, Y, Z: numerators and denominators of (x, y) and (u′, v′). Source: CIE 015:2018, 7.3 and 8.2.1.
_XY: Final = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]), np.ones(3)
_UV_PRIME: Final = np.array([[4.0, 0.0, 0.0], [0.0, 9.0, 0.0]]), np.array([1.0, 15.0, 3.0])
_TO_1960: Final = np.array([1.0, 2.0 / 3.0])  # (u, v) = (u′, 2/3·v′)
_MIRED: Final = np.arange(10.0, 1000.1, 2.5)  # 100 000 K to 1000 K; a cubic between them is right to 1e-8 in u and v
_FARTHEST_DUV: Final = 0.05  # beyond, light has no correlated colour temperature: CIE 015:2018, 9.5
_ROUNDS: Final = 8  # of Newton's method; from the nearest of the grid it needs 4
_SETTLED_MIRED: Final = 1e-3  # 0.04 K at 6500 K


@dataclass(frozen=True, slots=True, eq=False)
class Coordinates:
    """Chromaticity coordinates of light, one entry per light; shapes are those of the lights."""

    xy: Array  # (…, 2)
    xy_covariance: Array  # (…, 2, 2)
    uv_prime: Array  # u′, v′ (CIE 1976), (…, 2)
    uv_covariance: Array  # (…, 2, 2)
    cct_k: Array  # correlated colour temperature in K; NaN where there is none
    u_cct_k: Array  # its standard uncertainty
    duv: Array  # distance from the Planckian locus in the (u, v) diagram of 1960, above it positive; NaN as `cct_k`
    u_duv: Array  # its standard uncertainty

    def figures(self, xyz: Array, covariance: Array) -> tuple[Array, Array]:
        """Return the values of `QUANTITIES` for X, Y, Z, shape (…, 3), and their u, shape (…, 9) each."""
        squares = (covariance, self.xy_covariance, self.uv_covariance)
        u = [np.sqrt(np.diagonal(one, axis1=-2, axis2=-1)) for one in squares]
        own = self.cct_k[..., None], self.duv[..., None]
        values = np.concatenate([xyz, self.xy, self.uv_prime, *own], axis=-1)
        return values, np.concatenate([*u, self.u_cct_k[..., None], self.u_duv[..., None]], axis=-1)


def tristimulus(light: Spectrum) -> Array:
    """Return X, Y, Z, shape (3,): 683 lm/W · ∫S·x̄ dλ and so on; of W·sr⁻¹·m⁻²·nm⁻¹ in cd·m⁻²."""
    wavelength_nm, functions = matching_functions()
    return KM_LM_PER_W * np.array([light.integral(wavelength_nm, one) for one in functions])


def coordinates(xyz: Array, covariance: Array) -> Coordinates:
    """Return chromaticities, colour temperature and Duv, with uncertainties to first order.

    Args:
        xyz: X, Y, Z, shape (…, 3), with a sum above 0.
        covariance: Their covariance, shape (…, 3, 3).
    """
    xy, xy_covariance = _ratios(xyz, covariance, *_XY)
    uv, uv_covariance = _ratios(xyz, covariance, *_UV_PRIME)
    scale = np.outer(_TO_1960, _TO_1960)
    return Coordinates(xy, xy_covariance, uv, uv_covariance, *_temperature(uv * _TO_1960, uv_covariance * scale))


def _ratios(xyz: Array, covariance: Array, above: Array, below: Array) -> tuple[Array, Array]:
    """Return two ratios of sums of X, Y, Z, shape (…, 2), and their covariance."""
    total = (xyz @ below)[..., None]
    ratio = xyz @ above.T / total
    derivative = (above - ratio[..., None] * below) / total[..., None]
    return ratio, derivative @ covariance @ np.swapaxes(derivative, -1, -2)


@cache
def _locus() -> CubicSpline:
    """Return (u, v) of the Planckian locus over the reciprocal temperature in mired (MK⁻¹)."""
    wavelength_nm, functions = matching_functions()
    metres = wavelength_nm * 1e-9
    exponent = PLANCK_J_S * SPEED_OF_LIGHT_M_S / (metres * BOLTZMANN_J_K * (1e6 / _MIRED[:, None]))
    xyz = (metres**-5 / np.expm1(exponent)) @ functions.T
    return CubicSpline(_MIRED, _ratios(xyz, np.zeros((3, 3)), *_UV_PRIME)[0] * _TO_1960)


def locus_points() -> tuple[Array, Array]:
    """Return (x, y) of the spectral locus, shape (wavelengths, 2), and of the Planckian locus, for diagrams."""
    _, functions = matching_functions()
    seen = functions.T[functions.sum(axis=0) > 1e-4]  # beyond, entries have too few digits for a ratio
    u, v = _locus()(_MIRED).T
    planckian = np.stack([3.0 * u, 2.0 * v], axis=-1) / (2.0 * u - 8.0 * v + 4.0)[:, None]
    return seen[:, :2] / seen.sum(axis=1, keepdims=True), planckian


def _temperature(uv: Array, covariance: Array) -> tuple[Array, Array, Array, Array]:
    """Return CCT in K, its u, Duv and its u, of points in the diagram of 1960.

    The point p(r) of the locus is the nearest: (uv − p)·p′ = 0. Its derivative gives ∂r/∂uv = p′/(p′² − (uv − p)·p″).

    Source: Ohno 2014, LEUKOS 10, 47 (definitions of CCT and Duv).
    """
    locus = _locus()
    near = locus(_MIRED)
    mired = _MIRED[np.argmin(np.sum((uv[..., None, :] - near) ** 2, axis=-1), axis=-1)]
    for _ in range(_ROUNDS):
        away, along, bend = uv - locus(mired), locus(mired, 1), locus(mired, 2)
        stiffness = np.sum(along**2, axis=-1) - np.sum(away * bend, axis=-1)
        step = np.sum(away * along, axis=-1) / stiffness
        mired = np.clip(mired + step, _MIRED[0], _MIRED[-1])
    length = np.sqrt(np.sum(along**2, axis=-1, keepdims=True))
    normal = along[..., ::-1] * np.array([-1.0, 1.0]) / length  # upwards: u rises with the mireds
    duv = np.sum(away * normal, axis=-1)
    to_mired = along / stiffness[..., None]
    u_mired = np.sqrt(np.einsum("...i,...ij,...j", to_mired, covariance, to_mired))
    u_duv = np.sqrt(np.einsum("...i,...ij,...j", normal, covariance, normal))
    found = (np.abs(step) < _SETTLED_MIRED) & (np.abs(duv) <= _FARTHEST_DUV)
    cct_k = 1e6 / mired
    return tuple(np.where(found, one, np.nan) for one in (cct_k, cct_k**2 * u_mired / 1e6, duv, u_duv))  # type: ignore[return-value]
