"""From a fitted g(M) to the curve that is handed out: monotonic, gauged, flagged where extrapolated."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import isotonic_regression

from radiometer.analysis.response.samples import ResponseSamples
from radiometer.data.provenance import Provenance
from radiometer.data.response_curve import ResponseCurve

Array = NDArray[np.float64]
# An end of a curve that is less certain than this, in ln H, is called extrapolated.
_UNDETERMINED_U = 0.05


def supported_range(samples: ResponseSamples) -> tuple[int, int]:
    """Return the lowest and highest digital number that unclipped data reach."""
    return int(np.ceil(samples.dn.min())), int(np.floor(samples.dn.max()))


def finished_curve(
    log_exposure: Array,
    u_log_exposure: Array,
    valid_dn: tuple[int, int],
    *,
    method: str,
    channel: str,
    parameters: dict[str, Any] | None = None,
    assumptions: tuple[str, ...] = (),
    black_dn: int = 0,
) -> ResponseCurve:
    """Return the curve with the gauge g(M_mid) = 0, made monotonic, its uncertainty widened where extrapolated.

    Args:
        log_exposure: g at every digital number, finite.
        u_log_exposure: Its standard uncertainty relative to the gauge point.
        valid_dn: Lowest and highest digital number that data supported.
        method: Name of the method.
        channel: Colour channel.
        parameters: Settings of the method, for the provenance.
        assumptions: What was assumed, for the provenance.
        black_dn: Digital number of black.
    """
    inside = rising(log_exposure, u_log_exposure, valid_dn, black_dn)
    # Where the fit fell and had to be levelled, it is no better known than by how much.
    levelled = np.hypot(u_log_exposure, np.abs(inside - log_exposure))
    at_edge = levelled[np.clip(np.arange(inside.size), *valid_dn)]
    u = np.hypot(at_edge, _extrapolation(inside, valid_dn))
    middle = inside.size // 2
    return ResponseCurve(
        inside - inside[middle],
        u,
        valid_dn=_determined(u, valid_dn),
        channel=channel,
        provenance=Provenance(method, assumptions=assumptions, parameters=parameters or {}),
    )


def rising(log_exposure: Array, u: Array, valid_dn: tuple[int, int], black_dn: int = 0) -> Array:
    """Return the nearest non-falling curve; outside the supported range it goes on as it left off.

    Below the range it goes on as a power law of the distance from black, above with the slope at the edge.

    Args:
        log_exposure: g at every digital number.
        u: Its uncertainty; values count by its inverse square.
        valid_dn: Supported range.
        black_dn: Digital number of black.
    """
    low, high = valid_dn
    curve = np.array(log_exposure, dtype=np.float64)
    floor = max(float(np.median(u[low : high + 1])), 1e-12)
    core = isotonic_regression(curve[low : high + 1], weights=1.0 / (u[low : high + 1] ** 2 + floor**2)).x
    curve[low : high + 1] = core
    span = max(4, (high - low) // 64)
    height = np.log(np.maximum(np.arange(curve.size) - black_dn, 0.0) + 0.5)
    power = (core[min(span, core.size - 1)] - core[0]) / max(height[min(low + span, high)] - height[low], 1e-9)
    curve[:low] = core[0] - max(power, 1e-9) * (height[low] - height[:low])
    curve[high + 1 :] = core[-1] + _slope(core[-span - 1 :]) * np.arange(1, curve.size - high)
    return curve


def _determined(u: Array, valid_dn: tuple[int, int]) -> tuple[int, int]:
    """Return the supported range without ends where a few stray data leave the curve undetermined."""
    low, high = valid_dn
    limit = max(_UNDETERMINED_U, 10.0 * float(np.median(u[low : high + 1])))
    known = low + np.flatnonzero(u[low : high + 1] <= limit)
    return int(known[0]), max(int(known[-1]), int(known[0]) + 1)


def _slope(piece: Array) -> float:
    return max(float(piece[-1] - piece[0]) / max(piece.size - 1, 1), 1e-9)


def _extrapolation(curve: Array, valid_dn: tuple[int, int]) -> Array:
    """Return how far the curve runs beyond its data: the whole step counts as uncertain."""
    low, high = valid_dn
    dn = np.arange(curve.size)
    nearest = curve[np.clip(dn, low, high)]
    return np.asarray(np.abs(curve - nearest))
