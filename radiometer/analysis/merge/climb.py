"""Steps of Gauss and Newton towards the movement of highest correlation between two pictures.

The method is that of OpenCV's findTransformECC for a shift and a turn, whose every call blurs and derives anew and asks
for a dozen arrays as large as the picture. Here all of a pair's climbs share what is made of the two pictures, and the
sums of a step are made in blocks of rows that stay in a core's caches: less than half of the processor time.

Source: G. D. Evangelidis, E. Z. Psarakis 2008, IEEE Trans. PAMI 30, 1858–1865 (forward additive).
"""

from __future__ import annotations

import math
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from radiometer.errors import MeasurementError

Array = NDArray[np.float64]
Image = NDArray[np.float32]

BLUR_PX: Final = 5
_LEAST_STEP: Final = 1e-6  # of the correlation
# Of the blur's pixels so many must show something.
_SHOWN_SHARE: Final = 0.95
_BLOCK_PX: Final = 16384
_CENTRAL: Final = np.array([[-0.5, 0.0, 0.5]], np.float32)
# Of a movement: a turn, a shift to the right and one down. A block holds the moved picture's derivatives by these, then
# the moved picture and the still one where they show something, 1 where they do, the moved picture everywhere, and 1.
_PARAMETERS: Final = 3
_MOVING, _STILL, _SHOWN, _EVERYWHERE, _ONE, _ROWS = 3, 4, 5, 6, 7, 8


class Climb:
    """Two pictures of one shape, ready to be compared at any movement."""

    def __init__(self, still: Image, moving: Image, inside: NDArray[np.uint8]) -> None:
        """Blur both pictures and take the slopes of the second.

        Args:
            still: The one picture, shape (height, width).
            moving: The other, in the same grey values.
            inside: 1 where both show something.
        """
        blur = (BLUR_PX, BLUR_PX)
        self.shape = (int(still.shape[0]), int(still.shape[1]))
        self._still = cv2.GaussianBlur(still, blur, 0)
        blurred = cv2.GaussianBlur(moving, blur, 0)
        self._shown = (cv2.GaussianBlur(inside.astype(np.float32), blur, 0) > _SHOWN_SHARE).astype(np.uint8)
        slopes = [cv2.filter2D(blurred, -1, kernel) * self._shown for kernel in (_CENTRAL, _CENTRAL.T)]
        # Sums of squares in 32 bits are those of what differs from a mean, or little contrast would drown in them.
        self._middle = float(blurred.mean())
        self._still -= float(self._still.mean())
        # Four channels are moved at once, faster than three.
        self._moving = cv2.merge([blurred - self._middle, *slopes, slopes[0]])
        self._rows = max(1, _BLOCK_PX // self.shape[1])
        self._block = np.ones((_ROWS, self._rows, self.shape[1]), np.float32)
        self._moved, self._moved_shown = np.empty_like(self._moving), np.empty_like(self._shown)

    def climbed(self, start: Array, iterations: int) -> tuple[float, Array]:
        """Return the correlation before the last of the steps from a movement, and the movement after it.

        Args:
            start: Matrix, shape (2, 3), that takes a pixel of the first picture to its place in the second.
            iterations: Steps at most; fewer where the correlation no longer changes.

        Raises:
            MeasurementError: If the pictures have no correlation there.
        """
        movement, before, correlation = start, -_LEAST_STEP, -1.0
        for _ in range(iterations):
            if abs(correlation - before) < _LEAST_STEP:
                break
            before = correlation
            correlation, movement = self._step(movement)
        return correlation, movement

    def _step(self, movement: Array) -> tuple[float, Array]:
        """Return the correlation at a movement, and the movement a step further up."""
        products, pixels = self._products(movement)
        mean = products[_MOVING:, _SHOWN] / max(pixels, 1)
        # Products with what differs from the means of the pixels shown.
        moving, still = (products[:, k] - products[:, _SHOWN] * mean[k - _MOVING] for k in (_MOVING, _STILL))
        square, both, still_square = moving[_MOVING], moving[_STILL], still[_STILL]
        if not square * still_square > 0.0:
            raise MeasurementError("the pictures show nothing in common by which they could be brought together")
        slopes = slice(_PARAMETERS)
        try:
            inverse = np.linalg.inv(products[slopes, slopes])
        except np.linalg.LinAlgError:  # no slope: nowhere to go
            inverse = np.zeros((_PARAMETERS, _PARAMETERS))
        # Where a slope reaches beyond what is shown, OpenCV leaves the moved picture as it is, and so do we.
        beyond = products[slopes, _ONE] - products[slopes, _SHOWN]
        of_moving = products[slopes, _EVERYWHERE] - products[slopes, _SHOWN] * mean[0] + self._middle * beyond
        of_still = still[slopes]
        towards = inverse @ of_moving
        brighter, darker = square - of_moving @ towards, both - of_still @ towards
        if not darker > 0.0:
            raise MeasurementError("the pictures are too far apart, or not alike, to be brought together in steps")
        turn, right, down = inverse @ (brighter / darker * of_still - of_moving)
        angle = math.asin(movement[1, 0]) + turn
        turned = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
        reached = float(both) / math.sqrt(square * still_square)
        return reached, np.column_stack([turned, movement[:, 2] + (right, down)])

    def _products(self, movement: Array) -> tuple[Array, int]:
        """Return sums of products over pixels, shape (5, 8), as a block's rows have them, and how many they are."""
        (height, width), flags = self.shape, cv2.WARP_INVERSE_MAP
        moved = cv2.warpAffine(
            self._moving,
            movement,
            (width, height),
            dst=self._moved,
            flags=flags | cv2.INTER_LINEAR,
            borderValue=(-self._middle, 0.0, 0.0, 0.0),
        )
        shown = cv2.warpAffine(
            self._shown, movement, (width, height), dst=self._moved_shown, flags=flags | cv2.INTER_NEAREST
        )
        cos, sin = float(movement[0, 0]), float(movement[1, 0])
        x, y = np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32)[:, None]
        found = np.zeros((_SHOWN, _ROWS))
        for top in range(0, height, self._rows):
            rows = slice(top, min(top + self._rows, height))
            block, part = self._block[:, : rows.stop - top], moved[rows]
            block[_EVERYWHERE], block[1], block[2] = (part[..., k] for k in range(_PARAMETERS))
            np.multiply(-sin * x - cos * y[rows], block[1], out=block[0])
            block[0] += (cos * x - sin * y[rows]) * block[2]
            block[_SHOWN] = shown[rows]
            np.multiply(block[_EVERYWHERE], block[_SHOWN], out=block[_MOVING])
            np.multiply(self._still[rows], block[_SHOWN], out=block[_STILL])
            flat = block.reshape(_ROWS, -1)
            found += flat[:_SHOWN] @ flat.T
        return found, cv2.countNonZero(shown)
