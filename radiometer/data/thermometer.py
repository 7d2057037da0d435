"""Temperatures that are read in steps: how well each is known, and what a regulated sensor's readings come to."""

from __future__ import annotations

import itertools
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radiometer.data.capture_set import CaptureHeader

_FINEST_STEP_K: Final = 0.05  # finer steps are noise of the sensor, not its rounding
_WIDEST_STEP_K: Final = 0.75  # wider steps are changes of temperature; thermometers step by at most 0.5 K
_REPEATED: Final = 0.5  # share of frames that may have a unique reading before readings are no steps
_ALIKE_K: Final = 0.02  # by which two readings of one step differ
_IN_TURN: Final = 2  # changes between two readings: a drift makes one


def uncertainty_of_readings(temperatures_c: NDArray[np.float64]) -> float:
    """Return the standard uncertainty in K of temperature readings that come in steps; 0 where they do not.

    A regulated sensor shows two neighbouring readings in turn: their distance is the step, and the temperature is
    anywhere in it.

    Args:
        temperatures_c: Reading of each frame in °C; NaN where there is none.

    Source: JCGM 100:2008, 4.3.7, a rectangular distribution.
    """
    known = temperatures_c[np.isfinite(temperatures_c)]
    readings = np.unique(np.round(known, 3))
    if readings.size < 2 or readings.size > _REPEATED * known.size:
        return 0.0
    steps = np.diff(readings)
    steps = steps[(steps >= _FINEST_STEP_K) & (steps <= _WIDEST_STEP_K)]
    return float(np.median(steps)) / np.sqrt(12.0) if steps.size else 0.0


def readings_c(header: CaptureHeader) -> NDArray[np.float64]:
    """Return the temperature reading of each frame in °C; NaN where there is none."""
    return np.array([np.nan if e.temperature_C is None else e.temperature_C for e in header.frames], dtype=np.float64)


def regulated(header: CaptureHeader) -> CaptureHeader:
    """Return the header with one temperature for frames whose readings are two neighbouring steps in turn.

    A sensor at the border of two steps has one temperature, yet shows now the one reading and now the other. Used as
    read, each change of the reading would become one of the dark current. The mean of the readings replaces all of
    them. What changes once may be a drift, and stays as it is.
    """
    known = readings_c(header)
    step_k = uncertainty_of_readings(known) * np.sqrt(12.0)
    if step_k == 0.0:
        return header
    order = _in_order_of_time(header)
    levels = np.unique(np.round(known[np.isfinite(known)], 3))
    near = [bool(gap < 1.0 + _ALIKE_K and gap > 0.5) for gap in np.diff(levels) / step_k]
    for at, (low, high) in enumerate(itertools.pairwise(levels.tolist())):
        alone = near[at] and not any(near[max(at - 1, 0) : at] + near[at + 1 : at + 2])
        here = np.flatnonzero((known > low - _ALIKE_K) & (known < high + _ALIKE_K))
        shown = known[order][np.isin(order, here)]
        if alone and np.count_nonzero(np.abs(np.diff(shown)) > _ALIKE_K) >= _IN_TURN:
            known[here] = shown.mean()
    frames = zip(header.frames, known.tolist(), strict=True)
    return header.model_copy(
        update={
            "frames": tuple(
                e if e.temperature_C is None else e.model_copy(update={"temperature_C": t}) for e, t in frames
            )
        }
    )


def _in_order_of_time(header: CaptureHeader) -> NDArray[np.intp]:
    """Return the frames' positions in the order in which they were taken; as listed where times are missing."""
    stamps = [entry.timestamp_s for entry in header.frames]
    known = [stamp for stamp in stamps if stamp is not None]
    return np.argsort(known, kind="stable") if len(known) == len(stamps) else np.arange(len(stamps))
