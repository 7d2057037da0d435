"""Reduces frames to the statistics that are compared: one pass, three frames in memory at most."""

from __future__ import annotations

import itertools
import math
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, fields, replace
from typing import Any, Final

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from radiometer.compiled import compiled
from radiometer.data import Frame
from radiometer.errors import CaptureError
from radiometer.reconciliation.design import (
    COMB_PERIODS,
    SMALLEST_TILE_PX,
    SURFACE_LINES,
    SURFACE_TERMS,
    CaptureStatistics,
    Design,
    PatchSides,
    Tile,
    TileGroup,
    patch_sides,
    surface,
    tile_groups,
)
from radiometer.reconciliation.lines import RowBins, edge_shares, row_light
from radiometer.statistics.scale import MAD_TO_SIGMA, TWENTIETH_TO_SIGMA
from radiometer.typing import Array, Mask
from radiometer.units import gain_factor
from simulators.chain.unsteady_pixels import unsteady_from

Corners = NDArray[np.intp]
FrameReader = Callable[[int], Frame]
Progress = Callable[[int, int], None]


# The inner loops hold no lock, so that other threads read the next frames meanwhile.


@compiled
def add_tiles(
    dn: NDArray[Any],
    good: NDArray[np.bool_],
    top: Corners,
    left: Corners,
    nearly_full: float,
    comb_mad_dn: float,
    total: Array,
    square: Array,
    highest: Array,
    pair_x: Array,
    pair_y: Array,
    histogram: Array,
    occurring: NDArray[np.bool_],
) -> tuple[Array, Array, Array, Array]:
    """Add one frame to the sums of all tiles of one size.

    Args:
        dn: The frame in DN, (rows, columns).
        good: Pixels that count for a tile's mean, same shape.
        top: (tiles,) first row of each tile.
        left: (tiles,) first column of each tile.
        nearly_full: Digital number from which a sample counts as clipped.
        comb_mad_dn: Median absolute deviation above which a tile's histogram must be smooth, in DN.
        total: (tiles, height, width) sum of deviations from the tile's mean in DN; this frame is added.
        square: Same shape, sum of their squares; this frame is added.
        highest: Same shape, the highest of them; this frame is compared.
        pair_x: Same shape, sum of products with the left neighbour in DN²; this frame is added.
        pair_y: The same with the upper neighbour.
        histogram: Counts of digital numbers over smooth tiles, longer than the largest one; this frame is added.
        occurring: Digital numbers that occur in any tile, as long; this frame is added.

    Returns:
        (tiles,) mean in DN, share at 0, share clipped, and (tiles, height) sum of deviations along each row of the
        pixels that count.
    """
    tiles, height, width = total.shape
    mean, low, high = np.zeros(tiles), np.zeros(tiles), np.zeros(tiles)
    rows = np.zeros((tiles, height))
    counts = np.zeros(histogram.size, np.int64)
    for k in range(tiles):
        y0, x0 = top[k], left[k]
        light, number, dark, full = 0.0, 0, 0, 0
        smallest, largest = histogram.size, 0
        for i in range(height):
            for j in range(width):
                value = int(dn[y0 + i, x0 + j])
                counts[value] += 1
                smallest = min(smallest, value)
                largest = max(largest, value)
                dark += int(value <= 0)
                full += int(value >= nearly_full)
                if good[y0 + i, x0 + j]:
                    light += value
                    number += 1
        middle = light / number if number else np.nan
        mean[k], low[k], high[k] = middle, dark / (height * width), full / (height * width)
        for i in range(height):
            along = 0.0
            before = 0.0
            for j in range(width):
                deviation = dn[y0 + i, x0 + j] - middle
                total[k, i, j] += deviation
                square[k, i, j] += deviation * deviation
                highest[k, i, j] = max(highest[k, i, j], deviation)
                along += deviation * good[y0 + i, x0 + j]
                pair_x[k, i, j] += deviation * before
                before = deviation
            rows[k, i] = along
        for i in range(1, height):
            for j in range(width):
                pair_y[k, i, j] += (dn[y0 + i, x0 + j] - middle) * (dn[y0 + i - 1, x0 + j] - middle)
        smooth = dark == 0 and full == 0 and _within(counts, middle, comb_mad_dn) * 2 < height * width
        for code in range(smallest, largest + 1):
            if smooth:
                histogram[code] += counts[code]
            occurring[code] |= counts[code] > 0
            counts[code] = 0
    return mean, low, high, rows


@compiled
def _within(counts: NDArray[np.int64], middle: float, distance: float) -> int:
    first = max(int(np.ceil(middle - distance)), 0)
    last = min(int(np.floor(middle + distance)), counts.size - 1)
    return int(counts[first : last + 1].sum())


