"""A readout amplifier that has not settled when a line begins."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final, Self

import numpy as np

from simulators.effects.base import DIGITAL_NUMBER, Stage, parameter
from simulators.effects.catalogue import Offset
from simulators.effects.context import ExposureContext
from simulators.effects.tile_moments import TileMoments

_STRIPS: Final = 64  # of a tile, for the law may fall within few pixels
_PLACES: Final = (2.0 * np.arange(_STRIPS) + 1.0) / _STRIPS - 1.0  # their middles, −1 to 1
_SURFACE, _ = np.linalg.qr(np.vander(_PLACES, 3, increasing=True))  # what a quadratic surface may be along a tile
_GAUSS: Final = 1.0 / math.sqrt(3.0)  # points of a Gauss-Legendre rule of two
_SLOW_PART: Final = 0.1  # of the quick part, from which a fit of the slow one begins
_LONGER: Final = 8.0  # times the quick decay, from which a fit of the slow one begins


@dataclass(frozen=True)
class LineStartOffset(Offset):
    """Adds an offset that dies away along each line: y' = y + a·exp(−x/d), x the share of the line that was read.

    It is there in a frame of no exposure, alike in all lines, at every exposure and temperature. A chain that settles
    quickly and is clamped slowly has a second part, b·exp(−x/s), which the quick one may overshoot.

    Source: Janesick (2001), Scientific Charge-Coupled Devices, ch. 6: the video chain settles after the pause between
    two lines; an SBIG STL-1001E begins its lines 14 DN high and comes down within 0.13 of them. A Basler CCD (EMVA 1288
    reference set 1) begins 1.5 DN low, is 0.2 DN high after a tenth of the line, and comes back within a third of it.
    """

    name = "line_start_offset"
    stage = Stage.READOUT
    unit_in = unit_out = DIGITAL_NUMBER
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
        0.15, "1", 0.01, 0.5, source="share of a line; a shorter one is only a few columns, a longer one a tilt"
    )
    from_right: float = parameter(0.0, "1", 0.0, 1.0, source="1 where a line is read from its last column on")
    slow_dn: float = parameter(0.0, "DN", -0.05, 0.05, source="a clamp's: tenths of a DN", of_full_scale=True)
    slow_share: float = parameter(0.3, "1", 0.1, 1.0, source="share of a line; a longer one is a tilt")

    def free(self) -> tuple[str, ...]:
        return (*self.fitted, "slow_dn", "slow_share") if self.slow_dn else self.fitted

    def loosened(self, context: ExposureContext) -> tuple[Self, ...]:
        """Return settlings with a slow part of either sign and the quick one."""
        if self.slow_dn:
            return ()
        size, longer = _SLOW_PART * abs(self.offset_dn), min(max(_LONGER * self.decay_share, 0.2), 1.0)
        return tuple(self.with_parameters(slow_dn=sign * size, slow_share=longer) for sign in (1.0, -1.0))

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

    def _law(self, along: Any, half_strip: Any = None) -> Any:
        """Return the offset in DN; of strips ±r wide their mean, for that of exp is sinh(r)/r times its middle."""
        quick = _settling(along, self.offset_dn, self.decay_share, half_strip)
        return quick + _settling(along, self.slow_dn, self.slow_share, half_strip) if self.slow_dn else quick

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
        middle = self._read_share(context).mean(axis=-1, keepdims=True)
        return self._law(middle + half * _PLACES, half / _STRIPS)


def _settling(along: Any, size: float, share: float, half_strip: Any) -> Any:
    wider = 1.0 if half_strip is None else np.sinh(half_strip / share) * share / half_strip
    return size * np.exp(-along / share) * wider
