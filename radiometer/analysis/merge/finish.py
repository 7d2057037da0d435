"""Compiled last step of the merge: sums into radiance, standard uncertainty and mask."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from radiometer.analysis.merge.censored import include_nearest_censored, near_clipping
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
    INV1,
    INV2,
    LONGEST,
    NEAR,
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
from radiometer.analysis.merge.straight import ONLY_NEAR_CLIPPING, marks, straight, straight_curved
from radiometer.compiled import compiled, compiled_apart
from radiometer.data.radiance_map import PixelMask

SATURATED = np.uint8(PixelMask.SATURATED)
BELOW_NOISE = np.uint8(PixelMask.BELOW_NOISE)
EXTRAPOLATED = np.uint8(PixelMask.EXTRAPOLATED)
INCONSISTENT = np.uint8(PixelMask.INCONSISTENT)
_RUN = 1024  # pixels whose square roots are taken together: only a loop without branches is vectorised
_PROBES = 8
_HASH = np.uint64(0x9E3779B97F4A7C15)  # 2^64 over the golden ratio (Knuth, vol. 3, 6.4)


@compiled
def finish(sums: Any, kept: Any, tables: Any, quantisation: Any, image: Any) -> None:  # pragma: no cover (compiled)
    """Turn the sums of a block into radiance, standard uncertainty and mask.

    A first loop, for a linear sensor one without branches, works out every pixel; pixels about which there is more to
    say (frames that disagree, frames near clipping) are few and gone through again. A branch that no processor can
    foresee costs as much as a pixel's arithmetic.

    Args:
        sums: What was summed of each pixel: Σt^0.35·x and Σt·x, float32, which may be `radiance` and `u_radiance`
            themselves; Σx², float32; the frames used, as bits. Last, whether a frame was clipped at white, which is
            overwritten by PixelMask bits.
        kept: What is kept from block to block: sets of frames, their `records` and their `levels`. Records are as of
            `fill_record`, shape (sets, RECORD_SIZE), their number a power of 2. Levels are as in `moments.at_level`,
            shape (sets, levels, 4); of no size for a linear sensor.
        tables: The other `MergeTables.arguments`; their curve is None for a linear sensor.
        quantisation: Variance (dx/dM)²/12 over √x, for `from_root_table`; None for a linear sensor, where it is part
            of `frames` (the loop is compiled for each, which needs a separate argument).
        image: Radiance per rate, of every pixel or of all (size 1), float32; radiance and its standard uncertainty,
            written.
    """
    first, second, squares, bits, mask = sums
    known, records, levels = kept
    frames, kappa, bounds, gains, curve, top, valid = tables
    factor, radiance, u_radiance = image
    rates, variances = np.empty(_RUN), np.empty(_RUN)
    slots, doubtful = np.empty(_RUN, np.uint16), np.empty(_RUN, np.uint8)
    waiting = np.empty(_RUN, np.uint16), np.empty(_RUN, np.uint16), np.empty((2, _RUN)), np.empty(_RUN, np.uint8)
    start, dark = 0, bool(np.any(frames[:, 4] > 0.0))
    while start < bits.size:
        end = min(start + _RUN, bits.size)
        count = _find_sets(bits[start:end], slots, known, records, levels, frames, kappa, gains, top)
        end = start + count
        run = first[start:end], second[start:end], squares[start:end]
        these, seen = bits[start:end], mask[start:end]
        if quantisation is None:
            straight(*run, these, slots, records, dark, rates, variances, seen, doubtful)
            _include_nearest_censored(rates, variances, seen, slots, doubtful[:count], waiting, records, frames, kappa)
        else:
            straight_curved(
                *run,
                these,
                slots,
                records,
                levels,
                frames,
                kappa,
                gains,
                quantisation,
                curve,
                top,
                valid,
                rates,
                variances,
                seen,
                doubtful,
            )
        for i in range(count):
            if doubtful[i] == ONLY_NEAR_CLIPPING:
                rate, variance, contradiction = near_clipping(
                    rates[i], variances[i], np.uint64(these[i]), slots[i], records, frames, kappa
                )
                seen[i] = marks(rate, variance) | (INCONSISTENT if contradiction else np.uint8(0))
                rates[i], variances[i] = rate, variance
            elif doubtful[i]:
                rates[i], variances[i], seen[i] = _single(
                    first[start + i],
                    second[start + i],
                    squares[start + i],
                    np.uint64(these[i]),
                    seen[i],
                    slots[i],
                    records,
                    levels,
                    frames,
                    kappa,
                    bounds,
                    gains,
                    quantisation,
                    curve,
                    top,
                    valid,
                )
        scaled(rates[:count], variances[:count], factor, start, radiance, u_radiance)
        start = end


@compiled
def _include_nearest_censored(
    rates: Any,
    variances: Any,
    mask: Any,
    slots: Any,
    doubtful: Any,
    waiting: Any,
    records: Any,
    frames: Any,
    kappa: float,
) -> None:  # pragma: no cover (compiled)
    """Hear the clipped frame nearest to a pixel where only that one has something to say; doubtful no more.

    Args:
        rates: Overwritten there; so are `variances`, `mask` and `doubtful`.
        variances: Likewise.
        mask: Likewise.
        slots: Places of the records.
        doubtful: As written by `straight`.
        waiting: Room for such pixels: their places, slots, rates and variances, and whether frames contradict.
        records: As of `fill_record`.
        frames: Likewise.
        kappa: Shot noise variance per unit of x.
    """
    places, places_of_records, estimates, contradictions = waiting
    near = 0
    for i in range(doubtful.size):  # a step of 0 or 1: no processor foresees which pixel is near
        places[near] = i
        near += doubtful[i] == ONLY_NEAR_CLIPPING
    count = 0
    for j in range(near):
        i = places[j]
        if rates[i] >= records[slots[i], NEXT]:
            places[count], places_of_records[count] = i, slots[i]
            estimates[0, count], estimates[1, count] = rates[i], variances[i]
            count += 1
    heard, their_variances = estimates[0, :count], estimates[1, :count]
    include_nearest_censored(heard, their_variances, places_of_records[:count], records, frames, kappa, contradictions)
    for j in range(count):
        i = places[j]
        rates[i], variances[i], doubtful[i] = heard[j], their_variances[j], 0
        mask[i] = marks(heard[j], their_variances[j]) | (INCONSISTENT if contradictions[j] else np.uint8(0))


@compiled
def _find_sets(
    bits: Any, slots: Any, known: Any, records: Any, levels: Any, frames: Any, kappa: float, gains: Any, top: float
) -> int:  # pragma: no cover (compiled)
    """Write where the record of each pixel's set of frames is; return for how many pixels there was room.

    Records are filled in where they were not; one that is in the way of the first pixel is given up for it, one that
    earlier pixels of the run may need is not.
    """
    if _at_home(bits, known, slots):
        return int(bits.size)
    last, shift = np.uint64(known.size - 1), np.uint64(32)
    for i in range(bits.size):
        pattern = np.uint64(bits[i])
        place = int(((pattern * _HASH) >> shift) & last)
        if known[place] != pattern and pattern != 0:
            place = _place_of(pattern, known)
            if known[place] != pattern:
                if i > 0 and known[place] != 0:
                    return i
                known[place] = pattern
                fill_record(records[place], pattern, frames, kappa, gains, top)
                levels[place] = 0.0
        slots[i] = place
    return int(bits.size)


@compiled_apart
def _at_home(bits: Any, known: Any, slots: Any) -> bool:  # pragma: no cover (compiled)
    """Write the first place where each pixel's set of frames may be kept; return whether all are kept there."""
    last, shift, elsewhere = np.uint64(known.size - 1), np.uint64(32), np.uint64(0)
    for i in range(bits.size):
        pattern = np.uint64(bits[i])
        place = ((pattern * _HASH) >> shift) & last
        slots[i] = place
        elsewhere |= (known[place] ^ pattern) if pattern != 0 else np.uint64(0)
    return bool(elsewhere == 0)


