"""Compiled last step of the merge: sums into radiance, standard uncertainty and mask."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from radiometer.analysis.merge.censored import with_censored
from radiometer.analysis.merge.moments import (
    FIRST_LEVEL,
    SHARE,
    SQUARES,
    TOTAL,
    VARIANCE,
    at_rate,
    fill_levels,
    from_root_table,
)
from radiometer.analysis.merge.records import (
    A0,
    A1,
    AGREEMENT_SIGMA,
    C1,
    CC,
    D1,
    D2,
    G0,
    G1,
    INV1,
    INV2,
    LONGEST,
    NEAR,
    NEAREST,
    NEXT,
    P0,
    P1,
    PLENTY,
    R0,
    R1,
    ROOT,
    S2,
    V0,
    V1,
    fill_record,
    scatter_limit,
)
from radiometer.compiled import compiled
from radiometer.data.radiance_map import PixelMask

SATURATED = np.uint8(PixelMask.SATURATED)
BELOW_NOISE = np.uint8(PixelMask.BELOW_NOISE)
EXTRAPOLATED = np.uint8(PixelMask.EXTRAPOLATED)
INCONSISTENT = np.uint8(PixelMask.INCONSISTENT)
_NOISE_FLOOR_SIGMA = 2.0
_RUN = 1024  # pixels whose square roots are taken together: only a loop without branches is vectorised
_PROBES = 8
_HASH = np.uint64(0x9E3779B97F4A7C15)  # 2^64 over the golden ratio (Knuth, vol. 3, 6.4)


@compiled
def finish(
    first: Any,
    second: Any,
    squares: Any,
    bits: Any,
    mask: Any,
    known: Any,
    records: Any,
    levels: Any,
    frames: Any,
    kappa: float,
    bounds: Any,
    gains: Any,
    quantisation: Any,
    curve: Any,
    top: float,
    valid: Any,
    factor: Any,
    radiance: Any,
    u_radiance: Any,
) -> None:  # pragma: no cover (compiled)
    """Turn the sums of a block into radiance, standard uncertainty and mask.

    Args:
        first: Σt^0.35·x, float32; may be `radiance` itself.
        second: Σt·x, float32; may be `u_radiance` itself.
        squares: Σx², float32.
        bits: Frames used in each pixel, uint64.
        mask: Clipping seen in each pixel; overwritten by PixelMask bits.
        known: Sets of frames that `records` and `levels` hold something of; as is the rest, kept from block to block.
        records: As of `fill_record`, shape (sets, RECORD_SIZE); their number is a power of 2.
        levels: As in `moments.at_level`, shape (sets, levels, 4); of no size for a linear sensor.
        frames: As in `records.fill_record`.
        kappa: Shot noise variance per unit of x.
        bounds: Rate that is the lower bound where all frames clip, the upper bound where all are black, and the
            relative difference between frames that is never called inconsistent.
        gains: Gain factor of every frame.
        quantisation: Variance (dx/dM)²/12 over √x, for `from_root_table`; None for a linear sensor, where it is part
            of `frames` (the loop is compiled for each).
        curve: Relative standard uncertainty of x over √x.
        top: x of the last entry of both.
        valid: Lowest and highest x times gain that the response curve has data for.
        factor: Radiance per rate, of every pixel or of all (size 1), float32.
        radiance: Written.
        u_radiance: Written.
    """
    rates, variances = np.empty(_RUN), np.empty(_RUN)
    record, last, slot = records[0], np.uint64(0), 0
    for start in range(0, bits.size, _RUN):
        count = min(_RUN, bits.size - start)
        for j in range(count):
            i = start + j
            pattern = bits[i]
            if pattern == 0:  # no frame shows this pixel unclipped
                white = mask[i] & SATURATED
                rates[j] = bounds[0] if white else bounds[1]
                variances[j] = rates[j] ** 2
                mask[i] = SATURATED if white else BELOW_NOISE
                continue
            if pattern != last:
                last = pattern
                slot = _place_of(pattern, known)
                record = records[slot]
                if known[slot] != pattern:
                    known[slot] = pattern
                    fill_record(record, pattern, frames, kappa, gains, top)
                    levels[slot] = 0.0
                inv1, inv2, s2, near, plenty = record[INV1], record[INV2], record[S2], record[NEAR], record[PLENTY]
                p0, p1, r0, r1 = record[P0], record[P1], record[R0], record[R1]
                a0, a1, g0, g1, v0, v1 = record[A0], record[A1], record[G0], record[G1], record[V0], record[V1]
                d1, d2 = record[D1], record[D2]
                if quantisation is not None:
                    longest = int(record[LONGEST])
                    of_longest, per_root = frames[longest, 0] * gains[longest], record[ROOT] * (levels.shape[1] - 1)
            sum_b = float(second[i])
            rate_a, rate_b = first[i] * inv1, sum_b * inv2
            found, extra, level_u = np.uint8(0), 0.0, 0.0
            if quantisation is not None:
                rate, share, variance, total = rate_b, 0.0, 0.0, 0.0
                for _ in range(2):
                    place = math.sqrt(max(rate, 0.0)) * per_root
                    if FIRST_LEVEL <= place < levels.shape[1] - 1:
                        k = int(place)
                        above = place - k
                        if levels[slot, k, VARIANCE] == 0.0 or levels[slot, k + 1, VARIANCE] == 0.0:
                            fill_levels(k, pattern, record, levels[slot], frames, gains, kappa, quantisation, top)
                        share = levels[slot, k, SHARE] + above * (levels[slot, k + 1, SHARE] - levels[slot, k, SHARE])
                        variance = levels[slot, k, VARIANCE] + above * (
                            levels[slot, k + 1, VARIANCE] - levels[slot, k, VARIANCE]
                        )
                        total = levels[slot, k, TOTAL] + above * (levels[slot, k + 1, TOTAL] - levels[slot, k, TOTAL])
                        extra = levels[slot, k, SQUARES] + above * (
                            levels[slot, k + 1, SQUARES] - levels[slot, k, SQUARES]
                        )
                    else:
                        share, variance, total, extra = at_rate(
                            rate, pattern, record, frames, gains, kappa, quantisation, top
                        )
                    rate = rate_b + share * (rate_a - rate_b)
                # Frames may differ by what the curve is uncertain by, at the level of the longest.
                level = max(rate, 0.0) * of_longest
                level_u = from_root_table(level, curve, top)
                if level < valid[0] or level > valid[1]:
                    found |= EXTRAPOLATED
            else:
                seen = max(rate_b, 0.0)
                rate = rate_b + (p0 + p1 * seen) / (r0 + r1 * seen) * (rate_a - rate_b)
                seen = max(rate, 0.0)
                inverse = 1.0 / (r0 + r1 * seen)
                share, gap = (p0 + p1 * seen) * inverse, g0 + g1 * seen
                rate = rate_b + share * (rate_a - rate_b)
                variance, total = a0 + a1 * seen - gap * gap * inverse, v0 + v1 * seen
            scatter = squares[i] - rate * (2.0 * sum_b - rate * s2)
            if scatter > plenty * total:
                if quantisation is None:
                    extra = record[CC] + kappa * seen * (2.0 * record[C1] + kappa * seen * s2)
                # Satterthwaite 1946 for the degrees of freedom.
                tolerance = (bounds[2] ** 2 + (AGREEMENT_SIGMA * level_u) ** 2) * rate**2 * s2
                if scatter > total * scatter_limit(total**2 / extra) + tolerance:
                    found |= INCONSISTENT
            if rate < near:
                if rate < record[NEXT]:
                    rate, variance, contradiction = with_censored(rate, variance, pattern, frames, kappa)
                else:  # the others had to clip: only one frame has something to say
                    nearest = int(record[NEAREST])
                    here = frames[nearest : nearest + 1]
                    rate, variance, contradiction = with_censored(rate, variance, np.uint64(0), here, kappa)
                if contradiction:
                    found |= INCONSISTENT
            dark = d2 + share * (d1 - d2)
            variance += dark * dark
            if rate < 0.0 or rate * rate < _NOISE_FLOOR_SIGMA**2 * variance:
                found |= BELOW_NOISE
            rates[j], variances[j], mask[i] = rate, variance + (level_u * rate) ** 2, found
        scaled(rates[:count], variances[:count], factor, start, radiance, u_radiance)


@compiled
def _place_of(pattern: Any, known: Any) -> int:  # pragma: no cover (compiled)
    """Return where a set of frames is kept, or is to be kept in place of what is there."""
    last = int(known.size) - 1
    place = int((pattern * _HASH) >> np.uint64(32)) & last
    for _ in range(_PROBES):
        if known[place] == pattern or known[place] == 0:
            return place
        place = (place + 1) & last
    return place


@compiled
def scaled(
    rates: Any, variances: Any, factor: Any, start: int, radiance: Any, u_radiance: Any
) -> None:  # pragma: no cover (compiled)
    """Write rates and the roots of their variances, times the factor, from the pixel `start` on."""
    end = start + rates.size
    value, u = radiance[start:end], u_radiance[start:end]
    if factor.size > 1:
        place = factor[start:end]
        for j in range(rates.size):
            value[j] = rates[j] * place[j]
        for j in range(rates.size):
            u[j] = math.sqrt(variances[j]) * place[j]
        return
    scale = factor[0]
    for j in range(rates.size):
        value[j] = rates[j] * scale
    for j in range(rates.size):
        u[j] = math.sqrt(variances[j]) * scale
