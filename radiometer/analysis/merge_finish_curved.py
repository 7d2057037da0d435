"""Compiled last step of the merge through a response curve, where quantisation depends on the level."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from radiometer.analysis.merge_compile import compiled
from radiometer.analysis.merge_finish import (
    _NOISE_FLOOR_SIGMA,
    BELOW_NOISE,
    COUNT,
    D1,
    D2,
    FIRST_POWER,
    INCONSISTENT,
    INV1,
    INV2,
    LONGEST,
    NEAR,
    RECORD_SIZE,
    S2,
    agrees,
    all_cut_off,
    fill_record,
    find_pattern,
    with_censored,
)
from radiometer.data.radiance_map import PixelMask

EXTRAPOLATED = np.uint8(PixelMask.EXTRAPOLATED)


@compiled
def from_root_table(expected: float, gain: float, entries: Any, top: float) -> float:  # pragma: no cover (compiled)
    """Return a table's value at x times gain.

    Args:
        expected: x at 0 dB.
        gain: Gain factor of the frame.
        entries: Values at x = top·(k/(size − 1))², float64.
        top: x of the last entry.
    """
    place = math.sqrt(min(max(expected * gain, 0.0) / top, 1.0)) * (entries.size - 1)
    low = min(int(place), entries.size - 2)
    return float(entries[low] + (place - low) * (entries[low + 1] - entries[low]))


@compiled
def moments(
    rate: float, pattern: Any, frames: Any, gains: Any, kappa: float, quantisation: Any, top: float
) -> tuple[float, float, float, float, float]:  # pragma: no cover (compiled)
    """Return (Σv, Σv², Σw²·v, Σw·t·v, Σt²·v), w = t^0.35, over the frames of a pattern at a rate."""
    total, squares, var_a, both, var_b = 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(frames.shape[0]):
        if not (pattern >> np.uint64(i)) & np.uint64(1):
            continue
        t, gain = frames[i, 0], gains[i]
        v = frames[i, 1] + kappa * rate * t + from_root_table(rate * t, gain, quantisation, top) / gain**2
        w = t**FIRST_POWER
        total, squares = total + v, squares + v * v
        var_a, both, var_b = var_a + w * w * v, both + w * t * v, var_b + t * t * v
    return total, squares, var_a, both, var_b


@compiled
def mixture(
    rate_a: float, rate_b: float, var_a: float, both: float, var_b: float
) -> tuple[float, float, float]:  # pragma: no cover (compiled)
    """Return (rate, share of the first, variance) of the mixture of two estimates with the least variance."""
    between = var_a + var_b - 2.0 * both
    if between <= 1e-9 * var_a:
        return rate_a, 1.0, var_a
    share = (var_b - both) / between
    return rate_b + share * (rate_a - rate_b), share, var_a - (var_a - both) ** 2 / between


@compiled
def finish_curved(
    first: Any,
    second: Any,
    squares: Any,
    bits: Any,
    mask: Any,
    frames: Any,
    patterns: Any,
    records: Any,
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
    """Turn the sums of a block into radiance, standard uncertainty and mask, through a response curve.

    Args:
        first: Σt^0.35·x, float32; may be `radiance` itself.
        second: Σt·x, float32; may be `u_radiance` itself.
        squares: Σx², float32.
        bits: Frames used in each pixel.
        mask: Clipping seen in each pixel; overwritten by PixelMask bits.
        frames: As in `fill_record`.
        patterns: Bits of the sets of frames that occur most.
        records: Their records.
        kappa: Shot noise variance per unit of x.
        bounds: As in `finish_linear`.
        gains: Gain factor of every frame.
        quantisation: Variance (dx/dM)²/12 over √x, for `from_root_table`.
        curve: Relative standard uncertainty of x over √x.
        top: x of the last entry of both.
        valid: Lowest and highest x times gain that the response curve has data for.
        factor: Radiance per rate, of every pixel or of all (size 1), float32.
        radiance: Written.
        u_radiance: Written.
    """
    record = np.zeros(RECORD_SIZE)
    last = np.uint64(0)
    step = 1 if factor.size > 1 else 0
    for i in range(bits.size):
        pattern = np.uint64(bits[i])
        scale = factor[i * step]
        if pattern == 0:
            bound, mask[i] = all_cut_off(mask[i], bounds)
            radiance[i] = u_radiance[i] = bound * scale
            continue
        if pattern != last:
            last = pattern
            found = find_pattern(pattern, patterns)
            if found >= 0:
                record = records[found]
            else:
                record = np.zeros(RECORD_SIZE)
                fill_record(record, pattern, frames, kappa)
        inv1, inv2 = record[INV1], record[INV2]
        sum_b = float(second[i])
        rate_a, rate_b = first[i] * inv1, sum_b * inv2
        rate, share, variance, total, total_squares = rate_b, 0.0, 0.0, 0.0, 0.0
        for _ in range(2):
            seen = max(rate, 0.0)
            total, total_squares, var_a, both, var_b = moments(seen, pattern, frames, gains, kappa, quantisation, top)
            rate, share, variance = mixture(rate_a, rate_b, var_a * inv1**2, both * inv1 * inv2, var_b * inv2**2)
        flags = np.uint8(0)
        scatter = squares[i] - rate * (2.0 * sum_b - rate * record[S2])
        # Frames may differ by what the curve is uncertain by, at the level of the longest.
        longest = int(record[LONGEST])
        level = max(rate, 0.0) * frames[longest, 0] * gains[longest]
        curve_u = from_root_table(level, 1.0, curve, top)
        tolerance = (bounds[2] ** 2 + 25.0 * curve_u**2) * rate**2 * record[S2]
        if record[COUNT] > 1.0 and not agrees(scatter, total, total_squares, tolerance):
            flags |= INCONSISTENT
        if rate < record[NEAR]:
            rate, variance, contradiction = with_censored(rate, variance, pattern, frames, kappa)
            if contradiction:
                flags |= INCONSISTENT
        dark = share * record[D1] + (1.0 - share) * record[D2]
        if rate < 0.0 or rate * rate < _NOISE_FLOOR_SIGMA**2 * (variance + dark * dark):
            flags |= BELOW_NOISE
        if level < valid[0] or level > valid[1]:
            flags |= EXTRAPOLATED
        radiance[i] = rate * scale
        u_radiance[i] = math.sqrt(variance + dark * dark + (curve_u * rate) ** 2) * scale
        mask[i] = flags
