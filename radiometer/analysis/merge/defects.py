"""Defective pixels filled in from their neighbours, and marked."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from radiometer.data.radiance_map import PixelMask


def repair_defects(
    radiance: NDArray[np.float32],
    u_radiance: NDArray[np.float32],
    mask: NDArray[np.uint8],
    defects: Sequence[tuple[int, int]],
) -> None:
    """Fill defective pixels in place with the mean of their sound neighbours, and mark them DEFECTIVE.

    The uncertainty is that of the mean together with the scatter of the neighbours: what stood there is not known.
    A pixel without sound neighbours keeps its value with an uncertainty as large.

    Args:
        radiance: Radiance, shape (height, width), still owned by the merge.
        u_radiance: Its standard uncertainty.
        mask: PixelMask bits.
        defects: Positions (x, y); those outside the picture are left out.
    """
    height, width = radiance.shape
    inside = [(x, y) for x, y in defects if 0 <= x < width and 0 <= y < height]
    for x, y in inside:
        mask[y, x] |= PixelMask.DEFECTIVE
    for x, y in inside:
        window = slice(max(y - 1, 0), y + 2), slice(max(x - 1, 0), x + 2)
        sound = mask[window] & (PixelMask.DEFECTIVE | PixelMask.SATURATED) == 0
        values = radiance[window][sound].astype(np.float64)
        if values.size < 2:
            u_radiance[y, x] = abs(radiance[y, x])
            continue
        noise = float(np.mean(u_radiance[window][sound].astype(np.float64) ** 2)) / values.size
        radiance[y, x] = values.mean()
        u_radiance[y, x] = np.sqrt(noise + values.var(ddof=1))
