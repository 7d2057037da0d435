"""Differences between pixels: DSNU and PRNU."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from radiometer.analysis.characterise.group_statistics import GroupStatistics
from radiometer.analysis.characterise.line_fit import fit_line
from radiometer.analysis.characterise.steps import SAME_EXPOSURE_REL
from radiometer.data import Quantity


def dsnu(dark: GroupStatistics, K: Quantity) -> Quantity:
    """Return DSNU_1288, the spatial standard deviation of the dark signal in e-.

    Source: EMVA Standard 1288, release 4.0, equation (54).
    """
    return _in_electrons(_root(dark.spatial_variance_dn2, dark.u_spatial_variance_dn2), K)


def prnu(bright: GroupStatistics, dark: Sequence[GroupStatistics], signal_dn: float) -> Quantity:
    """Return PRNU_1288, the relative spatial standard deviation of the response in %.

    Unevenness of the light itself counts in it, as in the standard.

    Args:
        dark: Dark groups of its temperature.
        signal_dn: Signal of the bright group above the dark signal of its exposure in DN.

    Source: EMVA Standard 1288, release 4.0, equation (55).
    """
    below = _at_exposure(dark, bright, lambda one: (one.spatial_variance_dn2, one.u_spatial_variance_dn2))
    spread = _root(bright.spatial_variance_dn2 - below[0], math.hypot(bright.u_spatial_variance_dn2, below[1]))
    return _in_percent(spread, signal_dn)


def of_exposure(dark: Sequence[GroupStatistics], exposure_s: float) -> GroupStatistics:
    """Return the dark group of an exposure, that of most frames, or the nearest one."""

    def apart_s(one: GroupStatistics) -> float:
        here_s = one.settings.exposure_s
        return 0.0 if math.isclose(here_s, exposure_s, rel_tol=SAME_EXPOSURE_REL) else abs(here_s - exposure_s)

    return min(dark, key=lambda one: (apart_s(one), -one.frames))


def _at_exposure(
    dark: Sequence[GroupStatistics],
    bright: GroupStatistics,
    part: Callable[[GroupStatistics], tuple[float, float]],
) -> tuple[float, float]:
    """Return a spatial variance of the dark signal at the exposure of a bright group, and its standard uncertainty.

    Its pattern is one without dark current and one that grows as time: variances follow a line over time squared. One
    exposure alone leaves open how much grows.
    """
    exposure_s = bright.settings.exposure_s
    near = of_exposure(dark, exposure_s)
    value, u = part(near)
    if math.isclose(near.settings.exposure_s, exposure_s, rel_tol=SAME_EXPOSURE_REL):
        return value, u
    squares = np.array([d.settings.exposure_s for d in dark]) ** 2
    if np.unique(squares).size > 1:
        values, us = np.array([part(d) for d in dark]).T
        line = fit_line(squares, values, np.maximum(us, 1e-9))
        return line.intercept + line.slope * exposure_s**2, math.hypot(line.u_intercept, line.u_slope * exposure_s**2)
    grown = value * (exposure_s / near.settings.exposure_s) ** 2 if near.settings.exposure_s else value
    return (value + grown) / 2.0, math.hypot(u, abs(grown - value) / math.sqrt(12.0))


def nonuniformity_by_part(
    bright: GroupStatistics | None, dark: Sequence[GroupStatistics], K: Quantity | None, signal_dn: float = math.nan
) -> dict[str, Quantity]:
    """Return DSNU and PRNU of rows, columns and pixels, as far as the pictures determine them.

    Args:
        bright: Bright group of the PRNU; None for no PRNU.
        dark: Dark groups of its temperature.
        K: Overall system gain in DN/e-; None for no DSNU.
        signal_dn: Signal of the bright group above the dark signal of its exposure in DN.

    Source: EMVA Standard 1288, release 4.0, sections 8.2 and 8.3.
    """
    found: dict[str, Quantity] = {}
    known = [one for one in dark if one.split is not None]
    if not known:
        return found
    near = known[0] if bright is None else of_exposure(known, bright.settings.exposure_s)
    for part in ("row", "column", "pixel"):

        def of(one: GroupStatistics, part: str = part) -> tuple[float, float]:
            return getattr(one.split, f"{part}_dn2"), getattr(one.split, f"u_{part}_dn2")

        if K is not None:
            found[f"DSNU_{part}"] = _in_electrons(_root(*of(near)), K)
        if bright is not None and bright.split is not None:
            (above, u_above), (below, u_below) = of(bright), _at_exposure(known, bright, of)
            spread = _root(above - below, math.hypot(u_above, u_below))
            found[f"PRNU_{part}"] = _in_percent(spread, signal_dn)
    return found


def best_stack(groups: Sequence[GroupStatistics], saturation_dn: float, black_dn: float) -> GroupStatistics:
    """Return the bright group for PRNU: most frames, then nearest to half of saturation."""
    return max(groups, key=lambda g: (g.frames, -abs(g.mean_dn - black_dn - 0.5 * saturation_dn)))


def _in_electrons(spread: Quantity, K: Quantity) -> Quantity:
    value = spread.value / K.value
    return Quantity(value, math.hypot(spread.u / K.value, value * K.u_rel), "e-")


def _in_percent(spread: Quantity, signal_dn: float) -> Quantity:
    return Quantity(100.0 * spread.value / signal_dn, 100.0 * spread.u / signal_dn, "%")


def _root(variance: float, u_variance: float) -> Quantity:
    """Return the root of a variance that may be zero, with an uncertainty whose ±2u spans that of the variance."""
    value = math.sqrt(max(variance, 0.0))
    above = math.sqrt(max(variance, 0.0) + 2 * u_variance) - value
    below = value - math.sqrt(max(variance - 2 * u_variance, 0.0))
    return Quantity(value, max(above, below) / 2, "DN")
