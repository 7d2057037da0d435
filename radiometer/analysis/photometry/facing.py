"""Irradiance on a plane that faces an evenly bright rectangle or disc: from its radiance, size and distance.

Source: Howell, A Catalog of Radiation Heat Transfer Configuration Factors: differential element to a parallel rectangle
and disc.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

from radiometer.data import Quantity
from radiometer.errors import UsageError
from radiometer.numbers import unit_text

_UNITS: Final = {"W sr-1 m-2": "W m-2", "cd m-2": "lx"}
_STEP_REL: Final = 1e-4  # of the distance: the derivative of the factor is then right to 1e-8


@dataclass(frozen=True, slots=True)
class FacingSource:
    """An evenly bright area whose middle is straight before a parallel plane."""

    size_m: tuple[float, ...]  # width and height of a rectangle, or the diameter of a disc, in m
    distance_m: float  # from the plane, in m
    u_distance_m: float = 0.0  # standard uncertainty of the distance in m

    def __post_init__(self) -> None:
        """Raise UsageError for a size or a distance that is not above 0."""
        sizes = " x ".join(f"{one:g}" for one in self.size_m)
        if len(self.size_m) not in (1, 2) or not all(math.isfinite(one) and one > 0.0 for one in self.size_m):
            raise UsageError(f"size {sizes} m: give width x height, or the diameter of a disc, each above 0")
        if not (math.isfinite(self.distance_m) and self.distance_m > 0.0):
            raise UsageError(f"distance {self.distance_m:g} m: must be above 0")
        if not (math.isfinite(self.u_distance_m) and self.u_distance_m >= 0.0):
            raise UsageError(f"uncertainty of the distance {self.u_distance_m:g} m: must be 0 or more")

    def projected_sr(self, distance_m: float | None = None) -> float:
        """Return the projected solid angle in sr, π for the whole hemisphere.

        Args:
            distance_m: Another distance; its own by default.
        """
        distance = self.distance_m if distance_m is None else distance_m
        half = [one / 2.0 / distance for one in self.size_m]
        if len(half) == 1:
            return math.pi * half[0] ** 2 / (1.0 + half[0] ** 2)
        x, y = half
        across, up = math.hypot(1.0, x), math.hypot(1.0, y)
        return 2.0 * (x / across * math.atan(y / across) + y / up * math.atan(x / up))

    def irradiance(self, radiance: Quantity) -> Quantity:
        """Return the irradiance in W·m⁻², or the illuminance in lx, with its standard uncertainty.

        Args:
            radiance: In W·sr⁻¹·m⁻² or cd·m⁻², alike in all directions towards the plane.

        Raises:
            UsageError: If its unit is another.
        """
        if radiance.unit not in _UNITS:
            raise UsageError(f"size and distance make an irradiance of a radiance, not of {unit_text(radiance.unit)}")
        solid, step = self.projected_sr(), _STEP_REL * self.distance_m
        slope = (self.projected_sr(self.distance_m + step) - self.projected_sr(self.distance_m - step)) / (2.0 * step)
        u = math.hypot(radiance.u * solid, radiance.value * slope * self.u_distance_m)
        return Quantity(radiance.value * solid, u, _UNITS[radiance.unit])
