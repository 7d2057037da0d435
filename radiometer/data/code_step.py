"""The distance between the codes that frames hold: more than 1 DN where a converter's few bits are written in more.

Cameras and programs write 12 bits in 16 by zeros below them (codes 16 DN apart), or stretch them to the full range, so
that 4095 becomes 65535 (codes 16 or 17 DN apart). Rounding then has steps of that distance.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radiometer.data.frame import DigitalNumbers

_CODES_OF_NOISE: Final = 3  # numbers that occur where noise spreads them; two may be the scene's
_EVIDENCE_BITS: Final = 20.0  # one chance in a million: so many bits of the numbers are none by chance
_STRETCHED_BITS: Final = (8, 10, 12, 14)  # of converters whose codes programs stretch
_TOP_DN: Final = 65535
_MOST_PADDING_BITS: Final = 8  # 8 bits written in 16
_MOST_SHARE: Final = 0.999  # of the pixels: a status line or a time stamp has fewer


def code_step_of(light: Iterable[DigitalNumbers], stated: int | None = None) -> int:
    """Return the distance in DN between the numbers that light frames hold; 1 where nothing shows that it is more.

    Args:
        light: Digital numbers of pixels of light frames, any shape.
        stated: As the camera's description states it: it counts unless the numbers contradict it.
    """
    found = [dn.ravel() for dn in light]
    codes, counts = np.unique(np.concatenate(found), return_counts=True) if found else (np.empty(0, np.int64),) * 2
    return code_step(codes, counts, stated)


def code_step(codes: NDArray[np.integer], counts: NDArray[np.integer], stated: int | None = None) -> int:
    """Return the same of the numbers that occur, each once and in rising order.

    Numbers far from each other show a step where chance makes it of so many numbers once in a million. Of fewer it is a
    power of two, as of padded low bits, and most of them are neighbours at that distance.

    Args:
        codes: The numbers.
        counts: How many pixels have each.
        stated: As for `code_step_of`.
    """
    step_dn = _shown_step(_without_odd(codes.astype(np.int64), counts))
    if stated is None or step_dn > stated or codes.size == 0:
        return step_dn
    on = (codes - codes[np.argmax(counts)]) % stated == 0
    return stated if step_dn == stated or counts[on].sum() >= _MOST_SHARE * counts.sum() else step_dn


def _without_odd(codes: NDArray[np.int64], counts: NDArray[np.integer]) -> NDArray[np.int64]:
    """Return the numbers without the few that are none of the converter: some cameras write a frame's number there."""
    for bits in range(_MOST_PADDING_BITS, 0, -1):
        on = (codes - codes[np.argmax(counts)]) % (1 << bits) == 0 if codes.size else np.empty(0, bool)
        if counts[on].sum() >= _MOST_SHARE * counts.sum():
            return np.asarray(codes[on])
    return codes


def _shown_step(codes: NDArray[np.int64]) -> int:
    if codes.size < _CODES_OF_NOISE:
        return 1
    apart = np.diff(codes)
    divisor = int(np.gcd.reduce(apart))
    if divisor > 1 and apart.size * math.log2(divisor) >= _EVIDENCE_BITS:
        return divisor
    step_dn = divisor & -divisor
    if step_dn > 1 and np.median(apart) <= step_dn:
        return step_dn
    return _stretched_step(codes) if divisor == 1 else 1


def _stretched_step(codes: NDArray[np.integer]) -> int:
    """Return the step of codes that were stretched to 16 bits, rounded, cut off, or with their high bits repeated."""
    for bits in _STRETCHED_BITS:
        top = (1 << bits) - 1
        step = _TOP_DN / top
        # Fractions that are cut off and bits that are repeated leave a number up to 1 DN from the exact one.
        enough = codes.size * math.log2(step / 3.0) >= _EVIDENCE_BITS
        if enough and np.all(np.abs(codes - step * np.rint(codes / step)) <= 1.0):
            return round(step)
    return 1
