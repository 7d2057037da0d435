"""Measures how sharp the borders of patches are: the share of a step that is in the last line before it.

That share measures blur where a border runs along its line: the blend of a line that cuts a round outline is a matter
of shape. The outline of a patch is not stated, so it is found from the pixels along each line. Behind a straight
border all have the blend; along a cut outline each has one side's light or the other's. Of a side that bends, thirds
are tried.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radiometer.reconciliation.measure.design import PatchSides
from radiometer.typing import Array

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
    """Return which parts of sides count: the whole side where it is straight, else those of its parts that are."""
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
    """Statistics that show whether borders run along their lines."""

    step: Array  # (captures, sides, lines) deviation of each line from the patch in DN
    uneven: Array  # variance along each in DN²
    noise: Array  # what pixel noise adds to it
    clipped: NDArray[np.bool_]  # (captures, sides) whether anything clips
    pixels: NDArray[np.intp]  # (sides,) pixels in a line

    def of(self, shown: NDArray[np.bool_], line: NDArray[np.intp], sides: int) -> NDArray[np.bool_]:
        """Return it for the borders behind a line each, from all captures that are shown.

        Outlines are alike: where most borders of the same part of a side are cut, those that pixel noise hides and
        those that happen to seem straight are, too.
        """
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
    """Return the share of all sides, and its standard uncertainty; where rows and columns differ, the mean of both.

    Pixels may exchange charge along rows more than along columns: sides of one direction then disagree with the others.
    """
    if down.all() or not down.any():
        return _agreed(before, whole, noise)
    (a, u_a), (b, u_b) = (_agreed(before[own], whole[own], noise[own]) for own in (down, ~down))
    u = float(np.hypot(u_a, u_b))
    differ = np.isfinite(u) and abs(a - b) > _OUTLYING * u
    return (0.5 * (a + b), 0.5 * u) if differ else _agreed(before, whole, noise)


def _agreed(before: Array, whole: Array, noise: Array) -> tuple[float, float]:
    """Return the mean share of the sides that agree with the median, and its standard uncertainty."""
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
    """Return the line before the step of every side in the mean of some captures, and whether it is a clear one."""
    weight = np.where(clipped | ~(noise > 0), 0.0, 1.0 / np.maximum(noise, 1e-12))
    average = np.sum(np.nan_to_num(step) * np.sqrt(weight)[:, :, None], axis=0)
    return _first_step(average, np.sqrt(np.sum(weight > 0, axis=0)))


def _first_step(average: Array, sigma: Array) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
    """Return the line before the step of each side, and whether that step is a clear one.

    Args:
        average: (sides, lines) deviation of each line from the patch.
        sigma: (sides,) its noise.
    """
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
