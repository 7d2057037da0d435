"""A readout amplifier that has not settled when a line begins."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from simulators.effects.base import DIGITAL_NUMBER, Stage, parameter
from simulators.effects.catalogue import Offset
from simulators.effects.context import ExposureContext
from simulators.effects.tile_moments import TileMoments

_STRIPS: Final = 64  # of a tile, for the law may fall within few pixels
_PLACES: Final = (2.0 * np.arange(_STRIPS) + 1.0) / _STRIPS - 1.0  # their middles, −1 to 1
_SURFACE, _ = np.linalg.qr(np.vander(_PLACES, 3, increasing=True))  # what a quadratic surface may be along a tile
_GAUSS: Final = 1.0 / math.sqrt(3.0)


@dataclass(frozen=True)
class LineStartOffset(Offset):
    """Adds an offset that dies away along each line: y' = y + a·exp(−x/d), x the share of the line that was read.

    It is there in a frame of no exposure, alike in all lines, at every exposure and temperature.

    Source: Janesick (2001), Scientific Charge-Coupled Devices, ch. 6: the video chain settles after the pause between
    two lines; an SBIG STL-1001E begins its lines 14 DN high and comes down within 0.13 of them.
    """

    name = "line_start_offset"
    stage = Stage.READOUT
    unit_in = DIGITAL_NUMBER
    unit_out = DIGITAL_NUMBER
    where = "image_x"
    block = "mean"
    also = ("slope",)
    log_prior_odds = -1.0
    prior_reason = "most converters begin behind the settling; of an uneven scene light can look the same"
    trials = tuple(
        {"offset_dn": size, "decay_share": share, "from_right": side}
        for share in (0.03, 0.15)
        for side in (0.0, 1.0)
        for size in (1.0, -1.0)
    )
    fitted = ("offset_dn", "decay_share")
    settles = "an average of many frames of no exposure, with masked or overscanned columns at both ends of the lines"
    offset_dn: float = parameter(0.0, "DN", -0.05, 0.05, source="tenths of a DN to tens of DN", of_full_scale=True)
    decay_share: float = parameter(
        0.15, "1", 0.02, 0.5, source="share of a line; a shorter one is no more than a few columns, a longer one a tilt"
    )
    from_right: float = parameter(0.0, "1", 0.0, 1.0, source="1 where a line is read from its last column on")

    def offset(self, context: ExposureContext) -> Any:
        """Return the offset in DN: of a pixel, or at the points of tiles with their true mean and slope."""
        along = self._read_share(context)
        at = self._in_strips(context)
        if at is None:
            return self._law(along)
        mean, rise = at.mean(axis=-1, keepdims=True), (at @ _PLACES / float(_PLACES @ _PLACES))[..., None]
        side = np.sign(along - along.mean(axis=-1, keepdims=True))
        return mean + _GAUSS * rise * side

    def tile(self, after: TileMoments, before: TileMoments, context: ExposureContext) -> TileMoments:
        """Return the moments with what a quadratic surface leaves of the fall in each tile, alike in all rows."""
        at = self._in_strips(context)
        if at is None:
            return after
        left = at - (at @ _SURFACE) @ _SURFACE.T
        columns = np.mean(np.square(left), axis=-1, keepdims=True).mean(axis=-2, keepdims=True)
        return after.changed(fixed_column_variance=before.fixed_column_variance + columns)

    def _law(self, along: Any) -> Any:
        return self.offset_dn * np.exp(-along / self.decay_share)

    def _read_share(self, context: ExposureContext) -> Any:
        """Return which share of its line was read before each pixel or point."""
        geometry = context.geometry
        share = (geometry.x_px + 0.5) / geometry.sensor_width
        return 1.0 - share if self.from_right else share

    def _in_strips(self, context: ExposureContext) -> Any:
        """Return the mean offset of each of the tiles' strips in DN; None for the pixels of a frame."""
        height: Any = getattr(context, "tile_height", None)
        if height is None:
            return None
        half = 0.5 * getattr(context, "tile_pixels", 1.0) / height / context.geometry.sensor_width
        reach = half / _STRIPS / self.decay_share  # half a strip: the mean of exp over ±r is sinh(r)/r
        middle = self._read_share(context).mean(axis=-1, keepdims=True)
        return self._law(middle + half * _PLACES) * np.sinh(reach) / reach
