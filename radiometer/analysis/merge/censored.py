"""What a frame that clips at a pixel still says: "at least so much".

Near clipping it enters with its censored likelihood, or the choice of frames by their own noisy values would bias the
result (Tobin 1958, Econometrica 26, 24).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from radiometer.analysis.merge.records import CENSORED_SIGMA, CONTRADICTION_SIGMA, NEAREST, NEXT
from radiometer.compiled import compiled

# The hazard is read off straight lines, right to 1e-6, which is quicker than exp and erfc for every such pixel.
_TABLE_END, _TABLE_STEPS = 8.0, 4096
_PER_SIGMA = _TABLE_STEPS / (_TABLE_END + CENSORED_SIGMA)


def _hazard(z: float) -> float:
    """Return φ(z)/(1 − Φ(z)), the hazard of the normal distribution."""
    return math.sqrt(2.0 / math.pi) * math.exp(-0.5 * z * z) / math.erfc(z / math.sqrt(2.0))


_HAZARD = np.array([_hazard(step / _PER_SIGMA - CENSORED_SIGMA) for step in range(_TABLE_STEPS + 1)])


@compiled
def hazard(z: float) -> float:  # pragma: no cover (compiled)
    """Return φ(z)/(1 − Φ(z)) to 1e-6 for z at or above −CENSORED_SIGMA."""
    place = (z + CENSORED_SIGMA) * _PER_SIGMA
    if place >= _TABLE_STEPS:
        return z + 1.0 / z - 2.0 / z**3  # its asymptotic series, right to 3e-4 and better beyond
    low = int(place)
    return float(_HAZARD[low] + (place - low) * (_HAZARD[low + 1] - _HAZARD[low]))


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
            t, clips_at = frames[i, 0], frames[i, 2]
            expected = max(estimate, 0.0) * t
            noise, below = frames[i, 1] + kappa * expected, clips_at - expected
            if below < 0.0 and below * below >= CENSORED_SIGMA**2 * noise:
                continue  # it had to clip
            gap = clips_at - rate * t
            if gap > 0.0 and gap * gap > CONTRADICTION_SIGMA**2 * (noise + t * t * variance):
                # Far below clipping: it was cut off at the black end, or the scene has changed.
                contradiction = contradiction or expected > 0.1 * clips_at
                continue
            per_sigma = 1.0 / math.sqrt(noise)
            z = below * per_sigma
            rise = hazard(z)
            score += t * rise * per_sigma
            total += t * t * rise * (rise - z) * (per_sigma * per_sigma)
        estimate += score / total
        information = total
    return estimate, 1.0 / information, contradiction


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
