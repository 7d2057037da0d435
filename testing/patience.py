"""Deadlines that judge the code and not the machine: they grow with what the machine is slower by just now."""

from __future__ import annotations

import os
import time
from functools import lru_cache

# In front of a program that a test starts: it ends with the test's process, however that ends, and holds no port then.
ENDS_WITH_US = ("setpriv", "--pdeathsig", "KILL")
TURN_S = 2.0  # as long a measurement serves: each is work itself, and hundreds of tests ask


def slowness() -> float:
    """Return how many times longer this process waits for its work than it works, at least 1."""
    return max(1.0, waited_for_work(int(time.monotonic() / TURN_S)), queue())


@lru_cache(maxsize=1)
def waited_for_work(turn: int) -> float:
    """Return how many times longer a short piece of work takes by the clock than by the processor, once in a turn.

    What others take of the machine lies between.
    """
    begun, worked = time.monotonic(), time.process_time()
    total = 0
    while time.process_time() - worked < 0.01:
        total += sum(range(500))
    return (time.monotonic() - begun) / 0.01


def queue() -> float:
    """Return how many processes share a core just now, by the mean of the last minute."""
    return os.getloadavg()[0] / (os.cpu_count() or 1)


def within(seconds: float) -> float:
    """Return a time in s that a quiet machine would do something in, as long as it takes on this one now."""
    return seconds * slowness()
