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

from radiometer.analysis.merge.finish import FIRST_POWER
from radiometer.analysis.merge.frames import FrameTerms, longest_of
from radiometer.compiled import compiled
from radiometer.data.radiance_map import PixelMask

CLIPPED_HIGH = np.uint8(PixelMask.SATURATED)
MANY: Final = 16  # frames that go through one call; those of one plane of bits
_RUN = 4096  # pixels: their sums and four frames of 16 bits are read from a core's nearest caches
Images = tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.uint8]]

_AT_ONCE: Final = 4  # frames that one pass over the sums takes in


@compiled
def add_many(
    frames: Any, count: int, start: int, tables: Any, constants: Any, limits: Any, bits_of: Any, sums: Any
) -> None:  # pragma: no cover (compiled)
    """Add frames in fours, in runs of pixels whose sums stay in a core's first-level cache.

    A frame's signal is x = (M − offset)/gain where low ≤ M < high, or what its table gives at M.

    Args:
        frames: Digital numbers of `MANY` frames of one type, uint8 or uint16, whole pictures.
        count: How many of them count: a multiple of four.
        start: Their first pixel that the sums are of.
        tables: x less its dark signal at every digital number of each frame, 0 where it is not used, float32; None for
            a linear sensor (the loop is compiled for each).
        constants: Black level plus dark signal in DN, 1/gain, relative exposure t, and t to the power `FIRST_POWER` of
            each, float32, shape (count, 4).
        limits: Lowest digital number used and the one from which the frame clips, of their type, shape (count, 2).
        bits_of: Bits of the frames, of the type of the bits, shape (count,).
        sums: Σw·x, Σt·x and Σx², float32, bits of the frames used, and whether a frame was clipped at white in each
            pixel: all added to.
    """
    first, second, squares, bits, mask = sums
    for low in range(0, first.size, _RUN):
        high = min(low + _RUN, first.size)
        here, marks = slice(start + low, start + high), (bits[low:high], mask[low:high])
        run = first[low:high], second[low:high], squares[low:high]
        for k in range(0, count, 4):
            four = frames[k][here], frames[k + 1][here], frames[k + 2][here], frames[k + 3][here]
            if tables is None:
                _add_four(four, None, constants[k : k + 4], limits[k : k + 4], run)
            else:
                of_four = tables[k], tables[k + 1], tables[k + 2], tables[k + 3]
                _add_four(four, of_four, constants[k : k + 4], limits[k : k + 4], run)
            _mark_four(four, limits[k : k + 4], bits_of[k : k + 4], marks)


@compiled
def _add_four(dn: Any, tables: Any, constants: Any, limits: Any, sums: Any) -> None:  # pragma: no cover (compiled)
    """Add four frames in one pass over the sums, which is what takes the time; arguments as `add_many`.

    Only loops without a look-up are vectorised: what is marked goes after what is summed.
    """
    dn_a, dn_b, dn_c, dn_d = dn
    first, second, squares = sums
    offset_a, inverse_a, exposure_a, weight_a = constants[0]
    offset_b, inverse_b, exposure_b, weight_b = constants[1]
    offset_c, inverse_c, exposure_c, weight_c = constants[2]
    offset_d, inverse_d, exposure_d, weight_d = constants[3]
    low_a, high_a, low_b, high_b = limits[0, 0], limits[0, 1], limits[1, 0], limits[1, 1]
    low_c, high_c, low_d, high_d = limits[2, 0], limits[2, 1], limits[3, 0], limits[3, 1]
    zero = np.float32(0.0)
    for i in range(dn_a.size):
        a, b, c, d = dn_a[i], dn_b[i], dn_c[i], dn_d[i]
        if tables is None:
            x_a = (np.float32(a) - offset_a) * inverse_a if (a >= low_a) & (a < high_a) else zero
            x_b = (np.float32(b) - offset_b) * inverse_b if (b >= low_b) & (b < high_b) else zero
            x_c = (np.float32(c) - offset_c) * inverse_c if (c >= low_c) & (c < high_c) else zero
            x_d = (np.float32(d) - offset_d) * inverse_d if (d >= low_d) & (d < high_d) else zero
        else:
            x_a, x_b, x_c, x_d = tables[0][a], tables[1][b], tables[2][c], tables[3][d]
        first[i] = (((first[i] + weight_a * x_a) + weight_b * x_b) + weight_c * x_c) + weight_d * x_d
        second[i] = (((second[i] + exposure_a * x_a) + exposure_b * x_b) + exposure_c * x_c) + exposure_d * x_d
        squares[i] = (((squares[i] + x_a * x_a) + x_b * x_b) + x_c * x_c) + x_d * x_d


