"""A bracket: frames of one unmoving scene at several exposures."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NoReturn, Self

import numpy as np
from numpy.typing import NDArray

from radiometer.data.frame import DigitalNumbers, Frame
from radiometer.errors import InputError


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Bracket:
    """Frames of one scene, all of one size and bit depth, from the shortest effective exposure to the longest.

    A bracket is not iterable: `light` and `dark` say which frames are meant.
    """

    light: tuple[Frame, ...]  # frames with the shutter open, at least one
    dark: tuple[Frame, ...] = ()  # frames with the shutter closed, possibly none
    origin: str = ""  # where the frames came from, for messages and provenance

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
        if not self.light:
            raise InputError(f"{where}: holds no frame with the shutter open")
        first = self.light[0]
        for frame in self.every_frame:
            if frame.shape != first.shape:
                raise InputError(
                    f"{where}: frames differ in size ({frame.shape[1]} × {frame.shape[0]} and "
                    f"{first.shape[1]} × {first.shape[0]} pixels); all frames of a bracket need one size"
                )
            if frame.bit_depth != first.bit_depth:
                raise InputError(
                    f"{where}: frames differ in bit depth ({frame.bit_depth} and {first.bit_depth}); "
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
            light=tuple(lattice(frame) for frame in self.light),
            dark=tuple(lattice(frame) for frame in self.dark),
        )

    if not TYPE_CHECKING:  # a type checker must find a loop over a bracket, not believe that it ends in an error

        def __iter__(self) -> NoReturn:
            """Raise TypeError: whoever loops over a bracket would lose its dark frames without notice."""
            raise TypeError("a Bracket is not iterable: loop over bracket.light, bracket.dark or bracket.every_frame")

    @property
    def every_frame(self) -> tuple[Frame, ...]:
        """Return dark and light frames, the dark ones first."""
        return (*self.dark, *self.light)

    def with_light(self, light: Iterable[Frame]) -> Bracket:
        """Return the bracket with other light frames, sorted by exposure, and its own dark frames."""
        return self.from_frames((*self.dark, *light), origin=self.origin)

    def __repr__(self) -> str:
        """Return number, size, bits and exposure times of the frames in one line, no pixels."""
        times = [frame.settings.exposure_s for frame in self.light]
        height, width = self.shape
        dark = f" + {len(self.dark)} dark" if self.dark else ""
        return (
            f"<Bracket {self.origin}: {len(self.light)}{dark} frames of {width} × {height} pixels, "
            f"{self.bit_depth} bits, {min(times):.4g} to {max(times):.4g} s>"
        )

    @property
    def bit_depth(self) -> int:
        """Return the bits per pixel."""
        return self.light[0].bit_depth

    @property
    def shape(self) -> tuple[int, int]:
        """Return (height, width) in pixels."""
        return self.light[0].shape

    @property
    def effective_exposures_s(self) -> NDArray[np.float64]:
        """Return exposure time × gain factor of every light frame in s, ascending."""
        return np.array([f.settings.effective_exposure_s for f in self.light])
