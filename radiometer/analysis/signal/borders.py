"""Borders between the taps of a sensor: steps along whole lines that pictures of it show."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from itertools import pairwise
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from radiometer.statistics.scale import robust_sigma
from radiometer.typing import Array

_STRIPS: Final = 8  # a border is in all strips of one half of the frame at least: an edge of the scene hardly is
_SIGMAS: Final = 6.0  # of a step in a strip, over all strips: chance exceeds it at one of 1e9 places
_STRIP_SIGMAS: Final = 2.5  # of a step in one strip
_WIDEST_PX: Final = 16  # columns on each side that a line is drawn through: shading is straight over so few
_NARROWEST_PX: Final = 4
_ROUNDING_DN2: Final = 1.0 / 12.0  # variance by rounding to whole codes: less noise cannot be seen


def borders(pictures: Iterable[NDArray[Any]], variance: NDArray[Any] | None = None) -> list[int]:
    """Return the columns at which a tap begins, in rising order.

    The clearest border is taken first. The next ones are looked for on each side of it, so that no line is drawn across
    a border: narrow taps have many.

    Args:
        pictures: Light or dark signal of each pixel, shape (height, width) each; transposed ones give rows.
        variance: Temporal variance of each pixel in DN². Its logarithm counts, which scatters alike in noisy taps and
            in quiet ones.
    """
    strips = [_in_strips(picture) for picture in pictures if picture.shape[0] >= 2 * _STRIPS]
    if variance is not None and variance.shape[0] >= 2 * _STRIPS:
        strips.append(np.log(np.maximum(_in_strips(variance), _ROUNDING_DN2)))
    waiting = [(0, strips[0].shape[1])] if strips else []
    kept: list[int] = []
    while waiting:
        begin, end = waiting.pop()
        found = max((_clearest(picture[:, begin:end]) for picture in strips), key=lambda one: one[1])
        if found[1] > _SIGMAS:
            kept.append(begin + found[0])
            waiting += [(begin, kept[-1]), (kept[-1], end)]
    return sorted(kept)


def _in_strips(picture: NDArray[Any]) -> Array:
    return np.stack([part.mean(axis=0, dtype=np.float64) for part in np.array_split(picture, _STRIPS)])


def borders_of_grid(
    pictures: Sequence[NDArray[Any]], variance: NDArray[Any] | None = None
) -> tuple[list[int], list[int]]:
    """Return the columns and the rows at which taps begin that make a grid, each in rising order.

    What is above another tap may step the other way. So rows are looked for in the columns of each tap by themselves,
    and columns in its rows, until no further ones are found.
    """
    columns, rows = borders(pictures, variance), list[int]()
    turned, turned_variance = [picture.T for picture in pictures], None if variance is None else variance.T
    while True:
        more_rows = _in_parts(turned, turned_variance, columns, rows)
        more_columns = _in_parts(pictures, variance, more_rows, columns)
        if (more_columns, more_rows) == (columns, rows):
            return columns, rows
        columns, rows = more_columns, more_rows


def _in_parts(
    pictures: Sequence[NDArray[Any]], variance: NDArray[Any] | None, parted: Sequence[int], known: Sequence[int]
) -> list[int]:
    """Return the known columns and those that parts of the pictures' rows show, none next to another."""
    found = list(known)
    for begin, end in pairwise([0, *parted, pictures[0].shape[0]]):
        own = borders([one[begin:end] for one in pictures], None if variance is None else variance[begin:end])
        found += [column for column in own if all(abs(column - other) >= _NARROWEST_PX for other in found)]
    return sorted(found)


def _clearest(strips: Array) -> tuple[int, float]:
    """Return the column at which all strips of one half step alike the most, and the step's strength in sigmas."""
    reach = min(_WIDEST_PX, strips.shape[1] // 8)
    if reach < _NARROWEST_PX:
        return 0, 0.0
    narrow = np.array([_step_sigmas(strip, _NARROWEST_PX) for strip in strips])
    wide = np.array([_step_sigmas(strip, reach) for strip in strips])
    sigmas = np.where(np.abs(wide) > np.abs(narrow), wide, narrow)
    halves = sigmas[: _STRIPS // 2], sigmas[_STRIPS // 2 :]
    strength = np.max([_common(half) for half in halves], axis=0)
    column = int(np.argmax(strength))
    return column, float(strength[column])


def _common(sigmas: Array) -> Array:
    """Return the strength of a step that all strips share: 0 where one steps another way or hardly."""
    weakest = np.minimum(np.abs(sigmas.min(axis=0)), np.abs(sigmas.max(axis=0)))
    alike = (np.sign(sigmas) == np.sign(sigmas[0])).all(axis=0) & (weakest > _STRIP_SIGMAS)
    return np.where(alike, np.abs(sigmas.mean(axis=0)) * math.sqrt(len(sigmas)), 0.0)


def _step_sigmas(profile: Array, reach: int) -> Array:
    """Return at every column the step between lines through the columns on each side, over the profile's noise."""
    place = np.arange(reach) + 0.5
    centred = place - place.mean()
    weight = 1.0 / reach - place.mean() * centred / np.sum(centred**2)  # of the line's value at the border
    padded = np.pad(profile, reach, mode="reflect", reflect_type="odd")
    windows = np.lib.stride_tricks.sliding_window_view(padded, reach)
    right = windows[reach : reach + profile.size] @ weight
    left = windows[: profile.size] @ weight[::-1]
    step = right - left
    spread = robust_sigma(step[reach:-reach], 0.0)
    step[:reach] = step[-reach:] = 0.0  # a line must be drawn on each side
    return np.asarray(step / spread if spread > 0 else np.zeros_like(step))
