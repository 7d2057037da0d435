"""Pictures as their files hold them, decoded by OpenCV without its remarks on standard error."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from cv2.utils import logging
from numpy.typing import NDArray


def decoded(content: NDArray[np.uint8]) -> Any:
    """Return the picture in a file's bytes, as its own type, colours as blue, green, red; None where there is none."""
    before = logging.setLogLevel(logging.LOG_LEVEL_ERROR)  # tags that it does not know are no user's matter
    try:
        return cv2.imdecode(content, cv2.IMREAD_UNCHANGED) if content.size else None
    except cv2.error:
        return None
    finally:
        logging.setLogLevel(before)