@compiled
def coarse_cells(dn: NDArray[Any], cell: int, rows: int, columns: int) -> tuple[Array, Array]:
    """Return the mean of each cell of `cell` × `cell` pixels in DN, and its largest value."""
    mean, largest = np.zeros((rows, columns)), np.zeros((rows, columns))
    for i in range(rows * cell):
        for j in range(columns * cell):
            value = int(dn[i, j])
            mean[i // cell, j // cell] += value
            if value > largest[i // cell, j // cell]:
                largest[i // cell, j // cell] = value
    return mean / (cell * cell), largest


def _row_temporal_profile(
    groups: Sequence[TileGroup], row_sums: Sequence[Sequence[Array]], variance: Array, counting: Sequence[Mask]
) -> dict[str, float]:
    """Return how much row means scatter from frame to frame, over what the pixels' own noise gives."""
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


def _fixed_profile(
    groups: Sequence[TileGroup], residuals: Sequence[Array], spatial: Array, counting: Sequence[Mask]
) -> dict[str, float]:
    """Return how much the time mean's columns and rows scatter, over what a white pixel pattern gives."""
    columns: list[_Piece] = []
    rows: list[_Piece] = []
    for group, residual, good in zip(groups, residuals, counting, strict=True):
        for found, lines, across in ((columns, group.columns, 1), (rows, group.rows, 2)):
            sums, pixels = residual.sum(axis=across)[..., None], good.sum(axis=across)
            found.append((lines, sums, pixels, spatial[group.index], SURFACE_LINES))
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


OUTLIER_SIGMAS: Final = 6.0  # one false alarm in 5·10⁸ pixels of Gaussian pattern
_NEARLY_FULL: Final = 0.98  # counts as clipped: the highest code in use may be a little below full scale
_LOPSIDED: Final = 2.0  # a twentieth of the pixels as many times farther below: light cut off, no defects
# Above this scatter (variance 15 DN²) an honest histogram shows no comb of period 5: exp(−2π²·15/25) = 7e-6. The
# median deviation gives it, for one hot pixel does not move that.
_SMOOTH_MAD_DN: Final = 15.0**0.5 / MAD_TO_SIGMA
_MOST_FOR_MEDIAN: Final = 4096  # samples that give a robust sigma to 2 %; more would cost time and change nothing
_HALF_WAVES: Final = 3  # down a frame, of a black level that moves while the rows are read
_LITTLE_CUT: Final = 0.05  # share of a tile's samples at an end of the codes that leaves its noise nearly normal
_CUT_OFF: Final = 1.0 / 3.0  # of a darker tile's noise, below which light is cut off: six sigmas of 36 pixels in pairs


@dataclass(slots=True, eq=False)
class CaptureSums:
    """Running sums over the frames of one capture."""

    groups: Sequence[TileGroup]  # tiles by size
    sides: PatchSides  # sides of the patches
    defects: Mask  # pixels that are left out
    frame_means: list[Array]  # per frame, (tiles,) mean of each tile's good pixels in DN
    total: list[Array]  # per group, sum of pixels minus their tile's mean, (tiles, height, width)
    square: list[Array]  # the same of squares
    highest: list[Array]  # the highest deviation of each pixel in any frame
    # Per group, sum of products of each pixel's deviation with its left neighbour's in DN², as `total`
    pair_x: list[Array]
    pair_y: list[Array]  # the same with its upper neighbour's
    row_sums: list[list[Array]]  # per group and frame, sums of deviations along each tile row
    low: Array  # (tiles,) sum of the shares of samples at 0 DN
    high: Array  # (tiles,) the same at full scale
    side_pixels: Array  # (sides, lines, pixels) sum of the pixels of the lines across each patch's side
    histogram: Array  # counts of digital numbers over the tiles whose histogram must be smooth
    occurring: Mask  # digital numbers that occur in any tile

    @classmethod
    def start(cls, groups: Sequence[TileGroup], sides: PatchSides, tiles: int, defects: Mask) -> CaptureSums:
        """Return sums without any frame."""
        zeros = [np.zeros((len(g.tiles), g.height, g.width)) for g in groups]
        return cls(
            groups,
            sides,
            defects,
            [],
            zeros,
            [np.zeros_like(z) for z in zeros],
            [np.full(z.shape, -np.inf, np.float32) for z in zeros],
            [np.zeros(z.shape, np.float32) for z in zeros],
            [np.zeros(z.shape, np.float32) for z in zeros],
            [[] for _ in groups],
            np.zeros(tiles),
            np.zeros(tiles),
            np.zeros(sides.rows.shape),
            np.zeros(0),
            np.zeros(0, dtype=np.bool_),
        )

    def add(self, frame: Frame) -> None:
        """Add a frame."""
        self._make_room(max(frame.full_scale_dn, int(frame.dn.max(initial=0))) + 1)
        good, nearly_full = ~self.defects, _NEARLY_FULL * frame.saturated_dn
        mean = np.empty(self.low.size)
        for number, group in enumerate(self.groups):
            index = group.index
            own = (sums[number] for sums in (self.total, self.square, self.highest, self.pair_x, self.pair_y))
            places = (group.rows[:, 0], group.columns[:, 0])
            mean[index], low, high, rows = add_tiles(
                frame.dn, good, *places, nearly_full, _SMOOTH_MAD_DN, *own, self.histogram, self.occurring
            )
            self.low[index] += low
            self.high[index] += high
            self.row_sums[number].append(rows)
        self.frame_means.append(mean)
        self.side_pixels += self.sides.pixels(frame.dn)

    def _make_room(self, codes: int) -> None:
        more = codes - self.histogram.size
        if more > 0:
            self.histogram = np.pad(self.histogram, (0, more))
            self.occurring = np.pad(self.occurring, (0, more))

    def without(self, first: CaptureSums) -> CaptureSums:
        """Return the sums over the frames but the first; histogram and highest stay those of all."""
        apart: dict[str, Any] = {
            name: [both - one for both, one in zip(getattr(self, name), getattr(first, name), strict=True)]
            for name in ("total", "square", "pair_x", "pair_y")
        }
        apart |= {name: getattr(self, name) - getattr(first, name) for name in ("low", "high", "side_pixels")}
        row_sums = [sums[1:] for sums in self.row_sums]
        return replace(self, frame_means=self.frame_means[1:], row_sums=row_sums, **apart)

    def finish(
        self, black_dn: float, bins: RowBins, *, structured: bool = False, dark: bool = False
    ) -> tuple[dict[str, Array | float], Mask]:
        """Return the statistics of the capture by name, and the map of its outlying and restless pixels.

        Args:
            black_dn: Stated black level in DN; NaN where unknown.
            structured: Whether the tiles show a scene rather than even light: nothing in them is outlying or unsteady.
            dark: Whether it is a dark capture, whose restless pixels leave its noise.
        """
        n, tiles = len(self.frame_means), self.low.size
        out = {name: np.full(tiles, np.nan) for name in _PER_TILE}
        outlying, restless = np.zeros((2, *self.defects.shape), dtype=np.bool_)
        unsteady = 0.0
        means = np.array(self.frame_means)
        codes = np.flatnonzero(self.occurring)
        spacing_dn = float(np.gcd.reduce(np.diff(codes))) if codes.size > 1 else 1.0
        residuals, counting = [], []
        for number, group in enumerate(self.groups):
            residual, good, switching = self._finish_group(
                number, group, means, np.inf if structured else spacing_dn, out, outlying, restless, dark=dark
            )
            unsteady += switching
            residuals.append(residual)
            counting.append(good)
        out["low"], out["high"] = self.low / n, self.high / n
        row_sums = self._without_flicker(means, counting, out, black_dn) if structured and n > 1 else self.row_sums
        result: dict[str, Array | float] = dict(out)
        result["outliers"] = float(outlying.sum())
        result["unsteady"] = unsteady
        free = _free(out)  # a clipped tile has hardly any noise and would outweigh all
        variance, spatial = (np.where(free, out[name], np.nan) for name in ("variance", "spatial"))
        known = [group.cut(~self.defects).astype(np.bool_) for group in self.groups]
        result |= _row_temporal_profile(self.groups, row_sums, variance, known)
        result |= _fixed_profile(self.groups, residuals, spatial, counting)
        result |= row_light(bins, self.groups, self.row_sums, known, means, variance, black_dn, structured=structured)
        result |= light_of_frames(means, out, black_dn)
        result |= _additive_fluctuation(means, out, self._half_waves())
        result["side_lines"], result["side_unevenness"] = self.sides.lines(self.side_pixels / n)
        result |= _comb(self.histogram)
        return result, outlying | restless

    def _restless(self, number: int, good: Array, n: int, spacing_dn: float) -> tuple[Mask, float]:
        """Return which pixels, defects or not, scatter far more than those of their tile that count.

        Second, how many of them do so without their highest frame, too: no cosmic ray.

        Where the noise hides below the spacing of the codes, one sample two codes off is no sign of that, nor is any
        where most are cut off.
        """
        far = np.zeros(good.shape, dtype=np.bool_)
        if n < 2:
            return far, 0.0
        index = self.groups[number].index
        whole = np.maximum(self.low, self.high)[index] < _LITTLE_CUT * n
        scatter = (self.square[number] - np.square(self.total[number]) / n) / (n - 1)
        for _ in range(2):  # the noisiest ones raise what the others are compared with
            calm = good * ~far
            variance = (scatter * calm).sum(axis=(1, 2)) / np.maximum(calm.sum(axis=(1, 2)), 1.0)
            limit = np.maximum(unsteady_from(n) * variance, 4.0 * spacing_dn**2 / n)
            far = scatter > np.where(whole, limit, np.inf)[:, None, None]
        if n < 3:
            return far, 0.0
        top = np.square(self.highest[number] - self.total[number] / n) * n / (n - 1)
        others = (scatter * (n - 1) - top) / (n - 2)
        limit = np.maximum(unsteady_from(n - 1) * variance, 4.0 * spacing_dn**2 / (n - 1))
        return far, float(np.sum(far & (others > limit[:, None, None])))

    def _half_waves(self) -> Array:
        """Return the mean over each tile of half waves down the frame, (tiles, waves): as many as tiles can resolve."""
        rows = np.zeros(self.low.size)
        for group in self.groups:
            rows[group.index] = group.rows[:, 0]
        waves = np.arange(1, min(_HALF_WAVES, np.unique(rows).size - 1) + 1)
        found = np.zeros((self.low.size, waves.size))
        for group in self.groups:
            down = np.pi * (group.rows[:, :, None] + 0.5) / self.defects.shape[0]
            found[group.index] = np.cos(down * waves).mean(axis=1)
        return found

    def _finish_group(
        self,
        number: int,
        group: TileGroup,
        means: Array,
        spacing_dn: float,
        out: dict[str, Array],
        outlying: Mask,
        restless: Mask,
        *,
        dark: bool,
    ) -> tuple[Array, Mask, float]:
        n = means.shape[0]
        good = group.cut(~self.defects)
        picture = self.total[number] / n
        outside = _outlying(picture, group, spacing_dn)
        good = good * ~outside  # known defects and what stands out here
        scattering, unsteady = self._restless(number, good, n, spacing_dn)
        for tile, spots, scattering_spots in zip(group.tiles, outside, scattering, strict=True):
            outlying[tile.slices] |= spots
            restless[tile.slices] |= scattering_spots
        pixels = good.sum(axis=(1, 2))
        shift = (picture * good).sum(axis=(1, 2)) / pixels
        flat = (picture - shift[:, None, None]) * good
        coefficients = flat.reshape(len(group.tiles), -1) @ group.trend
        residual = (flat.reshape(len(group.tiles), -1) - coefficients @ group.trend.T).reshape(flat.shape) * good
        index = group.index
        out["mean"][index] = means[:, index].mean(axis=0) + shift
        out["peak"][index] = means[:, index].mean(axis=0) + np.where(good > 0, picture, -np.inf).max(axis=(1, 2))
        out["pixels"][index] = pixels
        out["spatial_dof"][index] = pixels - SURFACE_TERMS
        out["spatial"][index] = np.sum(residual**2, axis=(1, 2)) / (pixels - SURFACE_TERMS)
        out["slope_x"][index] = coefficients[:, 1] / group.slope_norm[0]
        out["slope_y"][index] = coefficients[:, 2] / group.slope_norm[1]
        calm = good * ~scattering if dark else good
        out["variance_dof"][index] = (n - 1) * (calm.sum(axis=(1, 2)) - 1)
        if n > 1:
            self._temporal(number, group, calm, out, n)
        return np.asarray(residual), np.asarray(good), unsteady

    def _without_flicker(
        self, means: Array, counting: Sequence[Mask], out: dict[str, Array], black_dn: float
    ) -> list[list[Array]]:
        """Free the temporal statistics of what light that all of a frame shares does to a tile's structure."""
        n = means.shape[0]
        amplitude, information = _common_amplitude(means, out, black_dn)
        if information <= 0:
            return self.row_sums
        shaken = float(np.sum(amplitude**2)) - (n - 1) / information
        follows = (out["high"] == 0) & (out["low"] == 0)  # what is clipped does not
        freed = []
        for number, (group, good, sums) in enumerate(zip(self.groups, counting, self.row_sums, strict=True)):
            self._temporal(number, group, good, out, n, np.where(follows, shaken, 0.0)[group.index])
            structure = (self.total[number] / n * group.cut(~self.defects)).sum(axis=2)
            freed.append([rows - a * structure for rows, a in zip(sums, amplitude.tolist(), strict=True)])
        return freed

    def _temporal(
        self,
        number: int,
        group: TileGroup,
        good: Array | Mask,
        out: dict[str, Array],
        n: int,
        shaken: Array | None = None,
    ) -> None:
        """Work out the tiles' noise."""
        total, index = self.total[number], group.index
        steady = 1.0 if shaken is None else 1.0 + shaken / n
        scatter = (self.square[number] - total**2 / n * np.reshape(steady, (-1, 1, 1))) * good
        variance = np.maximum(scatter.sum(axis=(1, 2)), 0.0) / out["variance_dof"][index]
        out["variance"][index] = variance
        safe = np.where(variance > 0, variance, np.nan)
        known = np.asarray(good, dtype=np.bool_)
        for axis, pairs in (("neighbour_x", self.pair_x), ("neighbour_y", self.pair_y)):
            later, earlier = _NEIGHBOURS[axis]
            both = (known[later] & known[earlier]).astype(np.float64)
            products = np.einsum("kij,kij->k", pairs[number][later], both)
            covariance = products - np.einsum("kij,kij,kij->k", total[later], total[earlier], both) / n * steady
            count = np.maximum(both.sum(axis=(1, 2)), 1.0)
            out[axis][index] = covariance / ((n - 1) * count * safe) + 1.0 / out["pixels"][index]


_NEIGHBOURS: Final = {
    "neighbour_x": ((slice(None), slice(None), slice(1, None)), (slice(None), slice(None), slice(None, -1))),
    "neighbour_y": ((slice(None), slice(1, None)), (slice(None), slice(None, -1))),
}
_PER_TILE: Final = (
    "mean",
    "variance",
    "variance_dof",
    "spatial",
    "spatial_dof",
    "slope_x",
    "slope_y",
    "neighbour_x",
    "neighbour_y",
    "first",
    "pixels",
    "peak",
    "low",
    "high",
)


def _outlying(picture: Array, group: TileGroup, spacing_dn: float) -> Mask:
    """Return which pixels are far off the quadratic surface through their tile, by a robust sigma.

    A hot pixel bends the surface: after a first look those that stand out are put at the middle and the surface is
    laid anew. Where the noise hides below the spacing of the codes, most pixels show one code and the median
    deviation gives no sigma: the neighbouring code is no outlier.
    """
    flat = picture.reshape(len(group.tiles), -1)
    step = _stride(flat.shape[1], group.width)
    flat = flat - np.median(flat[:, ::step], axis=1, keepdims=True)
    far = _far(flat, step, spacing_dn)
    for _ in range(2):
        calm = np.where(far, 0.0, flat)
        far = _far(flat - (calm @ group.trend) @ group.trend.T, step, spacing_dn)
    return far.reshape(picture.shape)


def _far(residual: Array, step: int, spacing_dn: float) -> Mask:
    some = residual[:, ::step]
    low, centre = np.percentile(some, (5.0, 50.0), axis=1)[..., None]
    sigma = MAD_TO_SIGMA * np.median(np.abs(some - centre), axis=1, keepdims=True)
    tail = (centre - low) / TWENTIETH_TO_SIGMA
    sigma = np.where(tail > _LOPSIDED * sigma, tail, sigma)
    limit = np.maximum(OUTLIER_SIGMAS * np.where(sigma > 0, sigma, np.inf), spacing_dn)
    return np.asarray(np.abs(residual - centre) > limit)


def _stride(pixels: int, width: int) -> int:
    step = max(1, pixels // _MOST_FOR_MEDIAN)
    while math.gcd(step, width) > 1:
        step += 1
    return step


def light_of_frames(means: Array, out: Mapping[str, Array], black_dn: float) -> dict[str, Array | float]:
    """Return the statistics of the frames of a capture: how the first differs, and what all tiles share, by name.

    Args:
        means: (frames, tiles) means in DN.
        out: Statistics of the tiles by name.
        black_dn: Black level in DN; NaN where unknown.
    """
    apart = means[0] - means[1:].mean(axis=0) if means.shape[0] > 1 else np.full(means.shape[1], np.nan)
    return {"first": apart, **_common_fluctuation(means, out, black_dn)}


def _common_fluctuation(means: Array, out: Mapping[str, Array], black_dn: float) -> dict[str, float]:
    # The first frame may differ for a separate reason (lag, dead time) and has a separate statistic.
    means = means[1:] if means.shape[0] > 2 else means
    amplitude, information = _common_amplitude(means, out, black_dn)
    n = means.shape[0]
    if n < 2 or information <= 0:
        return {"common": np.nan, "common_unit": np.nan}
    return {"common": float(np.sum(amplitude**2) / (n - 1) * information), "common_unit": 1.0 / information}


def _additive_fluctuation(means: Array, out: dict[str, Array], waves: Array) -> dict[str, float]:
    """Return the variance in DN² of an offset that all tiles of a frame share, and what pixel noise alone gives it.

    With it that of half waves down the frame: of a random walk the k-th has 1/k of the first, so k times their sizes
    estimate the first one's. What goes on steadily through the frames is a drift, not a wander: a straight line over
    them is taken out.

    Args:
        means: (frames, tiles) means in DN.
        out: Statistics of the tiles by name.
        waves: (tiles, waves) mean of each half wave over each tile.
    """
    means = means[1:] if means.shape[0] > 2 else means  # the first frame may differ for a separate reason
    n = means.shape[0]
    taken = 1 if n < 3 else 2
    usable = _free(out) & (out["variance"] > 0)
    weight = np.where(usable, out["pixels"] / np.where(usable, out["variance"], 1.0), 0.0)
    found: dict[str, float] = {}
    for name, forms in (("black", np.ones((usable.size, 1))), ("drift", waves)):
        shapes = forms if name == "black" else np.column_stack([forms, np.ones(usable.size)])
        inverse = np.linalg.pinv(shapes.T @ (weight[:, None] * shapes), hermitian=True)
        rank = forms.shape[1]
        size = np.arange(1, rank + 1)
        unit = np.square(size) * np.diag(inverse)[:rank]
        if n <= taken or not weight.sum() > 0 or not rank:
            found |= {name: np.nan, f"{name}_unit": np.nan, f"{name}_dof": 0.0}
            continue
        offset = size * ((means - means.mean(axis=0)) @ (weight[:, None] * shapes) @ inverse)[:, :rank]
        if taken == 2:
            steady = np.arange(n) - (n - 1) / 2.0
            offset = offset - np.outer(steady, steady @ offset) / float(steady @ steady)
        found |= {
            name: float(np.sum(offset**2)) / (n - taken) / rank,
            f"{name}_unit": float(np.mean(unit)),
            f"{name}_dof": (n - taken) * float(unit.sum() ** 2 / np.sum(unit**2)),
        }
    return found


def _common_amplitude(means: Array, out: Mapping[str, Array], black_dn: float) -> tuple[Array, float]:
    """Return by what share the light of each frame differs from all, and 1/variance of that; 0 without light."""
    signal = out["mean"] - (black_dn if np.isfinite(black_dn) else float(np.min(out["mean"])))
    usable = _free(out) & (out["variance"] > 0) & (signal > 0)
    weight = np.where(usable, signal * out["pixels"] / np.where(usable, out["variance"], 1.0), 0.0)
    information = float(np.sum(weight * signal))
    if information <= 0:
        return np.zeros(means.shape[0]), 0.0
    return np.asarray((means - means.mean(axis=0)) @ weight / information), information


def _free(out: Mapping[str, Array]) -> Mask:
    """Return which tiles are not clipped, be it below full scale: there noise falls away that darker tiles have."""
    order = np.argsort(out["mean"], kind="stable")
    variance = np.nan_to_num(out["variance"][order])
    cut_off = np.zeros(order.size, dtype=np.bool_)
    cut_off[order] = variance < _CUT_OFF * np.maximum.accumulate(variance)
    return np.asarray((out["low"] == 0) & (out["high"] == 0) & ~cut_off)


def _comb(histogram: Array) -> dict[str, Array | float]:
    total = float(histogram.sum())
    if total <= 0:
        return {"comb": np.zeros(len(COMB_PERIODS)), "comb_count": 0.0}
    numbers = np.arange(histogram.size)
    terms = [float(np.sum(histogram * np.cos(2 * np.pi * numbers / period))) / total for period in COMB_PERIODS]
    return {"comb": np.array(terms), "comb_count": total}


_COARSE_CELLS: Final = 192  # longer side of the coarse picture; stray light is smooth on that scale


@dataclass(slots=True, eq=False)
class PatternImages:
    """Coarse mean pictures, in DN above black per unit of t·G·level/N²."""

    cell_px: int  # edge of a coarse cell in pixels
    total: Array  # sum of unclipped signals, shape (patterns, rows, columns)
    weight: Array  # sum of t·G·level/N² over the same samples
    scale: Array  # (captures,) t·G·level/N² of each capture
    pattern: Array  # (captures,) pattern of each capture
    black_dn: Array  # (captures,) black level of each capture

    @classmethod
    def empty(cls, design: Design) -> PatternImages:
        """Return pictures without any frame yet."""
        cell = max(1, -(-max(design.shape) // _COARSE_CELLS))
        shape = (len(design.patterns), design.shape[0] // cell, design.shape[1] // cell)
        gain = np.array([gain_factor(g) for g in design.gain_db])
        scale = design.exposure_s * gain * design.source_level / design.f_number**2
        black = np.nan_to_num(design.black_level_dn)
        return cls(cell, np.zeros(shape), np.zeros(shape), scale, design.pattern_index.astype(np.float64), black)

    def add(self, frame: Frame, capture: int) -> None:
        """Add a frame of a capture; frames without light are left out, clipped cells too."""
        scale = float(self.scale[capture])
        if scale <= 0:
            return
        coarse, largest = coarse_cells(frame.dn, self.cell_px, *self.total.shape[1:])
        usable = largest < frame.saturated_dn
        pattern = int(self.pattern[capture])
        self.total[pattern] += np.where(usable, coarse - self.black_dn[capture], 0.0)
        self.weight[pattern] += np.where(usable, scale, 0.0)

    def picture(self, pattern: int) -> Array:
        """Return the picture of a pattern, shape (rows, columns); cells never seen unclipped take the largest seen."""
        seen = self.weight[pattern] > 0
        values = np.divide(self.total[pattern], self.weight[pattern], where=seen, out=np.zeros(seen.shape))
        return np.asarray(np.where(seen, values, values.max(initial=0.0)))


_LOOKS: Final = 4  # frames of a pattern that show where it is even, from its faintest light to its brightest
_SHARES: Final = (2 / 3, 1 / 2, 1 / 3)  # of a cell's sides that its even part may have
_PLACES: Final = 9  # along either side of a cell that are tried
_BY_CHANCE: Final = 5.0  # sigmas of a variance


def with_even_tiles(design: Design, read: FrameReader) -> Design:
    """Return the design of an unknown scene in which each tile is the part of its cell that shows the light best.

    What bends, saturates or stays behind does not act on a tile's mean light where half of the tile is dark. The part
    whose mean is known best is taken, structure beyond a quadratic surface counted as noise: the whole of an even cell,
    and of one that is textured throughout.

    Args:
        design: The cells of the scene; a design of known patches is returned as it is.
    """
    images = PatternImages.empty(design)
    for pattern in range(0 if design.uniform else len(design.patterns)):
        lit = [n for n in np.argsort(images.scale).tolist() if images.scale[n] > 0 and images.pattern[n] == pattern]
        for place in np.unique(np.linspace(0, len(lit) - 1, _LOOKS).astype(int)) if lit else ():
            images.add(read(design.captures[lit[place]].frames[0]), lit[place])
    pictures = np.stack([images.picture(pattern) for pattern in range(len(design.patterns))])
    return replace(design, tiles=tuple(_even_part(tile, pictures, images.cell_px) for tile in design.tiles))


def _even_part(tile: Tile, pictures: Array, cell_px: int) -> Tile:
    """Return the part of a tile whose mean light is known best from (patterns, rows, columns) in cells."""
    top, left = -(-tile.y // cell_px), -(-tile.x // cell_px)
    own = pictures[:, top : (tile.y + tile.height) // cell_px, left : (tile.x + tile.width) // cell_px]
    least, found = float(_u2_of_mean(own[:, None])[0]), tile
    for height, width in ((int(share * own.shape[1]), int(share * own.shape[2])) for share in _SHARES):
        if min(height, width) * cell_px < SMALLEST_TILE_PX:
            break
        spare = (own.shape[1] - height, own.shape[2] - width)
        at = np.stack(np.meshgrid(*(np.unique(np.linspace(0, n, _PLACES).astype(int)) for n in spare)), -1).reshape(
            -1, 2
        )
        u2 = _u2_of_mean(sliding_window_view(own, (height, width), axis=(1, 2))[:, at[:, 0], at[:, 1]])
        if u2.min() < least:
            least = float(u2.min())
            good = at[u2 <= least * (1.0 + _BY_CHANCE * math.sqrt(2.0 / (height * width)))]
            y, x = good[np.argmin(np.sum(np.square(good - good.mean(axis=0)), axis=1))].tolist()
            place = {"x": (left + x) * cell_px, "y": (top + y) * cell_px}
            found = replace(tile, **place, width=width * cell_px, height=height * cell_px)
    return found


def _u2_of_mean(parts: Array) -> Array:
    """Return the relative variance of the mean of parts, (patterns, parts, rows, columns), off a surface."""
    patterns, count, height, width = parts.shape
    pixels = height * width
    if pixels <= SURFACE_TERMS:
        return np.full(count, np.inf)
    flat = parts.reshape(patterns, count, pixels)
    left = np.sum(np.square(flat), axis=-1) - np.sum(np.square(flat @ surface(height, width)), axis=-1)
    mean = np.maximum(flat.mean(axis=-1), 1e-30)
    return np.asarray(np.sum(np.maximum(left, 0.0) / (pixels - SURFACE_TERMS) / pixels / mean**2, axis=0))


_AHEAD: Final = 2  # frames that are read before they are needed


def reduce_frames(
    design: Design, read: FrameReader, progress: Progress | None = None
) -> tuple[CaptureStatistics, PatternImages]:
    """Return the statistics of all captures and the mean image of each pattern.

    Dark captures come first, so that their outlying and restless pixels (defects) are left out everywhere.

    Raises:
        CaptureError: If a frame's size differs from the design's.
    """
    groups, sides, bins = tile_groups(design), patch_sides(design), RowBins.of(design)
    images = PatternImages.empty(design)
    defects: NDArray[np.bool_] = np.zeros(design.shape, dtype=np.bool_)
    collected: dict[int, dict[str, NDArray[np.float64] | float]] = {}
    done = 0
    darkest = np.nan  # stands for a black level that is not stated
    order = _darks_first(design)
    frames = _read_ahead(design, [index for number in order for index in design.captures[number].frames], read)
    for number in order:
        count = len(design.captures[number].frames)
        sums = CaptureSums.start(groups, sides, len(design.tiles), defects)
        apart = not design.uniform and count > 2
        first = CaptureSums.start(groups, sides, len(design.tiles), defects)
        for position, frame in enumerate(itertools.islice(frames, count)):
            sums.add(frame)
            images.add(frame, number)
            if apart and position == 0:
                first.add(frame)
            done += 1
            if progress is not None:
                progress(done, len(design.header.frames))
        structured = not design.uniform and design.source_level[number] > 0
        stated = float(design.black_level_dn[number])
        dark = bool(design.closed[number])
        black_dn = stated if np.isfinite(stated) or dark else darkest
        collected[number], outlying = sums.finish(black_dn, bins, structured=structured, dark=dark)
        if apart:
            later, _ = sums.without(first).finish(black_dn, bins, structured=structured, dark=dark)
            collected[number] |= _later_noise(later, count, structured=structured)
        if dark:
            defects = defects | outlying
            darkest = float(np.fmin(darkest, np.median(np.asarray(collected[number]["mean"]))))
    names = [entry.name for entry in fields(CaptureStatistics)]
    rows = [collected[number] for number in range(len(design.captures))]
    lines, uneven = (np.array([row[name] for row in rows]) for name in ("side_lines", "side_unevenness"))
    gathered = {name: np.array([row[name] for row in rows]) for name in names if name not in ("edge", "edge_u")}
    mean, spatial, high = (gathered[name] for name in ("mean", "spatial", "high"))
    gathered["edge"], gathered["edge_u"] = edge_shares(
        sides, lines, uneven, mean, spatial, high, design.pattern_index, design.f_number
    )
    return CaptureStatistics(**gathered), images


_NOISE: Final = (
    "variance",
    "variance_dof",
    "neighbour_x",
    "neighbour_y",
    "row_temporal",
    "row_temporal_weight",
    "row_temporal_dof",
    "row_temporal_light",
)


def _later_noise(
    later: Mapping[str, NDArray[np.float64] | float], frames: int, *, structured: bool
) -> dict[str, NDArray[np.float64] | float]:
    """Return the noise of a scene's frames after the first, by name: a picture left behind in that is no noise.

    The spatial variance of darks is brought to what the mean of all frames would have; mostly noise, it scatters more.
    """
    noise: dict[str, NDArray[np.float64] | float] = {name: later[name] for name in _NOISE}
    if not structured:
        white = np.asarray(later["variance"]) * (1.0 / (frames - 1) - 1.0 / frames)
        noise["spatial"] = np.asarray(later["spatial"]) - white
        noise["spatial_dof"] = np.asarray(later["spatial_dof"]) * ((frames - 1) / frames) ** 2
    return noise


def _darks_first(design: Design) -> list[int]:
    """Return the captures' numbers, darks first and the longest of them foremost: it shows the most defects."""
    return sorted(
        range(len(design.captures)), key=lambda n: (not design.closed[n], -design.exposure_s[n] * design.closed[n], n)
    )


def _read_ahead(design: Design, indices: Sequence[int], read: FrameReader) -> Iterator[Frame]:
    with ThreadPoolExecutor(max_workers=1) as reader:
        waiting = deque(reader.submit(read, index) for index in indices[:_AHEAD])
        for position, index in enumerate(indices):
            frame = waiting.popleft().result()
            waiting.extend(reader.submit(read, later) for later in indices[position + _AHEAD : position + _AHEAD + 1])
            if frame.shape != design.shape:
                raise CaptureError(
                    f"frame {index} is {frame.shape[1]} × {frame.shape[0]} pixels, the first one {design.shape[1]} × "
                    f"{design.shape[0]}; all frames of a capture set need one size"
                )
            yield frame
