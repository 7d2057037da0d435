"""The stored values of one photograph: JPEG, PNG, TIFF, or the sensor's own values of a camera raw file."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
from PIL import Image, UnidentifiedImageError

from radiometer.data.frame import DigitalNumbers
from radiometer.data.guards import refuse_large_picture
from radiometer.data.mosaic import COLOURS, LUMA
from radiometer.data.raw_files import RAW_SUFFIXES, read_raw_colours
from radiometer.data.reader_limits import RAW_READER_BYTES, bounded_reader
from radiometer.data.tiff_pixels import TIFF_MAGICS, decoded, read_one_picture
from radiometer.errors import CaptureError

IMAGE_SUFFIXES: Final = frozenset({".jpg", ".jpeg", ".png", ".tif", ".tiff"})
# A JPEG holds luma and two colour differences as whole numbers, 0.5 off at most each: a blue of 255 returns as 253.
_ROUNDED_DN: Final = 2
_PNG_START: Final = b"\x89PNG"
_JPEG_SUFFIXES: Final = frozenset({".jpg", ".jpeg"})


@dataclass(frozen=True, slots=True, eq=False)
class Photograph:
    """The stored values of one photograph."""

    values: DigitalNumbers  # shape (height, width) where grey, else (height, width, 3) in the order red, green, blue
    bit_depth: int  # bits per value
    # Value of black by channel, in their order, where the file states it
    black_levels_dn: tuple[float, float, float] | None = None
    white_level_dn: int | None = None  # value from which pixels are saturated, where the file states it
    is_raw: bool = False  # whether the values are the sensor's own, linear
    # (height, width) of the file where only a lattice of its pixels was taken
    full_shape: tuple[int, int] | None = None

    @property
    def is_grey(self) -> bool:
        """Return whether there is one channel only."""
        return self.values.ndim == 2

    @property
    def shape(self) -> tuple[int, int]:
        """Return (height, width) in pixels of the file."""
        return self.full_shape or (int(self.values.shape[0]), int(self.values.shape[1]))

    def black_level_dn(self, channel: str) -> float | None:
        """Return the value of black of one channel, that of luminance weighted as it is; None where not stated."""
        if self.black_levels_dn is None:
            return None
        if channel in COLOURS:
            return self.black_levels_dn[COLOURS.index(channel)]
        return float(np.dot(LUMA, self.black_levels_dn))

    def plane(self, channel: str) -> DigitalNumbers:
        """Return the values of one channel: "red", "green", "blue", "luminance", or "mono" where grey."""
        if self.is_grey:
            return self.values
        values: Any = self.values
        if channel in COLOURS:
            return _plane(values[..., COLOURS.index(channel)])
        full_scale = (1 << self.bit_depth) - 1
        end = full_scale - (_ROUNDED_DN if self.bit_depth == 8 else 0)
        return luma_of([values[..., k] for k in range(len(COLOURS))], (end,) * len(COLOURS), full_scale)


def luma_of(planes: Sequence[Any], saturated_dn: Sequence[int], full_scale_dn: int) -> DigitalNumbers:
    """Return the luma of red, green and blue; full scale where one of them is saturated.

    Args:
        planes: Values of red, green and blue, shape (height, width) each.
        saturated_dn: From which value each of them is saturated.
    """
    luma: DigitalNumbers = cv2.cvtColor(np.dstack(planes), cv2.COLOR_RGB2GRAY)
    # A sum is known only where all its parts are; a black part adds next to nothing.
    for plane, end in zip(planes, saturated_dn, strict=True):
        luma[plane >= end] = full_scale_dn
    return luma


def _plane(values: Any) -> DigitalNumbers:
    plane: DigitalNumbers = np.ascontiguousarray(values)
    return plane


@bounded_reader(RAW_READER_BYTES)
def read_photograph(path: Path, most_pixels: int | None = None, *, interpolated: bool = False) -> Photograph:
    """Return the stored values of a photograph.

    Args:
        most_pixels: Take every n-th pixel of every n-th row where the file holds more than this; None for all.
        interpolated: Of a camera raw file: fill in the colours that every pixel lacks.

    Raises:
        CaptureError: If the file is missing, truncated, or of another form.
        MissingLibrary: If it is a camera raw file and rawpy is not installed.
    """
    suffix = path.suffix.lower()
    if suffix in RAW_SUFFIXES:
        return _read_raw(path, most_pixels, interpolated=interpolated)
    if suffix in _JPEG_SUFFIXES and not _is_png(path):
        values, shape = _decode_jpeg(path, most_pixels)
    else:
        values = _decode_lossless(path)
        shape = (int(values.shape[0]), int(values.shape[1]))
        values = _on_lattice(values, _step(shape, most_pixels))
    if values.dtype not in (np.uint8, np.uint16):
        raise CaptureError(f"{path}: holds {values.dtype} values; expected 8 or 16 bits per channel")
    if values.ndim == 3:
        values = values[..., :3] if values.shape[2] >= 3 else values[..., 0]
    return Photograph(values, 8 * values.dtype.itemsize, full_shape=shape)


def _step(shape: tuple[int, int], most_pixels: int | None) -> int:
    """Return the step of the lattice: odd, so that it does not fall into step with the blocks of a JPEG."""
    if most_pixels is None or shape[0] * shape[1] <= most_pixels:
        return 1
    step = math.ceil(math.sqrt(shape[0] * shape[1] / most_pixels))
    return step + (step + 1) % 2


def _on_lattice(values: Any, step: int) -> Any:
    return values if step == 1 else np.ascontiguousarray(values[step // 2 :: step, step // 2 :: step])


def _decode_jpeg(path: Path, most_pixels: int | None) -> tuple[Any, tuple[int, int]]:
    """Return the values on the lattice and (height, width) of the file."""
    try:
        refuse_large_picture(path, path.read_bytes())
        with Image.open(path) as image:
            colour = image if image.mode in ("L", "RGB") else image.convert("RGB")
            width, height = colour.size
            step = _step((height, width), most_pixels)
            if step > 1:
                columns, rows = width // step, height // step
                box = (0, 0, columns * step, rows * step)
                # Picks the middle pixel of every cell; no array of the whole picture is ever made.
                colour = colour.resize((columns, rows), Image.Resampling.NEAREST, box=box)
            return np.asarray(colour), (height, width)
    except (OSError, UnidentifiedImageError, SyntaxError, ValueError) as error:
        raise CaptureError(f"{path}: not a readable JPEG (damaged or truncated): {error}") from error


def _decode_lossless(path: Path) -> Any:
    try:
        content = np.fromfile(path, np.uint8)
    except OSError as error:
        raise CaptureError(f"cannot read {path}: {error.strerror or error}") from error
    # Decoders fill the missing rows of a truncated PNG with zeros and say nothing.
    if content[:4].tobytes() == _PNG_START and b"IEND" not in content[-16:].tobytes():
        raise CaptureError(f"{path}: the PNG is truncated (no closing chunk); copy it again")
    refuse_large_picture(path, content.tobytes())
    if content[:4].tobytes() in TIFF_MAGICS:
        return read_one_picture(path, content.tobytes())
    image = decoded(content)
    if image is None:
        raise CaptureError(f"{path}: not a readable PNG or TIFF (damaged or truncated); copy it again")
    if _has_palette(path):
        return _of_palette(path, image)
    return cv2.cvtColor(image[..., :3], cv2.COLOR_BGR2RGB) if image.ndim == 3 and image.shape[2] >= 3 else image


def _is_png(path: Path) -> bool:
    """Return whether a file is a PNG whatever its name: read as a JPEG, 16 bits would be cut down to 8."""
    try:
        with path.open("rb") as file:
            return file.read(4) == _PNG_START
    except OSError:
        return False  # reported where it is read


def _has_palette(path: Path) -> bool:
    try:
        with Image.open(path) as image:
            return image.mode == "P"
    except (OSError, UnidentifiedImageError, SyntaxError, ValueError):
        return False  # OpenCV has read it: no form that holds a palette


def _of_palette(path: Path, image: Any) -> Any:
    """Return the grey values of a picture with a palette of greys, such as monochrome cameras' programs write."""
    if image.ndim == 3 and bool(np.all(image[..., :3] == image[..., :1])):
        return np.ascontiguousarray(image[..., 0])
    raise CaptureError(
        f"{path}: its colours are indices into a palette of at most 256, so they are not the camera's values. Use the "
        "camera's own file; a picture that was only packed can be saved as RGB without a palette"
    )


def _read_raw(path: Path, most_pixels: int | None = None, *, interpolated: bool = False) -> Photograph:
    """Return the three colours of a mosaic straight from the sensor: linear, black level not removed."""
    raw = read_raw_colours(path, interpolated=interpolated)
    shape = (int(raw.values.shape[0]), int(raw.values.shape[1]))
    values = _on_lattice(raw.values, _step(shape, most_pixels))
    return Photograph(values, raw.bit_depth, raw.black_levels_dn, raw.white_level_dn, is_raw=True, full_shape=shape)
