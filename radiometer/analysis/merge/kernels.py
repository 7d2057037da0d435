"""Compiled inner loops of the merge: samples into sums, as each frame arrives.

All arrays are one-dimensional and contiguous: a block of whole rows. The functions hold no lock, so that a thread
per core can work on a block each. Compiled code is kept on disk next to this module. Of clipping only white is marked:
where no frame is of use and none was white, all were black.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from radiometer.compiled import compiled
from radiometer.data.radiance_map import PixelMask

CLIPPED_HIGH = np.uint8(PixelMask.SATURATED)
MANY = 16  # frames that go through one call; those of one plane of bits
_RUN = 4096  # pixels: their sums and four frames of 16 bits are read from a core's nearest caches


@compiled
def add_linear(
    dn: Any,
    offset: Any,
    inverse_gain: Any,
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
    """Add one frame of a linear sensor: x = (M − offset)/gain where low ≤ M < high.

    Args:
        dn: Digital numbers of the block, uint8 or uint16.
        offset: Black level plus dark signal in DN, float32.
        inverse_gain: 1/gain, float32.
        low: Lowest digital number that is used.
        high: Digital number from which the frame clips.
        exposure: Relative exposure t, float32.
        weight: t to the power `records.FIRST_POWER`, float32.
        bit: Bit of this frame, of the type of `bits`.
        first: Σw·x, float32, added to.
        second: Σt·x, float32, added to.
        squares: Σx², float32, added to.
        bits: Frames used in each pixel, added to.
        mask: Whether a frame was clipped at white in each pixel, added to.
    """
    for i in range(dn.size):
        number = dn[i]
        used = (number >= low) & (number < high)
        x = (np.float32(number) - offset) * inverse_gain if used else np.float32(0.0)
        first[i] += weight * x
        second[i] += exposure * x
        squares[i] += x * x
        bits[i] |= bit if used else bits.dtype.type(0)
        mask[i] |= CLIPPED_HIGH if number >= high else np.uint8(0)


@compiled
def add_linear_pair(
    dn_a: Any,
    dn_b: Any,
    constants: Any,
    limits: Any,
    bits_ab: Any,
    first: Any,
    second: Any,
    squares: Any,
    bits: Any,
    mask: Any,
) -> None:  # pragma: no cover (compiled)
    """Add two frames of a linear sensor, one after the other, in one pass over the sums.

    Args:
        dn_a: Digital numbers of the one frame.
        dn_b: Digital numbers of the other, of the same type.
        constants: Offset, 1/gain, exposure and weight of both as in `add_linear`, float32, shape (2, 4).
        limits: Lowest digital number used and the one from which the frame clips, of the type of `dn_a`, shape (2, 2).
        bits_ab: Bits of both frames, of the type of `bits`, shape (2,).
        first: Σw·x, float32, added to.
        second: Σt·x, float32, added to.
        squares: Σx², float32, added to.
        bits: Frames used in each pixel, added to.
        mask: Whether a frame was clipped at white in each pixel, added to.
    """
    offset_a, inverse_a, exposure_a, weight_a = constants[0]
    offset_b, inverse_b, exposure_b, weight_b = constants[1]
    low_a, high_a, low_b, high_b = limits[0, 0], limits[0, 1], limits[1, 0], limits[1, 1]
    bit_a, bit_b, none = bits_ab[0], bits_ab[1], bits.dtype.type(0)
    for i in range(dn_a.size):
        a, b = dn_a[i], dn_b[i]
        used_a = (a >= low_a) & (a < high_a)
        used_b = (b >= low_b) & (b < high_b)
        x_a = (np.float32(a) - offset_a) * inverse_a if used_a else np.float32(0.0)
        x_b = (np.float32(b) - offset_b) * inverse_b if used_b else np.float32(0.0)
        first[i] = (first[i] + weight_a * x_a) + weight_b * x_b
        second[i] = (second[i] + exposure_a * x_a) + exposure_b * x_b
        squares[i] = (squares[i] + x_a * x_a) + x_b * x_b
        bits[i] |= (bit_a if used_a else none) | (bit_b if used_b else none)
        mask[i] |= CLIPPED_HIGH if (a >= high_a) | (b >= high_b) else np.uint8(0)


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
    """Add four frames of a linear sensor, one after the other, in one pass over the sums: that is what takes the time.

    Args:
        dn_a: Digital numbers of the first frame.
        dn_b: Of the second, of the same type; `dn_c` and `dn_d` likewise.
        dn_c: Of the third.
        dn_d: Of the fourth.
        constants: As in `add_linear_pair`, shape (4, 4).
        limits: Likewise, shape (4, 2).
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
        constants: Exposure and weight of each as in `add_linear`, float32, shape (4, 2).
        limits: As in `add_linear_four`.
        bits_of: Likewise.
        first: Σw·x, float32, added to.
        second: Σt·x, float32, added to.
        squares: Σx², float32, added to.
        bits: Frames used in each pixel, added to.
        mask: Whether a frame was clipped at white in each pixel, added to.
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
        first: Σw·x, float32, added to.
        second: Σt·x, float32, added to.
        squares: Σx², float32, added to.
        bits: Frames used in each pixel, added to.
        mask: Whether a frame was clipped at white in each pixel, added to.
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
        dark: Dark signal of every pixel of the block, or of all (size 1), float32.
        low: Lowest digital number that is used.
        high: Digital number from which the frame clips.
        exposure: Relative exposure t, float32.
        weight: t to the power `records.FIRST_POWER`, float32.
        bit: Bit of this frame.
        first: Σw·x, float32, added to.
        second: Σt·x, float32, added to.
        squares: Σx², float32, added to.
        bits: Frames used in each pixel, added to.
        mask: Whether a frame was clipped at white in each pixel, added to.
    """
    step = 1 if dark.size > 1 else 0
    for i in range(dn.size):
        number = dn[i]
        if number >= high:
            mask[i] |= CLIPPED_HIGH
        elif number >= low:
            x = table[number] - dark[i * step]
            first[i] += weight * x
            second[i] += exposure * x
            squares[i] += x * x
            bits[i] |= bit
