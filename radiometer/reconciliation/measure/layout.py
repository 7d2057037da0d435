"""Places of the pixels of the tiles, arranged so that all tiles of one size are treated at once."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radiometer.reconciliation.measure.design import Design, Tile
from radiometer.typing import Array

SHORTEST_PART_PX: Final = 4  # of a line, below which nothing tells whether it is even
LINES: Final = 7  # from one line inside a patch's stated border to five lines outside it


@dataclass(frozen=True, slots=True, eq=False)
class TileGroup:
    """All tiles of one size.

    Attributes:
        index: Their positions in the design.
        tiles: The tiles.
        height: Height of each in pixels.
        width: Width of each in pixels.
        trend: Orthonormal basis of the smooth shapes 1, u, v, u², uv, v² in a tile, shape (height × width, 6).
        slope_norm: Length of u and v over the tile; a coefficient divided by it is the rise from centre to edge.
        rows: Sensor row of each tile row, shape (tiles, height).
        columns: Sensor column of each tile column, shape (tiles, width).
    """

    index: NDArray[np.intp]
    tiles: tuple[Tile, ...]
    height: int
    width: int
    trend: Array
    slope_norm: tuple[float, float]
    rows: NDArray[np.intp]
    columns: NDArray[np.intp]

    def cut(self, image: NDArray[np.generic]) -> Array:
        """Return the tiles' pixels, shape (tiles, height, width), as float64."""
        return np.stack([image[tile.slices] for tile in self.tiles]).astype(np.float64)


def tile_groups(design: Design) -> tuple[TileGroup, ...]:
    """Return the tiles of a design, gathered by size."""
    sizes = dict.fromkeys((tile.height, tile.width) for tile in design.tiles)
    return tuple(_group(design.tiles, height, width) for height, width in sizes)


def slope_lengths(design: Design) -> tuple[Array, Array]:
    """Return the length of the tilts over each tile: a coefficient divided by it is the rise from centre to edge.

    The squares of the centres of n equal cells of −1 … 1 sum to (n² − 1)/(3n).
    """
    width, height = design.tile_width, design.tile_height
    across, down = ((n**2 - 1.0) / (3.0 * n) for n in (width, height))
    return np.sqrt(height * across), np.sqrt(width * down)


def _group(tiles: Sequence[Tile], height: int, width: int) -> TileGroup:
    index = [i for i, tile in enumerate(tiles) if (tile.height, tile.width) == (height, width)]
    chosen = tuple(tiles[i] for i in index)
    v, u = np.meshgrid(_centred(height), _centred(width), indexing="ij")
    shapes = np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], axis=-1).reshape(height * width, 6)
    trend, _ = np.linalg.qr(shapes)
    trend *= np.sign(np.sum(trend * shapes, axis=0))
    return TileGroup(
        np.array(index, dtype=np.intp),
        chosen,
        height,
        width,
        trend,
        (float(np.linalg.norm(u)), float(np.linalg.norm(v))),
        np.array([np.arange(tile.y, tile.y + height) for tile in chosen]),
        np.array([np.arange(tile.x, tile.x + width) for tile in chosen]),
    )


def _centred(count: int) -> Array:
    """Return positions −1 … 1 of `count` equal cells' centres."""
    return (2.0 * np.arange(count) + 1.0) / count - 1.0


@dataclass(frozen=True, slots=True, eq=False)
class PatchSides:
    """The sides of all patches as lines of pixels, from just inside the patch outwards.

    Attributes:
        tile: Tile of each side.
        rows: Sensor row of every pixel, shape (sides, lines, pixels).
        columns: Sensor column of every pixel, same shape.
    """

    tile: NDArray[np.intp]
    rows: NDArray[np.intp]
    columns: NDArray[np.intp]

    def pixels(self, image: NDArray[np.generic]) -> Array:
        """Return the pixels of every line, (sides, lines, pixels), as float64."""
        return image[self.rows, self.columns].astype(np.float64)

    @property
    def parts(self) -> tuple[slice, ...]:
        """Return the parts of a side that are judged apart: the whole, and its thirds where these are long enough."""
        length = self.rows.shape[2]
        ends = [round(length * i / 3) for i in range(4)] if length >= 3 * SHORTEST_PART_PX else []
        return (slice(0, length), *(slice(a, b) for a, b in itertools.pairwise(ends)))

    @property
    def along_rows(self) -> NDArray[np.bool_]:
        """Return for each side whether its lines run along rows, so that what crosses it goes down the columns."""
        return np.asarray(self.rows[:, 0, 0] == self.rows[:, 0, -1])

    def lines(self, pixels: Array) -> tuple[Array, Array]:
        """Return the mean of every line and the variance along it, for all parts of all sides.

        Args:
            pixels: (sides, lines, pixels) mean of each pixel over the frames of a capture, in DN.

        Returns:
            Means in DN and variances in DN², (parts × sides, lines), the whole sides first.
        """
        cut = [pixels[:, :, part] for part in self.parts]
        return np.concatenate([p.mean(axis=2) for p in cut]), np.concatenate([_unevenness(p) for p in cut])


def _unevenness(pixels: Array) -> Array:
    """Return the variance of pixels along the last axis; 0 where they are too few."""
    if pixels.shape[-1] < SHORTEST_PART_PX:
        return np.zeros(pixels.shape[:-1])
    return np.asarray(pixels.var(axis=-1, ddof=1))


def patch_sides(design: Design) -> PatchSides:
    """Return the sides of all patches; none for cells of an unknown scene.

    Lines that would leave the frame repeat its border.
    """
    found = [side for number, tile in enumerate(design.tiles) if tile.margin for side in _sides(number, tile)]
    if not found:
        nothing = np.zeros((0, LINES, 1), dtype=np.intp)
        return PatchSides(np.zeros(0, dtype=np.intp), nothing, nothing)
    length = min(rows.shape[1] for _, rows, _ in found)
    height, width = design.shape
    return PatchSides(
        np.array([tile for tile, _, _ in found], dtype=np.intp),
        np.clip(np.stack([rows[:, :length] for _, rows, _ in found]), 0, height - 1),
        np.clip(np.stack([columns[:, :length] for _, _, columns in found]), 0, width - 1),
    )


def _sides(number: int, tile: Tile) -> list[tuple[int, NDArray[np.intp], NDArray[np.intp]]]:
    """Return (tile, rows, columns) of the lines along the four sides."""
    outwards = np.arange(-1, LINES - 1)[:, None]
    along_y = np.arange(tile.y, tile.y + tile.height)[None, :]
    along_x = np.arange(tile.x, tile.x + tile.width)[None, :]
    left, right = tile.x - tile.margin, tile.x + tile.width + tile.margin
    top, bottom = tile.y - tile.margin, tile.y + tile.height + tile.margin
    pairs = [
        np.broadcast_arrays(along_y, left - 1 - outwards),
        np.broadcast_arrays(along_y, right + outwards),
        np.broadcast_arrays(top - 1 - outwards, along_x),
        np.broadcast_arrays(bottom + outwards, along_x),
    ]
    return [(number, rows, columns) for rows, columns in pairs]
