"""Descriptions of a display's curve by a few numbers, and how far each is from what was measured."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import least_squares

from radiometer.typing import Array

Curve = Callable[[Array, Array], Array]
_EXPONENTS: Final = (0.01, 100.0)  # of γ, the last parameter of every model: light rises with the drive


@dataclass(frozen=True, slots=True)
class TransferModel:
    """A named curve L(v; parameters) of the drive v = 0..1."""

    name: str  # name in files
    source: str  # where the equation comes from
    parameters: tuple[str, ...]  # names of its parameters
    curve: Curve  # function (parameters, v) giving values in the unit of the measured ones
    start: Callable[[Array, Array], list[float]]  # function (v, values) giving parameters to start from


@dataclass(frozen=True, slots=True)
class TransferFit:
    """A fitted model and its errors."""

    model: str  # name of the model
    parameters: dict[str, float]  # fitted value of each parameter; α, L0 and peak in the unit of the values
    rms_rel: float  # root mean square of the relative error over all measured levels above the black
    max_rel: float  # largest relative error over those levels
    max_of_peak: float  # largest error in units of the highest value
    # Standard uncertainty of γ: by the noise of the values, or by how far they miss the formula where that is more
    u_gamma: float

    def predict(self, level: ArrayLike) -> Array:
        """Return the model's values at levels 0..1."""
        model = MODELS[self.model]
        return model.curve(np.array(list(self.parameters.values())), np.asarray(level, dtype=np.float64))


def _gamma(p: Array, v: Array) -> Array:
    return np.asarray(p[0] * v ** p[1])


def _gamma_offset(p: Array, v: Array) -> Array:
    return np.asarray(p[0] + p[1] * v ** p[2])


def _pelli_zhang(p: Array, v: Array) -> Array:
    return np.asarray(p[0] + np.maximum(p[1] + p[2] * v, 0.0) ** p[3])


MODELS: Final[dict[str, TransferModel]] = {
    "gamma": TransferModel("gamma", "L = peak·v^γ", ("peak", "gamma"), _gamma, lambda v, y: [float(y.max()), 2.2]),
    "gamma_offset": TransferModel(
        "gamma_offset",
        "L = L0 + range·v^γ (PsychoPy's easy form)",
        ("L0", "range", "gamma"),
        _gamma_offset,
        lambda v, y: [float(y.min()), float(np.ptp(y)), 2.2],
    ),
    "pelli_zhang1991": TransferModel(
        "pelli_zhang1991",
        "L = α + (β + κ·v)^γ, Pelli and Zhang 1991, Vision Research 31, 1337",
        ("alpha", "beta", "kappa", "gamma"),
        _pelli_zhang,
        lambda v, y: [float(y.min()), 0.0, float(np.ptp(y)) ** (1 / 2.2), 2.2],
    ),
}


def fit_transfer(name: str, level: ArrayLike, value: ArrayLike, u: ArrayLike) -> TransferFit:
    """Fit one of the models to measured values.

    Args:
        name: Key of `MODELS`.
        level: Drive 0..1, shape (n,), n at least as many as the model has parameters.
        value: Radiance or luminance, 0 or more, shape (n,).
        u: Standard uncertainty of each value; a floor of 0.2 % of the value is added, since no display follows a
            formula better.

    Raises:
        ValueError: If there are too few levels or the fit does not converge.
    """
    model = MODELS[name]
    v, y, sigma = (np.asarray(a, dtype=np.float64) for a in (level, value, u))
    if v.size < len(model.parameters):
        raise ValueError(f"{name} needs at least {len(model.parameters)} levels, not {v.size}")
    scale = np.hypot(sigma, 0.002 * y) + 1e-6 * y.max()
    start = np.array(model.start(v, y))

    def residuals(p: Array) -> Array:
        return np.asarray((model.curve(p, v) - y) / scale)

    low, high = np.array([(-np.inf, np.inf)] * (start.size - 1) + [_EXPONENTS]).T
    found = least_squares(residuals, start, bounds=(low, high), x_scale=np.maximum(np.abs(start), 0.01), max_nfev=2000)
    if not found.success:
        raise ValueError(f"{name}: the fit did not converge ({found.message})")
    missed = 2.0 * found.cost / max(v.size - start.size, 1)  # χ² per degree of freedom (Birge 1932)
    jacobian = np.asarray(found.jac, dtype=np.float64)
    try:
        u_gamma = math.sqrt(max(missed, 1.0) * abs(float(np.linalg.inv(jacobian.T @ jacobian)[-1, -1])))
    except np.linalg.LinAlgError:
        u_gamma = math.inf
    return _judged(model, found.x, v, y, u_gamma)


def _judged(model: TransferModel, parameters: Array, v: Array, y: Array, u_gamma: float) -> TransferFit:
    error = model.curve(parameters, v) - y
    lit = (v > 0) & (y > 0)
    relative = error[lit] / y[lit]
    return TransferFit(
        model.name,
        dict(zip(model.parameters, (float(p) for p in parameters), strict=True)),
        rms_rel=float(np.sqrt(np.mean(relative**2))),
        max_rel=float(np.abs(relative).max()),
        max_of_peak=float(np.abs(error).max() / y.max()),
        u_gamma=u_gamma,
    )
