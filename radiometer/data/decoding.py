"""Pictures as their files hold them, decoded by OpenCV without its remarks on standard error."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import cv2
import numpy as np
from cv2.utils import logging
from numpy.typing import NDArray

_COUNTED = threading.Lock()
_levels: list[int] = []  # OpenCV's own before each decoding that is under way: the level is one for all threads


def decoded(content: NDArray[np.uint8]) -> Any:
    """Return the picture in a file's bytes, as its own type, colours as blue, green, red; None where there is none."""
    with _quiet():
        try:
            return cv2.imdecode(content, cv2.IMREAD_UNCHANGED) if content.size else None
        except cv2.error:
            return None


@contextmanager
def _quiet() -> Iterator[None]:
    """Have OpenCV tell errors alone (tags that it does not know are no user's matter) until the last thread is done."""
    with _COUNTED:
        _levels.append(logging.setLogLevel(logging.LOG_LEVEL_ERROR))
    try:
        yield
    finally:
        with _COUNTED:
            logging.setLogLevel(_levels[0] if len(_levels) == 1 else logging.LOG_LEVEL_ERROR)
            del _levels[-1]
