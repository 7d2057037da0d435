"""Borders between the taps of a sensor: steps along whole lines that pictures of it show."""

from __future__ import annotations

import math
from collections.abc import Iterable
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


def borders(pictures: Iterable[NDArray[Any]]) -> list[int]:
    """Return the columns at which a tap begins, in rising order.

    Args:
        pictures: Light, dark signal or noise of each pixel, shape (height, width) each; transposed ones give rows.
    """
    found: dict[int, float] = {}
    for picture in pictures:
        for column, strength in _steps(picture):
            found[column] = max(strength, found.get(column, 0.0))
    kept: list[int] = []
    for column in sorted(found, key=lambda at: -found[at]):
        if all(abs(column - other) >= _NARROWEST_PX for other in kept):
            kept.append(column)
    return sorted(kept)


def _steps(picture: NDArray[Any]) -> list[tuple[int, float]]:
    """Return the columns at which all strips of one half step alike, with the strength of the step in sigmas."""
    width = picture.shape[1]
    reach = min(_WIDEST_PX, width // 8)
    if reach < _NARROWEST_PX or picture.shape[0] < 2 * _STRIPS:
        return []
    strips = np.stack([part.mean(axis=0, dtype=np.float64) for part in np.array_split(picture, _STRIPS)])
    narrow = np.array([_step_sigmas(strip, _NARROWEST_PX) for strip in strips])
    wide = np.array([_step_sigmas(strip, reach) for strip in strips])
    sigmas = np.where(np.abs(wide) > np.abs(narrow), wide, narrow)
    halves = sigmas[: _STRIPS // 2], sigmas[_STRIPS // 2 :]
    strength = np.max([_common(half) for half in halves], axis=0)
    found = []
    for column in np.flatnonzero(strength > _SIGMAS):
        around = strength[max(column - reach, 0) : column + reach + 1]
        if strength[column] == around.max():
            found.append((int(column), float(strength[column])))
    return found


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
    step[:_NARROWEST_PX] = step[-_NARROWEST_PX:] = 0.0
    spread = robust_sigma(step, 0.0)
    return np.asarray(step / spread if spread > 0 else np.zeros_like(step))
