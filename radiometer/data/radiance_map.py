"""A radiance map: radiance, standard uncertainty and condition of every pixel."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from enum import IntFlag
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radiometer.data.provenance import Provenance
from radiometer.typing import Array


class PixelMask(IntFlag):
    """Why a pixel of a radiance map must be taken with care; 0 is a good pixel."""

    GOOD = 0
    SATURATED = 1  # clipped in every frame: the value is a lower bound
    BELOW_NOISE = 2  # never above the noise floor
    EXTRAPOLATED = 4  # uses digital numbers that the response curve had no data for
    DEFECTIVE = 8  # interpolated from its neighbours
    INCONSISTENT = 16  # frames disagree beyond their noise (flicker, motion)
    MOVED = 32  # something moved: the value is that of the frames that agree
    UNLIT = 64  # overscan, which gathers no light: no value


@dataclass(frozen=True, slots=True, eq=False)
class RadianceMap:
    """Radiance per pixel."""

    radiance: NDArray[np.float32]  # radiance, shape (height, width), float32, in `unit`
    # Standard uncertainty per pixel: noise and `u_shared`; what is common to all pixels is in `u_rel_common`
    u_radiance: NDArray[np.float32]
    mask: NDArray[np.uint8]  # PixelMask bits per pixel, uint8
    unit: str = "relative"  # "W sr-1 m-2", or "relative"
    u_rel_common: float = 0.0  # relative standard uncertainty common to all pixels (scale, lens, exposure time)
    exposures_s: tuple[float, ...] = ()  # exposure times merged, in s
    provenance: Provenance = field(default_factory=lambda: Provenance("unknown"))  # method, inputs, assumptions
    not_in_u: tuple[str, ...] = ()  # what neither `u_radiance` nor `u_rel_common` holds, in words with its size
    # Part of `u_radiance` that pixels of one level and place share, so that no mean makes it smaller (response curve,
    # dark level, fall-off, exposure), float32; None where there is none
    u_shared: NDArray[np.float32] | None = None
    # Part of `u_radiance`, relative to the value, for pixels that may differ in responsivity: each by an error of its
    # own, which a picture does or does not show. No scatter is known to hold it
    u_rel_pattern: float = 0.0

    def scaled(self, factor: float, unit: str) -> RadianceMap:
        """Return the map with all values and uncertainties times a factor, in another unit."""
        shared = None if self.u_shared is None else self.u_shared * factor
        return replace(
            self, radiance=self.radiance * factor, u_radiance=self.u_radiance * factor, u_shared=shared, unit=unit
        )

    def parts_of_u(self, where: Any) -> tuple[Array, Array]:
        """Return the noise of some pixels, and the uncertainty that they share, float64, in `unit`.

        Args:
            where: Which pixels, as numpy takes it: rows and columns, or a mask.
        """
        own = self.u_radiance[where].astype(np.float64)
        if self.u_shared is None:
            return own, np.zeros_like(own)
        shared = self.u_shared[where].astype(np.float64)
        return np.sqrt(np.maximum(own**2 - shared**2, 0.0)), shared

    @property
    def shape(self) -> tuple[int, int]:
        """Return (height, width) in pixels."""
        return (int(self.radiance.shape[0]), int(self.radiance.shape[1]))
