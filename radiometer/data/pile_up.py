"""The white level as the frames of one capture show it: where saturated pixels pile up.

A sensor, an amplifier or a converter stops somewhere, often below full scale and below what a file states. The pixels
beyond gather in a narrow pile, with some DN of noise, and with single stray pixels (hot ones, glitches) above it. The
highest value that occurs therefore says little. A pile alone says little too: an evenly lit area makes one. What
distinguishes saturated pixels is how they behave while the exposure grows:

* The longer exposure makes the values of these pixels more alike than the shorter one did. Where light is still
  recorded it does the reverse: differences between pixels grow with the exposure, and so does the noise of the light.
  The pixels also stay below what the shorter exposure predicts.
* Or these pixels have the same value in two exposures, while darker pixels rise.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from radiometer.data.code_step import code_step
from radiometer.data.frame import DigitalNumbers, Frame, FrameSettings
from radiometer.data.reading import Patch
from radiometer.data.white_level import EDGE_SIGMAS, Basis, WhiteLevel

# A quartile range of n values scatters by 1.17/sqrt(n) of itself (normal distribution), the ratio of two by sqrt(2)
# more. Of some thousand comparisons in a capture none passes 5 standard deviations by chance.
_SIGMAS = 5.0
_LN_RATIO_SIGMA = 1.17 * math.sqrt(2.0)
# No light source and no shutter is off by a factor of two between two frames: what halves the spread is no flicker.
_COLLAPSE = 2.0
# Exposures whose labels differ by less do not count as different: shutters are true to a few per cent.
_DIFFERENT_EXPOSURE = 1.1
_NORMAL_QUARTILES = 1.349  # quartile range of a normal distribution over its standard deviation
# A pile ends where its middle is so many times as dense: 2 standard deviations away in a normal distribution.
_DENSER = 8.0
_CUT_OFF_SPREAD = 0.89  # standard deviation of a normal distribution cut off there, over that of the whole
_FEWEST_PIXELS = 24  # in a pile: fewer can halve their spread by chance
_RANKS_PER_DOUBLING = 4
_SINGLE_SHARE = 0.5  # of the strays may have another next to them: in an area nearly all have
_CODES_NEXT_TO = 8  # next to a pile, which show how dense ordinary pixels are
_PILES_TRIED = 6  # distinct ones in a frame
_PIXELS_COMPARED = 4096  # of a pile: quartile ranges are then known to 2 per cent
_FRAMES_LOOKED_AT = 5  # of one gain and light, evenly over the exposures: every pair of them is compared
_LIGHTS_LOOKED_AT = 3  # patterns and drives of the source


class _Ranks:
    """The values of one frame, by place and by rank: the k-th brightest, from its histogram."""

    def __init__(self, frame: Frame) -> None:
        self.settings = frame.settings
        self.exposure_s = frame.settings.effective_exposure_s
        self.full_scale_dn = frame.full_scale_dn
        self.flat = frame.dn.ravel()
        self.counts = histogram(frame.dn, frame.full_scale_dn)
        self._at_least = np.cumsum(self.counts[::-1])  # pixels at or above full scale − index
        self.pixels = int(self._at_least[-1])
        black_dn = frame.settings.black_level_dn
        self.floor_dn = float(self.value(np.array([self.pixels]))[0]) if black_dn is None else black_dn

    def value(self, ranks: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the digital number of the pixels at some ranks, 1 for the brightest."""
        return self.full_scale_dn - np.searchsorted(self._at_least, ranks)

    def pixels_from(self, dn: int) -> int:
        """Return how many pixels have at least a digital number."""
        return int(self._at_least[self.full_scale_dn - dn]) if dn <= self.full_scale_dn else 0


@dataclass(frozen=True, slots=True)
class _Pile:
    """A pile of saturated pixels in one frame."""

    centre_dn: float
    spread_dn: float
    saturated_dn: int
    top_dn: int
    pixels: int
    sigmas: float


def histogram(dn: DigitalNumbers, full_scale_dn: int) -> NDArray[np.int64]:
    """Return how many pixels have each digital number, shape (full scale + 1,)."""
    size = full_scale_dn + 1
    counts = cv2.calcHist([np.ascontiguousarray(dn)], [0], None, [size], [0, size])
    return np.asarray(counts.ravel(), dtype=np.float64).astype(np.int64)


