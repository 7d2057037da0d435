"""How well the light repeats from capture to capture, from repeats of one setting alone."""

from __future__ import annotations

from typing import Final

import numpy as np

from radiometer.reconcile.chances import chi2_beyond, chi2_quantile
from radiometer.reconcile.measure.design import Array, Design

_ASSUMED_TAU: Final = 1e-3  # where neither repeats nor capture.yaml tell
_ASSUMED_RANGE: Final = (0.3, 3.0)
_DECLARED_RANGE: Final = (0.5, 2.0)
_ENOUGH_REPEATS: Final = 5
_CONFIDENCE: Final = 0.99
_SMALLEST_TAU: Final = 1e-6
_TREND_SHARE: Final = 0.4  # of the repeats' freedom that a slow change in time may take
_MOST_WAVES: Final = 16
_DECLARED_WANDER: Final = 1.3  # times the stated reproducibility, which is itself known to a few parts in ten
_PLAUSIBLE_WANDER: Final = 0.003  # of a source of which nothing is stated: what scatters more is something to name
_EXPOSURE_GROUPS: Final = 6
_NORMAL: Final = 1.4826  # standard deviation of normal values over their median deviation
_STANDS_OUT: Final = 8.0  # sigmas
_UNSTEADY: Final = 0.01
_ZOOMED: Final = 33  # values tried at once, of which the neighbours of the best are the next range
_ZOOMS: Final = 6
_SHOWN_WANDER: Final = 4.0  # deviance that it must explain


def capture_scale(
    difference: Array, sensitivity: Array, deviation: Array, usable: np.ndarray[tuple[int, ...], np.dtype[np.bool_]]
) -> tuple[Array, Array]:
    """Return the common relative deviation of each capture and its variance from pixel noise alone.

    Args:
        difference: (captures, tiles) measured minus predicted mean in DN.
        sensitivity: (captures, tiles) d(mean)/d(log light) in DN.
        deviation: (captures, tiles) standard uncertainty of a mean from pixel noise in DN.
        usable: Which entries count.

    Returns:
        (captures,) deviation and variance; the variance is infinite where no light is seen.
    """
    weight = np.where(usable, sensitivity / deviation**2, 0.0)
    information = np.sum(weight * np.where(usable, sensitivity, 0.0), axis=1)
    lit = information > 0
    scale = np.sum(weight * np.where(usable, difference, 0.0), axis=1) / np.where(lit, information, 1.0)
    return scale, np.where(lit, 1.0 / np.where(lit, information, 1.0), np.inf)


def estimate_tau(design: Design, scale: Array, variance: Array) -> float:
    """Return the capture-to-capture repeatability τ as a relative standard deviation.

    Repeats of one setting bound it (99 % interval of their scatter, slow change in time taken out); within the
    bounds the likelihood of all captures decides. Left free it would swallow effects, and from few repeats alone it
    would be loose by a factor of two.

    Args:
        design: Captures.
        scale: (captures,) common relative deviation from the model.
        variance: (captures,) its variance from pixel noise alone.
    """
    lit = np.isfinite(variance)
    low, high = _bounds(design, scale, variance, lit)
    if not lit.any():
        return float(np.sqrt(low * high))

    for _ in range(_ZOOMS):
        tried = np.geomspace(low, high, _ZOOMED)
        total = variance[lit] + np.square(tried)[:, None]
        best = int(np.argmin(np.sum(np.log(total) + scale[lit] ** 2 / total, axis=1)))
        low, high = tried[max(best - 1, 0)], tried[min(best + 1, _ZOOMED - 1)]
    return float(np.sqrt(low * high))


def steady_wander2(tried: Array, deviances: Array, exposure_s: Array, declared: float | None) -> float:
    """Return the relative variance by which the source wanders from frame to frame, alike at all exposures.

    It is the likeliest one. It is no more than the source's stated reproducibility, or 0.3 % where none is stated, and
    none where it differs between exposures, for light that flickers averages out in long ones.

    Args:
        tried: (values,) relative variances, 0 first.
        deviances: (values, captures) −2·ln of each capture's likelihood.
        exposure_s: (captures,) exposure times.
        declared: Stated relative standard uncertainty of the source's reproducibility; None where not stated.
    """
    allowed = tried <= (_PLAUSIBLE_WANDER if declared is None else _DECLARED_WANDER * declared) ** 2
    totals = np.where(allowed, deviances.sum(axis=1), np.inf)
    if not exposure_s.size or deviances[0].sum() - totals.min() < _SHOWN_WANDER:
        return 0.0
    order = np.argsort(exposure_s, kind="stable")
    groups = np.array_split(order, min(_EXPOSURE_GROUPS, len(np.unique(exposure_s))))
    apart = sum(float(deviances[:, group].sum(axis=1).min()) for group in groups)
    if declared is not None and len(groups) > 1 and chi2_beyond(totals.min() - apart, len(groups) - 1) < _UNSTEADY:
        return 0.0
    return float(tried[np.argmin(totals)])


