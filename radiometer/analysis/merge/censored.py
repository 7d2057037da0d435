"""What a frame that clips at a pixel still says: "at least so much".

Near clipping it enters with its censored likelihood, or the choice of frames by their own noisy values would bias the
result (Tobin 1958, Econometrica 26, 24).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from radiometer.analysis.merge.records import CENSORED_SIGMA, CONTRADICTION_SIGMA
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
    rate: float, variance: float, pattern: Any, frames: Any, kappa: float
) -> tuple[float, float, bool]:  # pragma: no cover (compiled)
    """Return (rate, variance, contradiction) after frames that clipped are heard.

    Args:
        rate: Estimate from the frames that did not clip.
        variance: Its variance.
        pattern: Bits of those frames.
        frames: As in `records.fill_record`.
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
            noise, below = frames[i, 1] + kappa * expected, clips_at - expected
            if below < 0.0 and below * below >= CENSORED_SIGMA**2 * noise:
                continue  # it had to clip
            gap = clips_at - rate * t
            if gap > 0.0 and gap * gap > CONTRADICTION_SIGMA**2 * (noise + t * t * variance):
                # Far below clipping: it was cut off at the black end, or the scene has changed.
                contradiction = contradiction or expected > 0.1 * clips_at
                continue
            sigma = math.sqrt(noise)
            rise = hazard(below / sigma)
            score += t * rise / sigma
            total += t * t * rise * (rise - below / sigma) / noise
        estimate += score / total
        information = total
    return estimate, 1.0 / information, contradiction