def find_white_levels(frames: Iterable[Frame], parts: Sequence[Patch] = ()) -> dict[float, WhiteLevel]:
    """Return the white level of every gain in dB among frames of one camera and pixel format.

    Frames are compared where pattern and drive of the source are the same. Where the frames of a gain show no pile,
    the lowest of the other gains is used unless areas of their pixels are above it. The reason: a converter ends at
    one number for all gains, and a full well ends lower at lower gains only.

    Args:
        frames: Dark frames are left out. Frames state their white level in their settings where a file does.
        parts: Of taps, whose black levels differ: they are looked at singly, and the lowest end counts.
    """
    light = [frame for frame in frames if not frame.settings.is_dark]
    if light and parts and all(part.fits(light[0].shape) for part in parts):
        cut = [[replace(one, dn=one.dn[part.slices].copy()) for one in light] for part in parts]
        each = [find_white_levels(some) for some in cut]
        return {gain_db: _lowest(one[gain_db] for one in each) for gain_db in each[0]}
    ranked = [_Ranks(frame) for frame in light]
    if not ranked:
        return {}
    gains = sorted({one.settings.gain_db for one in ranked})
    for one in ranked:  # an evenly lit frame does not show its black level; a shorter exposure comes nearer to it
        alike = (other for other in ranked if other.settings.gain_db == one.settings.gain_db)
        one.floor_dn = min(other.floor_dn for other in alike)
    counts = np.sum([one.counts for one in ranked], axis=0)
    codes = np.flatnonzero(counts)
    step = code_step(codes, counts[codes])
    # Padded codes end below full scale.
    highest = ranked[0].full_scale_dn - int(ranked[0].full_scale_dn - codes[-1]) % step
    piles = {gain: _pile_of_gain(ranked, gain, step) for gain in gains}
    shown = [pile for pile in piles.values() if pile is not None]
    lowest = min(shown, key=lambda pile: pile.saturated_dn, default=None)
    found = {}
    for gain in gains:
        of_gain = [one for one in ranked if one.settings.gain_db == gain]
        holds = lowest is not None and all(_strays_are_single(one, lowest.top_dn) for one in of_gain)
        found[gain] = _decided(of_gain, piles[gain], lowest if holds else None, highest)
    return found


def _lowest(levels: Iterable[WhiteLevel]) -> WhiteLevel:
    """Return the lowest of the levels that are measured, or of all where none is."""
    return min(levels, key=lambda one: (one.basis != "measured", one.saturated_dn))


def with_white_levels(frames: Sequence[Frame]) -> list[Frame]:
    """Return frames of one camera and pixel format with the white level that all of them show together.

    Frames that carry a white level from an earlier comparison are returned as they are.
    """
    if all(_is_compared(frame.settings) for frame in frames):
        return list(frames)
    return list(streamed_with_white_levels([frame.settings for frame in frames], frames.__getitem__))


def white_levels_of(
    settings: Sequence[FrameSettings], read: Callable[[int], Frame], parts: Sequence[Patch] = ()
) -> dict[float, WhiteLevel]:
    """Return the white level of every gain in dB among frames of one capture, of which a few are read.

    Args:
        settings: Of every frame.
        read: Returns the frame at a place of that order.
        parts: As for `find_white_levels`.
    """
    return find_white_levels((read(index) for index in _looked_at(settings)), parts)


def streamed_with_white_levels(
    settings: Sequence[FrameSettings], read: Callable[[int], Frame], parts: Sequence[Patch] = ()
) -> Iterator[Frame]:
    """Yield frames with the white level that they show together; a few of each gain are held in memory.

    Args:
        settings: Of every frame, in the order in which they are yielded.
        read: Returns the frame at a place of that order.
        parts: As for `find_white_levels`.
    """
    kept = {index: read(index) for index in _looked_at(settings)}
    levels = find_white_levels(kept.values(), parts)
    for index in range(len(settings)):
        frame = kept.pop(index, None) or read(index)
        level = None if frame.settings.is_dark else levels.get(frame.settings.gain_db)
        yield frame if level is None else replace(frame, settings=replace(frame.settings, white_level=level))


def _is_compared(settings: FrameSettings) -> bool:
    return settings.is_dark or (settings.white_level is not None and settings.white_level.exposures > 0)


