"""Measures what lines of pixels show: light that moves from row to row within a frame, and how sharp borders are.

Of each frame a = (light of a row − its mean over the frames) / light is taken, tiles weighted by their information.
It is projected on smooth functions of the row: cosines of rising order, orthonormal under the weights, the constant
first. Without bands each coefficient is white noise of variance 1. A wave of ν periods per row at a random phase adds
A²/2·|z|² to the variance of one whose projection of exp(2πi·ν·y) is z.

The share of a step that is in the last line before a border measures blur where the border runs along its line. The
blend of a line that cuts a round outline is a matter of shape. The outline of a patch is not stated, so it is found
from the pixels along each line. Behind a straight border all have the blend; along a cut outline each has one side's
light or the other's. Of a side that bends, thirds are tried.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radiometer.reconciliation.design import Design, PatchSides, TileGroup
from radiometer.typing import Array, Mask

_MOST_BINS: Final = 240  # rows of a large frame are gathered to so many
_MOST_ORDERS: Final = 96
_ROWS_PER_ORDER: Final = 3.0
_INDEPENDENT: Final = 0.05  # share of a function that the lower ones must leave of it


@dataclass(frozen=True, slots=True, eq=False)
class RowBins:
    """The rows that tiles cover, gathered to a few hundred at most."""

    step: int  # rows in each
    number: int  # number of bins over the whole frame
    orders: int  # number of smooth functions, the constant left out

    @classmethod
    def of(cls, design: Design) -> RowBins:
        """Return the bins of a design's rows."""
        height = design.shape[0]
        step = -(-height // _MOST_BINS)
        spans = {(tile.y // step, (tile.y + tile.height - 1) // step) for tile in design.tiles}
        covered = {number for first, last in spans for number in range(first, last + 1)}
        return cls(step, -(-height // step), int(np.clip(len(covered) / _ROWS_PER_ORDER, 1, _MOST_ORDERS)))

    @property
    def middle(self) -> Array:
        """Return the middle row of each bin."""
        return np.asarray((np.arange(self.number) + 0.5) * self.step - 0.5, dtype=np.float64)


def row_light(
    bins: RowBins,
    groups: Sequence[TileGroup],
    row_sums: Sequence[Sequence[Array]],
    known: Sequence[Mask],
    means: Array,
    variance: Array,
    black_dn: float,
    *,
    structured: bool,
) -> dict[str, Array | float]:
    """Return the statistics `bands…` and `row_temporal_light` of one capture; NaN where it has no light to show them.

    The first frame of three or more is left out: it may differ for another reason.

    Args:
        row_sums: Per group and frame, the sums of deviations from the tile's mean along each row, (tiles, height).
        known: Per group, the pixels that the sums hold, (tiles, height, width).
        means: (frames, tiles) mean of each tile in DN.
        variance: (tiles,) temporal variance of a pixel in DN², NaN where a tile does not count.
        black_dn: Black level in DN; NaN where unknown.
        structured: Whether the tiles show a scene, of which each row has its own light.
    """
    black = black_dn if np.isfinite(black_dn) else float(np.min(means.mean(axis=0)))
    later = slice(1 if means.shape[0] > 2 else 0, None)
    frames = means[later].shape[0]
    moved, weight = np.zeros((frames, bins.number)), np.zeros(bins.number)
    pulled, light_of_rows, inverse = (np.zeros(bins.number) for _ in range(3))
    if frames > 1:
        usable = np.nan_to_num(variance) > 0
        usable &= means.mean(axis=0) > black
        for group, sums, good in zip(groups, row_sums, known, strict=True):
            chosen = usable[group.index]
            if not chosen.any():
                continue
            pixels = good.sum(axis=2)[chosen]
            every = np.array(sums)[:, chosen] + means[:, group.index[chosen], None] * pixels
            white = _white(np.array(sums)[:, chosen], pixels, variance[group.index[chosen]], group.width)
            share = np.where(pixels > 0, 1.0 / white[:, None], 0.0)
            light = every.mean(axis=0) / np.maximum(pixels, 1) - black
            light = light if structured else np.broadcast_to(light.mean(axis=1, keepdims=True), light.shape)
            where = (group.rows[chosen] // bins.step).ravel()
            change = every[later] - every[later].mean(axis=0)
            for frame in range(frames):
                np.add.at(moved[frame], where, (change[frame] * light * share).ravel())
            np.add.at(weight, where, (pixels * light**2 * share).ravel())
            np.add.at(pulled, where, (pixels * light * share).ravel())
            of_all = np.broadcast_to(
                1.0 / variance[group.index[chosen], None], pixels.shape
            )  # as the rows' profile has it
            np.add.at(light_of_rows, where, (pixels * light * of_all).ravel())
            np.add.at(inverse, where, (pixels * of_all).ravel())
    lines = inverse > 0
    light_dn2 = float(np.mean(light_of_rows[lines] ** 2 / inverse[lines])) / bins.step if lines.any() else 0.0
    return _projected(bins, moved, weight, pulled) | {"row_temporal_light": light_dn2}


def _white(sums: Array, pixels: NDArray[np.intp], variance: Array, width: int) -> Array:
    frames, held = sums.shape[0], pixels.sum(axis=1)
    if frames < 2 or width < 3:
        return variance
    shared = np.sum((sums - sums.mean(axis=0)) ** 2 / np.maximum(pixels, 1), axis=(0, 2)) / (frames - 1)
    own = (variance * (held - 1.0) - shared) / np.maximum(held - pixels.shape[1], 1)
    return np.asarray(np.where(own > 0, own, variance))


def _projected(bins: RowBins, moved: Array, weight: Array, pulled: Array) -> dict[str, Array | float]:
    ratio, of_rows = np.full(bins.orders, np.nan), np.zeros(bins.orders)
    basis = np.zeros((bins.orders + 1, bins.number))
    seen = np.flatnonzero(weight > 0)
    frames = moved.shape[0]
    if seen.size > 2 and frames > 1:
        root = np.sqrt(weight[seen])
        turns = np.outer((seen + 0.5) / bins.number, np.arange(bins.orders + 1))
        columns = root[:, None] * np.cos(np.pi * turns)
        columns = columns[:, : min(bins.orders + 1, seen.size)]
        directions, upper = np.linalg.qr(columns)
        own = np.abs(np.diag(upper)) > _INDEPENDENT * np.linalg.norm(columns, axis=0)
        basis[: own.size, seen] = np.where(own[:, None], (directions * np.sign(np.diag(upper))).T * root, 0.0)
        coefficients = moved[:, seen] @ (basis[:, seen] / weight[seen]).T
        power = np.sum(coefficients**2, axis=0) / (frames - 1)
        ratio = np.where(basis.any(axis=1), power, np.nan)[1:]
        of_rows = np.sum((basis[1:, seen] * pulled[seen] / weight[seen]) ** 2, axis=1)
    return {"bands": ratio, "bands_basis": basis, "bands_of_rows": of_rows}


def wave_power(bins: RowBins, basis: Array, frequency: float) -> tuple[Array, Array]:
    """Return what a wave along the rows adds to the statistics, per unit of its relative variance.

    Args:
        basis: (captures, 1 + orders, bins) functions of the rows, the constant first.
        frequency: Periods per row.

    Returns:
        (captures, orders) added to the ratios of the bands, and (captures,) share of the wave that the whole frame
        has in common.
    """
    wave = np.exp(2j * np.pi * frequency * bins.middle) * np.sinc(frequency * bins.step)
    power = np.square(basis @ wave.real) + np.square(basis @ wave.imag)
    whole = np.square(basis[:, 0].sum(axis=1))
    return power[:, 1:], np.divide(power[:, 0], whole, out=np.ones_like(whole), where=whole > 0)


@dataclass(frozen=True, slots=True, eq=False)
class TileBands:
    """Trace of a wave along the rows in each tile, (tiles,), amplitudes or shares of the wave's variance."""

    mean: Array  # amplitude of the tile's mean
    rise: Array  # amplitude of its rise from the centre to the bottom edge
    within: Array  # variance from row to row about the mean
    rough: Array  # the same about a quadratic
    lag: Array  # covariance of neighbouring rows about the mean
    even: Array  # part of `within` that is even about the tile's middle
    middle: Array  # middle row
    frequency: float  # periods per row

    @classmethod
    def of(cls, design: Design, frequency: float) -> TileBands:
        """Return the shares of a design's tiles."""
        if not frequency:  # all rows go together
            one, nothing = np.ones(len(design.tiles)), np.zeros(len(design.tiles))
            return cls(one, nothing, nothing, nothing, nothing, nothing, nothing, 0.0)
        heights = np.array([tile.height for tile in design.tiles])
        figures = {int(height): _of_height(int(height), frequency) for height in np.unique(heights)}
        mean, rise, within, rough, lag, even = np.array([figures[int(height)] for height in heights]).T
        middle = np.array([tile.y + (tile.height - 1) / 2 for tile in design.tiles])
        return cls(mean, rise, within, rough, lag, even, middle, frequency)

    def quadratures(self, amplitude: Array) -> Array:
        """Return such amplitudes of the tiles for the two phases of a wave, (tiles, 2)."""
        turns = 2.0 * np.pi * self.frequency * self.middle
        return np.asarray(amplitude[:, None] * np.column_stack([np.cos(turns), np.sin(turns)]))

    def unsteadiness(self, frames: Array) -> Array:
        """Return the relative standard deviation of `within` over the phases of a few frames, (captures, tiles).

        A tile shows E·cos²θ + O·sin²θ of a wave of phase θ; over n frames, their mean taken out, cos² scatters by
        Var = ¼·(2/(n − 1) − 3/(2n)) and Cov(cos², sin²) = −1/(8n).
        """
        n = np.maximum(frames, 2.0)[:, None]
        odd = self.within - self.even
        spread = (self.even**2 + odd**2) * (2.0 / (n - 1.0) - 1.5 / n) - self.even * odd / n
        return np.asarray(np.sqrt(np.maximum(spread, 0.0)) / np.maximum(self.within, 1e-12))


def _of_height(height: int, frequency: float) -> tuple[float, ...]:
    y = np.arange(height) - (height - 1) / 2
    even, odd = np.cos(2 * np.pi * frequency * y), np.sin(2 * np.pi * frequency * y)
    u = y / (height / 2)
    mean, rise = float(even.mean()), float(odd @ u / max(float(u @ u), 1e-12))
    even = even - mean
    curved = u**2 - np.mean(u**2)
    bent = even - curved * float(even @ curved / max(float(curved @ curved), 1e-12))
    rough = float(np.mean(bent**2) + np.mean((odd - rise * u) ** 2))
    lag = float(np.mean(even[1:] * even[:-1] + odd[1:] * odd[:-1])) if height > 1 else 0.0
    within_even, within_odd = float(np.mean(even**2)), float(np.mean(odd**2))
    return mean, rise, within_even + within_odd, rough, lag, within_even


# ---- edges of patches -----------------------------------------------------------------------------------------------
_LEAVES: Final = 0.2  # share of the largest deviation at which a line is no longer the patch
_OUTLYING: Final = 4.0  # sigmas from the median of all sides
_OUTLYING_SHARE: Final = 0.1
SHARPEST: Final = 5e-4  # a blur of 0.26 px: what a border that is not quite straight does by itself
_WIDE: Final = 0.15  # a wide blur reaches beyond narrow surrounds, so that its share is less certain
_CALM: Final = 0.03  # largest deviation of the line before the last, in shares of the step
_FALLS: Final = 0.5  # a blur that leaves the line before the last calm falls off from line to line by more than this
_SEEN: Final = 2.0  # sigmas by which a line must differ from the patch to tell anything
_LARGEST_SHARE: Final = 0.45
_FEW: Final = 0.5  # of the borders that are clear at one f-number, below which others are too blurred to tell them
_CLEAR_STEP: Final = 5.0  # sigmas that a step must have to be a border at all: even fields have many lines
_CUT: Final = 0.25  # of the variance along a line that lies half here, half there, from which it is not straight
_UNEVEN: Final = 0.04  # of the squared step: variance along the first line behind it, likewise
_UNEVEN_SIGMAS: Final = 3.0  # by which pixel noise may make a line uneven
_AGREED: Final = 0.5  # least share of the information of all sides that must agree: a blur is the same at all


def edge_shares(
    sides: PatchSides,
    lines: Array,
    uneven: Array,
    mean: Array,
    spatial: Array,
    high: Array,
    pattern: NDArray[np.intp],
    f_number: Array | None = None,
) -> tuple[Array, Array]:
    """Return the blended share of each capture's borders and its standard uncertainty (infinite where none is seen).

    Each pattern's steps are found in the mean of its captures: the first line, going outwards, that leaves the
    patch's level. Where most captures are too blurred, those of the smallest aperture decide. A sharp picture has the
    patch's own level up to that line. The light that a blur carries into it is divided by the sum of both lines'
    differences from the patch. A symmetric blur leaves that sum as it is. Sides that disagree with the others (a
    faint step hidden before a strong one) are left out, and sides that do not run along their lines.

    Args:
        sides: Lines across the sides of the patches.
        lines: (captures, parts × sides, lines) their means in DN, of the whole sides first, then of parts of them.
        uneven: The variance along them in DN², likewise.
        mean: (captures, tiles) mean of each tile in DN.
        spatial: (captures, tiles) variance of the time mean from pixel to pixel in DN².
        high: (captures, tiles) share of samples at full scale.
        pattern: (captures,) pattern of each capture.
        f_number: (captures,) f-number of each; all alike where there is none.
    """
    captures = mean.shape[0]
    share, u = np.zeros(captures), np.full(captures, np.inf)
    if not sides.tile.size:
        return share, u
    tile = np.tile(sides.tile, len(sides.parts))
    pixels = np.repeat([part.stop - part.start for part in sides.parts], sides.tile.size)
    step = lines - mean[:, tile][:, :, None]
    clipped = (high[:, tile] > 0) | ~np.isfinite(step).all(axis=2)
    noise = spatial[:, tile] / pixels
    at = _positions(step, clipped, noise, pattern, np.zeros(captures) if f_number is None else f_number)
    straight = _Straightness(step, uneven, _pixel_noise(lines, mean, spatial, tile), clipped, pixels)
    at = {
        n: (line, _chosen(clear, straight.of(pattern == n, line, sides.tile.size), sides))
        for n, (line, clear) in at.items()
    }
    index = np.arange(tile.size)
    for capture in range(captures):
        line, clear = at[int(pattern[capture])]
        before = step[capture, index, line]
        after = step[capture, index, line + 1]
        whole = before + after
        seen = whole**2 > _CLEAR_STEP**2 * 2.0 * noise[capture]  # of two lines
        usable = clear & ~clipped[capture] & (noise[capture] > 0) & seen
        if usable.any():
            down = np.tile(sides.along_rows, len(sides.parts))[usable]
            share[capture], u[capture] = _of_both(before[usable], whole[usable], noise[capture][usable], down)
    return share, u


def _chosen(clear: NDArray[np.bool_], straight: NDArray[np.bool_], sides: PatchSides) -> NDArray[np.bool_]:
    good = (clear & straight).reshape(-1, sides.tile.size)
    good[1:] &= ~good[0]
    return np.asarray(good.ravel())


def _pixel_noise(lines: Array, mean: Array, spatial: Array, tile: NDArray[np.intp]) -> Array:
    """Return the variance of a pixel of the time mean in each line in DN²; brighter lines have more photon noise."""
    darkest = np.nanmin(mean)
    of_tile = (mean[:, tile] - darkest)[:, :, None]
    light = np.divide(lines - darkest, of_tile, out=np.zeros_like(lines), where=of_tile > 0)
    return np.asarray(spatial[:, tile][:, :, None] * np.where(of_tile > 0, np.maximum(light, 1.0), np.nan))


@dataclass(frozen=True, slots=True)
class _Straightness:
    step: Array  # (captures, sides, lines) deviation of each line from the patch in DN
    uneven: Array  # variance along each in DN²
    noise: Array  # what pixel noise adds to it
    clipped: NDArray[np.bool_]  # (captures, sides) whether anything clips
    pixels: NDArray[np.intp]  # (sides,) pixels in a line

    def of(self, shown: NDArray[np.bool_], line: NDArray[np.intp], sides: int) -> NDArray[np.bool_]:
        """Return it for the borders behind a line each, from all captures that are shown."""
        index = np.arange(line.size)
        before, after = (self.step[shown][:, index, at] for at in (line, line + 1))
        allowed = 1.0 + _UNEVEN_SIGMAS * np.sqrt(2.0 / np.maximum(self.pixels - 1, 1))
        straight, significant = np.ones(line.size, dtype=np.bool_), np.ones(line.size, dtype=np.bool_)
        behind = _UNEVEN * (before + after) ** 2
        for at, cut in ((line, _CUT * np.abs(before * after)), (line + 1, behind)):
            noise = allowed * self.noise[shown][:, index, at]
            known = ~self.clipped[shown] & np.isfinite(noise)
            beyond = np.where(known, self.uneven[shown][:, index, at] - noise - cut, 0.0)
            straight &= np.sum(beyond, axis=0) <= 0.0
            significant &= np.sum(np.where(known, noise - behind, 0.0), axis=0) < 0.0
        bent = (significant & ~straight).reshape(-1, sides).sum(axis=1)
        mostly = np.repeat(2 * bent <= significant.reshape(-1, sides).sum(axis=1), sides)
        return np.asarray(straight & mostly)


def _of_both(before: Array, whole: Array, noise: Array, down: NDArray[np.bool_]) -> tuple[float, float]:
    """Return the share of all sides, and its standard uncertainty; where rows and columns differ, the mean of both."""
    if down.all() or not down.any():
        return _agreed(before, whole, noise)
    (a, u_a), (b, u_b) = (_agreed(before[own], whole[own], noise[own]) for own in (down, ~down))
    u = float(np.hypot(u_a, u_b))
    differ = np.isfinite(u) and abs(a - b) > _OUTLYING * u
    return (0.5 * (a + b), 0.5 * u) if differ else _agreed(before, whole, noise)


def _agreed(before: Array, whole: Array, noise: Array) -> tuple[float, float]:
    single, sigma = before / whole, np.sqrt(noise) / np.abs(whole)
    order = np.argsort(single)
    weight = np.cumsum(1.0 / sigma[order])
    middle = float(single[order][np.searchsorted(weight, 0.5 * weight[-1])])
    kept = np.abs(single - middle) < _OUTLYING * sigma + _OUTLYING_SHARE * abs(middle)
    information = float(np.sum(1.0 / sigma[kept] ** 2))
    if information < _AGREED * float(np.sum(1.0 / sigma**2)):
        return 0.0, np.inf
    share = float(np.sum(single[kept] / sigma[kept] ** 2)) / information
    return share, float(np.sqrt(1.0 / information + SHARPEST**2 + (_WIDE * share**2) ** 2))


def _positions(
    step: Array, clipped: NDArray[np.bool_], noise: Array, pattern: NDArray[np.intp], f_number: Array
) -> dict[int, tuple[NDArray[np.intp], NDArray[np.bool_]]]:
    """Return for each pattern the line before the step of every side, and whether that step is a clear one.

    The smallest aperture at which they are clear shows their place. In a pattern that is seen only at f-numbers
    that are blurred in another one no step is clear.
    """
    found, blurred, stops_of = {}, set[float](), {}
    for number in np.unique(pattern):
        shown = pattern == number
        stops_of[int(number)] = stops = np.unique(f_number[shown]).tolist()
        of_all, *of_stops = (
            _steps_of(step[chosen], clipped[chosen], noise[chosen])
            for chosen in (shown, *(shown & (f_number == stop) for stop in stops))
        )
        most = max(clear.sum() for _, clear in of_stops)
        line, clear = next(entry for entry in reversed(of_stops) if entry[1].sum() >= _FEW * most)
        agree = [np.sum(clear & other[1] & (line == other[0])) >= _FEW * clear.sum() for other in (of_all, *of_stops)]
        found[int(number)] = of_all if agree[0] else (line, clear)
        if not agree[0]:
            blurred |= {stop for stop, same in zip(stops, agree[1:], strict=True) if not same}
    return {
        number: (line, clear & (not blurred.issuperset(stops_of[number]))) for number, (line, clear) in found.items()
    }


def _steps_of(step: Array, clipped: NDArray[np.bool_], noise: Array) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
    weight = np.where(clipped | ~(noise > 0), 0.0, 1.0 / np.maximum(noise, 1e-12))
    average = np.sum(np.nan_to_num(step) * np.sqrt(weight)[:, :, None], axis=0)
    return _first_step(average, np.sqrt(np.sum(weight > 0, axis=0)))


def _first_step(average: Array, sigma: Array) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
    """Return the line before the step of each side, and whether that step is a clear one."""
    sides, lines = average.shape
    index = np.arange(sides)
    size = np.abs(average)
    leaves = size > _LEAVES * size.max(axis=1, keepdims=True)
    first = np.argmax(leaves, axis=1)
    following = np.minimum(first + 1, lines - 1)
    same = np.sign(average[index, first]) == np.sign(average[index, following])
    inner = np.where(first > 0, size[index, np.maximum(first - 1, 0)], 0.0)
    blended = same & (size[index, following] - size[index, first] > size[index, first] - inner)
    after = np.where(blended, following, first)
    earlier = np.maximum(after - 2, 0)
    calm = size[index, earlier] < _CALM * size[index, after]
    calm &= ~_false_start(average, after, earlier, sigma)
    clear = (after >= 2) & calm | ((after == 1) & (size[index, 0] < _LARGEST_SHARE * size[index, 1]))
    line = np.clip(after - 1, 0, lines - 2)
    return line.astype(np.intp), np.asarray(clear & (size[index, after] > _CLEAR_STEP * sigma))


def _false_start(average: Array, after: NDArray[np.intp], earlier: NDArray[np.intp], sigma: Array) -> NDArray[np.bool_]:
    """Return where a small step came before the large one: it does not fall off inwards as a blur would."""
    index = np.arange(sigma.size)
    far, near, step = (average[index, line] for line in (earlier, np.maximum(after - 1, 0), after))
    rising = (np.abs(far) > _FALLS * np.abs(near)) | (np.sign(far) != np.sign(step))
    return np.asarray(rising & (np.abs(far) > _SEEN * sigma))
