"""Pictures as their files hold them, decoded by OpenCV without its remarks on standard error."""

from __future__ import annotations

import threading
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Final

import cv2
import numpy as np
from cv2.utils import logging
from numpy.typing import NDArray

_PNG_SIGNATURE: Final = b"\x89PNG\r\n\x1a\n"
_AROUND_DATA: Final = 12  # length, type and check sum of a chunk
_COUNTED = threading.Lock()
_levels: list[int] = []  # OpenCV's own before each decoding that is under way: the level is one for all threads


def decoded(content: NDArray[np.uint8]) -> Any:
    """Return the picture in a file's bytes, as its own type, colours as blue, green, red; None where there is none."""
    with _quiet():
        try:
            picture = _without_remarks(content)
            return cv2.imdecode(picture, cv2.IMREAD_UNCHANGED) if picture.size else None
        except cv2.error:
            return None


def _without_remarks(content: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return a PNG's bytes without its chunks that are no part of the picture; what is no whole PNG as it is.

    None are left where a check sum is wrong. libpng writes what it finds wrong straight to standard error, past
    OpenCV's level: faults of a damaged picture, and of colour profiles that are not needed.

    Source: PNG specification, third edition, 5.2 to 5.5: length, type, data and check sum (of type and data) of every
        chunk. A chunk whose type begins with a small letter is not needed for the picture. The exception is tRNS,
        which adds a channel.
    """
    whole = content.tobytes()
    if not whole.startswith(_PNG_SIGNATURE):
        return content
    kept, at = [_PNG_SIGNATURE], len(_PNG_SIGNATURE)
    while at + _AROUND_DATA <= len(whole):
        end = at + _AROUND_DATA + int.from_bytes(whole[at : at + 4], "big")
        if not whole[at + 4 : at + 5].islower() or whole[at + 4 : at + 8] == b"tRNS":
            if zlib.crc32(whole[at + 4 : end - 4]) != int.from_bytes(whole[end - 4 : end], "big"):
                return np.empty(0, np.uint8)
            kept.append(whole[at:end])
        at = end
    return np.frombuffer(b"".join(kept), np.uint8) if at == len(whole) else content


@contextmanager
def _quiet() -> Iterator[None]:
    """Have OpenCV print nothing until the last thread is done: what cannot be decoded gets one line of our own."""
    with _COUNTED:
        _levels.append(logging.setLogLevel(logging.LOG_LEVEL_SILENT))
    try:
        yield
    finally:
        with _COUNTED:
            logging.setLogLevel(_levels[0] if len(_levels) == 1 else logging.LOG_LEVEL_SILENT)
            del _levels[-1]
