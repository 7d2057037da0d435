"""Models the errors that a capture's figures share in the dark: a wandering black level, a coarse thermometer."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np

from radiometer.reconciliation.measure.design import Design
from radiometer.reconciliation.noise.darkness import Darkness
from radiometer.reconciliation.noise.shared import Part, SharedError
from radiometer.typing import Array, Mask

_HALF_WAVES: Final = 12  # of a black level that moves within a frame: three to each of four tiles


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
    parts = {"mean": design.rows_of_tiles @ shapes, "slope_y": design.tilts_of_rows @ shapes}
    of_mean = 1.0 / design.frame_count
    bases = (("mean", parts["mean"], of_mean), ("first", parts["mean"], first), ("slope_y", parts["slope_y"], of_mean))
    return [
        SharedError(
            "black level within a frame", {n: Part(usable[n].astype(np.float64), basis)}, each[:, None] * variance
        )
        for n, basis, each in bases
    ]
