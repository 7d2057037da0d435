"""The sums per pixel that frames are added to on their way into a merge."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from radiometer.analysis.merge import kernels as merge_kernels
from radiometer.analysis.merge.frames import FrameTerms
from radiometer.analysis.merge.records import FIRST_POWER

Images = tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.uint8]]

FRAMES_PER_PLANE: Final = merge_kernels.MANY
_AT_ONCE: Final = 4  # frames that one pass over the sums takes in


@dataclass(frozen=True, slots=True, eq=False)
class MergeSample:
    """A frame on its way into the sums.

    Attributes:
        dn: Digital numbers, one-dimensional.
        terms: The frame's constants.
        table: x by digital number; None where the sensor is linear and the dark signal one number.
        index: Place of the frame, from 0.
        usable: x less the dark signal by digital number, 0 where it is not used; None without a table, or where the
            dark signal is that of every pixel.
    """

    dn: NDArray[Any]
    terms: FrameTerms
    table: NDArray[np.float32] | None
    index: int
    usable: NDArray[np.float32] | None = None

    @classmethod
    def of(cls, dn: NDArray[Any], terms: FrameTerms, table: NDArray[np.float32] | None, index: int) -> MergeSample:
        """Return a frame's sample with what follows from its table; arguments as the attributes."""
        sample = cls(dn, terms, table, index)
        if table is None or terms.dark.size > 1:
            return sample
        low, high = sample.limits
        # As long as its type has digital numbers: the compiled loop asks of none whether the table holds it.
        usable = np.zeros(int(np.iinfo(dn.dtype).max) + 1, np.float32)
        usable[low:high] = table[low:high] - terms.dark
        return replace(sample, usable=usable)

    @property
    def limits(self) -> tuple[int, int]:
        """Return the lowest digital number that is used, and the one from which the frame clips."""
        return self.terms.low_dn, min(self.terms.high_dn, int(np.iinfo(self.dn.dtype).max))

    @property
    def plane(self) -> int:
        """Return which plane of bits the frame's bit is in."""
        return self.index // FRAMES_PER_PLANE

    @property
    def bit(self) -> int:
        """Return the frame's bit in its plane."""
        return 1 << (self.index % FRAMES_PER_PLANE)

    def signal_at(self, pixels: NDArray[np.intp]) -> NDArray[np.float64]:
        """Return the signal x of some pixels, clipped or not."""
        dn = self.dn[pixels]
        if self.table is None:
            offset, inverse, _, _ = self.constants(1.0)
            return np.asarray((dn.astype(np.float64) - offset) * inverse)
        dark = self.terms.dark if self.terms.dark.size == 1 else self.terms.dark[pixels]
        return np.asarray(self.table[dn].astype(np.float64) - dark)

    def only(self, pixels: NDArray[np.intp], index: int) -> MergeSample:
        """Return some pixels as a separate frame at another place among the frames."""
        dark = self.terms.dark
        terms = self.terms if dark.size == 1 else replace(self.terms, dark=np.ascontiguousarray(dark[pixels]))
        return replace(self, dn=np.ascontiguousarray(self.dn[pixels]), terms=terms, index=index)

    def is_like(self, other: MergeSample) -> bool:
        """Return whether both frames can go into the sums in one pass: both linear, or both through a table alone."""
        linear = self.table is None and other.table is None
        alike = linear or (self.usable is not None and other.usable is not None)
        return alike and self.plane == other.plane and self.dn.dtype == other.dn.dtype

    def constants(self, reference: float) -> tuple[float, float, float, float]:
        """Return offset in DN and 1/gain (of no meaning with a table), relative exposure t, and t^0.35."""
        relative = self.terms.exposure / reference
        offset = self.terms.black_dn + self.terms.gain * float(self.terms.dark[0])
        return offset, 1.0 / self.terms.gain, relative, relative**FIRST_POWER


@dataclass(frozen=True, slots=True, eq=False)
class MergeSums:
    """Sums of a run of pixels, one-dimensional and contiguous.

    Attributes:
        first: Σt^0.35·x, float32.
        second: Σt·x, float32.
        squares: Σx², float32.
        mask: Whether a frame was clipped at white so far, as PixelMask bit, uint8.
        planes: Bits of the frames used, uint16, a plane for every 16 frames.
    """

    first: NDArray[np.float32]
    second: NDArray[np.float32]
    squares: NDArray[np.float32]
    mask: NDArray[np.uint8]
    planes: list[NDArray[np.uint16]] = field(default_factory=list)

    @classmethod
    def zeros(cls, size: int) -> MergeSums:
        """Return empty sums of `size` pixels without room for any frame's bit."""
        first, second, squares = (np.zeros(size, np.float32) for _ in range(3))
        return cls(first, second, squares, np.zeros(size, np.uint8))

    def make_room(self, frames: int) -> None:
        """Make sure that the bits of `frames` frames can be kept."""
        while len(self.planes) * FRAMES_PER_PLANE < frames:
            self.planes.append(np.zeros(self.first.size, np.uint16))

    def part(self, start: int, stop: int) -> MergeSums:
        """Return the sums of the pixels from `start` to `stop` as views."""
        cut = slice(start, stop)
        planes = [plane[cut] for plane in self.planes]
        return MergeSums(self.first[cut], self.second[cut], self.squares[cut], self.mask[cut], planes)

    def patterns(self) -> NDArray[np.uint16] | NDArray[np.uint64]:
        """Return the bits of all frames used in each pixel."""
        if len(self.planes) == 1:
            return self.planes[0]
        bits = self.planes[0].astype(np.uint64)
        for number, plane in enumerate(self.planes[1:], start=1):
            bits |= plane.astype(np.uint64) << np.uint64(number * FRAMES_PER_PLANE)
        return bits

    def add(self, passes: Sequence[MergePass], start: int) -> None:
        """Add the pixels of frames from `start` on, as many as there are sums.

        Args:
            passes: The frames, as of `merge_passes`.
            start: First pixel of the frames that the sums are of.
        """
        for one in passes:
            one(self, start)

    def view(self, plane: int) -> tuple[NDArray[Any], ...]:
        """Return the sums in the order of the compiled loops, with one plane of bits."""
        return self.first, self.second, self.squares, self.planes[plane], self.mask


