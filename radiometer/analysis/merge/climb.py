"""Steps of Gauss and Newton towards the movement of highest correlation between two pictures.

The method is that of OpenCV's findTransformECC for a shift and a turn, whose every call blurs and derives anew and asks
for a dozen arrays as large as the picture. Here all climbs of a pair share what is computed from the two pictures.
The sums of a step are made in blocks of rows that stay in a core's caches. This takes less than half of the processor
time.

Every sum is one over the pixels that both pictures show, of what differs from its mean over these: so the coefficient
is defined, and its slopes with it. OpenCV lets the slopes reach beyond them, where the moved picture is not centred:
little contrast on a high pedestal then leads astray by tens of pixels. Where nothing slopes at the rim of what is shown
the steps are the same.

Source: G. D. Evangelidis, E. Z. Psarakis 2008, IEEE Trans. PAMI 30, 1858–1865 (forward additive).
"""

from __future__ import annotations

import math
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from radiometer.errors import MeasurementError
from radiometer.typing import Array, Image

BLUR_PX: Final = 5
_LEAST_STEP: Final = 1e-6  # of the correlation
# Of the blur's pixels so many must show something.
_SHOWN_SHARE: Final = 0.95
_BLOCK_PX: Final = 16384
_CENTRAL: Final = np.array([[-0.5, 0.0, 0.5]], np.float32)
# Of a movement: a turn, a shift to the right and one down. A block holds the moved picture's derivatives by these, the
# moved picture and the still one, all of them where both show something, and 1 there.
_PARAMETERS: Final = 3
_MOVING, _STILL, _SHOWN, _ROWS = 3, 4, 5, 6


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
        # Sums of squares in 32 bits are those of what differs from a mean, or little contrast would drown in them.
        self._still, blurred = (cv2.GaussianBlur(one - np.float32(one.mean()), blur, 0) for one in (still, moving))
        self._shown = (cv2.GaussianBlur(inside.astype(np.float32), blur, 0) > _SHOWN_SHARE).astype(np.uint8)
        slopes = [cv2.filter2D(blurred, -1, kernel) for kernel in (_CENTRAL, _CENTRAL.T)]
        # Four channels are moved at once, faster than three.
        self._moving = cv2.merge([blurred, *slopes, slopes[0]])
        self._rows = max(1, _BLOCK_PX // self.shape[1])
        self._block = np.empty((_ROWS, self._rows, self.shape[1]), np.float32)
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
        # Products of what differs from the means of the pixels shown.
        sums = products[:, _SHOWN]
        centred = products[:, :_SHOWN] - np.outer(sums, sums) / max(pixels, 1)
        slopes = slice(_PARAMETERS)
        square, both, still_square = centred[_MOVING, _MOVING], centred[_MOVING, _STILL], centred[_STILL, _STILL]
        of_moving, of_still = centred[slopes, _MOVING], centred[slopes, _STILL]
        if not square * still_square > 0.0:
            raise MeasurementError(
                "the pictures have nothing in common by which they could be aligned; take them of one scene"
            )
        try:
            inverse = np.linalg.inv(centred[slopes, slopes])
        except np.linalg.LinAlgError:  # no slope: nowhere to go
            inverse = np.zeros((_PARAMETERS, _PARAMETERS))
        towards = inverse @ of_moving
        brighter, darker = square - of_moving @ towards, both - of_still @ towards
        if not darker > 0.0:
            raise MeasurementError(
                "the pictures are displaced too far, or too different, to be aligned; take them from one place"
            )
        turn, right, down = inverse @ (brighter / darker * of_still - of_moving)
        angle = math.asin(movement[1, 0]) + turn
        turned = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
        reached = float(both) / math.sqrt(square * still_square)
        return reached, np.column_stack([turned, movement[:, 2] + (right, down)])

    def _products(self, movement: Array) -> tuple[Array, int]:
        """Return sums of products over pixels, shape (5, 6), as a block's rows have them, and how many they are."""
        (height, width), flags = self.shape, cv2.WARP_INVERSE_MAP
        # Half a pixel beyond its edge a picture still counts as shown.
        moved = cv2.warpAffine(
            self._moving,
            movement,
            (width, height),
            dst=self._moved,
            flags=flags | cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_REPLICATE,
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
            block[_SHOWN] = shown[rows]
            for k, row in enumerate((_MOVING, 1, 2)):
                np.multiply(part[..., k], block[_SHOWN], out=block[row])
            np.multiply(-sin * x - cos * y[rows], block[1], out=block[0])
            block[0] += (cos * x - sin * y[rows]) * block[2]
            np.multiply(self._still[rows], block[_SHOWN], out=block[_STILL])
            flat = block.reshape(_ROWS, -1)
            found += flat[:_SHOWN] @ flat.T
        return found, cv2.countNonZero(shown)
