"""The white level: the digital number from which pixels are saturated, as the frames of one capture show it.

A sensor, an amplifier or a converter stops somewhere, often below full scale and below what a file states. The pixels
beyond gather in a narrow pile, with some DN of noise, and with single stray pixels (hot ones, glitches) above it. The
highest value that occurs therefore says little. A pile alone says little too: an evenly lit area makes one. What
distinguishes saturated pixels is how they behave while the exposure grows:

* The longer exposure makes the values of these pixels more alike than the shorter one did. Where light is still
  recorded it does the reverse: differences between pixels grow with the exposure, and so does the noise of the light.
  The pixels also lie below what the shorter exposure predicts.
* Or these pixels have the same value in two exposures, while darker pixels rise.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from radiometer.data.bracket import Bracket
from radiometer.data.frame import DigitalNumbers, Frame

Basis = Literal["measured", "stated", "assumed"]

# A quartile range of n values scatters by 1.17/sqrt(n) of itself (normal distribution), the ratio of two by sqrt(2)
# more. Of some thousand comparisons in a capture none passes 5 standard deviations by chance.
_SIGMAS = 5.0
_LN_RATIO_SIGMA = 1.17 * math.sqrt(2.0)
# No light source and no shutter is off by a factor of two between two frames: what halves the spread is no flicker.
_COLLAPSE = 2.0
# Exposures whose labels differ by less do not count as different: shutters are true to a few per cent.
_DIFFERENT_EXPOSURE = 1.1
# The pile reaches down to this many standard deviations of its spread; 3e-5 of a normal distribution lie below.
_EDGE_SIGMAS = 4.0
_QUARTILES_OF_PILE = 1.28  # quartile range over standard deviation of a normal distribution cut off at that density
# A pile ends where its middle is so many times as dense: 2 standard deviations away in a normal distribution.
_DENSER = 8.0
_FEWEST_PIXELS = 24  # in a pile: fewer can halve their spread by chance
_RANKS_PER_DOUBLING = 4
_CODES_BELOW = 16  # below a pile: their median count is that of ordinary pixels
_PILES_TRIED = 6  # distinct ones in a frame
_PIXELS_COMPARED = 4096  # of a pile: quartile ranges are then known to 2 per cent
_FRAMES_LOOKED_AT = 8  # of one gain, evenly over the exposures: every pair of them is compared


@dataclass(frozen=True, slots=True)
class WhiteLevel:
    """The white level of the frames of one gain.

    Attributes:
        saturated_dn: Digital numbers at or above are saturated.
        basis: "measured" where the pile-up decides, "stated" where the file or camera does, "assumed" where only the
            bit depth is known.
        stated_dn: As the file or camera states it, else the highest code, in DN.
        measured_dn: Centre of the pile in DN; None where the frames show none.
        spread_dn: Standard deviation of the pile in DN.
        piled_pixels: Pixels in the pile, of the frame that shows it best.
        stray_pixels: Pixels above the pile in that frame.
        reached_dn: The highest digital number that more than single pixels reach.
        exposures: Different exposures that were compared.
    """

    saturated_dn: int
    basis: Basis
    stated_dn: int
    measured_dn: float | None = None
    spread_dn: float = 0.0
    piled_pixels: int = 0
    stray_pixels: int = 0
    reached_dn: int = 0
    exposures: int = 1

    @property
    def disagrees(self) -> bool:
        """Tell whether the frames show another white level than is stated."""
        if self.measured_dn is None:
            return False
        return abs(self.measured_dn - self.stated_dn) > _EDGE_SIGMAS * self.spread_dn + 1.0

    @property
    def sentence(self) -> str:
        """Return which white level is used and why, in plain words."""
        origin = "the bit depth gives" if self.basis == "assumed" or self.stated_dn == 0 else "stated are"
        if self.measured_dn is not None and self.disagrees:
            where = (
                f"{self.piled_pixels} pixels pile up at {self.measured_dn:.0f} ± {self.spread_dn:.1f} DN while the "
                f"exposure grows"
            )
            if self.saturated_dn < self.stated_dn:
                return (
                    f"white level {self.saturated_dn} DN: {where}; {origin} {self.stated_dn} DN, which is not reached"
                )
            return f"white level {self.saturated_dn} DN as stated, although {where}: no value above it is used"
        if self.measured_dn is not None:
            return f"white level {self.saturated_dn} DN, as the frames show it ({self.piled_pixels} pixels pile up)"
        if self.exposures < 2:
            return f"white level {self.saturated_dn} DN assumed: one exposure cannot show where pixels saturate"
        return (
            f"white level {self.saturated_dn} DN assumed: the frames reach {self.reached_dn} DN and show no pile-up "
            "of saturated pixels"
        )


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
    strays: int
    sigmas: float


def histogram(dn: DigitalNumbers, full_scale_dn: int) -> NDArray[np.int64]:
    """Return how many pixels have each digital number, shape (full scale + 1,)."""
    size = full_scale_dn + 1
    counts = cv2.calcHist([np.ascontiguousarray(dn)], [0], None, [size], [0, size])
    return np.asarray(counts.ravel(), dtype=np.float64).astype(np.int64)


def find_white_levels(frames: Iterable[Frame]) -> dict[float, WhiteLevel]:
    """Return the white level of every gain in dB among frames of one camera and pixel format.

    Frames are compared where pattern and drive of the source are the same. Where the frames of a gain show no pile,
    the lowest that another gain shows is used for it: a converter ends at one number for all gains, and a full well
    ends lower at lower gains only.

    Args:
        frames: Dark frames are left out. Frames state their white level in their settings where a file does.
    """
    ranked = [_Ranks(frame) for frame in frames if not frame.settings.is_dark]
    if not ranked:
        return {}
    gains = sorted({one.settings.gain_db for one in ranked})
    step = _code_step(ranked)
    piles = {gain: _pile_of_gain(ranked, gain, step) for gain in gains}
    shown = [pile for pile in piles.values() if pile is not None]
    lowest = min(shown, key=lambda pile: pile.saturated_dn, default=None)
    return {gain: _decided([r for r in ranked if r.settings.gain_db == gain], piles[gain], lowest) for gain in gains}


def with_white_levels(bracket: Bracket) -> tuple[Bracket, dict[float, WhiteLevel]]:
    """Return a bracket whose frames carry the white level that all of them show, and the level of every gain in dB."""
    levels = find_white_levels(looked_at(bracket.frames))
    return replace(bracket, frames=tuple(marked(frame, levels) for frame in bracket.frames)), levels


def marked(frame: Frame, levels: dict[float, WhiteLevel]) -> Frame:
    """Return a frame that carries the white level of its gain."""
    level = levels.get(frame.settings.gain_db)
    if level is None:
        return frame
    return replace(frame, settings=replace(frame.settings, white_level_dn=float(level.saturated_dn)))


def looked_at(frames: Sequence[Frame]) -> list[Frame]:
    """Return the frames that are enough to find the white level: of each gain some, evenly over the exposures."""
    groups: dict[tuple[float, str, float], list[Frame]] = {}
    for frame in frames:
        groups.setdefault((frame.settings.gain_db, frame.settings.pattern, frame.settings.source_level), []).append(
            frame
        )
    chosen = []
    for group in groups.values():
        ordered = sorted(group, key=lambda f: f.settings.exposure_s)
        places = np.unique(np.linspace(0, len(ordered) - 1, _FRAMES_LOOKED_AT).round().astype(int))
        chosen += [ordered[k] for k in places]
    return chosen


def _decided(frames: Sequence[_Ranks], pile: _Pile | None, lowest: _Pile | None) -> WhiteLevel:
    """Return the white level of frames of one gain from what they show and what they state."""
    full_scale = frames[0].full_scale_dn
    stated = [one.settings.white_level_dn for one in frames if one.settings.white_level_dn is not None]
    stated_dn = min(full_scale, math.floor(min(stated))) if stated else full_scale
    reached = max(int(one.value(np.array([min(_FEWEST_PIXELS, one.pixels)]))[0]) for one in frames)
    exposures = len({one.settings.effective_exposure_s for one in frames})
    basis: Basis = "stated" if stated else "assumed"
    saturated = stated_dn
    if pile is None and lowest is not None and lowest.saturated_dn < stated_dn:
        saturated, basis = lowest.saturated_dn, "measured"
    if pile is None:
        return WhiteLevel(saturated, basis, stated_dn, reached_dn=reached, exposures=exposures)
    if pile.saturated_dn <= stated_dn:
        saturated, basis = pile.saturated_dn, "measured"
    return WhiteLevel(
        saturated,
        basis,
        stated_dn,
        pile.centre_dn,
        pile.spread_dn,
        pile.pixels,
        pile.strays,
        reached,
        exposures,
    )


def _code_step(frames: Sequence[_Ranks]) -> int:
    """Return the distance between codes in DN: more than 1 where the low bits are padding."""
    occupied = np.flatnonzero(sum(one.counts for one in frames))
    return max(int(np.gcd.reduce(occupied)), 1) if occupied.size > 2 else 1


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
    if not found:
        return None
    best = max(found, key=lambda pile: pile.sigmas)
    same = [
        p for p in found if abs(p.centre_dn - best.centre_dn) <= _EDGE_SIGMAS * (p.spread_dn + best.spread_dn) + step
    ]
    return replace(best, saturated_dn=min(pile.saturated_dn for pile in same))


def _is_shorter(one: _Ranks, other: _Ranks) -> bool:
    a, b = one.settings, other.settings
    same_light = a.pattern == b.pattern and a.source_level == b.source_level
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
        if pile.strays <= pile.pixels:
            sigmas = max(_evidence(longer, one, pile, step) for one in shorter)
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


def _extent(frame: _Ranks, upper: int, centre: int, lower: int, step: int) -> tuple[_Pile, int, int]:
    """Return the pile around a dense run of given quartiles, and where its density has fallen to an eighth."""
    width = max((upper - lower) // 2 // step, 1) * step
    starts = np.arange((centre - width // 2) % width, frame.full_scale_dn + 1, width)
    counts = np.add.reduceat(frame.counts, starts)
    middle = int(np.searchsorted(starts, centre, "right")) - 1
    sparse = np.flatnonzero(counts <= counts[middle] / _DENSER)
    place = int(np.searchsorted(sparse, middle))
    low = int(starts[sparse[place - 1] + 1]) if place > 0 else 0
    high = int(starts[sparse[place]]) if place < sparse.size else frame.full_scale_dn + 1
    first, last = frame.pixels_from(high), frame.pixels_from(low)
    ranks = np.array([first + (part * (last - first) + 3) // 4 for part in (1, 2, 3)])
    upper, centre, lower = (int(value) for value in frame.value(ranks))
    spread = (upper - lower) / _QUARTILES_OF_PILE
    end = max(math.ceil(centre - _EDGE_SIGMAS * spread - 0.5 * step), 1)
    # Rounding hides a spread of less than a code, and noise behind the clipping may reach further down than the
    # quartiles suggest: values that stand out of those below belong to the pile.
    background = float(np.median(frame.counts[max(end - _CODES_BELOW * step, 0) : end : step])) if end > step else 0.0
    most = background + _SIGMAS * math.sqrt(background + 1.0)
    while end > step and frame.counts[end - step] > most:
        end -= step
    top = math.floor(centre + _EDGE_SIGMAS * max(spread, step / 2.0))
    above = frame.pixels_from(top + 1)
    return _Pile(float(centre), spread, end, top, frame.pixels_from(end) - above, above, 0.0), low, high


def _evidence(longer: _Ranks, shorter: _Ranks, pile: _Pile, step: int) -> float:
    """Return by how many standard deviations a shorter exposure shows that a pile is one of saturated pixels."""
    places = np.flatnonzero((longer.flat >= pile.saturated_dn) & (longer.flat <= pile.top_dn))
    places = places[:: max(places.size // _PIXELS_COMPARED, 1)]
    before = shorter.flat[places]
    if before.size < _FEWEST_PIXELS:
        return 0.0
    low, centre, high = (float(value) for value in np.sort(before)[[before.size * part // 4 for part in (1, 2, 3)]])
    black = shorter.settings.black_level_dn
    floor_dn = float(shorter.value(np.array([shorter.pixels]))[0]) if black is None else black
    predicted = floor_dn + longer.exposure_s / shorter.exposure_s * (centre - floor_dn)
    collapse = 0.0
    if predicted > pile.centre_dn + step + _EDGE_SIGMAS * pile.spread_dn:
        # Rounding to codes may take one step off a range or add one.
        ln_ratio = math.log(max(high - low - step, 1e-9) / (pile.spread_dn * _QUARTILES_OF_PILE + step))
        collapse = ln_ratio * math.sqrt(before.size) / _LN_RATIO_SIGMA if ln_ratio >= math.log(_COLLAPSE) else 0.0
    # The pixels next to these have their level, and noise of their own.
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
        already: Values next to those pixels in the shorter exposure, which have their level and noise of their own.
        floor_dn: Black, or a value not below it.
        step: Distance between codes in DN.
    """
    width = pile.top_dn - pile.saturated_dn + step
    lit = shorter.pixels_from(pile.saturated_dn)
    brighter = int(shorter.value(np.array([lit + (shorter.pixels - lit + 3) // 4]))[0])
    darker = np.flatnonzero((shorter.flat < pile.saturated_dn) & (shorter.flat >= brighter))
    if already.size < _FEWEST_PIXELS or darker.size < _FEWEST_PIXELS:
        return 0.0
    darker = darker[:: max(darker.size // _PIXELS_COMPARED, 1)]
    rise = np.median(longer.flat[darker].astype(np.int32) - shorter.flat[darker])
    lacking = (longer.exposure_s / shorter.exposure_s - 1.0) * (np.median(already) - floor_dn)
    return float(_SIGMAS * lacking / (2.0 * width)) if rise > width else 0.0
