"""Sums per pixel that frames are added to as they arrive, with their compiled inner loops.

All arrays are one-dimensional and contiguous: a block of whole rows. The functions hold no lock, so that a thread
per core can work on a block each. Compiled code is kept on disk next to this module. Of clipping only white is marked:
where no frame is of use and none was white, all were black.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from radiometer.analysis.merge.frames import FrameTerms
from radiometer.analysis.merge.tables import FIRST_POWER
from radiometer.compiled import compiled
from radiometer.data.radiance_map import PixelMask

CLIPPED_HIGH = np.uint8(PixelMask.SATURATED)
MANY = 16  # frames that go through one call; those of one plane of bits
_RUN = 4096  # pixels: their sums and four frames of 16 bits are read from a core's nearest caches
Images = tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.uint8]]

FRAMES_PER_PLANE: Final = MANY
_AT_ONCE: Final = 4  # frames that one pass over the sums takes in


@compiled
def add_linear_four(
    dn_a: Any,
    dn_b: Any,
    dn_c: Any,
    dn_d: Any,
    constants: Any,
    limits: Any,
    bits_of: Any,
    first: Any,
    second: Any,
    squares: Any,
    bits: Any,
    mask: Any,
) -> None:  # pragma: no cover (compiled)
    """Add four frames of a linear sensor in one pass over the sums, which is what takes the time.

    A frame's signal is x = (M − offset)/gain where low ≤ M < high.

    Args:
        dn_a: Digital numbers of the first frame's block, uint8 or uint16.
        dn_b: Of the second, of the same type; `dn_c` and `dn_d` likewise.
        dn_c: Of the third.
        dn_d: Of the fourth.
        constants: Black level plus dark signal in DN, 1/gain, relative exposure t, and t to the power
            `FIRST_POWER` of each, float32, shape (4, 4).
        limits: Lowest digital number used and the one from which the frame clips, of the type of `dn_a`, shape (4, 2).
        bits_of: Bits of the frames, of the type of `bits`, shape (4,).
        first: Σw·x, float32, added to.
        second: Σt·x, float32, added to.
        squares: Σx², float32, added to.
        bits: Frames used in each pixel, added to.
        mask: Whether a frame was clipped at white in each pixel, added to.
    """
    offset_a, inverse_a, exposure_a, weight_a = constants[0]
    offset_b, inverse_b, exposure_b, weight_b = constants[1]
    offset_c, inverse_c, exposure_c, weight_c = constants[2]
    offset_d, inverse_d, exposure_d, weight_d = constants[3]
    low_a, high_a, low_b, high_b = limits[0, 0], limits[0, 1], limits[1, 0], limits[1, 1]
    low_c, high_c, low_d, high_d = limits[2, 0], limits[2, 1], limits[3, 0], limits[3, 1]
    zero = np.float32(0.0)
    for i in range(dn_a.size):
        a, b, c, d = dn_a[i], dn_b[i], dn_c[i], dn_d[i]
        used_a, used_b = (a >= low_a) & (a < high_a), (b >= low_b) & (b < high_b)
        used_c, used_d = (c >= low_c) & (c < high_c), (d >= low_d) & (d < high_d)
        x_a = (np.float32(a) - offset_a) * inverse_a if used_a else zero
        x_b = (np.float32(b) - offset_b) * inverse_b if used_b else zero
        x_c = (np.float32(c) - offset_c) * inverse_c if used_c else zero
        x_d = (np.float32(d) - offset_d) * inverse_d if used_d else zero
        first[i] = (((first[i] + weight_a * x_a) + weight_b * x_b) + weight_c * x_c) + weight_d * x_d
        second[i] = (((second[i] + exposure_a * x_a) + exposure_b * x_b) + exposure_c * x_c) + exposure_d * x_d
        squares[i] = (((squares[i] + x_a * x_a) + x_b * x_b) + x_c * x_c) + x_d * x_d
    _mark_four(dn_a, dn_b, dn_c, dn_d, limits, bits_of, bits, mask)


@compiled
def add_table_four(
    dn_a: Any,
    dn_b: Any,
    dn_c: Any,
    dn_d: Any,
    tables: Any,
    constants: Any,
    limits: Any,
    bits_of: Any,
    first: Any,
    second: Any,
    squares: Any,
    bits: Any,
    mask: Any,
) -> None:  # pragma: no cover (compiled)
    """Add four frames through tables by digital number in one pass over the sums.

    Only loops without a look-up are vectorised: what is marked goes after what is summed.

    Args:
        dn_a: Digital numbers of the first frame.
        dn_b: Of the second, of the same type; `dn_c` and `dn_d` likewise.
        dn_c: Of the third.
        dn_d: Of the fourth.
        tables: x less its dark signal at every digital number of each, 0 where it is not used, float32.
        constants: Exposure and weight of each as in `add_linear_four`, float32, shape (4, 2).
        limits: As in `add_linear_four`.
        bits_of: Likewise.
        first: As in `add_linear_four`; so are `second`, `squares`, `bits` and `mask`.
    """
    exposure_a, weight_a = constants[0]
    exposure_b, weight_b = constants[1]
    exposure_c, weight_c = constants[2]
    exposure_d, weight_d = constants[3]
    table_a, table_b, table_c, table_d = tables[0], tables[1], tables[2], tables[3]
    for i in range(dn_a.size):
        x_a, x_b, x_c, x_d = table_a[dn_a[i]], table_b[dn_b[i]], table_c[dn_c[i]], table_d[dn_d[i]]
        first[i] = (((first[i] + weight_a * x_a) + weight_b * x_b) + weight_c * x_c) + weight_d * x_d
        second[i] = (((second[i] + exposure_a * x_a) + exposure_b * x_b) + exposure_c * x_c) + exposure_d * x_d
        squares[i] = (((squares[i] + x_a * x_a) + x_b * x_b) + x_c * x_c) + x_d * x_d
    _mark_four(dn_a, dn_b, dn_c, dn_d, limits, bits_of, bits, mask)


@compiled
def _mark_four(
    dn_a: Any, dn_b: Any, dn_c: Any, dn_d: Any, limits: Any, bits_of: Any, bits: Any, mask: Any
) -> None:  # pragma: no cover (compiled)
    """Mark which of four frames are used and which clip; arguments as `add_linear_four`.

    A loop for each: numbers of one width only are compared many at a time.
    """
    low_a, high_a, low_b, high_b = limits[0, 0], limits[0, 1], limits[1, 0], limits[1, 1]
    low_c, high_c, low_d, high_d = limits[2, 0], limits[2, 1], limits[3, 0], limits[3, 1]
    bit_a, bit_b, bit_c, bit_d, none = bits_of[0], bits_of[1], bits_of[2], bits_of[3], bits.dtype.type(0)
    for i in range(dn_a.size):
        a, b, c, d = dn_a[i], dn_b[i], dn_c[i], dn_d[i]
        seen = (bit_a if (a >= low_a) & (a < high_a) else none) | (bit_b if (b >= low_b) & (b < high_b) else none)
        seen |= (bit_c if (c >= low_c) & (c < high_c) else none) | (bit_d if (d >= low_d) & (d < high_d) else none)
        bits[i] |= seen
    nothing = np.uint8(0)
    for i in range(dn_a.size):
        a, b, c, d = dn_a[i], dn_b[i], dn_c[i], dn_d[i]
        clipped = (a >= high_a) | (b >= high_b) | (c >= high_c) | (d >= high_d)
        mask[i] |= CLIPPED_HIGH if clipped else nothing


@compiled
def add_linear_many(
    frames: Any,
    count: int,
    start: int,
    constants: Any,
    limits: Any,
    bits_of: Any,
    first: Any,
    second: Any,
    squares: Any,
    bits: Any,
    mask: Any,
) -> None:  # pragma: no cover (compiled)
    """Add frames of a linear sensor in fours, in runs of pixels whose sums stay in a core's first-level cache.

    Args:
        frames: Digital numbers of `MANY` frames of one type, whole pictures.
        count: How many of them count: a multiple of four.
        start: Their first pixel that the sums are of.
        constants: As in `add_linear_four` for each frame; so are `limits` and `bits_of`.
        limits: Likewise.
        bits_of: Likewise.
        first: As in `add_linear_four`; so are `second`, `squares`, `bits` and `mask`.
    """
    for low in range(0, first.size, _RUN):
        high = min(low + _RUN, first.size)
        here, sums = slice(start + low, start + high), (first[low:high], second[low:high], squares[low:high])
        marks = bits[low:high], mask[low:high]
        for k in range(0, count, 4):
            four = frames[k][here], frames[k + 1][here], frames[k + 2][here], frames[k + 3][here]
            add_linear_four(*four, constants[k : k + 4], limits[k : k + 4], bits_of[k : k + 4], *sums, *marks)


@compiled
def add_table_many(
    frames: Any,
    count: int,
    start: int,
    tables: Any,
    constants: Any,
    limits: Any,
    bits_of: Any,
    first: Any,
    second: Any,
    squares: Any,
    bits: Any,
    mask: Any,
) -> None:  # pragma: no cover (compiled)
    """Add frames through tables in fours; arguments as `add_linear_many`, `tables` and `constants` `add_table_four`."""
    for low in range(0, first.size, _RUN):
        high = min(low + _RUN, first.size)
        here, sums = slice(start + low, start + high), (first[low:high], second[low:high], squares[low:high])
        marks = bits[low:high], mask[low:high]
        for k in range(0, count, 4):
            four = frames[k][here], frames[k + 1][here], frames[k + 2][here], frames[k + 3][here]
            of_four = tables[k], tables[k + 1], tables[k + 2], tables[k + 3]
            add_table_four(*four, of_four, constants[k : k + 4], limits[k : k + 4], bits_of[k : k + 4], *sums, *marks)


@compiled
def add_table(
    dn: Any,
    table: Any,
    dark: Any,
    low: Any,
    high: Any,
    exposure: Any,
    weight: Any,
    bit: Any,
    first: Any,
    second: Any,
    squares: Any,
    bits: Any,
    mask: Any,
) -> None:  # pragma: no cover (compiled)
    """Add one frame through a table of x by digital number, less a dark signal.

    Args:
        dn: Digital numbers of the block.
        table: x at every digital number, float32.
        dark: Dark signal of every pixel of the block, float32.
        low: Lowest digital number that is used.
        high: Digital number from which the frame clips.
        exposure: Relative exposure t, float32.
        weight: t to the power `FIRST_POWER`, float32.
        bit: Bit of this frame.
        first: As in `add_linear_four`; so are `second`, `squares`, `bits` and `mask`.
    """
    for i in range(dn.size):
        number = dn[i]
        if number >= high:
            mask[i] |= CLIPPED_HIGH
        elif number >= low:
            x = table[number] - dark[i]
            first[i] += weight * x
            second[i] += exposure * x
            squares[i] += x * x
            bits[i] |= bit


@dataclass(frozen=True, slots=True, eq=False)
class MergeSample:
    """A frame on its way into the sums."""

    dn: NDArray[Any]  # digital numbers, one-dimensional
    terms: FrameTerms  # the frame's constants
    # x by digital number; None where the sensor is linear and the dark signal one number
    table: NDArray[np.float32] | None
    index: int  # place of the frame, from 0
    # x less the dark signal by digital number, 0 where it is not used; None without a table, or where the dark signal
    # is that of every pixel
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
    """Sums of a run of pixels, one-dimensional and contiguous."""

    first: NDArray[np.float32]  # Σt^0.35·x, float32
    second: NDArray[np.float32]  # Σt·x, float32
    squares: NDArray[np.float32]  # Σx², float32
    mask: NDArray[np.uint8]  # whether a frame was clipped at white so far, as PixelMask bit, uint8
    # Bits of the frames used, uint16, a plane for every 16 frames
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
        reference: Exposure that exposures are counted in.
    """
    passes, waiting = [], list(samples)
    while waiting:
        one = waiting[0]
        alike = list(itertools.takewhile(one.is_like, waiting[:FRAMES_PER_PLANE])) or [one]
        passes.append(_fours(alike, reference) if one.is_like(one) else _single(one, reference))
        waiting = waiting[len(alike) :]
    return passes


