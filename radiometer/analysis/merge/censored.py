"""Information from a frame that clips at a pixel: "at least so much".

Near clipping it enters with its censored likelihood, or the choice of frames by their own noisy values would bias the
result (Tobin 1958, Econometrica 26, 24).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from radiometer.analysis.merge.records import CENSORED_SIGMA, CONTRADICTION_SIGMA, NEAREST, NEXT
from radiometer.compiled import compiled, compiled_apart, compiled_within

# The hazard is read off straight lines, right to 1e-6, which is quicker than exp and erfc for every such pixel.
_TABLE_END, _TABLE_STEPS = 8.0, 4096
_PER_SIGMA = _TABLE_STEPS / (_TABLE_END + CENSORED_SIGMA)


def _hazard(z: float) -> float:
    """Return φ(z)/(1 − Φ(z)), the hazard of the normal distribution."""
    return math.sqrt(2.0 / math.pi) * math.exp(-0.5 * z * z) / math.erfc(z / math.sqrt(2.0))


_HAZARD = np.array([_hazard(step / _PER_SIGMA - CENSORED_SIGMA) for step in range(_TABLE_STEPS + 1)])


@compiled_within
def hazard(z: float) -> float:  # pragma: no cover (compiled)
    """Return φ(z)/(1 − Φ(z)) to 1e-6 for z at or above −CENSORED_SIGMA; below, some number."""
    place = (z + CENSORED_SIGMA) * _PER_SIGMA
    low = np.uint64(min(max(place, 0.0), _TABLE_STEPS - 1.0))
    rise = _HAZARD[low] + (place - low) * (_HAZARD[low + np.uint64(1)] - _HAZARD[low])
    # Beyond the table its asymptotic series, right to 3e-4 and better.
    return float(rise if place < _TABLE_STEPS else z + 1.0 / z - 2.0 / z**3)


@compiled_within
def heard(
    estimate: float, rate: float, variance: float, t: float, c: float, clips_at: float, kappa: float
) -> tuple[float, float, bool]:  # pragma: no cover (compiled)
    """Return what a frame that clipped adds to the score and to the information, and whether it contradicts the others.

    Args:
        estimate: Rate at which it is asked.
        rate: Estimate from the frames that did not clip.
        variance: Its variance.
        t: Relative exposure of the frame.
        c: Variance of its x at clipping but for shot noise.
        clips_at: Its x at clipping.
        kappa: Shot noise variance per unit of x.
    """
    expected = max(estimate, 0.0) * t
    noise, below = c + kappa * expected, clips_at - expected
    had_to_clip = (below < 0.0) & (below * below >= CENSORED_SIGMA**2 * noise)
    gap = clips_at - rate * t
    # Far below clipping: it was cut off at the black end, or the scene has changed.
    far = (gap > 0.0) & (gap * gap > CONTRADICTION_SIGMA**2 * (noise + t * t * variance))
    per_sigma = 1.0 / math.sqrt(noise)
    z = below * per_sigma
    silent = had_to_clip | far
    rise = hazard(z)
    score = 0.0 if silent else t * rise * per_sigma
    information = 0.0 if silent else t * t * rise * (rise - z) * (per_sigma * per_sigma)
    return score, information, far & (not had_to_clip) & (expected > 0.1 * clips_at)


@compiled
def with_censored(
    rate: float, variance: float, pattern: Any, frames: Any, begin: int, end: int, kappa: float
) -> tuple[float, float, bool]:  # pragma: no cover (compiled)
    """Return (rate, variance, contradiction) after frames that clipped are heard.

    Args:
        rate: Estimate from the frames that did not clip.
        variance: Its variance.
        pattern: Bits of those frames.
        frames: As in `records.fill_record`.
        begin: First of the frames that may have something to say.
        end: The one after the last of them.
        kappa: Shot noise variance per unit of x.
    """
    from_others = 1.0 / variance
    estimate, information, contradiction = rate, from_others, False
    for _ in range(2):
        score, total = (rate - estimate) * from_others, from_others
        for i in range(begin, end):
            if (pattern >> np.uint64(i)) & np.uint64(1):
                continue
            t, c, clips_at = frames[i, 0], frames[i, 5], frames[i, 2]
            rise, sharper, contradicts = heard(estimate, rate, variance, t, c, clips_at, kappa)
            score, total, contradiction = score + rise, total + sharper, contradiction | contradicts
        estimate += score / total
        information = total
    return estimate, 1.0 / information, contradiction


@compiled_apart
def include_nearest_censored(
    rates: Any, variances: Any, slots: Any, records: Any, frames: Any, kappa: float, contradictions: Any
) -> None:  # pragma: no cover (compiled)
    """Do as `with_censored` does for a run of pixels that one frame only has something to say of: many at a time.

    Args:
        rates: Estimates from the frames that did not clip; overwritten.
        variances: Their variances; overwritten.
        slots: Places of the records, unsigned.
        records: As of `records.fill_record`; the frame is their NEAREST.
        frames: Likewise.
        kappa: Shot noise variance per unit of x.
        contradictions: Whether the frame contradicts the others, written.
    """
    for j in range(slots.size):
        frame = np.uint64(records[slots[j], NEAREST])
        t, c, clips_at = frames[frame, 0], frames[frame, 5], frames[frame, 2]
        rate, variance = rates[j], variances[j]
        from_others = 1.0 / variance
        rise, sharper, before = heard(rate, rate, variance, t, c, clips_at, kappa)
        estimate = rate + rise / (from_others + sharper)
        rise, sharper, after = heard(estimate, rate, variance, t, c, clips_at, kappa)
        information = from_others + sharper
        rates[j] = estimate + ((rate - estimate) * from_others + rise) / information
        variances[j] = 1.0 / information
        contradictions[j] = np.uint8(before | after)


@compiled
def near_clipping(
    rate: float, variance: float, pattern: Any, slot: int, records: Any, frames: Any, kappa: float
) -> tuple[float, float, bool]:  # pragma: no cover (compiled)
    """Return (rate, variance, contradiction) after those frames were heard that need not have clipped at a rate.

    Args:
        rate: Estimate from the frames that did not clip.
        variance: Its variance.
        pattern: Bits of those frames.
        slot: Place of their record.
        records: As of `records.fill_record`.
        frames: Likewise.
        kappa: Shot noise variance per unit of x.
    """
    begin, end = 0, frames.shape[0]
    if rate >= records[slot, NEXT]:  # the others had to clip: only one frame has something to say
        begin = int(records[slot, NEAREST])
        end = begin + 1
    return with_censored(rate, variance, pattern, frames, begin, end, kappa)