@compiled
def _single(
    first: Any,
    second: Any,
    squares: Any,
    pattern: Any,
    seen_of_clipping: Any,
    slot: int,
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
) -> tuple[float, float, Any]:  # pragma: no cover (compiled)
    """Return rate, variance and mask of a pixel from its sums; arguments as `finish`, those of its set of frames."""
    if pattern == 0:  # no frame shows this pixel unclipped
        white = seen_of_clipping & SATURATED
        bound = bounds[0] if white else bounds[1]
        return bound, bound**2, SATURATED if white else BELOW_NOISE
    inv1, inv2, s2, near, plenty = (
        records[slot, INV1],
        records[slot, INV2],
        records[slot, S2],
        records[slot, NEAR],
        records[slot, PLENTY],
    )
    p0, p1, r0, r1 = records[slot, P0], records[slot, P1], records[slot, R0], records[slot, R1]
    a0, a1, v0, v1 = records[slot, A0], records[slot, A1], records[slot, V0], records[slot, V1]
    d1, d2 = records[slot, D1], records[slot, D2]
    sum_b = float(second)
    rate_a, rate_b = first * inv1, sum_b * inv2
    found, extra, level_u = np.uint8(0), 0.0, 0.0
    if quantisation is not None:
        longest = int(records[slot, LONGEST])
        of_longest, per_root = frames[longest, 0] * gains[longest], records[slot, ROOT] * (levels.shape[1] - 1)
        rate, share, variance, total = rate_b, 0.0, 0.0, 0.0
        for _ in range(2):
            place = math.sqrt(max(rate, 0.0)) * per_root
            if FIRST_LEVEL <= place < levels.shape[1] - 1:
                k = int(place)
                above = place - k
                if levels[slot, k, VARIANCE] == 0.0 or levels[slot, k + 1, VARIANCE] == 0.0:
                    fill_levels(k, pattern, records[slot], levels[slot], frames, gains, kappa, quantisation, top)
                share = levels[slot, k, SHARE] + above * (levels[slot, k + 1, SHARE] - levels[slot, k, SHARE])
                variance = levels[slot, k, VARIANCE] + above * (
                    levels[slot, k + 1, VARIANCE] - levels[slot, k, VARIANCE]
                )
                total = levels[slot, k, TOTAL] + above * (levels[slot, k + 1, TOTAL] - levels[slot, k, TOTAL])
                extra = levels[slot, k, SQUARES] + above * (levels[slot, k + 1, SQUARES] - levels[slot, k, SQUARES])
            else:
                share, variance, total, extra = at_rate(
                    rate, pattern, records[slot], frames, gains, kappa, quantisation, top
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
        of_b, of_both = p0 + p1 * seen, r0 + r1 * seen
        share, gap = of_b / of_both, of_both - of_b
        rate = rate_b + share * (rate_a - rate_b)
        variance, total = a0 + a1 * seen - gap * gap / of_both, v0 + v1 * seen
    scatter = squares - rate * (2.0 * sum_b - rate * s2)
    if scatter > plenty * total:
        if quantisation is None:
            extra = records[slot, CC] + kappa * seen * (2.0 * records[slot, C1] + kappa * seen * s2)
        # Satterthwaite 1946 for the degrees of freedom.
        tolerance = (bounds[2] ** 2 + (AGREEMENT_SIGMA * level_u) ** 2) * rate**2 * s2
        if scatter > total * scatter_limit(total**2 / extra) + tolerance:
            found |= INCONSISTENT
    if rate < near:
        rate, variance, contradiction = near_clipping(rate, variance, pattern, slot, records, frames, kappa)
        if contradiction:
            found |= INCONSISTENT
    dark = d2 + share * (d1 - d2)
    variance += dark * dark
    return rate, variance + (level_u * rate) ** 2, found | marks(rate, variance)


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
