"""The indices that look at a picture: uniformity, edge and smear."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radiometer.analysis.quality.indices import Figure
from radiometer.analysis.quality.signals import Deviation
from radiometer.data import Patch
from radiometer.data.radiance_map import PixelMask, RadianceMap
from radiometer.errors import MeasurementError
from radiometer.statistics.scale import jackknife_u, robust_sigma

_TILES: Final = 10
_BIN_PX: Final = 0.25  # ISO 12233: four bins a pixel
_BLOCKS: Final = 8
_PLATEAU_SHARE: Final = 0.2  # of the distance to the farthest pixel at either side
_SOURCE_HEIGHT: Final = 0.1  # of the picture: what smear is stated for
_UNUSABLE: Final = PixelMask.SATURATED | PixelMask.DEFECTIVE


def uniformity(radiance: RadianceMap) -> Figure:
    """Return 1 − min/max over the means of 10 × 10 tiles of an even source.

    Extremes of noisy means differ even where the truth is even. So the tiles are chosen by one half of their pixels
    (as on a chequerboard) and compared by the other half.
    """
    black, white = _tile_means(radiance)
    value, u = _contrast(black, white)
    means = 0.5 * (black[0] + white[0])
    noise = 0.5 * float(np.sqrt(np.mean((black[1] / means) ** 2 + (white[1] / means) ** 2)))
    scatter = math.sqrt(max(float(np.var(means) / np.mean(means) ** 2) - noise**2, 0.0))
    row, column = divmod(int(np.argmin(means)), _TILES)
    details = (Deviation("standard deviation of the tiles", scatter, noise),)
    remarks = (f"dimmest tile: row {row + 1}, column {column + 1} of {_TILES} × {_TILES}",)
    return Figure(max(value, 0.0), u, details=details, remarks=remarks)


Tiles = tuple[NDArray[np.float64], NDArray[np.float64]]


def _contrast(chosen: Tiles, read: Tiles) -> tuple[float, float]:
    """Return 1 − min/max and its u from means, u of `read` at the extreme places of `chosen`."""
    low, high = int(np.argmin(chosen[0])), int(np.argmax(chosen[0]))
    means, u = read
    ratio = float(means[low] / means[high])
    return 1.0 - ratio, ratio * math.hypot(u[low] / means[low], u[high] / means[high])


def _tile_means(radiance: RadianceMap) -> tuple[Tiles, Tiles]:
    """Return means and their u of every tile, from the black and from the white fields of a chequerboard.

    The u is that of the pixels' noise, or of what next but one pixels differ by where it is more: pixels that differ
    in responsivity differ in each half otherwise.
    """
    good = (radiance.mask & _UNUSABLE) == 0
    white = np.add.outer(np.arange(radiance.shape[0]), np.arange(radiance.shape[1])) % 2 == 1
    halves: list[Tiles] = []
    for half in (good & ~white, good & white):
        means, errors = [], []
        for rows in np.array_split(np.arange(radiance.shape[0]), _TILES):
            for columns in np.array_split(np.arange(radiance.shape[1]), _TILES):
                cut = np.ix_(rows, columns)
                used = half[cut]
                if used.mean() < 0.25:
                    raise MeasurementError("a tenth of the picture clips; take shorter exposures of the even source")
                values = radiance.radiance[cut].astype(np.float64)
                noise = float(np.square(radiance.parts_of_u(cut)[0][used]).mean())
                apart = (values[:, 2:] - values[:, :-2])[used[:, 2:] & used[:, :-2]]
                variance = max(noise, float(np.square(apart).mean()) / 2.0 if apart.size else 0.0)
                means.append(float(values[used].mean()))
                errors.append(math.sqrt(variance / float(used.sum())))
        halves.append((np.array(means), np.array(errors)))
    return halves[0], halves[1]


def edge_width(radiance: RadianceMap, patch: Patch) -> Figure:
    """Return the distance in pixels over which the edge in a patch rises from 10 to 90 %, and where it is at rest.

    The edge is found as the straight line through the largest gradients; all pixels are binned by their distance from
    it. u is the jackknife's over eight blocks along the edge.

    Source: ISO 12233, edge-based spatial frequency response, for the binning by distance.

    Raises:
        MeasurementError: If there is no edge in the patch, or it clips.
    """
    cut = radiance.radiance[patch.slices].astype(np.float64)
    if np.any(radiance.mask[patch.slices] & PixelMask.SATURATED):
        raise MeasurementError("the bright side of the edge clips; take shorter exposures")
    across = cut if bool(np.ptp(cut.mean(axis=0)) >= np.ptp(cut.mean(axis=1))) else cut.T
    distance, along = _from_edge(across)
    whole = _rise(distance, across)
    blocks = np.array_split(np.arange(across.shape[0]), _BLOCKS)
    widths = [
        _rise(np.delete(distance, block, axis=0), np.delete(across, block, axis=0))[0] for block in blocks if block.size
    ]
    u = float(jackknife_u(widths))
    rest = Deviation("px from the edge to within 1 % of the step", whole[1], _BIN_PX)
    return Figure(
        whole[0],
        u,
        len(widths) - 1,
        "px",
        (rest,),
        (f"edge slanted by {math.degrees(math.atan(along)):.1f}° to the pixels",),
    )


def _from_edge(across: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
    """Return every pixel's distance from the edge (bright side above 0), and the edge's slope."""
    gradient = np.diff(across, axis=1)
    rising = 1.0 if gradient.sum() >= 0 else -1.0
    weight = np.square(np.maximum(rising * gradient, 0.0))
    step = abs(float(np.median(across[:, -3:]) - np.median(across[:, :3])))
    scatter = robust_sigma(gradient, 0.0)
    if step <= 5.0 * scatter or weight.sum() <= 0.0:
        raise MeasurementError("there is no clear edge in the patch; it must hold one between dark and bright")
    place = np.arange(weight.shape[1]) + 0.5
    centres = weight @ place / np.maximum(weight.sum(axis=1), 1e-300)
    rows = np.arange(across.shape[0])
    slope, offset = np.polyfit(rows, centres, 1)
    columns = np.arange(across.shape[1])
    away = (columns[np.newaxis, :] - (slope * rows + offset)[:, np.newaxis]) / math.hypot(1.0, slope)
    return rising * away, float(slope)


def _rise(distance: NDArray[np.float64], across: NDArray[np.float64]) -> tuple[float, float]:
    """Return (10 to 90 % distance, distance beyond which the profile stays within 1 % of the step)."""
    index = np.floor(distance.ravel() / _BIN_PX).astype(int)
    index -= index.min()
    count = np.bincount(index)
    filled = count > 0
    profile = np.bincount(index, across.ravel())[filled] / count[filled]
    where = np.bincount(index, distance.ravel())[filled] / count[filled]
    reach = _PLATEAU_SHARE * min(-where[0], where[-1])
    dark = float(profile[where < where[0] + reach].mean())
    bright = float(profile[where > where[-1] - reach].mean())
    share = (profile - dark) / (bright - dark)
    rising = np.maximum.accumulate(share)
    low, high = (float(np.interp(level, rising, where)) for level in (0.1, 0.9))
    off = np.abs(share - (where > 0.5 * (low + high)))
    unrest = np.abs(where[off > 0.01])
    return high - low, float(unrest.max()) if unrest.size else 0.0


def smear(frames: RadianceMap, patch: Patch) -> Figure:
    """Return what the columns of a bright source show beyond their neighbours, over the source, per tenth of height.

    Args:
        frames: Merged from exposures that show the source unclipped and others that show its surround.

    Raises:
        MeasurementError: If the source reaches the picture's edges, or clips in all frames.
    """
    values = frames.radiance.astype(np.float64)
    height, width = frames.shape
    if np.any(frames.mask[patch.slices] & PixelMask.SATURATED):
        raise MeasurementError("the source clips even in the shortest exposure; take shorter ones")
    margin = max(4, patch.height // 2)
    rows = np.r_[0 : max(patch.y - margin, 0), min(patch.y + patch.height + margin, height) : height]
    source = _source_columns(values[patch.slices])
    columns = patch.x + source
    gap = max(4, patch.width // 2)
    neighbours = np.r_[
        max(patch.x - gap - patch.width, 0) : max(patch.x - gap, 0),
        min(patch.x + patch.width + gap, width) : min(patch.x + 2 * patch.width + gap, width),
    ]
    if rows.size < 8 or neighbours.size < 4:
        raise MeasurementError(
            "the patch leaves no rows above and below it, or no columns left and right of it; make it smaller"
        )
    below = values[np.ix_(rows, columns)].mean(axis=1) - values[np.ix_(rows, neighbours)].mean(axis=1)
    lit = values[patch.y : patch.y + patch.height, columns]
    bright = lit > 0.5 * float(np.percentile(lit, 99.0))
    level = float(np.mean(lit[bright]))
    noise = frames.parts_of_u((slice(patch.y, patch.y + patch.height), columns))[0][bright]
    u_level_rel = float(np.sqrt(np.mean(noise**2) / noise.size)) / level
    tall = float(bright.sum(axis=0).mean()) / height
    factor = _SOURCE_HEIGHT / (tall * level)
    blocks = np.array([block.mean() for block in np.array_split(below, _BLOCKS)])
    u = float(np.std(blocks, ddof=1)) / math.sqrt(blocks.size)
    value = float(below.mean())
    remarks = (f"source of {100 * tall:.2g} % of the picture's height",)
    return Figure(value * factor, math.hypot(u, value * u_level_rel) * factor, blocks.size - 1, remarks=remarks)


def _source_columns(cut: NDArray[np.float64]) -> NDArray[np.intp]:
    """Return the columns of a patch that the source takes up in at least a row."""
    bright = cut > 0.5 * np.percentile(cut, 99.0)
    return np.flatnonzero(bright.any(axis=0))
