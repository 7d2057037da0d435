"""Compiled last step of the merge: sums into radiance, standard uncertainty and mask.

Most pixels of a linear sensor need nothing but the mixture of their two estimates: runs of such pixels of the same
frames go through a loop without branches, which is vectorised, and the few where frames disagree or clip nearby are
looked at one by one, as all pixels behind a response curve are.
"""

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
    fill_level,
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
_DOUBTFUL = np.uint8(128)  # no flag of a map: to be looked at singly
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
    rates, variances, flags = np.empty(_RUN), np.empty(_RUN), np.empty(_RUN, np.uint8)
    for start in range(0, bits.size, _RUN):
        count = min(_RUN, bits.size - start)
        begin = 0
        while begin < count:
            pattern, end = bits[start + begin], begin + 1
            while end < count and bits[start + end] == pattern:
                end += 1
            if pattern == 0:  # no frame shows these pixels unclipped
                for j in range(begin, end):
                    white = mask[start + j] & SATURATED
                    rates[j] = bounds[0] if white else bounds[1]
                    variances[j] = rates[j] ** 2
                    flags[j] = SATURATED if white else BELOW_NOISE
                begin = end
                continue
            slot = _place_of(pattern, known)
            record = records[slot]
            if known[slot] != pattern:
                known[slot] = pattern
                fill_record(record, pattern, frames, kappa, gains, top)
                levels[slot] = 0.0
            if quantisation is None:
                _mixed(first, second, squares, start, begin, end, record, rates, variances, flags)
                for j in range(begin, end):
                    if flags[j] & _DOUBTFUL:
                        i = start + j
                        found = _linear_one(first[i], second[i], record, kappa)
                        rates[j], variances[j], flags[j] = _settled(
                            *found, second[i], squares[i], pattern, record, frames, kappa, bounds[2]
                        )
            else:
                _mixed_behind_curve(
                    first,
                    second,
                    squares,
                    start,
                    begin,
                    end,
                    pattern,
                    record,
                    levels[slot],
                    frames,
                    gains,
                    kappa,
                    quantisation,
                    top,
                    curve,
                    valid,
                    bounds[2],
                    rates,
                    variances,
                    flags,
                )
            begin = end
        mask[start : start + count] = flags[:count]
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
def _linear_mixture(
    rate_a: float,
    rate_b: float,
    p0: float,
    p1: float,
    r0: float,
    r1: float,
    a0: float,
    a1: float,
    g0: float,
    g1: float,
) -> tuple[float, float, float, float]:  # pragma: no cover (compiled)
    """Return (rate, share of the first estimate, variance, level that these are for) of a linear sensor's mixture.

    The arguments after the estimates are the columns of the record of these names.
    """
    seen = max(rate_b, 0.0)
    seen = max(rate_b + (p0 + p1 * seen) / (r0 + r1 * seen) * (rate_a - rate_b), 0.0)
    inverse, gap = 1.0 / (r0 + r1 * seen), g0 + g1 * seen
    share = (p0 + p1 * seen) * inverse
    return rate_b + share * (rate_a - rate_b), share, a0 + a1 * seen - gap * gap * inverse, seen


@compiled
def _mixed(
    first: Any,
    second: Any,
    squares: Any,
    start: int,
    begin: int,
    end: int,
    record: Any,
    rates: Any,
    variances: Any,
    flags: Any,
) -> None:  # pragma: no cover (compiled)
    """Write rates, variances and flags of the pixels `begin` to `end` after `start`, or that they are doubtful."""
    inv1, inv2, s2, near, plenty = record[INV1], record[INV2], record[S2], record[NEAR], record[PLENTY]
    p0, p1, r0, r1, a0, a1 = record[P0], record[P1], record[R0], record[R1], record[A0], record[A1]
    g0, g1, v0, v1, d1, d2 = record[G0], record[G1], record[V0], record[V1], record[D1], record[D2]
    good, below, doubtful = np.uint8(0), BELOW_NOISE, _DOUBTFUL
    for j in range(begin, end):
        sum_b = float(second[start + j])
        rate, share, variance, seen = _linear_mixture(
            first[start + j] * inv1, sum_b * inv2, p0, p1, r0, r1, a0, a1, g0, g1
        )
        scatter = squares[start + j] - rate * (2.0 * sum_b - rate * s2)
        doubt = (scatter > plenty * (v0 + v1 * seen)) | (rate < near)
        dark = d2 + share * (d1 - d2)
        variance += dark * dark
        dim = _below_noise(rate, variance)
        rates[j] = rate
        variances[j] = variance
        flags[j] = (below if dim else good) | (doubtful if doubt else good)


