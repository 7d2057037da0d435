"""Estimates how darkness differs from frame to frame: a black level that wanders, a thermometer of coarse steps."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from radiometer.reconciliation.chances import chi2_beyond
from radiometer.reconciliation.measure.design import Design
from radiometer.reconciliation.measure.seen import CaptureStatistics
from radiometer.typing import Array

_FEWEST_OF_A_LINE: Final = 4  # tiles
_CLEAR_SLOPE: Final = 5.0  # standard uncertainties
_FEWEST: Final = 1.0  # degrees of freedom of repeated dark frames that tell a wander
_CHANCE: Final = 1e-4
_MOST_SHARE: Final = 0.3  # of a pixel's own noise: a black level that differs by more is something to name


@dataclass(frozen=True, slots=True)
class Darkness:
    """Uncertainty of a frame's darkness in addition to the noise of its pixels."""

    black_dn: float  # standard deviation by which the black level wanders from frame to frame, in DN
    temperature_k: float  # standard uncertainty of a temperature reading, in K
    warmth: Array  # (captures, tiles) change of the means in DN per kelvin
    # The same of ln of variances, by statistic: leaks that differ do so the more the warmer it is
    swelling: Mapping[str, Array] = field(default_factory=dict)
    # Standard deviation of half a wave down the rows by which it moves while a frame is read, in DN
    drift_dn: float = 0.0


def black_by_noise(design: Design, seen: CaptureStatistics) -> float | None:
    """Return the black level in DN at which the noise of light would end; None where other data determine it.

    Frames of one setting, none of them dark, do not separate an offset from light. It must be stated, or follow from
    exposures, levels or darks. The noise follows a line: σ² = K·(y − y₀) + what has no light. With nothing for the
    latter y₀ is as high as can be. Where noise does not rise with the light beyond chance, it is undetermined and set
    to 0.
    """
    alike = np.unique(np.column_stack([design.exposure_s, design.gain_db, design.source_level]), axis=0).shape[0] == 1
    dark = design.closed | ~(design.source_level > 0)
    if not alike or dark.any() or not np.isnan(design.black_level_dn).all():
        return None
    counts = np.isfinite(seen.variance) & (seen.variance_dof > 0) & (seen.high == 0) & (seen.low == 0)
    mean, variance, dof = (values[counts] for values in (seen.mean, seen.variance, seen.variance_dof))
    if mean.size < _FEWEST_OF_A_LINE or np.ptp(mean) <= 0:
        return 0.0
    root = np.sqrt(dof / 2.0) / variance
    basis = np.column_stack([mean - mean.mean(), np.ones(mean.size)]) * root[:, None]
    (slope, height), *_ = np.linalg.lstsq(basis, variance * root, rcond=None)
    u_slope = float(np.sqrt(np.linalg.inv(basis.T @ basis)[0, 0]))
    if slope < _CLEAR_SLOPE * u_slope:
        return 0.0
    return float(np.clip(mean.mean() - height / slope, 0.0, mean.min()))


def wander_of_black(design: Design, seen: CaptureStatistics) -> float:
    """Return by how many DN the black level wanders from one dark frame to the next; 0 where it need not.

    Frames of one setting show it: what all tiles of a frame share beyond what pixels and rows give by chance. It is
    pooled over the dark captures, and at most 0.3 of a pixel's own noise.
    """
    return _wander("black", design, seen)


def drift_of_black(design: Design, seen: CaptureStatistics) -> float:
    """Return the standard deviation in DN of half a wave down the rows by which dark frames differ; 0 where none need.

    Rows are read one after the other: what wanders from frame to frame moves within one, too.
    """
    return _wander("drift", design, seen)


def _wander(name: str, design: Design, seen: CaptureStatistics) -> float:
    shown, unit, dof = (getattr(seen, name + of) for of in ("", "_unit", "_dof"))
    informative = design.closed & (dof > 0) & np.isfinite(shown)
    freedom = float(dof[informative].sum())
    if freedom < _FEWEST:
        return 0.0
    rows = np.where(np.isfinite(seen.row_temporal), np.maximum(seen.row_temporal, 1.0), 1.0)
    chance = unit[informative] * rows[informative]
    weight = dof[informative]
    if chi2_beyond(float(np.sum(weight * shown[informative] / chance)), int(freedom)) > _CHANCE:
        return 0.0
    wander2 = float(np.sum(weight * (shown[informative] - chance)) / freedom)
    noise2 = float(np.nanmedian(seen.variance[informative]))
    return float(np.sqrt(np.clip(wander2, 0.0, _MOST_SHARE**2 * noise2)))
