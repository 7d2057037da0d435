"""The matrix from a camera's channels to X, Y, Z: fitted to known lights, with its error for other lights.

A camera whose responsivities are no mixture of the colour matching functions has no exact matrix (Luther 1927). Its
error depends on the spectrum, so it is found from lights that the matrix was not fitted to, and is part of u.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from scipy.spatial import ConvexHull

from radiometer.analysis.colour.plausible import plausible_cameras, plausible_lights
from radiometer.analysis.photometry.displays import display_primaries, tristimulus_of
from radiometer.analysis.photometry.photometry import DISPLAY_TYPES
from radiometer.analysis.reading.budget import coverage_factor
from radiometer.data.validation import FileArray, FileSection
from radiometer.errors import CalibrationError
from radiometer.statistics.least_squares import solve
from radiometer.typing import Array

_ROW: Final = ("name", "kind", "signal", "u_signal", "xyz", "u_rel")  # keys of a light in a file
_LEAST_SPAN: Final = 1e-3  # of the singular values: below, the channels of all lights are one mixture of each other
_ALONE: Final = 1.0 - 1e-6  # leverage of a light that alone determines a coefficient
_ROUNDS: Final = 20  # of weights and error in turn; they settle within five
_LEAST_ERROR: Final = 1e-4  # relative; no camera is linear to better
_COVERED: Final = 0.9545  # of the lights by k = 2, as of a normal distribution


@dataclass(frozen=True, slots=True, eq=False)
class Training:
    """Lights of known X, Y, Z and the raw readings of them."""

    names: tuple[str, ...]  # name of each light
    kinds: tuple[str, ...]  # its kind, such as "oled"
    signal: FileArray  # channel readings, shape (lights, channels)
    u_signal: FileArray  # their standard uncertainties, independent of each other
    xyz: FileArray  # X, Y, Z in cd·m⁻², shape (lights, 3)
    u_rel: FileArray  # relative standard uncertainty of X, Y, Z of each light, independent of the others

    def rows(self) -> list[dict[str, Any]]:
        """Return a mapping of plain values for each light."""
        values = (one.tolist() for one in (self.signal, self.u_signal, self.xyz, self.u_rel))
        return [dict(zip(_ROW, row, strict=True)) for row in zip(self.names, self.kinds, *values, strict=True)]

    def of_kind(self, kind: str | None) -> Training:
        """Return the lights of a kind; all for None."""
        at = [n for n, one in enumerate(self.kinds) if kind in (None, one)]
        names, kinds = (tuple(given[n] for n in at) for given in (self.names, self.kinds))
        return Training(names, kinds, self.signal[at], self.u_signal[at], self.xyz[at], self.u_rel[at])


def of_rows(rows: Any) -> Any:
    """Return the fields of `Training` from the rows of a file; None for none. Raises ValueError for other rows."""
    try:
        columns = [[row[name] for row in rows] for name in _ROW] if isinstance(rows, list) else None
    except (KeyError, TypeError) as error:
        raise ValueError(f"a light has no {error}; calibrate again") from error
    return rows if columns is None else dict(zip(Training.__slots__, columns, strict=True)) if rows else None


class Fit(FileSection):
    """A matrix and what is known of its error.

    Errors are covariances of X, Y, Z over the square of X + Y + Z, shape (3, 3).
    """

    matrix: FileArray  # X, Y, Z per unit of each channel, shape (3, channels)
    # Inverse of the normal matrix, shape (channels, channels): aᵀ·spread·a is the leverage of a light
    spread: FileArray
    error: FileArray  # error for a light that was left out
    hull: FileArray  # corners (x, y) of the hull of the lights that it was fitted to, shape (corners, 2)

    def leverage(self, signal: Array) -> Array:
        """Return the leverage of lights, shape (…): about channels/lights within the training set, more outside."""
        total = np.sum(signal @ self.matrix.T, axis=-1, keepdims=True)
        share = signal / np.where(total > 0.0, total, np.nan)
        return np.asarray(np.einsum("...i,ij,...j", share, self.spread, share))


def fit_matrix(training: Training, white: str | None = None) -> Fit:
    """Return the matrix of least squares, each light weighted by 1/u².

    u² of a light is the noise of its readings, the uncertainty of its X, Y, Z, and the error of the matrix, which is
    found from the residuals. The error is that of the residual of each light without that light, r/(1 − h).
    It is widened so that k = 2 covers 95.45 %, by Student's t and by the residuals that are far off. The matrix gives
    X, Y, Z of the light named `white` exactly, so that greys keep its colour; those of its like gain, the others lose
    little. Raises CalibrationError if the lights do not determine the matrix and its error.

    Source: Finlayson & Drew 1997, Proc. 5th Color Imaging Conf., 258 (white-preserving least squares).
    """
    count, channels = training.signal.shape
    total = training.xyz.sum(axis=1, keepdims=True)
    if count <= channels:
        raise CalibrationError(f"{count} lights do not determine a matrix of {channels} channels and its error: "
                               f"give {channels + 1} lights or more")  # fmt: skip
    if np.any(total <= 0.0):
        raise CalibrationError(f"light {training.names[int(np.argmin(total))]!r}: X + Y + Z must be above 0")
    share, target = training.signal / total, training.xyz / total
    if np.linalg.cond(share / np.linalg.norm(share, axis=0)) >= 1.0 / _LEAST_SPAN:
        raise CalibrationError(
            f"the {count} lights do not determine the matrix: their channels have a fixed ratio; "
            "add lights of other colours"
        )
    known = training.u_rel**2 * np.mean(target**2, axis=1)
    noise, error_2 = known, 1e-4
    exact = training.names.index(white) if white in training.names else None
    along = np.zeros(channels) if exact is None else share[exact] / np.sum(share[exact] ** 2)  # along · white is 1
    free = np.eye(channels) if exact is None else np.linalg.svd(share[exact][None])[2][1:].T  # white has none of these
    fixed = np.outer(np.zeros(3) if exact is None else target[exact], along)
    for _ in range(_ROUNDS):
        weight = 1.0 / (error_2 + noise)
        weight /= weight.mean()
        spread = free @ np.linalg.inv(free.T @ share.T @ (weight[:, None] * share) @ free) @ free.T
        matrix = fixed + (spread @ share.T @ (weight[:, None] * (target - share @ fixed.T))).T
        leverage = weight * np.einsum("ni,ij,nj->n", share, spread, share)
        if np.any(leverage > _ALONE):
            alone = training.names[int(np.argmax(leverage))]
            raise CalibrationError(f"without light {alone!r} the others do not determine the matrix; add one like it")
        left_out = (target - share @ matrix.T) / (1.0 - leverage)[:, None]
        noise = known + np.mean((training.u_signal / total) ** 2 @ (matrix**2).T, axis=1)
        found = np.average(np.mean(left_out**2, axis=1) - noise, weights=weight)
        error_2 = max(float(found), _LEAST_ERROR**2)
    if exact is not None:  # what is wrong with the white is wrong with all that is like it
        spread = spread + noise[exact] / error_2 * np.outer(along, along)
    error = _covering((left_out * np.sqrt(weight)[:, None])[np.arange(count) != exact], count - channels)
    return Fit(matrix=matrix, spread=spread, error=error, hull=target[ConvexHull(target[:, :2]).vertices, :2])


def plausible_training(responsivities: Array) -> Training:
    """Return plausible lights as a camera of these responsivities, shape (channels, wavelengths), reads them."""
    lights = plausible_lights()
    kinds = tuple(kind for kind, powers in lights.items() for _ in powers)
    powers = np.vstack(list(lights.values()))
    signal, none = _signal(powers, responsivities), np.zeros(len(powers))
    return Training(kinds, kinds, signal, np.zeros(signal.shape), _normal(tristimulus_of(powers)), none)


def _covering(off: Array, freedom: int) -> Array:
    """Return the covariance of errors, shape (3, 3), of which k = 2 covers 95.45 % of them.

    It is the mean of e·eᵀ and of what no camera is better than. It is wider where a few lights are far off, such as
    those of a lamp with lines, and where few degrees of freedom are left (Student's t).
    """
    mean = off.T @ off / len(off)
    far = np.quantile(np.abs(off) / np.sqrt(np.maximum(np.diag(mean), 1e-30)), _COVERED)
    few = coverage_factor(freedom) / 2.0
    return np.asarray(max(few, float(far) / 2.0) ** 2 * mean + _LEAST_ERROR**2 * np.eye(3))


def _normal(xyz: Array) -> Array:
    return np.asarray(xyz / xyz.sum(axis=1, keepdims=True))


def _signal(powers: Array, responsivities: Array) -> Array:
    """Return the signals of lights over their X + Y + Z, shape (lights, channels)."""
    return np.asarray(powers @ responsivities.T / tristimulus_of(powers).sum(axis=1, keepdims=True))


def errors_of_other_lights(
    matrix: Array, training: Training, powers: Array | None, responsivities: Array | None
) -> tuple[dict[str, Array], dict[str, Array]]:
    """Return the error of a matrix by kind of plausible light, and as a function of X, Y, Z for types of display.

    The first are covariances over (X + Y + Z)². The light of a display is a mixture of its primaries, so its error is
    linear in X, Y, Z: e = D·(X, Y, Z). The second are covariances of D over the displays of a type, shape (9, 9).

    Args:
        matrix: Shape (3, channels).
        training: Lights that it was fitted to.
        powers: Their powers over the grid of plausible lights. None takes the plausible lights that are nearest in
            chromaticity and readings, of the kinds of the training where these are plausible ones.
        responsivities: The camera's, up to a common factor. None takes plausible colour cameras, each with a matrix
            fitted to the same lights.
    """
    lights, stated = plausible_lights(), powers is not None
    if powers is None:
        pool = np.vstack([lights[kind] for kind in lights if kind in training.kinds] or list(lights.values()))
        read, there = _normal(training.xyz)[:, :2], _normal(tristimulus_of(pool))[:, :2]
        if responsivities is not None:  # the camera distinguishes lamps that look alike
            read = np.hstack([read, _normal(training.signal)])
            there = np.hstack([there, _normal(_signal(pool, responsivities))])
        powers = pool[np.argmin(np.sum((read[:, None] - there) ** 2, axis=-1), axis=1)]
    u_scale = 0.0
    if responsivities is not None:
        computed, known = _signal(powers, responsivities), training.signal / training.xyz.sum(axis=1, keepdims=True)
        if not stated:  # the readings are of other spectra: the scale is that by which the matrix is right for these
            computed, known = computed @ matrix.T, _normal(tristimulus_of(powers))
        scale = float(np.sum(computed * known) / np.sum(computed**2))
        each = np.sum(computed * known, axis=1) / np.sum(computed**2, axis=1)
        u_scale = float(np.std(each, ddof=1)) / scale / math.sqrt(len(each))
        pairs = [(matrix, scale * responsivities)]
    else:
        target = _normal(tristimulus_of(powers))
        pairs = [(solve(_signal(powers, camera), target).T, camera) for camera in plausible_cameras()]
    found = {}
    for kind, one in lights.items():
        shares = _normal(tristimulus_of(one))
        off = np.vstack([_signal(one, camera) @ fitted.T - shares for fitted, camera in pairs])
        found[kind] = _covering(off, len(one)) + u_scale**2 * shares.T @ shares / len(shares)
    return found, {kind: _of_displays(kind, pairs, u_scale) for kind in DISPLAY_TYPES}


def _of_displays(kind: str, pairs: list[tuple[Array, Array]], u_scale: float) -> Array:
    """Return the covariance of D, shape (9, 9), over displays of a type and pairs of a matrix and a camera."""
    displays = display_primaries(kind)
    off = [
        np.eye(3) - tristimulus_of(primaries).T @ np.linalg.pinv(fitted @ camera @ primaries.T)
        for fitted, camera in pairs
        for primaries in displays
    ]
    few = coverage_factor(len(displays)) / 2.0
    mean = few**2 * np.mean([np.outer(one, one) for one in off], axis=0)
    alike = u_scale**2 * np.outer(np.eye(3), np.eye(3))
    return np.asarray(mean + alike + _LEAST_ERROR**2 * np.kron(np.eye(3), np.ones((3, 3))))
