"""A picture cut into parts: whole rows for each core, and in them blocks that stay in a core's cache."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Final

BLOCK_PIXELS: Final = 1 << 15  # a block's sums stay in a core's second-level cache
_PARTS_PER_CORE: Final = (
    4  # few, because each costs the interpreter's lock; several, because cores are not equally fast
)


def on_all_cores(shape: tuple[int, int], work: Callable[[int, int], None]) -> None:
    """Call work(start, stop) for parts of whole rows that make up the picture, on all cores.

    Args:
        shape: Height and width in pixels.
        work: Takes the first pixel of a part and the one after its last; must hold no lock to gain by it.
    """
    height, width = shape
    cores = os.cpu_count() or 1
    rows = -(-height // (cores * _PARTS_PER_CORE)) * width
    parts = [(start, min(start + rows, height * width)) for start in range(0, height * width, rows)]
    with ThreadPoolExecutor(max_workers=cores) as pool:
        list(pool.map(lambda part: work(*part), parts))


def block_size(width: int) -> int:
    """Return the largest number of pixels that a block has: whole rows, as many as the cache holds, one at least."""
    return max(1, BLOCK_PIXELS // width) * width


def blocks(start: int, stop: int, width: int) -> Iterator[tuple[int, int]]:
    """Yield the bounds of blocks of whole rows."""
    step = block_size(width)
    for begin in range(start, stop, step):
        yield begin, min(begin + step, stop)