def _fours(alike: Sequence[MergeSample], reference: float) -> MergePass:
    # Always as many arrays: the loop is compiled once. The last frame fills up its four with its own pixels; none of
    # them counts again, and they clip where they do anyway. Measured on 2 megapixels: one or two linear frames take
    # 1.3 ms longer than in loops for so few, three and more the same time, and tables up to half of it.
    count, last, plane = len(alike), alike[-1], alike[0].plane
    filled = -(-count // _AT_ONCE) * _AT_ONCE
    dn = tuple(alike[min(k, count - 1)].dn for k in range(MANY))
    constants = np.zeros((filled, 4), np.float32)
    limits, bits = np.full((filled, 2), last.limits[1], last.dn.dtype), np.zeros(filled, np.uint16)
    for k, one in enumerate(alike):
        constants[k], limits[k], bits[k] = one.constants(reference), one.limits, one.bit
    if last.table is None:
        return lambda sums, start: add_linear_many(dn, filled, start, constants, limits, bits, *sums.view(plane))
    nothing = np.zeros_like(last.usable)
    tables = tuple(alike[k].usable if k < count else nothing for k in range(MANY))
    exposures = np.ascontiguousarray(constants[:, 2:])
    return lambda sums, start: add_table_many(dn, filled, start, tables, exposures, limits, bits, *sums.view(plane))


def _single(one: MergeSample, reference: float) -> MergePass:
    """Return the pass of a frame whose dark signal is that of every pixel."""
    low, high = (one.dn.dtype.type(limit) for limit in one.limits)
    _, _, exposure, weight = (np.float32(value) for value in one.constants(reference))
    bit, table = np.uint16(one.bit), one.table

    def add(sums: MergeSums, start: int) -> None:
        here = slice(start, start + sums.first.size)
        add_table(one.dn[here], table, one.terms.dark[here], low, high, exposure, weight, bit, *sums.view(one.plane))

    return add


@dataclass(frozen=True, slots=True, eq=False)
class ScratchSums:
    """Sums of one block of pixels after another, each used up before the next: only the result is kept of all pixels.
    """

    first: NDArray[np.float32]  # place of the radiance of all pixels, and of a block's Σt^0.35·x before
    second: NDArray[np.float32]  # place of its uncertainty, and of a block's Σt·x before
    mask: NDArray[np.uint8]  # place of the mask, uint8
    squares: NDArray[np.float32]  # Σx² of a block
    planes: list[NDArray[np.uint16]]  # bits of the frames used in a block

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
