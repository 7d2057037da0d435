"""Camera raw files: the sensor's own numbers, linear, black level not removed."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from radiometer.errors import CaptureError, MissingLibrary

RAW_SUFFIXES: Final = frozenset({".cr2", ".cr3", ".nef", ".arw", ".dng", ".orf", ".raf", ".rw2", ".pef"})
_LETTERS: Final = "RGB"


@dataclass(frozen=True, slots=True, eq=False)
class RawColours:
    """The three colours of a mosaic, each at half size.

    Attributes:
        values: Shape (height, width, 3), red, green and blue; of the two green pixels of a cell the first.
        bit_depth: Bits per value, 9 to 16; numbers at the file's white level are full scale.
        black_level_dn: Mean black level that the file states.
    """

    values: NDArray[np.uint16]
    bit_depth: int
    black_level_dn: float

    @property
    def green(self) -> NDArray[np.uint16]:
        """Return the green plane: what a frame of a tethered camera consists of."""
        return np.ascontiguousarray(self.values[..., _LETTERS.index("G")])


def read_raw_colours(path: Path) -> RawColours:
    """Return the sensor's numbers of a camera raw file.

    Raises:
        CaptureError: If it is missing, damaged, or its mosaic is not the 2 × 2 Bayer pattern.
        MissingLibrary: If rawpy is not installed.
    """
    try:
        import rawpy
    except ImportError as error:
        raise MissingLibrary(
            f"{path}: camera raw files need rawpy; install it with `pip install 'radiometer[photo]'`"
        ) from error
    try:
        with rawpy.imread(str(path)) as raw:
            mosaic, pattern = raw.raw_image_visible.copy(), raw.raw_pattern
            white, black = int(raw.white_level), raw.black_level_per_channel
            names = raw.color_desc.decode("ascii", "replace")
    except (rawpy.LibRawError, OSError) as error:
        raise CaptureError(f"{path}: not a readable camera raw file: {error}") from error
    if pattern is None or pattern.shape != (2, 2):
        raise CaptureError(f"{path}: its colour mosaic is not the 2 × 2 Bayer pattern; develop it to linear TIFF")
    planes = [_bayer_plane(mosaic, pattern, names, letter) for letter in _LETTERS]
    bit_depth = max(9, min(16, int(np.ceil(np.log2(white + 1)))))
    values = np.minimum(np.stack(planes, axis=2), (1 << bit_depth) - 1).astype(np.uint16)
    values[values >= white] = (1 << bit_depth) - 1
    return RawColours(values, bit_depth, float(np.mean(black)))


def _bayer_plane(mosaic: Any, pattern: Any, names: str, letter: str) -> Any:
    row, column = next((r, c) for r in (0, 1) for c in (0, 1) if names[pattern[r, c]] == letter)
    height, width = (size // 2 * 2 for size in mosaic.shape)
    return mosaic[row:height:2, column:width:2]
