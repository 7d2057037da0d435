"""Settings as a photographic camera prints them: rounded thirds of a stop."""

from __future__ import annotations

import math
from dataclasses import replace

from testing.generator.plan import Setting

# As engraved and displayed on cameras; the exact values are powers of two.
DENOMINATORS = (
    8000,
    6400,
    5000,
    4000,
    3200,
    2500,
    2000,
    1600,
    1250,
    1000,
    800,
    640,
    500,
    400,
    320,
    250,
    200,
    160,
    125,
    100,
    80,
    60,
    50,
    40,
    30,
    25,
    20,
    15,
    13,
    10,
    8,
    6,
    5,
    4,
)
STOPS = (2.8, 4.0, 5.6, 8.0, 11.0)
SHORTER = (10_000, 13_000, 16_000, 20_000, 25_000, 32_000)


def printed(settings: list[Setting]) -> list[Setting]:
    """Return the settings with the nearest printed exposure; long darks stay."""
    times = [1 / d for d in (*SHORTER[::-1], *DENOMINATORS)]
    return [
        s if s.exposure_s > 0.2 else replace(s, exposure_s=min(times, key=lambda t: abs(math.log(t / s.exposure_s))))
        for s in settings
    ]
