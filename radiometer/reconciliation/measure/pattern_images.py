"""The mean picture of each displayed pattern, from all its unclipped frames: what stray light is made of."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radiometer.data import Frame
from radiometer.reconciliation.measure.design import Design
from radiometer.reconciliation.measure.kernels import coarse_cells
from radiometer.typing import Array
from radiometer.units import gain_factor

_COARSE_CELLS: Final = 192  # longer side of the coarse picture; stray light is smooth on that scale


@dataclass(slots=True, eq=False)
class PatternImages:
    """Coarse mean pictures, in DN above black per unit of t·G·level/N².

    Attributes:
        cell_px: Edge of a coarse cell in pixels.
        total: Sum of unclipped signals, shape (patterns, rows, columns).
        weight: Sum of t·G·level/N² over the same samples.
        scale: (captures,) t·G·level/N² of each capture.
        pattern: (captures,) pattern of each capture.
        black_dn: (captures,) black level of each capture.
    """

    cell_px: int
    total: Array
    weight: Array
    scale: Array
    pattern: Array
    black_dn: Array

    @classmethod
    def empty(cls, design: Design) -> PatternImages:
        """Return pictures without any frame yet."""
        cell = max(1, -(-max(design.shape) // _COARSE_CELLS))
        shape = (len(design.patterns), design.shape[0] // cell, design.shape[1] // cell)
        gain = np.array([gain_factor(g) for g in design.gain_db])
        scale = design.exposure_s * gain * design.source_level / design.f_number**2
        black = np.nan_to_num(design.black_level_dn)
        return cls(cell, np.zeros(shape), np.zeros(shape), scale, design.pattern_index.astype(np.float64), black)

    def add(self, frame: Frame, capture: int) -> None:
        """Add a frame of a capture; frames without light are left out, clipped cells too."""
        scale = float(self.scale[capture])
        if scale <= 0:
            return
        coarse, clipped = _coarse(frame, self.cell_px, self.total.shape[1:])
        usable = ~clipped
        pattern = int(self.pattern[capture])
        self.total[pattern] += np.where(usable, coarse - self.black_dn[capture], 0.0)
        self.weight[pattern] += np.where(usable, scale, 0.0)

    def picture(self, pattern: int) -> Array:
        """Return the picture of a pattern, shape (rows, columns); cells never seen unclipped take the largest seen."""
        seen = self.weight[pattern] > 0
        values = np.divide(self.total[pattern], self.weight[pattern], where=seen, out=np.zeros(seen.shape))
        return np.asarray(np.where(seen, values, values.max(initial=0.0)))


def _coarse(frame: Frame, cell: int, shape: tuple[int, ...]) -> tuple[Array, NDArray[np.bool_]]:
    """Return the mean of each coarse cell in DN, and whether one of its pixels is clipped."""
    mean, largest = coarse_cells(frame.dn, cell, *shape)
    return mean, largest >= frame.saturated_dn
