"""The digital numbers at which a camera is black or saturated, read off the frames themselves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from radiometer.data.bracket import Bracket
from radiometer.errors import MeasurementError

# A clipping level gathers whatever lies beyond it: its count stands out from its neighbours by this factor.
_PILE_UP = 8.0


@dataclass(frozen=True, slots=True)
class ValueLimits:
    """Digital numbers that carry no information.

    Attributes:
        black_dn: Values at or below are black (clipped, or the black level itself).
        saturated_dn: Values at or above are saturated.
    """

    black_dn: int
    saturated_dn: int


def find_limits(brackets: Sequence[Bracket]) -> ValueLimits:
    """Return the black and saturation level of brackets taken with one camera.

    Saturation is full scale, or lower where the highest value that occurs gathers far more pixels than those just
    below it (a sensor or film that saturates before the converter does). Black is 0, the stated black level, or
    the lowest value in the same way.

    Raises:
        MeasurementError: If every value of every frame is clipped.
    """
    full_scale = (1 << brackets[0].bit_depth) - 1
    histogram = np.zeros(full_scale + 1, dtype=np.int64)
    for bracket in brackets:
        for frame in bracket:
            histogram += np.bincount(frame.dn.ravel(), minlength=full_scale + 1)[: full_scale + 1]
    stated = [f.settings.black_level_dn for b in brackets for f in b if f.settings.black_level_dn]
    black = max(_floor(histogram), int(np.ceil(max(stated))) if stated else 0)
    saturated = _ceiling(histogram)
    if saturated - black < 4 or histogram[black + 1 : saturated].sum() == 0:
        raise MeasurementError(_all_clipped(histogram, full_scale))
    return ValueLimits(black, saturated)


def _ceiling(histogram: NDArray[np.int64]) -> int:
    top = int(np.flatnonzero(histogram)[-1])
    neighbours = histogram[max(top - 8, 0) : top]
    piled = neighbours.size > 0 and histogram[top] > _PILE_UP * max(float(neighbours.mean()), 1.0)
    return top if piled else histogram.size - 1


def _floor(histogram: NDArray[np.int64]) -> int:
    bottom = int(np.flatnonzero(histogram)[0])
    neighbours = histogram[bottom + 1 : bottom + 9]
    piled = neighbours.size > 0 and histogram[bottom] > _PILE_UP * max(float(neighbours.mean()), 1.0)
    return bottom if piled else 0


def _all_clipped(histogram: NDArray[np.int64], full_scale: int) -> str:
    total = max(int(histogram.sum()), 1)
    white, black = 100.0 * histogram[full_scale] / total, 100.0 * histogram[0] / total
    cure = "shorter" if white >= black else "longer"
    return (
        f"all frames are clipped ({white:.0f} % of the values saturated, {black:.0f} % black); take {cure} exposures "
        "so that the scene shows between black and white"
    )
