"""How far darkness differs from frame to frame: a black level that wanders, and a thermometer of coarse steps."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from radiometer.reconcile.chances import chi2_beyond
from radiometer.reconcile.measure.design import Array, Design
from radiometer.reconcile.measure.seen import CaptureStatistics

_FEWEST: Final = 2.0  # degrees of freedom of repeated dark frames that tell a wander
_CHANCE: Final = 1e-4
_MOST_SHARE: Final = 0.3  # of a pixel's own noise: a black level that differs by more is something to name
_FINEST_STEP_K: Final = 0.05
_WIDEST_STEP_K: Final = 0.75
_REPEATED: Final = 0.5  # share of frames that may have a reading of their own before readings are no steps


@dataclass(frozen=True, slots=True)
class Darkness:
    """What is not known of a frame's darkness beside the noise of its pixels.

    Attributes:
        black_dn: Standard deviation by which the black level wanders from frame to frame, in DN.
        temperature_k: Standard uncertainty of a temperature reading, in K.
        warmth: (captures, tiles) change of the means in DN per kelvin.
        swelling: The same of ln of variances, by statistic: leaks that differ do so the more the warmer it is.
    """

    black_dn: float
    temperature_k: float
    warmth: Array
    swelling: Mapping[str, Array] = field(default_factory=dict)


def wander_of_black(design: Design, seen: CaptureStatistics) -> float:
    """Return by how many DN the black level wanders from one dark frame to the next; 0 where it need not.

    Frames of one setting tell it: what all tiles of a frame share beyond what pixels and rows give by chance. It is
    pooled over the dark captures, and no more than 0.3 of a pixel's own noise.

    Args:
        design: Captures.
        seen: What was measured.
    """
    told = design.closed & (seen.black_dof > 0) & np.isfinite(seen.black)
    freedom = float(seen.black_dof[told].sum())
    if freedom < _FEWEST:
        return 0.0
    rows = np.where(np.isfinite(seen.row_temporal), np.maximum(seen.row_temporal, 1.0), 1.0)
    chance = seen.black_unit[told] * rows[told]
    weight = seen.black_dof[told]
    if chi2_beyond(float(np.sum(weight * seen.black[told] / chance)), int(freedom)) > _CHANCE:
        return 0.0
    wander2 = float(np.sum(weight * (seen.black[told] - chance)) / freedom)
    noise2 = float(np.nanmedian(seen.variance[told]))
    return float(np.sqrt(np.clip(wander2, 0.0, _MOST_SHARE**2 * noise2)))


def uncertainty_of_readings(temperatures_c: Array) -> float:
    """Return the standard uncertainty in K of temperature readings that come in steps; 0 where they do not.

    A regulated sensor shows two neighbouring readings in turn: their distance is the step, and the temperature lies
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