def _bounds(
    design: Design, scale: Array, variance: Array, lit: np.ndarray[tuple[int, ...], np.dtype[np.bool_]]
) -> tuple[float, float]:
    residual, noise, freedom = _within_repeats(design, scale, variance, lit)
    declared = design.header.source.reproducibility_u_rel
    if freedom < _ENOUGH_REPEATS:
        middle, (down, up) = (declared, _DECLARED_RANGE) if declared else (_ASSUMED_TAU, _ASSUMED_RANGE)
        return max(middle * down, _SMALLEST_TAU), max(middle * up, 2 * _SMALLEST_TAU)
    observed = residual / freedom
    inside = np.array([chi2_quantile(0.5 + s * _CONFIDENCE / 2.0, freedom) / freedom for s in (1.0, -1.0)])
    total = np.maximum(observed / inside, 0.0) - noise
    low, high = np.sqrt(np.maximum(total, _SMALLEST_TAU**2))
    return float(low), float(max(high, 2 * low, 2e-5))


def _within_repeats(
    design: Design, scale: Array, variance: Array, lit: np.ndarray[tuple[int, ...], np.dtype[np.bool_]]
) -> tuple[float, float, int]:
    """Return (sum of squares within repeated settings, mean pixel-noise variance, degrees of freedom).

    Settings of which one capture stands out from all others are left out: it has a cause of its own (a wrong label),
    which poor repeatability would hide.
    """
    apart, taken, rank = _about_repeats(design, scale, lit, waves=False)
    if not apart.size:
        return 0.0, 0.0, 0
    usual = _NORMAL * float(np.median(np.abs(apart))) * np.sqrt(apart.size / max(apart.size - rank, 1))
    limit = _STANDS_OUT * np.sqrt(usual**2 + variance[taken])
    odd = np.unique(design.setting_id[taken][np.abs(apart) > limit])
    residual, taken, rank = _about_repeats(design, scale, lit & ~np.isin(design.setting_id, odd), waves=True)
    if not residual.size:
        return 0.0, 0.0, 0
    return float(np.sum(residual**2)), float(np.mean(variance[taken])), residual.size - rank


def _about_repeats(
    design: Design, scale: Array, lit: np.ndarray[tuple[int, ...], np.dtype[np.bool_]], *, waves: bool
) -> tuple[Array, np.ndarray[tuple[int, ...], np.dtype[np.intp]], int]:
    """Return how far repeats lie from the means of their settings, which captures they are, and the rank of the means.

    Args:
        design: Captures.
        scale: (captures,) common relative deviation from the model.
        lit: Which captures count.
        waves: Whether a slow change in time is taken out too.
    """
    ids = design.setting_id
    repeated = lit & np.isin(ids, [i for i in np.unique(ids[lit]) if np.sum(ids[lit] == i) > 1])
    taken = np.flatnonzero(repeated)
    if not taken.size:
        return np.zeros(0), taken, 0
    groups = np.unique(ids[taken])
    basis = np.stack([(ids[taken] == group).astype(np.float64) for group in groups], axis=1)
    if waves:
        freedom = taken.size - len(groups)
        basis = np.hstack([basis, _slow_change(design.timestamp_s[taken], int(_TREND_SHARE * freedom))])
    solution, _, rank, _ = np.linalg.lstsq(basis, scale[taken], rcond=None)
    return np.asarray(scale[taken] - basis @ solution), taken, int(rank)


def _slow_change(time: Array, terms: int) -> Array:
    """Return up to so many functions of time that change slowly: a warm-up first, then ever shorter waves."""
    if terms < 3:
        return np.zeros((time.size, 0))
    u = (time - time.min()) / (float(np.ptp(time)) or 1.0)
    waves = np.arange(1, min(terms - 3, _MOST_WAVES) + 1)
    return np.column_stack([u, u**2, np.exp(-4.0 * u), np.cos(np.pi * u[:, None] * waves)])