MergePass = Callable[[MergeSums, int], None]


def merge_passes(samples: Sequence[MergeSample], reference: float) -> list[MergePass]:
    """Return the passes over the sums that take frames in, as few as can be.

    What the compiled loops are given of the frames is made once, not for every block of pixels anew.

    Args:
        samples: The frames.
        reference: Exposure that exposures are counted in.
    """
    passes, waiting = [], list(samples)
    while waiting:
        one = waiting[0]
        alike = list(itertools.takewhile(one.is_like, waiting[:FRAMES_PER_PLANE]))
        if len(alike) >= _AT_ONCE:
            alike = alike[: len(alike) // _AT_ONCE * _AT_ONCE]
            passes.append(_fours(alike, reference))
        elif len(alike) > 1 and one.table is None:
            alike = alike[:2]
            passes.append(_linear_pair(alike[0], alike[1], reference))
        else:
            alike = [one]
            passes.append(_single(one, reference))
        waiting = waiting[len(alike) :]
    return passes


def _fours(alike: Sequence[MergeSample], reference: float) -> MergePass:
    # Always as many arrays: the loop is compiled once. Those that do not count are not looked at.
    dn, count, plane = (
        tuple(alike[min(k, len(alike) - 1)].dn for k in range(merge_kernels.MANY)),
        len(alike),
        alike[0].plane,
    )
    constants = np.array([one.constants(reference) for one in alike], np.float32)
    limits, bits = np.array([one.limits for one in alike], dn[0].dtype), np.array([one.bit for one in alike], np.uint16)
    if alike[0].table is None:
        return lambda sums, start: merge_kernels.add_linear_many(
            dn, count, start, constants, limits, bits, *sums.view(plane)
        )
    tables = tuple(alike[min(k, count - 1)].usable for k in range(merge_kernels.MANY))
    exposures = np.ascontiguousarray(constants[:, 2:])
    return lambda sums, start: merge_kernels.add_table_many(
        dn, count, start, tables, exposures, limits, bits, *sums.view(plane)
    )


def _linear_pair(one: MergeSample, two: MergeSample, reference: float) -> MergePass:
    constants = np.array([one.constants(reference), two.constants(reference)], np.float32)
    limits = np.array([one.limits, two.limits], one.dn.dtype)
    bits = np.array([one.bit, two.bit], np.uint16)

    def add(sums: MergeSums, start: int) -> None:
        here = slice(start, start + sums.first.size)
        merge_kernels.add_linear_pair(one.dn[here], two.dn[here], constants, limits, bits, *sums.view(one.plane))

    return add


def _single(one: MergeSample, reference: float) -> MergePass:
    low, high = (one.dn.dtype.type(limit) for limit in one.limits)
    offset, inverse, exposure, weight = (np.float32(value) for value in one.constants(reference))
    bit = np.uint16(one.bit)

    def add(sums: MergeSums, start: int) -> None:
        here = slice(start, start + sums.first.size)
        dn, view = one.dn[here], sums.view(one.plane)
        if one.table is None:
            merge_kernels.add_linear(dn, offset, inverse, low, high, exposure, weight, bit, *view)
        else:
            dark = one.terms.dark if one.terms.dark.size == 1 else one.terms.dark[here]
            merge_kernels.add_table(dn, one.table, dark, low, high, exposure, weight, bit, *view)

    return add


@dataclass(frozen=True, slots=True, eq=False)
class ScratchSums:
    """Sums of one block of pixels after another, each used up before the next: only the result is kept of all pixels.

    Attributes:
        first: Place of the radiance of all pixels, and of a block's Σt^0.35·x before.
        second: Place of its uncertainty, and of a block's Σt·x before.
        mask: Place of the mask, uint8.
        squares: Σx² of a block.
        planes: Bits of the frames used in a block.
    """

    first: NDArray[np.float32]
    second: NDArray[np.float32]
    mask: NDArray[np.uint8]
    squares: NDArray[np.float32]
    planes: list[NDArray[np.uint16]]

    @classmethod
    def of(cls, images: Images, most: int, frames: int) -> ScratchSums:
        """Return sums of blocks of `most` pixels and `frames` frames.

        Args:
            images: Places of radiance, uncertainty and mask of all pixels, flat.
            most: Pixels of the largest block.
            frames: Number of frames.
        """
        block = MergeSums.zeros(most)
        block.make_room(frames)
        return cls(*images, block.squares, block.planes)

    def part(self, start: int, stop: int) -> MergeSums:
        """Return empty sums of the pixels from `start` to `stop`; those of the part before are lost."""
        cut, size = slice(start, stop), stop - start
        planes = [plane[:size] for plane in self.planes]
        part = MergeSums(self.first[cut], self.second[cut], self.squares[:size], self.mask[cut], planes)
        for one in (part.first, part.second, part.squares):
            one.fill(0.0)
        part.mask.fill(0)
        for plane in planes:
            plane.fill(0)
        return part
