"""Which exposures cover a scene: the fewest and shortest that expose every pixel well at least twice."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from radiometer.data import CameraDescription, SensorNoise
from radiometer.errors import SettingOutOfRange, UsageError
from radiometer.units import gain_factor

# A pixel counts as well exposed from this signal-to-noise ratio on …
MINIMUM_SNR = 10.0
# … up to this part of the clipping level, so that noise and a slightly wrong rate do not clip it.
HEADROOM = 0.88
# A plan aims this far above the lowest signal: three times the noise there, so that noise does not undo it.
_PLANNING_MARGIN = 1.0 + 3.0 / MINIMUM_SNR
# Exposures nearer to each other than this teach the response nothing new.
DISTINCT_RATIO = 2.0**0.5
# Rates are gathered in bins this wide (natural logarithm): 1 %.
_BIN_WIDTH = 0.01
_COVER = 2  # frames in which every pixel is well exposed: one alone could not show that it contradicts
_MAXIMUM_FRAMES = 64  # a ladder of 1/3 stop over 21 stops; more is a slip in --stops
_LONGEST_S = 86_400.0  # of exposures in sum for one reading: a day


@dataclass(frozen=True, slots=True)
class ExposureWindow:
    """The signals above black, in DN, between which a pixel counts as well exposed."""

    lowest_dn: float
    highest_dn: float
    clipping_dn: float

    @classmethod
    def of(cls, camera: CameraDescription, gain_db: float, black_level_dn: float) -> ExposureWindow:
        """Return the window of a camera at a gain.

        The lowest signal is where signal over noise reaches MINIMUM_SNR; the highest is HEADROOM of the
        clipping level, which is the converter's or the full well's, whichever comes first.
        """
        noise = SensorNoise.of(camera)
        gain = noise.gain_dn_per_e(gain_db)
        clipping = min(camera.saturated_dn - black_level_dn, noise.full_well_e * gain)
        floor_e2 = noise.read_noise_e**2 + 1.0 / (12.0 * gain**2)
        snr2 = MINIMUM_SNR**2
        lowest_e = (snr2 + math.sqrt(snr2**2 + 4.0 * snr2 * floor_e2)) / 2.0
        lowest = min(lowest_e * gain, HEADROOM * clipping / 2.0)
        return cls(lowest_dn=lowest, highest_dn=HEADROOM * clipping, clipping_dn=clipping)


@dataclass(frozen=True, slots=True)
class ExposurePlan:
    """Exposure times to take, and what they cannot reach.

    Attributes:
        total_s: Sum of the exposure times in s.
    """

    exposures_s: tuple[float, ...]  # exposure times in s, ascending; a time stands as often as it is to be taken
    too_bright: int = 0  # number of pixels that clip even at the shortest exposure
    too_dark: int = 0  # number of pixels that stay under the noise floor even at the longest permitted exposure
    cut_short: bool = False  # whether the time limit kept frames out that were requested

    @property
    def total_s(self) -> float:
        """Return the sum of the exposure times in s."""
        return float(sum(self.exposures_s))


def exposure_ladder(
    shortest_s: float, longest_s: float, stops: float, limits_s: tuple[float, float], repeats: int = 1
) -> ExposurePlan:
    """Return a fixed ladder of exposures from `shortest_s` to `longest_s`, both included, `stops` apart.

    Args:
        shortest_s: First exposure time in s.
        longest_s: Last exposure time in s, not below the first.
        stops: Distance in stops, above 0; the last step may be smaller.
        limits_s: What the camera can do, in s.
        repeats: How often each exposure is taken.

    Raises:
        UsageError: If the ladder makes no sense or holds more than 64 distinct exposures.
        SettingOutOfRange: If it leaves the camera's limits.
    """
    if not (stops > 0 and 0 < shortest_s <= longest_s and repeats >= 1):
        raise UsageError("a ladder needs 0 < shortest <= longest exposure, stops above 0 and at least one repeat")
    for value in (shortest_s, longest_s):
        if not limits_s[0] * (1 - 1e-9) <= value <= limits_s[1] * (1 + 1e-9):
            raise SettingOutOfRange("camera", "exposure time", value, *limits_s, "s")
    count = math.floor(math.log2(longest_s / shortest_s) / stops + 1e-9) + 1
    if count > _MAXIMUM_FRAMES:
        raise UsageError(f"a ladder of {count} exposures is too long; at most {_MAXIMUM_FRAMES}, so take larger steps")
    times = [shortest_s * 2.0 ** (stops * k) for k in range(count)]
    if times[-1] < longest_s * (1 - 1e-6):
        times.append(longest_s)
    return ExposurePlan(tuple(t for t in times for _ in range(repeats)))


def plan_exposures(
    rates_dn_per_s: NDArray[np.float64],
    window: ExposureWindow,
    gain_db: float,
    limits_s: tuple[float, float],
    *,
    time_limit_s: float = math.inf,
) -> ExposurePlan:
    """Return the fewest and shortest exposures that expose every pixel well at least twice.

    The pixel that still lacks cover and is brightest sets the next exposure: the longest at which it does not
    clip, which reaches furthest down. Exposures are kept apart by DISTINCT_RATIO so that a response can be
    recovered from them. This greedy choice is optimal for intervals on a line.

    Args:
        rates_dn_per_s: Signal above black in DN per s of exposure at gain 0 dB, any shape; not above 0 counts as
            too dark, infinite as too bright.
        window: What counts as well exposed at the gain used.
        gain_db: Analogue gain in dB.
        limits_s: Shortest and longest permitted exposure time in s.
        time_limit_s: Bound on the sum of the exposure times in s; the longest exposures are given up first.
    """
    bins = _occupied_bins(rates_dn_per_s * gain_factor(gain_db))
    counts = bins.pixels
    blinding = int(np.count_nonzero(np.isposinf(rates_dn_per_s)))
    too_dark = int(rates_dn_per_s.size - counts.sum()) - blinding
    reachable_top = bins.highest * limits_s[0] <= window.clipping_dn
    reachable_bottom = bins.lowest * limits_s[1] >= window.lowest_dn
    too_bright = int(counts[~reachable_top].sum()) + blinding
    too_dark += int(counts[~reachable_bottom].sum())
    times = _greedy_cover(bins.only(reachable_top & reachable_bottom), window, limits_s)
    if not times:
        times = [limits_s[0] if too_bright >= too_dark else min(limits_s[1], time_limit_s)]
    kept = _within_time(times, time_limit_s)
    return ExposurePlan(tuple(kept), too_bright, too_dark, cut_short=len(kept) < len(times))


# Frames that show whether the light is steady: more where each is short against a period of mains light.
STEADY_FRAMES = 3
STEADY_SHORT_FRAMES = 9  # flicker is random to a short exposure: nine frames average 1 % of it to 0.3 %
_MAINS_PERIODS_S = (0.05, 0.01)  # of 100 and 120 Hz together; of 100 Hz


def steadied(plan: ExposurePlan, flicker_hz: float | None, time_limit_s: float) -> ExposurePlan:
    """Return a plan that averages flicker where light permits, and has frames enough to show it where not.

    Exposures longer than a period of the flicker are shortened to whole periods: the source's where it is known, else
    1/20 s (five of 100 Hz, six of 120 Hz), else 1/100 s.

    Args:
        plan: Exposures that cover the scene.
        flicker_hz: Frequency of the light's flicker in Hz; None where unknown.
        time_limit_s: Bound on the sum of the exposure times in s.
    """
    periods = _MAINS_PERIODS_S if flicker_hz is None else (1.0 / flicker_hz,)
    times = [_whole_periods(t, periods) for t in plan.exposures_s]
    short = max(times, default=0.0) < periods[-1] * (1 - 1e-9)
    frame_count = STEADY_SHORT_FRAMES if short else STEADY_FRAMES
    total = sum(times)
    for exposure in sorted(times, reverse=True) * frame_count:  # the longest first: they weigh most
        if len(times) >= frame_count:
            break
        if total + exposure <= time_limit_s:
            times.append(exposure)
            total += exposure
    return replace(plan, exposures_s=tuple(sorted(times)))


def _whole_periods(exposure_s: float, periods_s: tuple[float, ...]) -> float:
    for period in periods_s:
        if exposure_s >= period:
            return math.floor(exposure_s / period * (1 + 1e-9)) * period
    return exposure_s


def repeats_for(
    plan: ExposurePlan,
    rates_dn_per_s: NDArray[np.float64],
    camera: CameraDescription,
    gain_db: float,
    target_u_rel: float,
) -> int:
    """Return how often a plan must be taken so that the mean of a region reaches a relative uncertainty.

    Args:
        rates_dn_per_s: Rates of the region's pixels in DN per s at gain 0 dB.
        gain_db: Analogue gain in dB.
        target_u_rel: Wanted relative standard uncertainty (k = 1) of the region's mean from noise, above 0.

    Raises:
        UsageError: If the target is not above 0, or takes exposures of more than a day.
    """
    if not target_u_rel > 0:
        raise UsageError(f"a relative uncertainty of {target_u_rel:g} cannot be reached; ask for more than 0")
    noise = SensorNoise.of(camera)
    rate = float(np.mean(np.maximum(rates_dn_per_s, 0.0))) * gain_factor(gain_db)
    if rate <= 0:
        return 1
    window = ExposureWindow.of(camera, gain_db, camera.black_level_dn or 0.0)
    information = sum(
        (rate * t) ** 2 / float(noise.variance_dn2(rate * t, gain_db))
        for t in plan.exposures_s
        if rate * t <= window.highest_dn
    )
    if information == 0:
        return 1
    per_pass = 1.0 / math.sqrt(information * max(1, rates_dn_per_s.size))
    passes, longest = (per_pass / target_u_rel) ** 2, max(_LONGEST_S / sum(plan.exposures_s), 1.0)
    if passes > longest:
        raise UsageError(
            f"a relative uncertainty of {target_u_rel:g} needs exposures of more than a day in sum; ask for "
            f"{per_pass / math.sqrt(longest):.2g} or more"
        )
    return max(1, math.ceil(passes - 1e-9))


@dataclass(frozen=True, slots=True, eq=False)
class _Bins:
    """Rates gathered in bins, ascending: the lowest and highest rate in each, and its number of pixels."""

    lowest: NDArray[np.float64]
    highest: NDArray[np.float64]
    pixels: NDArray[np.int64]

    def only(self, chosen: NDArray[np.bool_]) -> _Bins:
        return _Bins(self.lowest[chosen], self.highest[chosen], self.pixels[chosen])


def _occupied_bins(rates: NDArray[np.float64]) -> _Bins:
    positive = np.sort(rates[np.isfinite(rates) & (rates > 0)], axis=None)
    if positive.size == 0:
        return _Bins(np.empty(0), np.empty(0), np.empty(0, np.int64))
    bins = np.floor(np.log(positive) / _BIN_WIDTH).astype(np.int64)
    _, first, pixels = np.unique(bins, return_index=True, return_counts=True)
    return _Bins(positive[first], positive[first + pixels - 1], pixels.astype(np.int64))


def _greedy_cover(bins: _Bins, window: ExposureWindow, limits_s: tuple[float, float]) -> list[float]:
    cover = np.zeros(bins.pixels.size, np.int64)
    times: list[float] = []
    while bins.pixels.size and len(times) < _MAXIMUM_FRAMES:
        lacking = np.flatnonzero(cover < _COVER)
        if lacking.size == 0:
            break
        longest = min(window.highest_dn / bins.highest[lacking[-1]], limits_s[1])
        exposure = _distinct(max(longest, limits_s[0]), times, limits_s[0])
        times.append(exposure)
        above = bins.lowest * exposure >= window.lowest_dn * _PLANNING_MARGIN
        gained = above & (bins.highest * exposure <= window.highest_dn * (1 + 1e-9))
        # What the camera's limits keep from being covered as often as intended must not hold the others up.
        gained[lacking[-1]] = True
        cover += gained
    return sorted(map(float, times))


def _distinct(exposure_s: float, taken: Sequence[float], shortest_s: float) -> float:
    """Return the longest exposure not above the given one that is apart from those taken."""
    candidate = exposure_s
    for other in sorted(taken, reverse=True):
        if other / DISTINCT_RATIO < candidate * (1 + 1e-9) and candidate < other * DISTINCT_RATIO * (1 - 1e-9):
            candidate = other / DISTINCT_RATIO
    return candidate if candidate >= shortest_s else exposure_s


def _within_time(times: list[float], time_limit_s: float) -> list[float]:
    kept: list[float] = []
    for exposure in sorted(times):
        if sum(kept) + exposure > time_limit_s and kept:
            break
        kept.append(exposure)
    return kept
