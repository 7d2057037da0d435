"""Which pixels a bracket reached, and how often."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from radiometer.acquire.exposure_plan import ExposureWindow
from radiometer.data import CameraDescription, Frame, Patch


@dataclass(frozen=True, slots=True, eq=False)
class Reach:
    """How often each pixel was well exposed."""

    # Number of frames in which the pixel lay between noise floor and clipping, shape (height, width)
    cover: NDArray[np.uint16]
    saturated: NDArray[np.bool_]  # pixels that clipped in every frame
    below_noise: NDArray[np.bool_]  # pixels that never rose above the noise floor
    origin: tuple[int, int] = (0, 0)  # column and row of the first of these pixels in the frame

    def sentences(self) -> list[str]:
        """Return in plain language which pixels could not be reached; empty where all were, twice."""
        total = self.cover.size
        once = int(np.count_nonzero(self.cover == 1))
        found = [
            _sentence(self.saturated, "clip even in the shortest exposure", total, self.origin),
            _sentence(self.below_noise, "stay under the noise floor even in the longest exposure", total, self.origin),
            f"{once} of {total} pixels are well exposed only once" if once else "",
        ]
        return [sentence for sentence in found if sentence]


def assess_reach(frames: Iterable[Frame], camera: CameraDescription, region: Patch | None = None) -> Reach:
    """Return which pixels the light frames reached; one frame in memory at a time.

    Args:
        frames: Frames of one size; dark frames are passed over.
        region: The pixels that are looked at; all of the frame where None.

    Raises:
        ValueError: If there is no light frame.
    """
    cover: NDArray[np.uint16] | None = None
    for frame in frames:
        if frame.settings.is_dark:
            continue
        black = frame.settings.black_level_dn or 0.0
        window = ExposureWindow.of(camera, frame.settings.gain_db, black)
        dn = frame.dn[region.slices] if region else frame.dn
        if cover is None:
            cover = np.zeros(dn.shape, np.uint16)
            saturated, dim = np.ones(dn.shape, np.bool_), np.ones(dn.shape, np.bool_)
        low, high = black + window.lowest_dn, min(black + window.clipping_dn * 0.995, frame.saturated_dn)
        above, below = dn >= low, dn < high
        cover += above & below
        saturated &= ~below
        dim &= ~above
    if cover is None:
        raise ValueError("there is no frame with the shutter open")
    return Reach(cover, saturated, dim, (region.x, region.y) if region else (0, 0))


def _sentence(pixels: NDArray[np.bool_], what: str, total: int, origin: tuple[int, int]) -> str:
    count = int(np.count_nonzero(pixels))
    if not count:
        return ""
    rows, columns = np.nonzero(pixels)
    x, y = int(columns.min()), int(rows.min())
    width, height = int(columns.max()) - x + 1, int(rows.max()) - y + 1
    where = f"within x {origin[0] + x}, y {origin[1] + y}, {width} × {height}"
    return f"{count} of {total} pixels {what} ({where})"
