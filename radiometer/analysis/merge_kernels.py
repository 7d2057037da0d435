"""Compiled inner loops of the merge: samples into sums, as each frame arrives.

All arrays are one-dimensional and contiguous: a block of whole rows. The functions hold no lock, so that a thread
per core can work on a block each. Compiled code is kept on disk beside this module.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from radiometer.analysis.merge_compile import compiled
from radiometer.data.radiance_map import PixelMask

CLIPPED_HIGH = np.uint8(PixelMask.SATURATED)
CLIPPED_LOW = np.uint8(PixelMask.BELOW_NOISE)


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
        weight: t to the power `merge_finish.FIRST_POWER`, float32.
        bit: Bit of this frame, of the type of `bits`.
        first: Σw·x, float32, added to.
        second: Σt·x, float32, added to.
        squares: Σx², float32, added to.
        bits: Frames used in each pixel, added to.
        mask: Clipping seen in each pixel, added to.
    """
    for i in range(dn.size):
        number = dn[i]
        used = (number >= low) & (number < high)
        x = (np.float32(number) - offset) * inverse_gain if used else np.float32(0.0)
        first[i] += weight * x
        second[i] += exposure * x
        squares[i] += x * x
        bits[i] |= bit if used else bits.dtype.type(0)
        mask[i] |= CLIPPED_HIGH if number >= high else (CLIPPED_LOW if number < low else np.uint8(0))


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
        weight: t to the power `merge_finish.FIRST_POWER`, float32.
        bit: Bit of this frame.
        first: Σw·x, float32, added to.
        second: Σt·x, float32, added to.
        squares: Σx², float32, added to.
        bits: Frames used in each pixel, added to.
        mask: Clipping seen in each pixel, added to.
    """
    step = 1 if dark.size > 1 else 0
    for i in range(dn.size):
        number = dn[i]
        if number >= high:
            mask[i] |= CLIPPED_HIGH
        elif number < low:
            mask[i] |= CLIPPED_LOW
        else:
            x = table[number] - dark[i * step]
            first[i] += weight * x
            second[i] += exposure * x
            squares[i] += x * x
            bits[i] |= bit
