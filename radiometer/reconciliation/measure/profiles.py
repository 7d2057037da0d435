"""Row and column patterns: how much the means of rows and columns scatter beyond what single pixels explain."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from radiometer.reconciliation.measure.layout import TileGroup
from radiometer.typing import Array, Mask

_TREND_TERMS_PER_AXIS = 3  # constant, slope and curvature of each tile are taken out of its profile


def row_temporal_profile(
    groups: Sequence[TileGroup], row_sums: Sequence[Sequence[Array]], variance: Array, counting: Sequence[Mask]
) -> dict[str, float]:
    """Return how much row means scatter from frame to frame, over what the pixels' own noise gives.

    Each tile's frame mean is taken out beforehand, so that flicker does not enter; that takes one degree of freedom
    per tile and frame.

    Args:
        groups: Groups of tiles.
        row_sums: Per group and frame, the sums of deviations along each tile row, shape (tiles, height).
        variance: (tiles,) temporal variance of a pixel in DN².
        counting: Per group, the pixels that the sums hold, shape (tiles, height, width).
    """
    frames = len(row_sums[0])
    if frames < 2:
        return {"row_temporal": np.nan, "row_temporal_weight": 0.0, "row_temporal_dof": 0.0}
    pieces = []
    for group, sums, good in zip(groups, row_sums, counting, strict=True):
        stack = np.array(sums)
        stack = (stack - stack.mean(axis=0)).transpose(1, 2, 0)
        pieces.append((group.rows, stack, good.sum(axis=2), variance[group.index], 1))
    ratio, weight, dof = _profile(pieces)
    return _named("row_temporal", (ratio * frames / (frames - 1), weight, dof), frames - 1)


def fixed_profile(
    groups: Sequence[TileGroup], residuals: Sequence[Array], spatial: Array, counting: Sequence[Mask]
) -> dict[str, float]:
    """Return how much the time mean's columns and rows scatter, over what a white pixel pattern gives.

    Args:
        groups: Groups of tiles.
        residuals: Per group, the time mean minus its quadratic surface, shape (tiles, height, width).
        spatial: (tiles,) variance of the time mean from pixel to pixel in DN².
        counting: Per group, the pixels that count, same shape; residuals are 0 elsewhere.
    """
    columns: list[_Piece] = []
    rows: list[_Piece] = []
    for group, residual, good in zip(groups, residuals, counting, strict=True):
        for found, lines, across in ((columns, group.columns, 1), (rows, group.rows, 2)):
            sums, pixels = residual.sum(axis=across)[..., None], good.sum(axis=across)
            found.append((lines, sums, pixels, spatial[group.index], _TREND_TERMS_PER_AXIS))
    return _named("columns", _profile(columns), 1) | _named("rows", _profile(rows), 1)


_Piece = tuple[NDArray[np.intp], Array, NDArray[np.intp], Array, int]


def _profile(pieces: Sequence[_Piece]) -> tuple[float, float, float]:
    """Return (excess ratio, mean weight in DN⁻², degrees of freedom per repeat) of line means.

    Each piece: sensor line of every tile line (tiles, lines), line sums (tiles, lines, repeats), pixels in each line
    (tiles, lines), variance of a pixel (tiles,), degrees of freedom that the tile's trend took.
    """
    length = 1 + max(int(lines.max()) for lines, *_ in pieces)
    repeats = pieces[0][1].shape[2]
    weighted, weight, freedom = np.zeros((length, repeats)), np.zeros(length), np.zeros(length)
    for lines, sums, pixels, variance, taken in pieces:
        usable = np.isfinite(variance) & (variance > 0)
        inverse = np.where(usable, 1.0 / np.where(usable, variance, 1.0), 0.0)
        share = pixels * inverse[:, None]
        np.add.at(weighted, lines.ravel(), (sums * inverse[:, None, None]).reshape(-1, repeats))
        np.add.at(weight, lines.ravel(), share.ravel())
        np.add.at(freedom, lines.ravel(), (share * (1.0 - taken / lines.shape[1])).ravel())
    seen = weight > 0
    if not seen.any():
        return np.nan, 0.0, 0.0
    dof = float(np.sum(freedom[seen] / weight[seen]))
    excess = float(np.sum(weighted[seen] ** 2 / weight[seen][:, None]) / repeats)
    return excess / dof if dof > 0 else np.nan, float(np.mean(weight[seen])), dof


def _named(name: str, profile: tuple[float, float, float], repeats: int) -> dict[str, float]:
    ratio, weight, dof = profile
    return {name: ratio, f"{name}_weight": weight, f"{name}_dof": dof * repeats}
