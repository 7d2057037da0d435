"""Camera raw files: the sensor's own numbers, linear, black level not removed."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from radiometer.data.reader_limits import RAW_READER_BYTES, bounded_reader
from radiometer.errors import CaptureError, required_library

RAW_SUFFIXES: Final = frozenset({".cr2", ".cr3", ".nef", ".arw", ".dng", ".orf", ".raf", ".rw2", ".pef"})
_LETTERS: Final = "RGB"


# Side of the cell that holds all three colours, by the size of the pattern that repeats: Bayer's and X-Trans.
_CELLS: Final = {(2, 2): 2, (6, 6): 3}


@dataclass(frozen=True, slots=True, eq=False)
class RawColours:
    """The three colours of a mosaic, or the one of a sensor without filters."""

    # Shape (height, width) of a sensor without filters, else (height, width, 3), red, green and blue. They are values
    # of the first pixel of a colour in each cell (at half size for Bayer's mosaic, a third for X-Trans). Where
    # interpolated, they are values of every pixel.
    values: NDArray[np.uint16]
    bit_depth: int  # bits per value, 9 to 16
    white_level_dn: int  # white level as the file states it
    black_levels_dn: tuple[float, float, float]  # black level of red, green and blue

    @property
    def green(self) -> NDArray[np.uint16]:
        """Return the green or only plane of a frame without a white level: what reaches it is at full scale."""
        plane = np.ascontiguousarray(self.values if self.values.ndim == 2 else self.values[..., _LETTERS.index("G")])
        plane[plane >= self.white_level_dn] = (1 << self.bit_depth) - 1
        return plane


@bounded_reader(RAW_READER_BYTES, apart="rawpy")
def read_raw_colours(path: Path, *, interpolated: bool = False) -> RawColours:
    """Return the sensor's numbers of a camera raw file.

    Args:
        path: The file.
        interpolated: Fill in the two colours that every pixel lacks (for pictures; black is then 0); what is filled in
            from a clipped pixel counts as clipped.

    Raises:
        CaptureError: If it is missing, damaged, developed, or its mosaic is neither Bayer's nor X-Trans.
        MissingLibrary: If rawpy is not installed.
    """
    rawpy = required_library(
        "rawpy", f"{path}: camera raw files need rawpy; install it with `pip install 'radiometer[photo]'`"
    )
    try:
        with rawpy.imread(str(path)) as raw:
            grey = raw.raw_type == rawpy.RawType.Flat and raw.num_colors == 1
            if not grey and (raw.raw_type != rawpy.RawType.Flat or raw.raw_pattern is None):
                raise CaptureError(f"{path}: is not a mosaic of colours, or was developed; develop it to linear TIFF")
            mosaic, pattern = raw.raw_image_visible.copy(), raw.raw_pattern
            white, black = int(raw.white_level), raw.black_level_per_channel
            names = raw.color_desc.decode("ascii", "replace")
            developed = _developed(raw, rawpy) if interpolated and not grey else None
    except (rawpy.LibRawError, OSError) as error:
        reason = error.args[0] if error.args else error
        reason_text = reason.decode("utf-8", "replace") if isinstance(reason, bytes) else error
        raise CaptureError(f"{path}: not a readable camera raw file: {reason_text}") from error
    if not grey and pattern.shape not in _CELLS:
        raise CaptureError(f"{path}: its colour mosaic is neither Bayer's nor X-Trans; develop it to linear TIFF")
    bit_depth = max(9, min(16, int(np.ceil(np.log2(white + 1)))))
    if grey:
        values = np.minimum(mosaic, (1 << bit_depth) - 1).astype(np.uint16)
        return RawColours(values, bit_depth, white, (float(black[0]),) * 3)
    levels = [float(np.mean([black[k] for k in set(pattern.ravel().tolist()) if names[k] == c])) for c in _LETTERS]
    letters = np.array(list(names))[pattern]
    if developed is not None:
        values = developed
        values[_near_clipped(mosaic, letters, white)] = (1 << bit_depth) - 1
        return RawColours(values, bit_depth, white, (0.0, 0.0, 0.0))
    planes = [_plane(mosaic, letters, letter) for letter in _LETTERS]
    if _CELLS[pattern.shape] == 2:  # the green that is read has a separate black level
        row, column = np.argwhere(letters == "G")[0]
        levels[1] = float(black[pattern[row, column]])
    values = np.minimum(np.stack(planes, axis=2), (1 << bit_depth) - 1).astype(np.uint16)
    return RawColours(values, bit_depth, white, (levels[0], levels[1], levels[2]))


def _plane(mosaic: NDArray[np.uint16], letters: NDArray[np.str_], letter: str) -> NDArray[np.uint16]:
    """Return the first pixel of a colour in every cell."""
    period, side = letters.shape[0], _CELLS[(letters.shape[0], letters.shape[1])]
    height, width = (size // side for size in mosaic.shape)
    plane = np.empty((height, width), mosaic.dtype)
    cells = period // side
    for i in range(cells):
        for j in range(cells):
            cell = letters[i * side : (i + 1) * side, j * side : (j + 1) * side]
            row, column = np.argwhere(cell == letter)[0]
            part = plane[i::cells, j::cells]
            found = mosaic[i * side + row :: period, j * side + column :: period]
            part[:] = found[: part.shape[0], : part.shape[1]]
    return plane


def _developed(raw: Any, rawpy: Any) -> NDArray[np.uint16]:
    """Return red, green and blue of every pixel above black, in the sensor's own numbers."""
    values: NDArray[np.uint16] = raw.postprocess(
        # Means of neighbours: in proportion to light, which algorithms that follow edges are not.
        demosaic_algorithm=rawpy.DemosaicAlgorithm.LINEAR,
        output_color=rawpy.ColorSpace.raw,
        gamma=(1, 1),
        user_wb=[1.0, 1.0, 1.0, 1.0],
        no_auto_bright=True,
        no_auto_scale=True,
        output_bps=16,
        user_flip=0,
    )
    return values.copy()


def _near_clipped(mosaic: NDArray[np.uint16], letters: NDArray[np.str_], white: int) -> NDArray[np.bool_]:
    """Return where red, green and blue are clipped, or mean of a neighbour of that colour which is; (height, width, 3).

    What clips in one colour says nothing of another: a lamp's green ends long before its red.
    """
    from scipy.ndimage import maximum_filter

    (height, width), (rows, columns) = mosaic.shape, letters.shape
    colour = np.tile(letters, (-(-height // rows), -(-width // columns)))[:height, :width]
    clipped, found = mosaic >= white, np.empty((height, width, len(_LETTERS)), bool)
    for k, letter in enumerate(_LETTERS):
        own = colour == letter
        found[..., k] = np.where(own, clipped, maximum_filter(clipped & own, size=3))
    return found
