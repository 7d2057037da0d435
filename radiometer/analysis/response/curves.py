"""From a fitted g(M) to the curve that is handed out: monotonic, gauged, flagged where extrapolated."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.optimize import isotonic_regression

from radiometer.analysis.response.samples import ResponseSamples
from radiometer.data.provenance import Provenance
from radiometer.data.response_curve import ResponseCurve
from radiometer.typing import Array

# An end of a curve that is less certain than this, in ln H, is called extrapolated.
_UNDETERMINED_U = 0.05
# The gauge makes u vanish at the middle: levelling takes no value for better known than this part of the median.
_LEVEL_FLOOR = 0.3
BLACK_KEY = "black_dn"  # in a curve's parameters
# Signal in DN that represents black: the middle of what rounds to it.
_AT_BLACK_DN = 0.5


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
    black_dn: float = 0.0,
    parameters: dict[str, Any] | None = None,
    assumptions: tuple[str, ...] = (),
) -> ResponseCurve:
    """Return the curve with the gauge g(M_mid) = 0, made monotonic, its uncertainty infinite where not supported.

    Args:
        log_exposure: g at every digital number, finite.
        u_log_exposure: Its standard uncertainty relative to the gauge point.
        valid_dn: Lowest and highest digital number that data supported.
        black_dn: Digital number of no light.
    """
    inside = rising(log_exposure, u_log_exposure, valid_dn, black_dn)
    # Where the fit fell and had to be levelled, it is no better known than by how much.
    u = np.hypot(u_log_exposure, np.abs(inside - log_exposure))
    determined = _determined(inside, u, valid_dn)
    u = np.where((np.arange(u.size) < determined[0]) | (np.arange(u.size) > determined[1]), np.inf, u)
    found = {**({BLACK_KEY: float(black_dn)} if black_dn > 0.0 else {}), **(parameters or {})}
    middle = inside.size // 2
    if not determined[0] <= middle <= determined[1]:
        u[determined[0] : determined[1] + 1] = np.hypot(
            u[determined[0] : determined[1] + 1], _extrapolation(inside, valid_dn)[middle]
        )
    return ResponseCurve(
        inside - inside[middle],
        u,
        valid_dn=determined,
        channel=channel,
        provenance=Provenance(method, assumptions=assumptions, parameters=found),
    )


def black_of_curve(curve: ResponseCurve) -> float:
    """Return the digital number of no light that frames showed when their response was recovered; 0 where none did."""
    black_dn = curve.provenance.parameters.get(BLACK_KEY, 0.0)
    return float(black_dn) if isinstance(black_dn, int | float) else 0.0


def rising(log_exposure: Array, u: Array, valid_dn: tuple[int, int], black_dn: float = 0.0) -> Array:
    """Return the nearest non-falling curve, continued outside the supported range by its last slopes.

    It continues as a power of M − M_black: ln H over ln(M − M_black) is straight. So a linear camera stays linear and
    H falls to 0 at black. Black itself stands half a digital number above it.

    Args:
        log_exposure: g at every digital number.
        u: Its uncertainty; values count by its inverse square, so that poorly known ones do not level the others.
        black_dn: Digital number of no light.
    """
    low, high = valid_dn
    curve = np.array(log_exposure, dtype=np.float64)
    known = u[low : high + 1][np.isfinite(u[low : high + 1])]
    floor = max(_LEVEL_FLOOR * float(np.median(known)), 1e-12) if known.size else 1.0
    sigma = np.minimum(np.hypot(u[low : high + 1], floor), 1e6)
    core = isotonic_regression(curve[low : high + 1], weights=(floor / sigma) ** 2).x
    curve[low : high + 1] = core
    span = max(4, (high - low) // 64)
    signal = np.maximum(np.arange(curve.size) - min(black_dn, low - 1.0), _AT_BLACK_DN)
    log_signal = np.log(signal)
    ends = log_signal[low : low + span + 1], log_signal[high - span : high + 1]
    curve[:low] = core[0] + _slope(core[: span + 1], ends[0]) * (log_signal[:low] - log_signal[low])
    curve[high + 1 :] = core[-1] + _slope(core[-span - 1 :], ends[1]) * (log_signal[high + 1 :] - log_signal[high])
    return curve


def _determined(curve: Array, u: Array, valid_dn: tuple[int, int]) -> tuple[int, int]:
    """Return the supported range without ends where a few stray data leave the curve undetermined, or level.

    Where the uncertainty grows faster towards an end than ln H changes, the fit bends away from its data: whatever
    light made a number, the curve gives it that of the one before.
    """
    low, high = valid_dn
    limit = max(_UNDETERMINED_U, 10.0 * float(np.median(u[low : high + 1])))
    known = low + np.flatnonzero(u[low : high + 1] <= limit)
    first, last = int(known[0]), max(int(known[-1]), int(known[0]) + 1)
    rise, growth = np.gradient(curve[first : last + 1]), np.gradient(u[first : last + 1])
    rising_to, rising_from = np.flatnonzero(rise > growth), np.flatnonzero(rise > -growth)
    if not (rising_to.size and rising_from.size) or rising_from[0] >= rising_to[-1]:
        return first, last
    return first + int(rising_from[0]), first + int(rising_to[-1])


def _slope(piece: Array, over: Array) -> float:
    """Return the slope of the ends of a piece over those of a variable."""
    return max(float(piece[-1] - piece[0]) / max(float(over[-1] - over[0]), 1e-9), 1e-9)


def u_with_extrapolation(curve: ResponseCurve) -> Array:
    """Return the standard uncertainty of g, with the whole step beyond the supported range as that outside it.

    A curve states no (an infinite) uncertainty there; what measures the ends by other means still needs a start.
    """
    if curve.valid_dn is None:
        return curve.u_log_exposure
    u = curve.u_log_exposure
    at_edge = u[np.clip(np.arange(u.size), *curve.valid_dn)]
    return np.where(np.isfinite(u), u, np.hypot(at_edge, _extrapolation(curve.log_exposure, curve.valid_dn)))


def _extrapolation(curve: Array, valid_dn: tuple[int, int]) -> Array:
    """Return how far the curve runs beyond its data: the whole step counts as uncertain."""
    low, high = valid_dn
    dn = np.arange(curve.size)
    nearest = curve[np.clip(dn, low, high)]
    return np.asarray(np.abs(curve - nearest))
