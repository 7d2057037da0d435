"""The digital numbers at which a camera is black or saturated, read off the frames, and by what power they grow."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radiometer.analysis.signal.model import mean_darks, unexposed_dn, whole_darks
from radiometer.data.frame import Bracket, Frame
from radiometer.data.pile_up import with_white_levels
from radiometer.errors import MeasurementError

# Black gathers whatever is below it: its count stands out from so many neighbours by this factor.
_PILE_UP, _NEIGHBOURS = 8.0, 8
# Fog holds still while the exposure grows: over this many frames, by this factor in all, to this share of full scale,
# with this share of the picture in the peak.
_STILL_FRAMES, _STILL_GROWTH, _STILL_SHARE, _PEAK_SHARE = 3, 3.0, 1.0 / 128.0, 0.05
# A signal below 3 widths would grow by less than one behind the square root of a tripled exposure.
_CLEAR = 3
# Numbers that are asked, as shares of the span from black to white: clear of rounding, of stray light and of clipping.
_LOWEST_SHARE: Final = 0.1
_HIGHEST_SHARE: Final = 0.95
_FEWEST_PIXELS: Final = 50  # that two frames show: their median ratio is then known to some per cent at the noisiest
_LEAST_RATIO: Final = 1.2  # of two exposures; nearer ones say little of growth
_PIXELS: Final = 50_000  # so many show the ends of a histogram; more cost time alone


@dataclass(frozen=True, slots=True)
class ValueLimits:
    """Digital numbers that carry no information."""

    black_dn: int  # values at or below are black (clipped, or the black level itself)
    saturated_dn: int  # values at or above are saturated
    no_light_dn: float = 0.0  # digital number of no light: the black level, where it is known


def find_limits(brackets: Sequence[Bracket]) -> ValueLimits:
    """Return the black and saturation level of brackets taken with one camera.

    Saturation is the lowest white level that the frames of a bracket show or state. Black is the stated black level,
    else that of the dark frames, or the lowest value where it gathers far more pixels than those next above it.
    Besides, a value at which much of the shortest frames stands still while their exposure grows is black: the fog of
    a film, or a black level that is not stated.

    Raises:
        MeasurementError: If every value of every frame is clipped.
    """
    full_scale = (1 << brackets[0].bit_depth) - 1
    histogram = np.zeros(full_scale + 1, dtype=np.int64)
    for bracket in brackets:
        for frame in bracket.light:
            histogram += np.bincount(frame.dn.ravel(), minlength=full_scale + 1)[: full_scale + 1]
    known = [f.settings.black_level_dn for b in brackets for f in b.light if f.settings.black_level_dn]
    known = known or [level for b in brackets if (level := black_of_darks(b)) is not None]
    fog = max(_fog(bracket, full_scale) for bracket in brackets)
    black = max(_floor(histogram), int(np.ceil(max(known))) if known else 0, fog)
    no_light = max(known) if known else float(black)
    saturated = min(white_level_dn(bracket) for bracket in brackets)
    if saturated - black < 4 or histogram[black + 1 : saturated].sum() == 0:
        raise MeasurementError(_all_clipped(histogram, full_scale))
    return ValueLimits(black, saturated, no_light)


def black_of_darks(bracket: Bracket) -> float | None:
    """Return the black level in DN that dark frames show, where no light frame states it; None without any.

    It is the one that `black_from_darks` takes. Of one exposure time, the dark current is not taken off.
    """
    used = whole_darks(bracket.dark)
    if not used or any(frame.settings.black_level_dn for frame in bracket.light):
        return None
    times, means = mean_darks(used)
    line = unexposed_dn(times, means)
    return float(means.mean()) if line is None else line[0]


def with_stated_black(bracket: Bracket, black_dn: float | None) -> Bracket:
    """Return a bracket whose light frames state the camera's black level in DN, where dark frames do not show it.

    They do where they are of several exposure times; else their dark current is not known apart from it.
    """
    used = whole_darks(bracket.dark)
    if not black_dn or (used and unexposed_dn(*mean_darks(used)) is not None):
        return bracket
    light = [
        replace(f, settings=replace(f.settings, black_level_dn=f.settings.black_level_dn or black_dn))
        for f in bracket.light
    ]
    return replace(bracket, light=tuple(light))


def white_level_dn(bracket: Bracket) -> int:
    """Return the lowest digital number from which frames of a bracket are saturated."""
    return min(frame.saturated_dn for frame in with_white_levels(bracket.light))


def _fog(bracket: Bracket, full_scale: int) -> int:
    """Return the commonest value of the shortest frames where it does not move with the exposure, else 0."""
    times = bracket.effective_exposures_s
    shortest = max(_STILL_FRAMES, int(np.searchsorted(times, _STILL_GROWTH * times[0])) + 1)
    if shortest > len(bracket.light) // 2:
        return 0
    low = _common_peak(bracket.light[:shortest], full_scale) or 0
    return low if low < (full_scale + 1) // 2 else 0


def _common_peak(frames: Sequence[Frame], full_scale: int) -> int | None:
    """Return the value that the most pixels of every frame have, where it is the same in all."""
    width = max(int(_STILL_SHARE * full_scale), 1)
    peaks = []
    for frame in frames:
        counts = np.bincount(frame.dn.ravel(), minlength=full_scale + 1)
        peak = int(np.argmax(counts))
        if counts[max(peak - width, 0) : peak + width + 1].sum() < _PEAK_SHARE * frame.dn.size:
            return None
        peaks.append(peak)
    # Nearer to an end, a signal would not have moved by more than the peak is wide.
    clear = min(peaks) >= _CLEAR * width and max(peaks) <= full_scale - _CLEAR * width
    return max(peaks) if clear and max(peaks) - min(peaks) <= width else None


def _floor(histogram: NDArray[np.int64]) -> int:
    """Return the highest of the values that pile up above the lowest one; 0 where none does."""
    bottom = int(np.flatnonzero(histogram)[0])
    piled = itertools.takewhile(lambda value: _piles_up(histogram, value), range(bottom, histogram.size - 1))
    return max(piled, default=0)


def _piles_up(histogram: NDArray[np.int64], value: int) -> bool:
    """Return whether far more pixels have a value than those next above it."""
    neighbours = histogram[value + 1 : value + _NEIGHBOURS + 1]
    return bool(neighbours.size) and bool(histogram[value] > _PILE_UP * max(float(neighbours.mean()), 1.0))


def _all_clipped(histogram: NDArray[np.int64], full_scale: int) -> str:
    total = max(int(histogram.sum()), 1)
    white, black = 100.0 * histogram[full_scale] / total, 100.0 * histogram[0] / total
    cure = "shorter" if white >= black else "longer"
    return (
        f"all frames are clipped ({white:.0f} % of the values saturated, {black:.0f} % black); take {cure} exposures "
        "so that the scene shows between black and white"
    )


def growth_power(bracket: Bracket, black_dn: float = 0.0) -> float | None:
    """Return p of M − black ∝ (exposure)^p: 1 of a linear camera; None where no two frames show the same pixels.

    The median over pairs of neighbouring frames of Δln(M − black) / Δln(exposure), each that of its pixels' median, so
    that one wrong time in four or more says nothing. Behind a gamma of 1/2.2 it is 0.45.
    """
    try:
        span = find_limits([bracket]).saturated_dn - black_dn
    except MeasurementError:  # nothing but black and white
        return None
    step = max(1, int(np.sqrt(bracket.shape[0] * bracket.shape[1] / _PIXELS)))
    signals = [(frame.dn[::step, ::step].ravel().astype(np.float64) - black_dn) / span for frame in bracket.light]
    log_times = np.log(bracket.effective_exposures_s)
    powers = [
        power
        for a, b in itertools.pairwise(range(len(bracket.light)))
        if (power := _power(signals[a], signals[b], float(log_times[b] - log_times[a]))) is not None
    ]
    return float(np.median(powers)) if powers else None


def _power(short: NDArray[np.float64], long: NDArray[np.float64], log_ratio: float) -> float | None:
    """Return the power of two frames; None where too few pixels show in both, or their exposures hardly differ."""
    lowest, highest = np.minimum(short, long), np.maximum(short, long)
    shown = (lowest > _LOWEST_SHARE) & (highest < _HIGHEST_SHARE)
    if log_ratio < np.log(_LEAST_RATIO) or np.count_nonzero(shown) < _FEWEST_PIXELS:
        return None
    return float(np.median(np.log(long[shown] / short[shown]))) / log_ratio
