"""Holds the earlier frames of all captures at once."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal, Self

import numpy as np
from numpy.typing import NDArray

from radiometer.reconciliation.measure.design import Design
from radiometer.typing import Array

Part = Literal["all", "first", "later"]
_MOST_KNOWN: Final = 64  # tables that are kept: a search comes back to the same time constants
_AT_ONCE: Final = 256  # frames that look back together: thousands of frames have millions of pairs


class FrameTimes:
    """When the frames of all captures were taken."""

    def __init__(self, stamps_s: Array, owner: NDArray[np.intp], place: NDArray[np.intp], captures: int) -> None:
        """Take up the frames.

        Args:
            stamps_s: (frames,) times.
            owner: (frames,) capture that each belongs to, one after the other.
            place: (frames,) its number within the capture.
            captures: How many captures there are.
        """
        self._stamps_s, self._owner = stamps_s, owner
        self._starts = np.searchsorted(owner, np.arange(captures))
        lone = np.bincount(owner, minlength=captures)[owner] == 1
        self._meant = {"all": place >= 0, "first": place == 0, "later": (place > 0) | lone}
        self._known: dict[tuple[Part, float], Array] = {}

    @classmethod
    def of(cls, design: Design) -> Self | None:
        """Return the times of a design's frames; None where that of any frame is not known."""
        frames = [(index, at, number) for at, c in enumerate(design.captures) for number, index in enumerate(c.frames)]
        stamps = [stamp for index, _, _ in frames if (stamp := design.header.frames[index].timestamp_s) is not None]
        if len(stamps) < len(frames):
            return None
        _, owner, place = (np.array(column, dtype=np.intp) for column in zip(*frames, strict=True))
        return cls(np.array(stamps, dtype=np.float64), owner, place, len(design.captures))

    def fading(self, tau_s: float, part: Part) -> Array:
        """Return Σ exp(−age/τ) over each capture's frames before those of another, on average over these.

        Args:
            tau_s: Time constant in s.
            part: The frames that look back: all of a capture, its first one or the others; a lone one is all parts.

        Returns:
            (captures that look back, captures).
        """
        if (part, tau_s) not in self._known:
            if len(self._known) >= _MOST_KNOWN:
                self._known.clear()
            found = np.zeros((self._starts.size, self._starts.size))
            looking = np.flatnonzero(self._meant[part])
            for begin in range(0, looking.size, _AT_ONCE):
                some = looking[begin : begin + _AT_ONCE]
                age_s = self._stamps_s[some, None] - self._stamps_s
                kept = np.where(age_s > 0, np.exp(-np.maximum(age_s, 0.0) / tau_s), 0.0)
                np.add.at(found, self._owner[some], np.add.reduceat(kept, self._starts, axis=1))
            self._known[part, tau_s] = found / np.bincount(self._owner[looking])[:, None]
        return self._known[part, tau_s]


@dataclass(frozen=True, slots=True, eq=False)
class CapturesPast:
    """The earlier frames of each capture, as some of its frames see them.

    Attributes:
        times: When the frames were taken.
        held_e: (captures, tiles) electrons in each frame of a capture.
        part: The frames that look back.
    """

    times: FrameTimes
    held_e: Array
    part: Part = "all"

    def faded(self, tau_s: float) -> Array:
        """Return the sum of what all earlier frames held, each times exp(−age/τ), (captures, tiles, 1) in electrons."""
        return np.asarray((self.times.fading(tau_s, self.part) @ self.held_e)[:, :, None])
