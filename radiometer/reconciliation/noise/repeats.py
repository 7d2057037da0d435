"""Measures how equal frames differ: the offset or the light of each frame of a series relative to its others.

A frame's offset is seen in every tile, so what one frame shows is held out over the tiles of that frame. The scatter
of all frames of all series shows whether one of them is an outlier.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtr

from radiometer.reconciliation.measure.design import Design
from radiometer.reconciliation.result import FittedParameter, Repeats, Series
from radiometer.reconciliation.thresholds import FRAME_SIGNIFICANCE
from radiometer.statistics.scale import MAD_TO_SIGMA, MEDIAN_U
from radiometer.typing import Array

_OF_MEDIAN: Final = MEDIAN_U * MAD_TO_SIGMA  # standard error of a median of normal values, from their median deviation
_FEWEST_TILES: Final = 4  # whose median deviation gives their scatter within a factor of two
_FEWEST: Final = 2  # degrees of freedom that tell a scatter
_ROUNDS: Final = 4  # by which the weights of series settle
_LIT_DN: Final = 1.0  # per unit of ln light, below which nothing is reported of light

Tiles = Callable[[tuple[int, ...]], Array]


def repeats_of(
    design: Design,
    tiles_of: Tiles,
    usable: NDArray[np.bool_],
    sensitivity: Array,
    first: Array,
    wander: Sequence[float],
) -> tuple[Repeats, ...]:
    """Return what frames of one setting differ by: dark ones in DN, lit ones relative to their light.

    Args:
        tiles_of: Gives the mean of each tile in frames at positions of the header, (frames, tiles) in DN.
        usable: (captures, tiles) which means count.
        sensitivity: (captures, tiles) d(mean)/d(log light) in DN.
        first: (captures, tiles) what the model has a first frame above the others by, in DN: it is taken off.
        wander: What the weights of the model hold of it, of dark frames in DN and of lit ones relative.
    """
    dark = design.closed | ~(design.source_level > 0)
    found = []
    for kind, unit, chosen, aside in zip(("dark", "lit"), ("DN", "1"), (dark, ~dark), wander, strict=True):
        series = []
        for number in np.flatnonzero(chosen).tolist():
            frames = design.captures[number].frames
            scale = np.ones(len(design.tiles)) if kind == "dark" else sensitivity[number]
            counts = usable[number] & (scale >= _LIT_DN)
            if len(frames) > 1 and np.count_nonzero(counts) >= _FEWEST_TILES:
                means = np.array(tiles_of(frames)[:, counts])
                means[0] -= first[number, counts]
                series.append(_series(design, number, means / scale[counts]))
        if sum(len(one.frames) - 1 for one in series) >= _FEWEST:
            found.append(_together(kind, unit, series, aside))
    return tuple(found)


def _series(design: Design, number: int, means: Array) -> Series:
    """Return each frame less the mean of the others of its capture, from (frames, tiles) in the unit to be reported."""
    n = means.shape[0]
    apart = (means - means.mean(axis=0)) * n / (n - 1.0)
    middle = np.median(apart, axis=1)
    u = _OF_MEDIAN * np.median(np.abs(apart - middle[:, None]), axis=1) / np.sqrt(apart.shape[1])
    warm = float(design.temperature_c[number])
    return Series(
        tuple(design.captures[number].frames),
        float(design.exposure_s[number]),
        warm if np.isfinite(warm) else None,
        tuple(middle.tolist()),
        tuple(u.tolist()),
    )


def _together(kind: str, unit: str, series: Sequence[Series], aside: float) -> Repeats:
    """Return series of one kind with what they scatter by beyond their tiles' chance, and the frames that stick out."""
    own = np.array([len(one.frames) - 1.0 for one in series])
    seen, chance = (np.array([of(one) for one in series]) for of in (_square, _chance2))
    scatter2 = 0.0
    for _ in range(_ROUNDS):
        weight = own / np.maximum(chance + scatter2, 1e-30) ** 2
        scatter2 = max(float(weight @ (seen / own - chance)) / float(weight.sum()), 0.0)
    spread = np.sqrt(2.0 * float(weight**2 @ ((chance + scatter2) ** 2 / own))) / float(weight.sum())
    u = spread / (2.0 * max(np.sqrt(scatter2), np.sqrt(spread / 2.0), 1e-30))
    scaled = [_scaled(one, np.sqrt(scatter2 + noise)) for one, noise in zip(series, chance, strict=True)]
    total = sum(_square(one) for one in scaled)
    out = [_standing_out(one, total, int(own.sum())) for one in scaled]
    shown = [replace(one, standing_out=at) for one, at in zip(series, out, strict=True)]
    return Repeats(kind, FittedParameter(float(np.sqrt(scatter2)), float(u), unit), aside, tuple(shown))


def _chance2(series: Series) -> float:
    """Return the variance that the tiles' chance gives a frame about the mean of its series."""
    n = len(series.frames)
    return float(np.mean(np.square(series.u))) * (n - 1.0) / n


def _scaled(series: Series, by: float) -> Series:
    return replace(series, apart=tuple(apart / max(by, 1e-30) for apart in series.apart))


def _square(series: Series) -> float:
    """Return the sum of squares of the frames' deviations from their mean."""
    n = len(series.frames)
    return float(np.sum(np.square(series.apart))) * ((n - 1.0) / n) ** 2


def _standing_out(series: Series, total: float, freedom: int) -> tuple[int, ...]:
    """Return the positions of frames that are farther off than the scatter of all others allows.

    A frame less the mean of the n − 1 others, over their scatter times √(n/(n − 1)), follows Student's t.

    Source: R. D. Cook, S. Weisberg (1982), Residuals and Influence in Regression, 2.2.1, externally studentised
    residuals; Bonferroni over the frames.
    """
    n, found = len(series.frames), []
    for position, apart in enumerate(series.apart):
        own = apart**2 * (n - 1.0) / n
        left = max(total - own, 1e-30) / max(freedom - 1, 1)
        t = abs(apart) / np.sqrt(left * n / (n - 1.0))
        if freedom > _FEWEST and 2.0 * float(stdtr(freedom - 1, -t)) * (freedom + 1) < FRAME_SIGNIFICANCE:
            found.append(position)
    return tuple(found)
