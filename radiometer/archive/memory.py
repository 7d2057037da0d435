"""Keeps freed memory in the process, so that a picture's arrays need not be zeroed by the kernel again and again."""

from __future__ import annotations

import ctypes
import sys
from functools import cache
from typing import Final

# mallopt(3): parameter numbers of glibc, and the largest block that a thread's heap may hold on 64-bit machines.
_TRIM_THRESHOLD: Final = -1
_MMAP_THRESHOLD: Final = -3  # malloc.h of glibc
_LARGEST_BLOCK: Final = 32 << 20  # glibc's own upper limit on 64 bits
_KEPT_BYTES: Final = 256 << 20  # a capture's frames are read again and again: giving them back costs page faults


@cache
def keep_freed_memory() -> bool:
    """Let this process keep up to 256 MB that it has freed, and return whether that could be set (glibc only).

    By default an array of a few megabytes comes from the kernel page by page and goes back when it is freed; Dask sets
    its workers so that even less is kept. Half of a worker's processor time then goes into clearing pages.
    """
    if not sys.platform.startswith("linux"):
        return False
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (OSError, AttributeError):  # another C library
        return False
    return bool(mallopt(_MMAP_THRESHOLD, _LARGEST_BLOCK)) and bool(mallopt(_TRIM_THRESHOLD, _KEPT_BYTES))
