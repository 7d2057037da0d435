"""Lets the event loop run as soon as a client's message is there, while measurements compute beside it."""

from __future__ import annotations

import gc
import os
import sys
from typing import Final

# The event loop must get the interpreter soon after a reply is due, even while a measurement computes.
_SWITCH_INTERVAL_S: Final = 0.0005
_PRIORITY: Final = 1  # the lowest of the real-time ones: before everything ordinary, behind every other


def be_prompt() -> bool:
    """Give the calling thread, that of the event loop, the processor whenever it has something to do.

    With as many busy threads as cores, an ordinary thread that wakes may wait for a whole time slice of another one,
    4 ms and more. Threads and programs that this one starts are ordinary again; a loop that never rests is held to
    95 % by the kernel (sched(7)) and ended by the watchdog.

    Returns:
        Whether the system allowed it: to root, and within RLIMIT_RTPRIO.
    """
    sys.setswitchinterval(_SWITCH_INTERVAL_S)
    gc.freeze()  # what was imported stays for good: a collection need not look at it
    try:
        os.sched_setscheduler(0, os.SCHED_RR | os.SCHED_RESET_ON_FORK, os.sched_param(_PRIORITY))
    except OSError:
        return False
    return True
