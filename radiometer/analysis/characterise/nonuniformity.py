"""Differences between pixels: DSNU and PRNU."""

from __future__ import annotations

import math
from collections.abc import Sequence

from radiometer.analysis.characterise.group_statistics import GroupStatistics
from radiometer.data import Quantity


def dsnu(dark: GroupStatistics, K: Quantity) -> Quantity:
    """Return DSNU_1288, the spatial standard deviation of the dark signal in e-.

    Source: EMVA Standard 1288, release 4.0, equation (54).
    """
    spread = _root(dark.spatial_variance_dn2, dark.u_spatial_variance_dn2)
    return Quantity(spread.value / K.value, math.hypot(spread.u / K.value, spread.value / K.value * K.u_rel), "e-")


def prnu(bright: GroupStatistics, dark: GroupStatistics) -> Quantity:
    """Return PRNU_1288, the relative spatial standard deviation of the response in %.

    Unevenness of the light itself counts in it, as in the standard.

    Source: EMVA Standard 1288, release 4.0, equation (55).
    """
    difference = bright.spatial_variance_dn2 - dark.spatial_variance_dn2
    spread = _root(difference, math.hypot(bright.u_spatial_variance_dn2, dark.u_spatial_variance_dn2))
    signal = bright.mean_dn - dark.mean_dn
    return Quantity(100.0 * spread.value / signal, 100.0 * spread.u / signal, "%")


def nonuniformity_by_part(
    bright: GroupStatistics | None, dark: GroupStatistics | None, K: Quantity | None
) -> dict[str, Quantity]:
    """Return DSNU and PRNU of rows, columns and pixels, as far as the pictures determine them.

    Args:
        bright: Bright group of the PRNU; None for no PRNU.
        K: Overall system gain in DN/e-; None for no DSNU.

    Source: EMVA Standard 1288, release 4.0, sections 8.2 and 8.3.
    """
    found: dict[str, Quantity] = {}
    if dark is None or dark.split is None:
        return found
    for part in ("row", "column", "pixel"):
        below, u_below = getattr(dark.split, f"{part}_dn2"), getattr(dark.split, f"u_{part}_dn2")
        if K is not None:
            spread = _root(below, u_below)
            u = math.hypot(spread.u / K.value, spread.value / K.value * K.u_rel)
            found[f"DSNU_{part}"] = Quantity(spread.value / K.value, u, "e-")
        if bright is not None and bright.split is not None:
            above, u_above = getattr(bright.split, f"{part}_dn2"), getattr(bright.split, f"u_{part}_dn2")
            spread = _root(above - below, math.hypot(u_above, u_below))
            signal = bright.mean_dn - dark.mean_dn
            found[f"PRNU_{part}"] = Quantity(100.0 * spread.value / signal, 100.0 * spread.u / signal, "%")
    return found


def best_stack(groups: Sequence[GroupStatistics], saturation_dn: float, black_dn: float) -> GroupStatistics:
    """Return the bright group for PRNU: most frames, then nearest to half of saturation."""
    return max(groups, key=lambda g: (g.frames, -abs(g.mean_dn - black_dn - 0.5 * saturation_dn)))


def _root(variance: float, u_variance: float) -> Quantity:
    """Return the root of a variance that may be zero, with an uncertainty whose ±2u spans that of the variance."""
    value = math.sqrt(max(variance, 0.0))
    above = math.sqrt(max(variance, 0.0) + 2 * u_variance) - value
    below = value - math.sqrt(max(variance - 2 * u_variance, 0.0))
    return Quantity(value, max(above, below) / 2, "DN")