def _looked_at(settings: Sequence[FrameSettings]) -> list[int]:
    """Return which frames are enough to find the white level: of each gain some, evenly over the exposures."""
    groups: dict[tuple[float, str, float], list[int]] = {}
    for index, one in enumerate(settings):
        if not one.is_dark:
            groups.setdefault((one.gain_db, one.pattern, one.source_level), []).append(index)
    chosen: list[int] = []
    for gain in {key[0] for key in groups}:
        of_gain = [sorted(g, key=lambda k: settings[k].exposure_s) for key, g in groups.items() if key[0] == gain]
        # The longest exposures under the brightest light show most; more than a few kinds of light show the same.
        of_gain.sort(key=lambda g: settings[g[-1]].exposure_s * settings[g[-1]].source_level, reverse=True)
        for group in of_gain[:_LIGHTS_LOOKED_AT]:
            places = np.unique(np.linspace(0, len(group) - 1, _FRAMES_LOOKED_AT).round().astype(int))
            chosen += [group[place] for place in places]
    return chosen


def _decided(frames: Sequence[_Ranks], pile: _Pile | None, lowest: _Pile | None, highest_dn: int) -> WhiteLevel:
    """Return the white level of frames of one gain from what they show and what they state."""
    known = [one.settings.white_level for one in frames if one.settings.white_level is not None]
    stated = [level for level in known if level.is_stated]
    stated_dn = min((level.stated_dn for level in stated or known), default=highest_dn)
    reached = max(int(one.value(np.array([min(_FEWEST_PIXELS, one.pixels)]))[0]) for one in frames)
    exposures = len({one.settings.effective_exposure_s for one in frames})
    basis: Basis = "stated" if stated else "assumed"
    used = pile or lowest
    if used is None or used.saturated_dn > stated_dn:
        # Above the level that is stated, nothing promises that numbers are proportional to light.
        saturated = min(stated_dn, highest_dn)
    else:
        saturated, basis = used.saturated_dn, "measured"
    found = WhiteLevel(saturated, basis, stated_dn, bool(stated), reached_dn=reached, exposures=exposures)
    if pile is None:
        return found
    return replace(
        found,
        measured_dn=pile.centre_dn,
        spread_dn=pile.spread_dn,
        piled_pixels=pile.pixels,
    )


def _pile_of_gain(frames: Sequence[_Ranks], gain_db: float, step: int) -> _Pile | None:
    """Return the pile that the frames of one gain show together."""
    found = []
    for longer in frames:
        if longer.settings.gain_db != gain_db:
            continue
        shorter = [one for one in frames if _is_shorter(one, longer)]
        shorter.sort(key=lambda one: one.exposure_s)
        pile = _pile_in(longer, shorter, step)
        if pile is not None:
            found.append(pile)
    return max(found, key=lambda pile: pile.sigmas, default=None)


def _is_shorter(one: _Ranks, other: _Ranks) -> bool:
    a, b = one.settings, other.settings
    same_light = (a.pattern, a.source_level, one.pixels) == (b.pattern, b.source_level, other.pixels)
    # A higher gain has more noise at the same value, which says nothing of saturation.
    return (
        same_light and a.gain_db <= b.gain_db and a.effective_exposure_s * _DIFFERENT_EXPOSURE <= b.effective_exposure_s
    )


def _pile_in(longer: _Ranks, shorter: Sequence[_Ranks], step: int) -> _Pile | None:
    """Return the pile of saturated pixels in a frame, shown by frames of shorter exposure; None where none is shown."""
    if not shorter:
        return None
    upper, centre, lower = _dense_runs(longer, step)
    for _ in range(_PILES_TRIED):
        if centre.size == 0:
            return None
        pile, low, high = _extent(longer, int(upper[0]), int(centre[0]), int(lower[0]), step)
        if pile is not None and _strays_are_single(longer, pile.top_dn):
            places = _places_in(longer, pile)
            sigmas = max(_evidence(longer, one, pile, places, step) for one in shorter)
            if sigmas >= _SIGMAS:
                return replace(pile, sigmas=sigmas)
        elsewhere = (centre < low) | (centre > high)
        upper, centre, lower = upper[elsewhere], centre[elsewhere], lower[elsewhere]
    return None


