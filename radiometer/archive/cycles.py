"""Cycles of unknown period in a history: half of a cycle would otherwise be claimed as a drift."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from radiometer.statistics.least_squares import solve
from radiometer.statistics.model_choice import is_supported, schwarz
from radiometer.typing import Array

# Cycles that are looked for, from one in the span to one in some readings (or so many), this many steps per one.
MOST_CYCLES: Final = 3
_READINGS_PER_CYCLE: Final = 2.5  # more than the two of the sampling theorem, for times are uneven
_FINER: Final = 8  # steps on each side of the best frequency
# Cycles in the span that are hardly separable from a drift.
_SLOW_PER_SPAN: Final = (0.75, 1.0, 1.25, 1.5, 1.75, 2.0, 2.5, 3.0, 4.0)
_FEWEST_PER_SPAN: Final = 0.5  # below which the record cannot separate a cycle from a drift
# Cycles in the span beyond the season's that may replace it.
_NEAR_THE_SEASON: Final = (-0.5, -0.375, -0.25, -0.125, 0.125, 0.25, 0.375, 0.5)
_APART: Final = 0.6  # cycles per span by which two separable cycles differ
_TRIFLE: Final = 1e-3  # share of the variance that a cycle must explain
_LEAST_APART: Final = 1e-4  # smallest over largest singular value of columns of norm 1
_MOST_ODDS: Final = 3.0  # for cycles that were not clear enough to be taken as found
_MOST_PER_SPAN: Final = 120  # a year of readings: periods down to three days
_STEPS: Final = 4  # per cycle and span: a peak of a periodogram is one wide
# Correlation times of neighbours that compete with a cycle, as parts of the span.
_TIMES_OF_SPAN: Final = (0.003, 0.01, 0.03, 0.1, 0.3)
_MOST_CORRELATED: Final = 0.995  # nearer to 1 the covariance cannot be inverted in double precision
# Values in a table of trial cycles at once.
_MOST_VALUES: Final = 4_000_000


def hidden_cycles(
    design: Array, relative: Array, sigma: Array, time_s: Array, season_s: Sequence[float]
) -> tuple[float, ...]:
    """Return the periods in s of cycles that the readings show beyond line and season, the clearest first.

    A cycle is taken where it explains more than neighbours' correlation does, by Schwarz's criterion.

    Args:
        design: Columns of what is fitted without cycles, shape (n, columns).
        relative: Values, shape (n,).
        sigma: Standard deviations of their noise, up to a factor, same shape.
        time_s: Times in s, ascending, same shape.
        season_s: Periods in s of cycles that the design holds already.

    Source: generalised Lomb–Scargle, Zechmeister and Kürster 2009.
    """
    span, count = float(time_s[-1] - time_s[0]), relative.size
    per_span = np.arange(1.0, min(count / _READINGS_PER_CYCLE, _MOST_PER_SPAN) + 1e-9, 1.0 / _STEPS)
    per_span = per_span[: max(_MOST_VALUES // (2 * count), 8)]
    found: list[float] = []
    for _ in range(MOST_CYCLES):
        per_span = _away(per_span, span, (*season_s, *found))
        if count < 2 * (design.shape[1] + 4) or per_span.size == 0:
            break
        without, gains = _likelihoods(design, relative / sigma, sigma, time_s, span / per_span)
        best = int(gains.argmax())
        if not is_supported(2.0 * (gains[best] - without), schwarz(2, count, trials=float(per_span[-1]))):
            break
        if not is_determined(np.column_stack([design, cycle_columns(time_s, span / float(per_span[best]))])):
            break
        near = per_span[best] + np.linspace(-1.0, 1.0, 2 * _FINER + 1) / _STEPS
        _, gains = _likelihoods(design, relative / sigma, sigma, time_s, span / near)
        found.append(span / float(near[int(gains.argmax())]))
        design = np.column_stack([design, with_period(design, relative, sigma, time_s, found[-1])])
        if not is_determined(design):
            found.pop()
            break
    return tuple(found)


def is_determined(design: Array) -> bool:
    """Return whether the readings separate columns: not where they are all at few times of a cycle."""
    sizes = np.linalg.svd(design / np.maximum(np.linalg.norm(design, axis=0), 1e-300), compute_uv=False)
    return bool(sizes[-1] > _LEAST_APART * sizes[0])


def slow_cycles(
    design: Array, relative: Array, sigma: Array, time_s: Array, fitted_s: Sequence[float]
) -> list[tuple[float, float]]:
    """Return periods in s of slow cycles that may be there as well, and their odds against none, by the readings.

    Some one to four cycles in the span are hardly separable from a drift, and show late. All of them count as far as
    the readings allow them.

    Args:
        design: Columns of what is fitted, shape (n, columns).
        relative: Values, shape (n,).
        sigma: Standard deviations of their noise, up to a factor, same shape.
        time_s: Times in s, ascending, same shape.
        fitted_s: Periods in s of the cycles that the design holds: those nearby are theirs.

    Source: Hoeting et al. 1999, Statistical Science 14, 382.
    """
    count = relative.size
    span = float(time_s[-1] - time_s[0])
    periods_s = span / _away(np.array(_SLOW_PER_SPAN), span, fitted_s)
    if periods_s.size == 0 or count < 2 * (design.shape[1] + 4):
        return []
    without, gains = _likelihoods(design, relative / sigma, sigma, time_s, periods_s)
    odds = np.exp(np.clip(gains - without - math.log(count) - math.log(periods_s.size), -700.0, 700.0))
    odds *= min(1.0, _MOST_ODDS / max(float(odds.sum()), 1e-300))
    return _separated(design, time_s, periods_s, odds)


def near_the_season(
    others: Array, relative: Array, sigma: Array, time_s: Array, season_s: float
) -> list[tuple[float, float]]:
    """Return periods in s of cycles that may replace a season's, and their odds against it, by the readings.

    A cycle that is nearly as long is hardly separable from it, and its residual would appear as a drift.

    Args:
        others: Columns of what is fitted besides the season, shape (n, columns).
        relative: Values, shape (n,).
        sigma: Standard deviations of their noise, up to a factor, same shape.
        time_s: Times in s, ascending, same shape.
        season_s: Period of the season in s.
    """
    span = float(time_s[-1] - time_s[0])
    per_span = span / season_s + np.array(_NEAR_THE_SEASON)
    per_span = per_span[per_span >= _FEWEST_PER_SPAN]
    periods_s = np.concatenate([[season_s], span / per_span])
    _, gains = _likelihoods(others, relative / sigma, sigma, time_s, periods_s)
    odds = np.exp(np.clip(gains[1:] - gains[0], -700.0, 700.0)) / max(per_span.size, 1)
    return _separated(others, time_s, periods_s[1:], odds)


def _separated(design: Array, time_s: Array, periods_s: Array, odds: Array) -> list[tuple[float, float]]:
    whole = 1.0 + float(odds.sum())
    return [
        (float(period), float(one))
        for period, one in zip(periods_s, odds, strict=True)
        if one > _TRIFLE * whole and is_determined(np.column_stack([design, cycle_columns(time_s, float(period))]))
    ]


def _away(per_span: Array, span: float, fitted_s: Sequence[float]) -> Array:
    """Return the numbers of cycles in the span that are none of the fitted cycles'."""
    taken = np.array([span / period for period in fitted_s])
    return per_span[np.all(np.abs(per_span[:, None] - taken) >= _APART, axis=1)]