@compiled
def _mixed_behind_curve(
    first: Any,
    second: Any,
    squares: Any,
    start: int,
    begin: int,
    end: int,
    pattern: Any,
    record: Any,
    levels: Any,
    frames: Any,
    gains: Any,
    kappa: float,
    quantisation: Any,
    top: float,
    curve: Any,
    valid: Any,
    agreement: float,
    rates: Any,
    variances: Any,
    flags: Any,
) -> None:  # pragma: no cover (compiled)
    """Write rates, variances and flags of the pixels `begin` to `end` after `start`, by the levels of their frames.

    Levels are filled in as they are needed. Arguments as in `finish`; `agreement` is the last of its `bounds`.
    """
    inv1, inv2, s2, near, plenty = record[INV1], record[INV2], record[S2], record[NEAR], record[PLENTY]
    d1, d2, longest, last = record[D1], record[D2], int(record[LONGEST]), levels.shape[0] - 1
    per_root, of_longest, low_x, high_x = record[ROOT] * last, frames[longest, 0] * gains[longest], valid[0], valid[1]
    for j in range(begin, end):
        sum_b = float(second[start + j])
        rate_a, rate_b = first[start + j] * inv1, sum_b * inv2
        rate, share, variance, total, extra = rate_b, 0.0, 0.0, 0.0, 0.0
        for _ in range(2):
            place = math.sqrt(max(rate, 0.0)) * per_root
            if FIRST_LEVEL <= place < last:
                k = int(place)
                above = place - k
                if levels[k, VARIANCE] == 0.0:
                    fill_level(k, pattern, record, levels, frames, gains, kappa, quantisation, top)
                if levels[k + 1, VARIANCE] == 0.0:
                    fill_level(k + 1, pattern, record, levels, frames, gains, kappa, quantisation, top)
                share = levels[k, SHARE] + above * (levels[k + 1, SHARE] - levels[k, SHARE])
                variance = levels[k, VARIANCE] + above * (levels[k + 1, VARIANCE] - levels[k, VARIANCE])
                total = levels[k, TOTAL] + above * (levels[k + 1, TOTAL] - levels[k, TOTAL])
                extra = levels[k, SQUARES] + above * (levels[k + 1, SQUARES] - levels[k, SQUARES])
            else:
                share, variance, total, extra = at_rate(rate, pattern, record, frames, gains, kappa, quantisation, top)
            rate = rate_b + share * (rate_a - rate_b)
        # Frames may differ by what the curve is uncertain by, at the level of the longest.
        level = max(rate, 0.0) * of_longest
        level_u, beyond = from_root_table(level, curve, top), level < low_x or level > high_x
        scatter = squares[start + j] - rate * (2.0 * sum_b - rate * s2)
        if scatter > plenty * total or rate < near:
            rates[j], variances[j], flags[j] = _settled(
                rate,
                share,
                variance,
                total,
                extra,
                level_u,
                beyond,
                sum_b,
                squares[start + j],
                pattern,
                record,
                frames,
                kappa,
                agreement,
            )
            continue
        dark = d2 + share * (d1 - d2)
        variance += dark * dark
        dim = _below_noise(rate, variance)
        rates[j], variances[j] = rate, variance + (level_u * rate) ** 2
        flags[j] = (BELOW_NOISE if dim else np.uint8(0)) | (EXTRAPOLATED if beyond else np.uint8(0))


@compiled
def _below_noise(rate: float, variance: float) -> bool:  # pragma: no cover (compiled)
    """Tell whether a rate does not stand out of its noise."""
    return (rate < 0.0) | (rate * rate < _NOISE_FLOOR_SIGMA**2 * variance)


@compiled
def _linear_one(
    first: float, second: float, record: Any, kappa: float
) -> tuple[float, float, float, float, float, float, bool]:  # pragma: no cover (compiled)
    """Return (rate, share, variance, Σv, Σv², u of the curve, beyond its data) of a pixel of a linear sensor."""
    p0, p1, r0, r1, a0, a1 = record[P0], record[P1], record[R0], record[R1], record[A0], record[A1]
    rate_a, rate_b = first * record[INV1], float(second) * record[INV2]
    rate, share, variance, seen = _linear_mixture(rate_a, rate_b, p0, p1, r0, r1, a0, a1, record[G0], record[G1])
    extra = record[CC] + kappa * seen * (2.0 * record[C1] + kappa * seen * record[S2])
    return rate, share, variance, record[V0] + record[V1] * seen, extra, 0.0, False


@compiled
def _settled(
    rate: float,
    share: float,
    variance: float,
    total: float,
    extra: float,
    level_u: float,
    beyond: bool,
    sum_b: float,
    squares: float,
    pattern: Any,
    record: Any,
    frames: Any,
    kappa: float,
    agreement: float,
) -> tuple[float, float, Any]:  # pragma: no cover (compiled)
    """Return (rate, variance, flags) of one pixel after all that its frames say of each other.

    The first seven arguments are of `_linear_one`, `agreement` is the last of `bounds` of `finish`.
    """
    flags, s2 = EXTRAPOLATED if beyond else np.uint8(0), record[S2]
    scatter = squares - rate * (2.0 * sum_b - rate * s2)
    if scatter > record[PLENTY] * total:
        # Satterthwaite 1946 for the degrees of freedom.
        tolerance = (agreement**2 + (AGREEMENT_SIGMA * level_u) ** 2) * rate**2 * s2
        if scatter > total * scatter_limit(total**2 / extra) + tolerance:
            flags |= INCONSISTENT
    if rate < record[NEAR]:
        if rate < record[NEXT]:
            rate, variance, contradiction = with_censored(rate, variance, pattern, frames, kappa)
        else:  # the others had to clip: only one frame has something to say
            nearest = int(record[NEAREST])
            here = frames[nearest : nearest + 1]
            rate, variance, contradiction = with_censored(rate, variance, np.uint64(0), here, kappa)
        if contradiction:
            flags |= INCONSISTENT
    dark = record[D2] + share * (record[D1] - record[D2])
    variance += dark * dark
    if _below_noise(rate, variance):
        flags |= BELOW_NOISE
    return rate, variance + (level_u * rate) ** 2, flags


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