def _dense_runs(frame: _Ranks, step: int) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Return the quartiles in DN of runs of ranks among the brightest pixels, the densest first."""
    doublings = math.log2(max(frame.pixels, 2))
    grid = np.unique(np.round(2.0 ** np.arange(0.0, doublings, 1.0 / _RANKS_PER_DOUBLING)).astype(np.int64))
    first, last = (part.ravel() for part in np.meshgrid(np.insert(grid, 0, 0), np.append(grid, frame.pixels)))
    size = last - first
    kept = (size >= _FEWEST_PIXELS) & (first <= size)  # strays above a pile are fewer than its pixels
    first, size = first[kept], size[kept]
    upper, centre, lower = (frame.value(first + (part * size + 3) // 4) for part in (1, 2, 3))
    density = size / (upper - lower + step)
    order = np.argsort(-density, kind="stable")
    return upper[order], centre[order], lower[order]


def _extent(frame: _Ranks, upper: int, centre: int, lower: int, step: int) -> tuple[_Pile | None, int, int]:
    """Return the pile around a dense run of given quartiles, and the range that it takes out of the search.

    There is no pile where the codes next to the run are about as dense: it is a part of something wider.
    """
    width = max((upper - lower) // 2 // step, 1) * step
    starts = np.arange((centre - width // 2) % width, frame.full_scale_dn + 1, width)
    counts = np.add.reduceat(frame.counts, starts)
    middle = int(np.searchsorted(starts, centre, "right")) - 1
    sparse = np.flatnonzero(counts <= counts[middle] / _DENSER)
    place = int(np.searchsorted(sparse, middle))
    low = int(starts[sparse[place - 1] + 1]) if place > 0 else 0
    high = int(starts[sparse[place]]) if place < sparse.size else frame.full_scale_dn + 1
    # Below, a soft shoulder may lead up to the pile; above, there is nothing but full scale.
    side, bound = (1, high) if high <= frame.full_scale_dn else (-1, low)
    spread = _half_spread(frame, centre, bound, side)
    centre = _mean_near(frame, centre, spread, step) if side > 0 else centre
    spread = _half_spread(frame, centre, bound, side)
    end = max(math.ceil(centre - EDGE_SIGMAS * spread - 0.5 * step), 1)
    end = _lower_end(frame, end + (centre - end) % step, step)  # a code: between padded ones no pixels are
    top = math.floor(centre + EDGE_SIGMAS * max(spread, step / 2.0))
    inner = step * round(spread / step)
    dense = _per_code(frame, centre - inner, centre + inner + 1, step)
    margin = max(_CODES_NEXT_TO * step, math.ceil(EDGE_SIGMAS * spread))
    around = max(_per_code(frame, end - margin, end, step), _per_code(frame, top + 1, top + 1 + margin, step))
    above = frame.pixels_from(top + 1)
    pixels = frame.pixels_from(end) - above
    is_pile = end > margin and dense > _DENSER * around and above <= pixels
    return _Pile(float(centre), spread, end, top, pixels, 0.0) if is_pile else None, low, high


def _lower_end(frame: _Ranks, end: int, step: int) -> int:
    """Return the lowest code of a pile: codes below `end` belong to it that stand out of those below them.

    Rounding hides a spread of less than a code, and noise may be wider below the middle of a pile than above it.
    """
    reach = _CODES_NEXT_TO * step
    while end - step > reach:
        ordinary = _per_code(frame, end - step - reach, end - step, step)
        if frame.counts[end - step] <= max(_DENSER * ordinary, ordinary + _SIGMAS * math.sqrt(ordinary + 1.0)):
            break
        end -= step
    return end


def _mean_near(frame: _Ranks, centre: int, spread: float, step: int) -> int:
    """Return the mean of the values within two standard deviations of a first guess, as a code."""
    reach = step * round(2.0 * spread / step)
    codes = np.arange(max(centre - reach, 0), min(centre + reach, frame.full_scale_dn) + 1, step)
    mean = float(np.average(codes, weights=frame.counts[codes]))
    return int(codes[np.argmin(np.abs(codes - mean))])


def _strays_are_single(frame: _Ranks, top_dn: int) -> bool:
    """Return whether the pixels above a pile are single: an area of them records light that a full sensor would not."""
    strays = frame.pixels_from(top_dn + 1)
    if strays < _FEWEST_PIXELS:
        return True
    above = frame.flat > top_dn
    return bool(np.count_nonzero(above[1:] & above[:-1]) < _SINGLE_SHARE * strays)


def _half_spread(frame: _Ranks, centre: int, end: int, side: int) -> float:
    """Return the standard deviation in DN of one half of a pile, from its centre to where its density ends."""
    codes = np.arange(centre, end, side)
    counts = frame.counts[codes].astype(np.float64)
    counts[:1] *= 0.5
    total = float(np.sum(counts))
    return math.sqrt(float(np.sum(counts * (codes - centre) ** 2.0)) / total) / _CUT_OFF_SPREAD if total else 0.0


def _per_code(frame: _Ranks, low: int, high: int, step: int) -> float:
    """Return the mean count of the codes from `low` up to below `high`."""
    low, high = max(low, 0), min(high, frame.full_scale_dn + 1)
    return float(np.sum(frame.counts[low:high])) * step / (high - low) if high > low else 0.0


def _places_in(frame: _Ranks, pile: _Pile) -> NDArray[np.intp]:
    """Return where pixels of a pile are; of many only some, evenly over the frame."""
    # An odd step does not fall into step with the rows of most frames.
    apart = max(pile.pixels // _PIXELS_COMPARED, 1) | 1
    some = frame.flat[::apart]
    return np.flatnonzero((some >= pile.saturated_dn) & (some <= pile.top_dn)) * apart


def _evidence(longer: _Ranks, shorter: _Ranks, pile: _Pile, places: NDArray[np.intp], step: int) -> float:
    """Return by how many standard deviations a shorter exposure shows that a pile is one of saturated pixels."""
    before = shorter.flat[places]
    if before.size < _FEWEST_PIXELS:
        return 0.0
    low, centre, high = (float(value) for value in np.sort(before)[[before.size * part // 4 for part in (1, 2, 3)]])
    floor_dn = shorter.floor_dn
    predicted = floor_dn + longer.exposure_s / shorter.exposure_s * (centre - floor_dn)
    collapse = 0.0
    if predicted > pile.centre_dn + step + EDGE_SIGMAS * pile.spread_dn:
        # Rounding to codes may take one step off a range or add one.
        ln_ratio = math.log(max(high - low - step, 1e-9) / (pile.spread_dn * _NORMAL_QUARTILES + step))
        collapse = ln_ratio * math.sqrt(before.size) / _LN_RATIO_SIGMA if ln_ratio >= math.log(_COLLAPSE) else 0.0
    # The pixels next to these have the same level and independent noise.
    neighbours = shorter.flat[np.where(places > 0, places - 1, 1)[_in(pile, before)]]
    return max(collapse, _standstill(longer, shorter, pile, neighbours, floor_dn, step))


def _in(pile: _Pile, values: DigitalNumbers) -> NDArray[np.bool_]:
    return (values >= pile.saturated_dn) & (values <= pile.top_dn)


def _standstill(
    longer: _Ranks, shorter: _Ranks, pile: _Pile, already: DigitalNumbers, floor_dn: float, step: int
) -> float:
    """Return the rise that pixels lack which lay in the pile already, over the width of the pile; 0 where none did.

    0 also where darker pixels do not rise: then the exposure itself may be another than its label.

    Args:
        longer: The frame with the pile.
        shorter: One of a shorter exposure.
        pile: The pile.
        already: Values next to those pixels in the shorter exposure, which have the same level and independent noise.
        floor_dn: Black, or a value not below it.
        step: Distance between codes in DN.
    """
    width = pile.top_dn - pile.saturated_dn + step
    lit = shorter.pixels_from(pile.saturated_dn)
    brighter = int(shorter.value(np.array([lit + (shorter.pixels - lit + 3) // 4]))[0])
    apart = max(shorter.pixels // (16 * _PIXELS_COMPARED), 1) | 1  # a quarter of them or less will be darker
    some = shorter.flat[::apart]
    darker = np.flatnonzero((some < pile.saturated_dn) & (some >= brighter)) * apart
    if already.size < _FEWEST_PIXELS or darker.size < _FEWEST_PIXELS:
        return 0.0
    rise = np.median(longer.flat[darker].astype(np.int32) - shorter.flat[darker])
    lacking = (longer.exposure_s / shorter.exposure_s - 1.0) * (np.median(already) - floor_dn)
    return float(_SIGMAS * lacking / (2.0 * width)) if rise > width else 0.0
