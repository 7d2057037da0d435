"""Deadlines that judge the code and not the machine: they grow with what the machine is slower by just now."""

from __future__ import annotations

import os
import time


def slowness() -> float:
    """Return how many times longer this process waits for its work than it works, at least 1.

    A short piece of work is timed by the clock and by the processor; what others take of the machine lies between.
    """
    begun, worked = time.monotonic(), time.process_time()
    total = 0
    while time.process_time() - worked < 0.01:
        total += sum(range(500))
    waited = (time.monotonic() - begun) / 0.01
    return max(1.0, waited, queue())


def queue() -> float:
    """Return how many processes share a core just now, by the mean of the last minute."""
    return os.getloadavg()[0] / (os.cpu_count() or 1)


def within(seconds: float) -> float:
    """Return a time in s that a quiet machine would do something in, as long as it takes on this one now."""
    return seconds * slowness()
