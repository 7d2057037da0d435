"""How far darkness differs from frame to frame: a black level that wanders, and a thermometer of coarse steps."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from radiometer.reconcile.chances import Mask, chi2_beyond
from radiometer.reconcile.measure.design import Array, Design
from radiometer.reconcile.measure.seen import CaptureStatistics
from radiometer.reconcile.noise.shared_errors import Part, SharedError, tilts_of_rows

_FEWEST: Final = 1.0  # degrees of freedom of repeated dark frames that tell a wander
_CHANCE: Final = 1e-4
_HALF_WAVES: Final = 12  # of a black level that moves within a frame: three to each of four tiles
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


def errors_of_darkness(design: Design, usable: Mapping[str, Mask], darkness: Darkness) -> tuple[SharedError, ...]:
    """Return what a wandering black level and a coarse thermometer do to a capture's means, first frame and variances.

    Repeated frames do not average it out: they follow one another, and the black level has its way from one series to
    the next.

    Args:
        design: Captures and tiles.
        usable: Which entries of each statistic count.
        darkness: How far darkness differs.
    """
    first = 1.0 + 1.0 / np.maximum(design.frame_count - 1.0, 1.0)
    every, one = np.ones(len(design.captures)), np.ones((len(design.tiles), 1))
    found = []
    for name, amplitude, u in (
        ("black level of a capture", np.ones_like(darkness.warmth), darkness.black_dn),
        ("temperature of a capture", darkness.warmth, darkness.temperature_k),
    ):
        if u > 0:
            found += [
                SharedError(name, {"mean": Part(np.where(usable["mean"], amplitude, 0.0), one)}, u**2 * every),
                SharedError(name, {"first": Part(np.where(usable["first"], amplitude, 0.0), one)}, u**2 * first),
            ]
    if darkness.drift_dn > 0:
        found += _drift(design, usable, darkness.drift_dn, first)
    for statistic, swelling in darkness.swelling.items() if darkness.temperature_k > 0 else ():
        part = Part(np.where(usable[statistic], swelling, 0.0), one)
        found.append(SharedError("temperature of a capture", {statistic: part}, darkness.temperature_k**2 * every))
    return tuple(found)


def _drift(design: Design, usable: Mapping[str, Mask], drift_dn: float, first: Array) -> list[SharedError]:
    """Return a black level that moves while the rows are read, as a random walk does: k half waves have 1/k of one.

    Its steps in one frame are independent of those in another, so that repeats average them out.

    Source: the expansion of Brownian motion in cosines, K. Karhunen (1947), whose variances go as 1/k².
    """
    waves = np.arange(1, _HALF_WAVES + 1)
    shapes = np.cos(np.pi * (np.arange(design.shape[0])[:, None] + 0.5) / design.shape[0] * waves)
    variance = np.square(drift_dn / waves)
    parts = {"mean": design.rows_of_tiles @ shapes, "slope_y": tilts_of_rows(design) @ shapes}
    of_mean = 1.0 / design.frame_count
    bases = (("mean", parts["mean"], of_mean), ("first", parts["mean"], first), ("slope_y", parts["slope_y"], of_mean))
    return [
        SharedError(
            "black level within a frame", {n: Part(usable[n].astype(np.float64), basis)}, each[:, None] * variance
        )
        for n, basis, each in bases
    ]
