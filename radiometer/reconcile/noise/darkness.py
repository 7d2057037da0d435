"""How far darkness differs from frame to frame: a black level that wanders, and a thermometer of coarse steps."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from radiometer.reconcile.chances import chi2_beyond
from radiometer.reconcile.measure.design import Array, Design
from radiometer.reconcile.measure.seen import CaptureStatistics

_FEWEST: Final = 1.0  # degrees of freedom of repeated dark frames that tell a wander
_CHANCE: Final = 1e-4
_MOST_SHARE: Final = 0.3  # of a pixel's own noise: a black level that differs by more is something to name


@dataclass(frozen=True, slots=True)
class Darkness:
    """What is not known of a frame's darkness beside the noise of its pixels.

    Attributes:
        black_dn: Standard deviation by which the black level wanders from frame to frame, in DN.
        drift_dn: Standard deviation of half a wave down the rows by which it moves while a frame is read, in DN.
        temperature_k: Standard uncertainty of a temperature reading, in K.
        warmth: (captures, tiles) change of the means in DN per kelvin.
        swelling: The same of ln of variances, by statistic: leaks that differ do so the more the warmer it is.
    """

    black_dn: float
    temperature_k: float
    warmth: Array
    swelling: Mapping[str, Array] = field(default_factory=dict)
    drift_dn: float = 0.0


def wander_of_black(design: Design, seen: CaptureStatistics) -> float:
    """Return by how many DN the black level wanders from one dark frame to the next; 0 where it need not.

    Frames of one setting tell it: what all tiles of a frame share beyond what pixels and rows give by chance. It is
    pooled over the dark captures, and no more than 0.3 of a pixel's own noise.

    Args:
        design: Captures.
        seen: What was measured.
    """
    return _wander("black", design, seen)


def drift_of_black(design: Design, seen: CaptureStatistics) -> float:
    """Return the standard deviation in DN of half a wave down the rows by which dark frames differ; 0 where none need.

    Rows are read one after the other: what wanders from frame to frame moves within one, too.

    Args:
        design: Captures.
        seen: What was measured.
    """
    return _wander("drift", design, seen)


def _wander(name: str, design: Design, seen: CaptureStatistics) -> float:
    shown, unit, dof = (getattr(seen, name + of) for of in ("", "_unit", "_dof"))
    told = design.closed & (dof > 0) & np.isfinite(shown)
    freedom = float(dof[told].sum())
    if freedom < _FEWEST:
        return 0.0
    rows = np.where(np.isfinite(seen.row_temporal), np.maximum(seen.row_temporal, 1.0), 1.0)
    chance = unit[told] * rows[told]
    weight = dof[told]
    if chi2_beyond(float(np.sum(weight * shown[told] / chance)), int(freedom)) > _CHANCE:
        return 0.0
    wander2 = float(np.sum(weight * (shown[told] - chance)) / freedom)
    noise2 = float(np.nanmedian(seen.variance[told]))
    return float(np.sqrt(np.clip(wander2, 0.0, _MOST_SHARE**2 * noise2)))