def with_period(design: Array, relative: Array, sigma: Array, time_s: Array, period_s: float) -> Array:
    """Return the columns of a cycle whose period is not quite known: sine, cosine, and the slope by the period.

    Args:
        design: Columns of what is fitted without it, shape (n, columns).
        relative: Values, shape (n,).
        sigma: Standard deviations of their noise, up to a factor, same shape.
        time_s: Times in s, same shape.
        period_s: Its period in s.
    """
    columns = cycle_columns(time_s, period_s)
    both = np.column_stack([design, columns]) / sigma[:, None]
    size = solve(both, relative / sigma)[-2:]
    turned = columns[:, 1] * size[0] - columns[:, 0] * size[1]
    middle = (time_s - time_s.mean()) / (time_s[-1] - time_s[0])
    return np.column_stack([columns, middle * turned / max(float(np.hypot(*size)), 1e-300)])


def cycle_columns(time_s: Array, period_s: float) -> Array:
    """Return sine and cosine of a period at the times, shape (n, 2)."""
    phase = 2.0 * np.pi * (time_s - time_s[0]) / period_s
    return np.stack([np.sin(phase), np.cos(phase)], axis=1)


def _likelihoods(design: Array, observed: Array, sigma: Array, time_s: Array, periods_s: Array) -> tuple[float, Array]:
    """Return the log-likelihood without a cycle and with each, every one at its likeliest correlation time."""
    gaps, freedom = np.diff(time_s), observed.size - design.shape[1] - 2
    trials = np.concatenate([cycle_columns(time_s, period) for period in periods_s], axis=1) / sigma[:, None]
    rows = np.column_stack([design / sigma[:, None], observed, trials])
    without, gains = -math.inf, np.full(periods_s.size, -math.inf)
    for tau in (0.0, *(part * float(time_s[-1] - time_s[0]) for part in _TIMES_OF_SPAN)):
        phi = np.zeros_like(gaps) if tau == 0.0 else np.minimum(np.exp(-gaps / tau), _MOST_CORRELATED)
        root = np.sqrt(1.0 - phi**2)
        white = np.concatenate([rows[:1], (rows[1:] - phi[:, None] * rows[:-1]) / root[:, None]])
        base, _ = np.linalg.qr(white[:, : design.shape[1]])
        rest = white[:, design.shape[1] :]
        rest = rest - base @ (base.T @ rest)
        left, sine, cosine = rest[:, 0], rest[:, 1::2], rest[:, 2::2]
        ss, cc, sc = (np.einsum("ij,ij->j", a, b) for a, b in ((sine, sine), (cosine, cosine), (sine, cosine)))
        s, c, whole = left @ sine, left @ cosine, float(left @ left)
        determinant = np.maximum(ss * cc - sc**2, 1e-9 * ss * cc + 1e-300)
        explained = np.clip((cc * s**2 - 2.0 * sc * s * c + ss * c**2) / determinant, 0.0, whole * (1 - 1e-12))
        jacobian = -float(np.log(root).sum())
        without = max(without, jacobian - 0.5 * freedom * math.log(max(whole, 1e-300)))
        gains = np.maximum(gains, jacobian - 0.5 * freedom * np.log(np.maximum(whole - explained, 1e-300)))
    return without, gains
