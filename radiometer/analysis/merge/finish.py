"""Compiled last step of the merge: sums into radiance, standard uncertainty and mask."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from radiometer.analysis.merge.censored import with_censored
from radiometer.analysis.merge.moments import from_root_table, mixture, moments
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
    P0,
    P1,
    PLENTY,
    R0,
    R1,
    RECORD_SIZE,
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
_KEPT_RECORDS = 64
_HASH = np.uint64(0x9E3779B97F4A7C15)  # 2^64 over the golden ratio (Knuth, vol. 3, 6.4)


@compiled
def finish(
    first: Any,
    second: Any,
    squares: Any,
    bits: Any,
    mask: Any,
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
        frames: As in `merge_records.fill_record`.
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
    known, records = np.zeros(_KEPT_RECORDS, np.uint64), np.zeros((_KEPT_RECORDS, RECORD_SIZE))
    record, last = records[0], np.uint64(0)
    rates, variances = np.empty(_RUN), np.empty(_RUN)
    for start in range(0, bits.size, _RUN):
        count = min(_RUN, bits.size - start)
        for j in range(count):
            i = start + j
            pattern = bits[i]
            if pattern == 0:  # no frame shows this pixel unclipped
                rates[j] = bounds[0] if mask[i] & SATURATED else bounds[1]
                variances[j] = rates[j] ** 2
                mask[i] = SATURATED if mask[i] & SATURATED else BELOW_NOISE
                continue
            if pattern != last:
                last = pattern
                slot = (pattern * _HASH) >> np.uint64(58)
                record = records[slot]
                if known[slot] != pattern:
                    known[slot] = pattern
                    fill_record(record, pattern, frames, kappa)
                inv1, inv2, s2, near, plenty = record[INV1], record[INV2], record[S2], record[NEAR], record[PLENTY]
                p0, p1, r0, r1 = record[P0], record[P1], record[R0], record[R1]
                a0, a1, g0, g1, v0, v1 = record[A0], record[A1], record[G0], record[G1], record[V0], record[V1]
                d1, d2 = record[D1], record[D2]
            sum_b = float(second[i])
            rate_a, rate_b = first[i] * inv1, sum_b * inv2
            flags, extra, level_u = np.uint8(0), 0.0, 0.0
            if quantisation is not None:
                rate, share, variance, total = rate_b, 0.0, 0.0, 0.0
                for _ in range(2):
                    seen = max(rate, 0.0)
                    total, extra, var_a, both, var_b = moments(seen, pattern, frames, gains, kappa, quantisation, top)
                    rate, share, variance = mixture(
                        rate_a, rate_b, var_a * inv1**2, both * inv1 * inv2, var_b * inv2**2
                    )
                # Frames may differ by what the curve is uncertain by, at the level of the longest.
                longest = int(record[LONGEST])
                level = max(rate, 0.0) * frames[longest, 0] * gains[longest]
                level_u = from_root_table(level, curve, top)
                if level < valid[0] or level > valid[1]:
                    flags |= EXTRAPOLATED
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
                    flags |= INCONSISTENT
            if rate < near:
                rate, variance, contradiction = with_censored(rate, variance, pattern, frames, kappa)
                if contradiction:
                    flags |= INCONSISTENT
            dark = d2 + share * (d1 - d2)
            variance += dark * dark
            if rate < 0.0 or rate * rate < _NOISE_FLOOR_SIGMA**2 * variance:
                flags |= BELOW_NOISE
            rates[j], variances[j], mask[i] = rate, variance + (level_u * rate) ** 2, flags
        scaled(rates[:count], variances[:count], factor, start, radiance, u_radiance)


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
