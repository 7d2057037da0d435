"""A black level that is off in the first frame of a series."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, cast

import numpy as np

from simulators.effects.base import DIGITAL_NUMBER, Stage, UnitSlope, parameter
from simulators.effects.catalogue import CatalogueEffect
from simulators.effects.context import ExposureContext, Signal
from simulators.effects.tile_moments import TileMoments


@dataclass(frozen=True)
class FirstFrameOffset(UnitSlope, CatalogueEffect):
    """Adds a constant to the first frame after a change of settings: y' = y + b in frame 0, y' = y in the others.

    Source: reset and reference levels that have not settled; the first bias frame of a CCD's series is off by 4 DN
    (SBIG STL-1001E).
    """

    name = "first_frame_offset"
    stage = Stage.READOUT
    unit_in = unit_out = DIGITAL_NUMBER
    where = "previous_frame"
    block = "first"
    trials = ({"offset_dn": 0.5}, {"offset_dn": -0.5})
    fitted = ("offset_dn",)
    settles = "ten dark frames of one setting in a row"
    offset_dn: float = parameter(0.0, "DN", -0.25, 0.25, source="tenths of a DN to some DN", of_full_scale=True)

    def mean(self, signal: Signal, context: ExposureContext) -> Signal:
        """Return DN with the offset: of one frame if it is the first, of a series' mean its share."""
        frames: Any = getattr(context, "frames", None)
        share = float(context.frame_index == 0) if frames is None else 1.0 / np.asarray(frames)
        return cast(Signal, (signal + self.offset_dn * share).astype(signal.dtype))

    def tile(self, after: TileMoments, before: TileMoments, context: ExposureContext) -> TileMoments:
        return after.changed(first_excess=before.first_excess + self.offset_dn)

    @classmethod
    def usable(cls, context: ExposureContext) -> bool:
        return bool(np.max(np.asarray(getattr(context, "frames", 2.0))) > 1)
