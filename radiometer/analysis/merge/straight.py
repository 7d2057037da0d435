"""Compiled: sums into rate and variance, pixel by pixel with as few branches as can be."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from radiometer.analysis.merge.censored import near_clipping
from radiometer.analysis.merge.moments import FIRST_LEVEL, SHARE, TOTAL, VARIANCE, fill_levels, from_root_table
from radiometer.analysis.merge.records import (
    A0,
    A1,
    D1,
    D2,
    INV1,
    INV2,
    LONGEST,
    NEAR,
    P0,
    P1,
    PLENTY,
    PLENTY0,
    PLENTY1,
    R0,
    R1,
    ROOT,
    S2,
)
from radiometer.compiled import compiled, compiled_apart
from radiometer.data.radiance_map import PixelMask

NOISE_FLOOR_SIGMA = 2.0
_BELOW_NOISE = np.uint8(PixelMask.BELOW_NOISE)
_EXTRAPOLATED = np.uint8(PixelMask.EXTRAPOLATED)
_INCONSISTENT = np.uint8(PixelMask.INCONSISTENT)
ONLY_NEAR_CLIPPING = np.uint8(2)  # frames that clip may say something; nothing else is doubtful


@compiled
def marks(rate: float, variance: float) -> Any:  # pragma: no cover (compiled)
    """Return the mask of a pixel that is below the noise, or of one that is not."""
    below = (rate < 0.0) | (rate * rate < NOISE_FLOOR_SIGMA**2 * variance)
    return _BELOW_NOISE if below else np.uint8(0)


@compiled_apart
def straight(
    first: Any,
    second: Any,
    squares: Any,
    bits: Any,
    slots: Any,
    records: Any,
    dark: bool,
    rates: Any,
    variances: Any,
    mask: Any,
    doubtful: Any,
) -> None:  # pragma: no cover (compiled)
    """Write rate, variance and mask of a run of pixels, and of which of them `finish` has more to say.

    Args:
        first: Σt^0.35·x, float32.
        second: Σt·x, float32.
        squares: Σx², float32.
        bits: Frames used in each pixel.
        slots: Place of their record, unsigned.
        records: As of `fill_record`, shape (sets, RECORD_SIZE).
        dark: Whether the frames have a common uncertainty of the dark level.
        rates: Written.
        variances: Written.
        mask: PixelMask bits, written where there is no more to say.
        doubtful: Whether there is (`ONLY_NEAR_CLIPPING` where that is all), written.
    """
    # Frames that clip are heard before what is common to all.
    near = np.uint8(ONLY_NEAR_CLIPPING | 1) if dark else ONLY_NEAR_CLIPPING
    for i in range(bits.size):
        k = slots[i]
        sum_b = np.float64(second[i])
        rate_b = sum_b * records[k, INV2]
        apart = np.float64(first[i]) * records[k, INV1] - rate_b
        seen = max(rate_b, 0.0)
        share = (records[k, P0] + records[k, P1] * seen) / (records[k, R0] + records[k, R1] * seen)
        seen = max(rate_b + share * apart, 0.0)
        of_b, of_both = records[k, P0] + records[k, P1] * seen, records[k, R0] + records[k, R1] * seen
        inverse, gap = 1.0 / of_both, of_both - of_b
        share = of_b * inverse
        rate = rate_b + share * apart
        variance = records[k, A0] + records[k, A1] * seen - gap * gap * inverse
        if dark:
            common = records[k, D2] + share * (records[k, D1] - records[k, D2])
            variance += common * common
        scatter = np.float64(squares[i]) - rate * (2.0 * sum_b - rate * records[k, S2])
        plenty = records[k, PLENTY0] + records[k, PLENTY1] * seen
        rates[i], variances[i] = rate, variance
        more = np.uint8((scatter > plenty) | (bits[i] == 0))
        doubtful[i] = more | near if rate < records[k, NEAR] else more
    for i in range(bits.size):
        mask[i] = mask[i] if doubtful[i] else marks(rates[i], variances[i])


@compiled
def straight_curved(
    first: Any,
    second: Any,
    squares: Any,
    bits: Any,
    slots: Any,
    records: Any,
    levels: Any,
    frames: Any,
    kappa: float,
    gains: Any,
    quantisation: Any,
    curve: Any,
    top: float,
    valid: Any,
    rates: Any,
    variances: Any,
    mask: Any,
    doubtful: Any,
) -> None:  # pragma: no cover (compiled)
    """Do as `straight` does behind a response curve; its further arguments are those of `finish.finish`."""
    steps, last = levels.shape[1] - 1, np.uint64(0)
    for i in range(bits.size):
        pattern, slot = np.uint64(bits[i]), slots[i]
        doubtful[i] = 1
        if pattern == 0:
            continue
        if pattern != last:
            last, longest = pattern, int(records[slot, LONGEST])
            of_longest, per_root = frames[longest, 0] * gains[longest], records[slot, ROOT] * steps
            inv1, inv2, s2, near = records[slot, INV1], records[slot, INV2], records[slot, S2], records[slot, NEAR]
            plenty, d1, d2 = records[slot, PLENTY], records[slot, D1], records[slot, D2]
        sum_b = np.float64(second[i])
        rate_b = sum_b * inv2
        apart = np.float64(first[i]) * inv1 - rate_b
        place = math.sqrt(max(rate_b, 0.0)) * per_root
        if not FIRST_LEVEL <= place < steps:
            continue
        k = int(place)
        if levels[slot, k, VARIANCE] == 0.0 or levels[slot, k + 1, VARIANCE] == 0.0:
            fill_levels(k, pattern, records[slot], levels[slot], frames, gains, kappa, quantisation, top)
        share = levels[slot, k, SHARE] + (place - k) * (levels[slot, k + 1, SHARE] - levels[slot, k, SHARE])
        place = math.sqrt(max(rate_b + share * apart, 0.0)) * per_root
        if not FIRST_LEVEL <= place < steps:
            continue
        k = int(place)
        above = place - k
        if levels[slot, k, VARIANCE] == 0.0 or levels[slot, k + 1, VARIANCE] == 0.0:
            fill_levels(k, pattern, records[slot], levels[slot], frames, gains, kappa, quantisation, top)
        share = levels[slot, k, SHARE] + above * (levels[slot, k + 1, SHARE] - levels[slot, k, SHARE])
        variance = levels[slot, k, VARIANCE] + above * (levels[slot, k + 1, VARIANCE] - levels[slot, k, VARIANCE])
        total = levels[slot, k, TOTAL] + above * (levels[slot, k + 1, TOTAL] - levels[slot, k, TOTAL])
        rate = rate_b + share * apart
        scatter = np.float64(squares[i]) - rate * (2.0 * sum_b - rate * s2)
        if scatter > plenty * total:
            continue
        level = max(rate, 0.0) * of_longest
        level_u = from_root_table(level, curve, top)
        found = _EXTRAPOLATED if (level < valid[0]) | (level > valid[1]) else np.uint8(0)
        if rate < near:
            rate, variance, contradiction = near_clipping(rate, variance, pattern, slot, records, frames, kappa)
            found |= _INCONSISTENT if contradiction else np.uint8(0)
        variance += (d2 + share * (d1 - d2)) ** 2
        rates[i], variances[i], mask[i] = rate, variance + (level_u * rate) ** 2, marks(rate, variance) | found
        doubtful[i] = 0
