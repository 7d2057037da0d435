"""A bracket: frames of one unmoving scene at several exposures."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from radiometer.data.frame import DigitalNumbers, Frame
from radiometer.errors import InputError


@dataclass(frozen=True, slots=True, eq=False)
class Bracket:
    """Frames of one scene, all of one size and bit depth, from the shortest effective exposure to the longest.

    Attributes:
        frames: Light frames, at least one.
        dark_frames: Frames with the shutter closed, possibly none.
        origin: Where the frames came from, for messages and provenance.
    """

    frames: tuple[Frame, ...]
    dark_frames: tuple[Frame, ...] = ()
    origin: str = ""

    @classmethod
    def from_frames(cls, frames: Iterable[Frame], origin: str = "") -> Self:
        """Return a bracket of the given frames, dark frames set apart and the rest sorted by exposure.

        Raises:
            InputError: If there is no light frame, or sizes or bit depths differ.
        """
        everything = list(frames)
        light = sorted((f for f in everything if not f.settings.is_dark), key=lambda f: f.settings.effective_exposure_s)
        dark = tuple(f for f in everything if f.settings.is_dark)
        return cls(tuple(light), dark, origin)

    def __post_init__(self) -> None:
        where = self.origin or "bracket"
        if not self.frames:
            raise InputError(f"{where}: holds no frame with the shutter open")
        first = self.frames[0]
        for frame in (*self.frames, *self.dark_frames):
            if frame.shape != first.shape:
                raise InputError(
                    f"{where}: frames differ in size ({frame.shape[1]} × {frame.shape[0]} beside "
                    f"{first.shape[1]} × {first.shape[0]} pixels); all frames of a bracket need one size"
                )
            if frame.bit_depth != first.bit_depth:
                raise InputError(
                    f"{where}: frames differ in bit depth ({frame.bit_depth} beside {first.bit_depth}); "
                    "take the whole bracket in one pixel format"
                )

    def thinned(self, most_pixels: int) -> Bracket:
        """Return every n-th pixel of every n-th row where there are more than so many, n odd; itself where not."""
        pixels = self.shape[0] * self.shape[1]
        if pixels <= most_pixels:
            return self
        step = math.ceil(math.sqrt(pixels / most_pixels))
        step += (step + 1) % 2

        def lattice(frame: Frame) -> Frame:
            dn: DigitalNumbers = np.ascontiguousarray(frame.dn[step // 2 :: step, step // 2 :: step])  # type: ignore[assignment]
            return replace(frame, dn=dn)

        return replace(
            self,
            frames=tuple(lattice(frame) for frame in self.frames),
            dark_frames=tuple(lattice(frame) for frame in self.dark_frames),
        )

    def __len__(self) -> int:
        return len(self.frames)

    def __iter__(self) -> Iterator[Frame]:
        return iter(self.frames)

    @property
    def bit_depth(self) -> int:
        """Return the bits per pixel."""
        return self.frames[0].bit_depth

    @property
    def shape(self) -> tuple[int, int]:
        """Return (height, width) in pixels."""
        return self.frames[0].shape

    @property
    def effective_exposures_s(self) -> NDArray[np.float64]:
        """Return exposure time × gain factor of every light frame in s, ascending."""
        return np.array([f.settings.effective_exposure_s for f in self.frames])