@compiled
def _mark_four(dn: Any, limits: Any, bits_of: Any, marks: Any) -> None:  # pragma: no cover (compiled)
    """Mark which of four frames are used and which clip; arguments as `add_many`.

    A loop for each: numbers of one width only are compared many at a time.
    """
    dn_a, dn_b, dn_c, dn_d = dn
    bits, mask = marks
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
def _add_one(
    dn: Any, table: Any, dark: Any, constants: Any, limits: Any, bit: Any, sums: Any
) -> None:  # pragma: no cover (compiled)
    """Add one frame through a table of x by digital number, less the dark signal of every pixel.

    Args:
        dn: Digital numbers of the block.
        table: x at every digital number, float32.
        dark: Dark signal of every pixel of the block, float32.
        constants: As in `add_many`, of this frame; so are `limits` and `bit`.
        limits: Likewise.
        bit: Likewise.
        sums: As in `add_many`.
    """
    first, second, squares, bits, mask = sums
    low, high, exposure, weight = limits[0], limits[1], constants[2], constants[3]
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
    # x by digital number below those that are used, nan at 0, inf above; None where only 0 is below
    below: NDArray[np.float32] | None = None

    @classmethod
    def of(cls, dn: NDArray[Any], terms: FrameTerms, table: NDArray[np.float32] | None, index: int) -> MergeSample:
        """Return a frame's sample with what follows from its table; arguments as the attributes."""
        sample = cls(dn, terms, table, index)
        if table is None:
            return sample
        low, high = sample.limits
        # As long as its type has digital numbers: the compiled loop asks of none whether the table holds it.
        size = int(np.iinfo(dn.dtype).max) + 1
        if low > 1:
            below = np.full(size, np.inf, np.float32)
            below[1:low] = table[1:low]
            below[0] = np.nan
            sample = replace(sample, below=below)
        if terms.dark.size > 1:
            return sample
        usable = np.zeros(size, np.float32)
        usable[low:high] = table[low:high] - terms.dark
        return replace(sample, usable=usable)

    @property
    def limits(self) -> tuple[int, int]:
        """Return the lowest digital number that is used, and the one from which the frame clips."""
        return self.terms.low_dn, min(self.terms.high_dn, int(np.iinfo(self.dn.dtype).max))

    @property
    def plane(self) -> int:
        """Return which plane of bits the frame's bit is in."""
        return self.index // MANY

    @property
    def bit(self) -> int:
        """Return the frame's bit in its plane."""
        return 1 << (self.index % MANY)

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
        if terms.variance_hot.size > 1:
            terms = replace(terms, variance_hot=terms.variance_hot[pixels])
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
    # x of the longest frame where it is below the numbers that are used, float32; no plane where only 0 is below
    lowest: list[NDArray[np.float32]] = field(default_factory=list)

    @classmethod
    def zeros(cls, size: int) -> MergeSums:
        """Return empty sums of `size` pixels without room for any frame's bit."""
        first, second, squares = (np.zeros(size, np.float32) for _ in range(3))
        return cls(first, second, squares, np.zeros(size, np.uint8))

    def make_room(self, terms: Sequence[FrameTerms]) -> None:
        """Make sure that there is room for the bits of some frames, and for what is below their numbers."""
        while len(self.planes) * MANY < len(terms):
            self.planes.append(np.zeros(self.first.size, np.uint16))
        if not self.lowest and any(one.low_dn > 1 for one in terms):
            self.lowest.append(np.zeros(self.first.size, np.float32))

    def part(self, start: int, stop: int) -> MergeSums:
        """Return the sums of the pixels from `start` to `stop` as views."""
        cut = slice(start, stop)
        planes, lowest = [plane[cut] for plane in self.planes], [plane[cut] for plane in self.lowest]
        return MergeSums(self.first[cut], self.second[cut], self.squares[cut], self.mask[cut], planes, lowest)

    def patterns(self) -> NDArray[np.uint16] | NDArray[np.uint64]:
        """Return the bits of all frames used in each pixel."""
        if len(self.planes) == 1:
            return self.planes[0]
        bits = self.planes[0].astype(np.uint64)
        for number, plane in enumerate(self.planes[1:], start=1):
            bits |= plane.astype(np.uint64) << np.uint64(number * MANY)
        return bits

    def take_lowest(self, terms: Sequence[FrameTerms]) -> None:
        """Count the longest frame where it is below the numbers that are used as well.

        Args:
            terms: Of all frames, in the order of their bits.
        """
        if not self.lowest:
            return
        longest = longest_of(terms)
        # The number 0 is what other frames correct; alone it is no value.
        below = (self.lowest[0] < np.inf) | (np.isnan(self.lowest[0]) & (self.patterns() != 0))
        x, t = np.nan_to_num(self.lowest[0][below]), np.float32(terms[longest].exposure / terms[0].exposure)
        self.first[below] += t ** np.float32(FIRST_POWER) * x
        self.second[below] += t * x
        self.squares[below] += x * x
        self.planes[longest // MANY][below] |= np.uint16(1 << (longest % MANY))

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


def merge_passes(samples: Sequence[MergeSample], terms: Sequence[FrameTerms]) -> list[MergePass]:
    """Return the passes over the sums that take frames in, as few as can be.

    What the compiled loops are given of the frames is made once, not for every block of pixels anew.

    Args:
        terms: Of all frames so far, these included, in the order of their bits.
    """
    passes, waiting, reference = [], list(samples), terms[0].exposure
    longest = terms[longest_of(terms)]
    passes += [_keep_lowest(one) for one in samples if one.terms is longest and one.below is not None]
    while waiting:
        one = waiting[0]
        alike = list(itertools.takewhile(one.is_like, waiting[:MANY])) or [one]
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
    tables = None
    if last.usable is not None:
        nothing = np.zeros_like(last.usable)
        tables = tuple(alike[k].usable if k < count else nothing for k in range(MANY))
    return lambda sums, start: add_many(dn, filled, start, tables, constants, limits, bits, sums.view(plane))


def _single(one: MergeSample, reference: float) -> MergePass:
    """Return the pass of a frame whose dark signal is that of every pixel."""
    limits, bit = np.array(one.limits, one.dn.dtype), np.uint16(one.bit)
    constants, dark = np.array(one.constants(reference), np.float32), one.terms.dark

    def add(sums: MergeSums, start: int) -> None:
        here = slice(start, start + sums.first.size)
        _add_one(one.dn[here], one.table, dark[here], constants, limits, bit, sums.view(one.plane))

    return add


def _keep_lowest(one: MergeSample) -> MergePass:
    """Return the pass that keeps what the longest frame shows below the numbers that are used."""
    dark = one.terms.dark
    below = np.zeros(0, np.float32) if one.below is None else one.below

    def add(sums: MergeSums, start: int) -> None:
        here = slice(start, start + sums.first.size)
        sums.lowest[0][:] = below[one.dn[here]] - (dark if dark.size == 1 else dark[here])

    return add


@dataclass(frozen=True, slots=True, eq=False)
class ScratchSums:
    """Sums of one block of pixels after another, each used up before the next: only the result is kept of all."""

    first: NDArray[np.float32]  # place of the radiance of all pixels, and of a block's Σt^0.35·x before
    second: NDArray[np.float32]  # place of its uncertainty, and of a block's Σt·x before
    mask: NDArray[np.uint8]  # place of the mask, uint8
    block: MergeSums  # its other sums are those of a block

    @classmethod
    def of(cls, images: Images, most: int, terms: Sequence[FrameTerms]) -> ScratchSums:
        """Return sums of blocks of `most` pixels.

        Args:
            images: Places of radiance, uncertainty and mask of all pixels, flat.
            most: Pixels of the largest block.
            terms: Of all frames.
        """
        block = MergeSums.zeros(most)
        block.make_room(terms)
        return cls(*images, block)

    def part(self, start: int, stop: int) -> MergeSums:
        """Return empty sums of the pixels from `start` to `stop`; those of the part before are lost."""
        cut, block = slice(start, stop), self.block.part(0, stop - start)
        part = replace(block, first=self.first[cut], second=self.second[cut], mask=self.mask[cut])
        for sums in (part.first, part.second, part.squares):
            sums.fill(0.0)
        part.mask.fill(0)
        for plane in part.planes:
            plane.fill(0)
        return part
