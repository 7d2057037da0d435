"""Irradiance on a plane that faces an evenly bright rectangle or disc: from its radiance, size and distance.

Source: Howell, A Catalog of Radiation Heat Transfer Configuration Factors: differential element to a parallel rectangle
and disc.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

from radiometer.data import Quantity
from radiometer.errors import UsageError
from radiometer.numbers import unit_text

_UNITS: Final = {"W sr-1 m-2": "W m-2", "cd m-2": "lx"}
_STEP_REL: Final = 1e-4  # of the distance: the derivative of the factor is then right to 1e-8


def facing_irradiance(
    radiance: Quantity, size_m: Sequence[float], distance_m: float, u_distance_m: float = 0.0
) -> Quantity:
    """Return the irradiance in W·m⁻², or the illuminance in lx, on a parallel plane before the middle of a source.

    Args:
        radiance: In W·sr⁻¹·m⁻² or cd·m⁻², alike in all directions towards the plane.
        size_m: Width and height of a rectangle, or the diameter of a disc, in m.
        distance_m: From the plane, in m.
        u_distance_m: Its standard uncertainty in m.

    Raises:
        UsageError: If the unit is another, or a size or distance is not above 0.
    """
    if len(size_m) not in (1, 2) or not all(math.isfinite(one) and one > 0.0 for one in size_m):
        sizes = " x ".join(f"{one:g}" for one in size_m)
        raise UsageError(f"size {sizes} m: give width x height, or the diameter of a disc, each above 0")
    if not (math.isfinite(distance_m) and distance_m > 0.0):
        raise UsageError(f"distance {distance_m:g} m: must be above 0")
    if not (math.isfinite(u_distance_m) and u_distance_m >= 0.0):
        raise UsageError(f"uncertainty of the distance {u_distance_m:g} m: must be 0 or more")
    if radiance.unit not in _UNITS:
        raise UsageError(f"size and distance make an irradiance of a radiance, not of {unit_text(radiance.unit)}")
    solid, step = _projected_sr(size_m, distance_m), _STEP_REL * distance_m
    slope = (_projected_sr(size_m, distance_m + step) - _projected_sr(size_m, distance_m - step)) / (2.0 * step)
    u = math.hypot(radiance.u * solid, radiance.value * slope * u_distance_m)
    return Quantity(radiance.value * solid, u, _UNITS[radiance.unit])


def _projected_sr(size_m: Sequence[float], distance_m: float) -> float:
    """Return the projected solid angle in sr, π for the whole hemisphere."""
    half = [one / 2.0 / distance_m for one in size_m]
    if len(half) == 1:
        return math.pi * half[0] ** 2 / (1.0 + half[0] ** 2)
    x, y = half
    across, up = math.hypot(1.0, x), math.hypot(1.0, y)
    return 2.0 * (x / across * math.atan(y / across) + y / up * math.atan(x / up))
