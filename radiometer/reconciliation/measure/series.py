"""Finds where a long series of equal frames jumps: captures are cut there, so that none spans an event."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from typing import Final

import numpy as np

from radiometer.reconciliation.measure.design import Design
from radiometer.statistics.scale import robust_sigma
from radiometer.typing import Array

_STANDS_OUT: Final = 8.0  # times what neighbouring frames differ by otherwise
_STAYS: Final = 4.0  # the same of the frames behind the jump: a lone frame that differs is no jump
_BESIDE: Final = 3  # frames on either side that tell whether it stays
_MOST_JUMPS: Final = 8  # of one series, the largest first


def jumps(design: Design, tiles_of: Callable[[tuple[int, ...]], Array]) -> tuple[int, ...]:
    """Return the positions in the header of the frames that are the first behind a jump.

    Args:
        design: Captures; those that follow each other in one setting are a series.
        tiles_of: Gives the mean of each tile in frames at positions of the header, (frames, tiles) in DN.
    """
    return tuple(sorted(frame for frames in _series(design) for frame in _of_series(frames, tiles_of(frames))))


def _series(design: Design) -> Iterator[tuple[int, ...]]:
    """Yield the frames of captures of one setting that follow each other, where there are several."""
    numbers = range(len(design.captures))
    for _, same in itertools.groupby(numbers, key=lambda number: design.setting_id[number]):
        captures = [design.captures[number].frames for number in same]
        frames = tuple(itertools.chain.from_iterable(captures))
        if len(captures) > 1 and frames == tuple(range(frames[0], frames[0] + len(frames))):
            yield frames


def _of_series(frames: tuple[int, ...], means: Array) -> list[int]:
    level = np.median(means - means.mean(axis=0), axis=1)
    steps = np.diff(level)
    usual = robust_sigma(steps)
    found = []
    for at in np.argsort(-np.abs(steps), kind="stable")[:_MOST_JUMPS].tolist():
        behind, before = level[at + 1 : at + 1 + _BESIDE], level[max(at + 1 - _BESIDE, 0) : at + 1]
        stays = abs(float(np.median(behind) - np.median(before)))
        if abs(float(steps[at])) > _STANDS_OUT * usual and stays > _STAYS * usual:
            found.append(frames[at + 1])
    return found
