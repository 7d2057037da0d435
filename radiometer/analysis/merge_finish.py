"""Compiled last step of the merge: sums into radiance, standard uncertainty and mask.

For independent samples x_i = E·t_i + noise with variance v_i = c_i + κ·E·t_i the maximum-likelihood weights are
t_i/v_i. They depend on E, which a stream does not know yet, and weights that follow the noisy sample itself are
biased. Two sums with fixed weights, Σt^0.35·x and Σt·x, give two unbiased estimates of E, and the mixture of least
variance follows from E at the end: over all ladders of 4 to 16 frames and all ratios of read to shot noise its
variance is within 1.5 % of the optimum (with the powers 0 and 1 it would be 8 %). The error of that mixture is
uncorrelated with the difference of the two estimates, so choosing it by the estimated E brings no bias to first
order (Gauss–Markov).

A frame that clips at a pixel still says "at least so much": near clipping it enters with its censored likelihood,
or the choice of frames by their own noisy values would bias the result (Tobin 1958, Econometrica 26, 24).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from radiometer.analysis.merge_compile import compiled
from radiometer.data.radiance_map import PixelMask

SATURATED = np.uint8(PixelMask.SATURATED)
BELOW_NOISE = np.uint8(PixelMask.BELOW_NOISE)
EXTRAPOLATED = np.uint8(PixelMask.EXTRAPOLATED)
INCONSISTENT = np.uint8(PixelMask.INCONSISTENT)
# Columns of a record: what `finish` needs of one set of frames.
(INV1, INV2, S2, P0, P1, R0, R1, A0, A1, G0, G1, V0, V1, CC, C1, D1, D2, NEAR, COUNT, LONGEST) = range(20)
RECORD_SIZE = 20
FIRST_POWER = 0.35
_NOISE_FLOOR_SIGMA = 2.0
# A frame expected to clip by more than this says nothing new: its censored score is below 0.001 sigma.
_CENSORED_SIGMA = 3.5
_CONTRADICTION_SIGMA = 6.0  # clipped, though the other frames put it this far below clipping
_AGREEMENT_SIGMA = 5.0


@compiled
def fill_record(record: Any, pattern: Any, frames: Any, kappa: float) -> None:  # pragma: no cover (compiled)
    """Fill in what follows from which frames are used: sums, and the variances as lines in E.

    With w = t^0.35, E_a = Σwx/Σwt and E_b = Σtx/Σt²: var E_a = a0 + a1·E, var E_a − cov = g0 + g1·E, the variance
    of E_a − E_b is r0 + r1·E, and the best share of E_a is (p0 + p1·E)/(r0 + r1·E).

    Args:
        record: float64, shape (RECORD_SIZE,), overwritten.
        pattern: Bits of the frames used.
        frames: float64, shape (n, 5): t, c, x at clipping, its sigma there, common uncertainty of the dark level.
        kappa: Shot noise variance per unit of x.
    """
    record[:] = 0.0
    longest, s1, s2 = -1.0, 0.0, 0.0
    var_a0, var_a1, var_b0, var_b1, both0, both1 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(frames.shape[0]):
        t, c = frames[i, 0], frames[i, 1]
        if (pattern >> np.uint64(i)) & np.uint64(1):
            w, k = t**FIRST_POWER, kappa * t
            s1, s2 = s1 + w * t, s2 + t * t
            var_a0, var_b0, both0 = var_a0 + w * w * c, var_b0 + t * t * c, both0 + w * t * c
            var_a1, var_b1, both1 = var_a1 + w * w * k, var_b1 + t * t * k, both1 + w * t * k
            record[V0] += c
            record[V1] += k
            record[C1] += t * c
            record[CC] += c * c
            record[D1] += w * frames[i, 4]
            record[D2] += t * frames[i, 4]
            record[COUNT] += 1.0
            if t > longest:
                longest = t
                record[LONGEST] = i
        else:
            record[NEAR] = max(record[NEAR], (frames[i, 2] + _CENSORED_SIGMA * frames[i, 3]) / t)
    record[INV1], record[INV2], record[S2] = 1.0 / s1, 1.0 / s2, s2
    record[D1], record[D2] = record[D1] / s1, record[D2] / s2
    var_a0, var_a1 = var_a0 / s1**2, var_a1 / s1**2
    var_b0, var_b1 = var_b0 / s2**2, var_b1 / s2**2
    both0, both1 = both0 / (s1 * s2), both1 / (s1 * s2)
    record[A0], record[A1] = var_a0, var_a1
    record[R0], record[R1] = var_a0 + var_b0 - 2.0 * both0, var_a1 + var_b1 - 2.0 * both1
    record[P0], record[P1] = var_b0 - both0, var_b1 - both1
    record[G0], record[G1] = var_a0 - both0, var_a1 - both1
    if record[R0] <= 1e-9 * var_a0 and record[R1] <= 1e-9 * var_a1:  # one exposure only: both estimates are the same
        record[P0], record[P1], record[R0], record[R1], record[G0], record[G1] = 1.0, 0.0, 1.0, 0.0, 0.0, 0.0


@compiled
def hazard(z: float) -> float:  # pragma: no cover (compiled)
    """Return φ(z)/(1 − Φ(z)), the hazard of the normal distribution."""
    if z > 20.0:
        return z
    return math.exp(-0.5 * z * z) / math.sqrt(2.0 * math.pi) / (0.5 * math.erfc(z / math.sqrt(2.0)))


@compiled
def with_censored(
    rate: float, variance: float, pattern: Any, frames: Any, kappa: float
) -> tuple[float, float, bool]:  # pragma: no cover (compiled)
    """Return (rate, variance, contradiction) after frames that clipped are heard.

    Args:
        rate: Estimate from the frames that did not clip.
        variance: Its variance.
        pattern: Bits of those frames.
        frames: As in `fill_record`.
        kappa: Shot noise variance per unit of x.
    """
    estimate, information, contradiction = rate, 1.0 / variance, False
    for _ in range(2):
        score, total = (rate - estimate) / variance, 1.0 / variance
        for i in range(frames.shape[0]):
            if (pattern >> np.uint64(i)) & np.uint64(1):
                continue
            t, clips_at = frames[i, 0], frames[i, 2]
            expected = max(estimate, 0.0) * t
            sigma = math.sqrt(frames[i, 1] + kappa * expected)
            z = (clips_at - expected) / sigma
            if clips_at - rate * t > _CONTRADICTION_SIGMA * math.sqrt(sigma**2 + t * t * variance):
                # Far below clipping: it was cut off at the black end, or the scene has changed.
                contradiction = contradiction or expected > 0.1 * clips_at
            elif z > -_CENSORED_SIGMA:
                rise = hazard(z)
                score += t * rise / sigma
                total += t * t * rise * (rise - z) / sigma**2
        estimate += score / total
        information = total
    return estimate, 1.0 / information, contradiction


@compiled
def from_root_table(expected: float, gain: float, slopes: Any, top: float) -> float:  # pragma: no cover (compiled)
    """Return a table's value at x times gain, over the square of the gain.

    Args:
        expected: x at 0 dB.
        gain: Gain factor of the frame.
        slopes: Values at x = top·(k/(size − 1))², float64.
        top: x of the last entry.
    """
    place = math.sqrt(min(max(expected * gain, 0.0) / top, 1.0)) * (slopes.size - 1)
    low = min(int(place), slopes.size - 2)
    return float((slopes[low] + (place - low) * (slopes[low + 1] - slopes[low])) / gain**2)


@compiled
def agrees(scatter: float, total: float, squares: float, tolerance: float) -> bool:  # pragma: no cover (compiled)
    """Tell whether Σ(x − E·t)² lies within what noise explains at five sigma.

    Args:
        scatter: Σ(x − E·t)².
        total: Σv.
        squares: Σv².
        tolerance: What is passed in any case.

    Source: Satterthwaite 1946 for the degrees of freedom, Wilson and Hilferty 1931 for the limit of χ².
    """
    freedom = total**2 / squares
    root = 1.0 - 2.0 / (9.0 * freedom) + _AGREEMENT_SIGMA * math.sqrt(2.0 / (9.0 * freedom))
    return bool(scatter <= total * root**3 + tolerance)


@compiled
def all_cut_off(mask: Any, bounds: Any) -> tuple[float, Any]:  # pragma: no cover (compiled)
    """Return the bound of the rate, and the mask, of a pixel that no frame shows unclipped."""
    return (bounds[0], SATURATED) if mask & SATURATED else (bounds[1], BELOW_NOISE)


@compiled
def finish_linear(
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
    factor: Any,
    radiance: Any,
    u_radiance: Any,
) -> None:  # pragma: no cover (compiled)
    """Turn the sums of a block into radiance, standard uncertainty and mask, for a linear sensor.

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
        bounds: Rate that is the lower bound where all frames clip, the upper bound where all are black, and the
            relative difference between frames that is never called inconsistent.
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
            inv1, inv2, s2, near, several = record[INV1], record[INV2], record[S2], record[NEAR], record[COUNT] > 1.0
            p0, p1, r0, r1 = record[P0], record[P1], record[R0], record[R1]
            a0, a1, g0, g1, v0, v1 = record[A0], record[A1], record[G0], record[G1], record[V0], record[V1]
        sum_b = float(second[i])
        rate_a, rate_b = first[i] * inv1, sum_b * inv2
        seen = max(rate_b, 0.0)
        rate = rate_b + (p0 + p1 * seen) / (r0 + r1 * seen) * (rate_a - rate_b)
        seen = max(rate, 0.0)
        inverse = 1.0 / (r0 + r1 * seen)
        share, gap = (p0 + p1 * seen) * inverse, g0 + g1 * seen
        rate = rate_b + share * (rate_a - rate_b)
        variance = a0 + a1 * seen - gap * gap * inverse
        found_mask = np.uint8(0)
        scatter, total = squares[i] - rate * (2.0 * sum_b - rate * s2), v0 + v1 * seen
        if several and scatter > 2.0 * total:
            total_squares = record[CC] + kappa * seen * (2.0 * record[C1] + kappa * seen * s2)
            if not agrees(scatter, total, total_squares, (bounds[2] * rate) ** 2 * s2):
                found_mask |= INCONSISTENT
        if rate < near:
            rate, variance, contradiction = with_censored(rate, variance, pattern, frames, kappa)
            if contradiction:
                found_mask |= INCONSISTENT
        dark = share * record[D1] + (1.0 - share) * record[D2]
        if rate < 0.0 or rate * rate < _NOISE_FLOOR_SIGMA**2 * (variance + dark * dark):
            found_mask |= BELOW_NOISE
        radiance[i] = rate * scale
        u_radiance[i] = math.sqrt(variance + dark * dark) * scale
        mask[i] = found_mask


@compiled
def find_pattern(pattern: Any, patterns: Any) -> int:  # pragma: no cover (compiled)
    """Return the index of a set of frames in `patterns` (by its number of frames), or −1."""
    count = 0
    while pattern and count < patterns.size:
        count += 1
        if patterns[count] == pattern:
            return count
    return -1
