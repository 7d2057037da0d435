"""Pictures of files: decoded by OpenCV, and of TIFF files whichever directory is the picture, whatever its layout.

tifffile reads the values. The compressions that it has no decoder for are decoded by libtiff, within Pillow or OpenCV.
"""

from __future__ import annotations

import io
import math
import struct
import threading
import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
import tifffile
from cv2.utils import logging
from numpy.typing import NDArray
from PIL import Image

from radiometer.data.guards import MOST_FILE_BYTES, refuse_endless_tiff, refuse_size
from radiometer.data.reader_limits import bounded_reader, unpacked
from radiometer.errors import CaptureError, DamagedFileError, UnsettledError

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


TIFF_MAGICS: Final = (b"II*\x00", b"MM\x00*", b"II+\x00", b"MM\x00+")  # TIFF 6.0 and BigTIFF
DAMAGE: Final = (
    tifffile.TiffFileError, OSError, ValueError, TypeError, KeyError, IndexError, AttributeError, struct.error,
    RuntimeError, ZeroDivisionError, OverflowError,
)  # fmt: skip
"""What tifffile raises on damaged tags or data: nearly any built-in error."""
# PhotometricInterpretation: TIFF 6.0, sections 4 to 6 and 21; TIFF/EP for the mosaic.
WHITE_IS_ZERO, BLACK_IS_ZERO, RGB, PALETTE, Y_CB_CR, MOSAIC = 0, 1, 2, 3, 6, 32803
_MASK_TYPE, _MASK_PHOTOMETRIC = 4, 4
# LZW (OpenCV's default) and the JPEG and CCITT kinds: tifffile needs a further library for them, libtiff has them.
_OF_LIBTIFF: Final = (2, 3, 4, 5, 7)
_JPEG: Final = 7
_ORIENTATION: Final = 274
_ASSOCIATED, _UNASSOCIATED = 1, 2  # ExtraSamples: a transparency that colours are multiplied by, and another
_PLANES_APART: Final = 2  # PlanarConfiguration


@contextmanager
def opened_tiff(path: Path, content: bytes) -> Iterator[Any]:
    """Give a TIFF's bytes as tifffile's file while the block runs.

    Raises:
        CaptureError: If its compression is not read.
        DamagedFileError: If it is damaged or truncated.
    """
    refuse_endless_tiff(path, content)
    try:
        with tifffile.TiffFile(io.BytesIO(content)) as tiff:
            yield tiff
    except (CaptureError, UnsettledError):
        raise
    except DAMAGE as error:
        if "imagecodecs" in str(error):  # what tifffile names where it has no decoder
            raise CaptureError(
                f"{path}: its compression or packing is not read ({error}); save it with 8 or 16 bits, uncompressed"
            ) from error
        why = (str(error).strip().splitlines() or [type(error).__name__])[0]
        raise DamagedFileError(f"{path}: not a readable TIFF file (damaged or truncated): {why}") from error


def directories(tiff: Any) -> Iterator[tuple[Any, tuple[Any, ...]]]:
    """Yield every directory of a TIFF with those above it: pages, and the directories within them."""
    for page in tiff.pages:
        whole = page.aspage()
        yield whole, ()
        for inner in whole.pages or ():
            yield inner.aspage(), (whole,)


def full_size(tiff: Any) -> tuple[list[tuple[Any, tuple[Any, ...]]], tuple[str, ...]]:
    """Return the directories of full-size pictures with those above them, and the others in words."""
    found = list(directories(tiff))
    whole = [(page, parents) for page, parents in found if not (page.is_reduced or _is_mask(page))]
    if not whole:  # writers that mark everything as reduced: the first is the picture
        whole = found[:1]
    kept = {id(page) for page, _ in whole}
    return whole, tuple(
        f"directory {n} (a {'mask' if _is_mask(page) else 'reduced picture'} of {page.shape[1]} × {page.shape[0]}"
        " pixels)"
        for n, (page, _) in enumerate(found)
        if id(page) not in kept
    )


def _is_mask(page: Any) -> bool:
    """Return whether a directory is the transparency mask of another (TIFF 6.0: NewSubfileType 4, photometric 4)."""
    return bool(page.subfiletype & _MASK_TYPE) or page.photometric == _MASK_PHOTOMETRIC


def pictures_without_directory(tiff: Any, pages: Sequence[Any]) -> int:
    """Return how many pictures follow the first one's in a file with one directory: large stacks of ImageJ, and STK."""
    if len(pages) != 1 or not (tiff.is_imagej or tiff.is_stk) or len(pages[0].shape) != 2:
        return 0
    return int(math.prod(tiff.series[0].shape) // math.prod(pages[0].shape)) - 1


def refuse_cut_short(path: Path, page: Any, size: int) -> None:
    """Refuse a page whose data end beyond the file: decoders would fill what is missing with zeros.

    Args:
        path: The file, for the message.
        page: Its directory, as tifffile's.
        size: Size of the file in bytes.

    Raises:
        DamagedFileError: If they do.
    """
    ends = [o + c for o, c in zip(page.dataoffsets, page.databytecounts, strict=False)]
    if not ends or max(ends) > size:
        raise DamagedFileError(f"{path}: the TIFF is truncated (its data end beyond the file); copy it again")


def page_values(path: Path, page: Any) -> NDArray[Any]:
    """Return the stored values of a directory, as stored: no orientation is applied, no sample is scaled.

    Args:
        path: The file.
        page: Its directory, as tifffile's.

    Returns:
        Shape (height, width) or (height, width, samples), samples in the file's order.

    Raises:
        CaptureError: If its layout is not read, or the data are damaged.
    """
    layout = {"YX": tuple(page.shape), "YXS": tuple(page.shape), "SYX": (*page.shape[1:], *page.shape[:1])}
    shape = layout.get(page.axes)
    if shape is None or page.dtype is None:
        raise CaptureError(f"{path}: the layout of its values is not read; save it as one picture of 8 or 16 bits")
    if page.compression not in _OF_LIBTIFF:
        values = np.asarray(page.asarray())
        return np.moveaxis(values, 0, -1) if page.axes == "SYX" else values
    # libtiff gives what is stored, its users do not: Pillow makes 8 bits of several samples and divides colours by
    # their transparency where they were multiplied by it. OpenCV multiplies where they were not, and mixes up planes.
    several = len(shape) > 2
    with_opencv = several and (page.dtype.itemsize > 1 or _ASSOCIATED in page.extrasamples)
    mixed_up = with_opencv and page.planarconfig == _PLANES_APART
    found = None if mixed_up else _of_libtiff(path, page.offset, with_opencv=with_opencv)
    if found is None or found.shape != shape or (several and found.dtype != page.dtype):
        raise CaptureError(f"{path}: its samples are not read with this compression; save it without compression")
    return found.astype(page.dtype, copy=False)


@bounded_reader(apart="PIL")
def _of_libtiff(path: Path, directory: int, *, with_opencv: bool) -> NDArray[Any] | None:
    """Return the values of the directory at a place of the file, not turned by its orientation; None where not read."""
    content = bytearray(unpacked(path, path.read_bytes(), MOST_FILE_BYTES))
    with opened_tiff(path, bytes(content)) as tiff:
        page = next(one for one, _ in directories(tiff) if one.offset == directory)
        turned = page.tags.get(_ORIENTATION)
        order, is_big = tiff.byteorder, tiff.is_bigtiff
    # Both read the first directory, and turn it.
    struct.pack_into(f"{order}{'Q' if is_big else 'I'}", content, 8 if is_big else 4, directory)
    if turned is not None:
        entry = (_ORIENTATION, 3, 1, 1)  # SHORT, one of them, not turned
        struct.pack_into(f"{order}{'HHQH6x' if is_big else 'HHIH2x'}", content, turned.offset, *entry)
    if not with_opencv:
        with Image.open(io.BytesIO(content)) as image:
            return np.asarray(image)
    values = decoded(np.frombuffer(content, np.uint8))
    if values is None or values.ndim != 3:
        return None
    return np.ascontiguousarray(values[..., [2, 1, 0, *range(3, values.shape[2])]]) if values.shape[2] >= 3 else values


def read_one_picture(path: Path, content: bytes, *, may_be_mosaic: bool = False) -> NDArray[Any]:
    """Return the stored values of the only full-size picture of a TIFF.

    Args:
        path: The file, for messages.
        content: Its bytes.
        may_be_mosaic: Whether pixels under filters of several colours are taken.

    Returns:
        Shape (height, width) of grey values, else (height, width, 3) in the order red, green, blue.

    Raises:
        CaptureError: If it holds several pictures, is damaged or truncated, or its numbers are neither grey values nor
            red, green and blue.
    """
    with opened_tiff(path, content) as tiff:
        pages = [page for page, _ in full_size(tiff)[0]]
        count = len(pages) + pictures_without_directory(tiff, pages)
        if count != 1:
            raise CaptureError(
                f"{path}: a TIFF of {count} pages, where one picture is read: save each page as a file, or"
                " `radiometer import` reads them all"
            )
        page = pages[0]
        _refuse_other_meaning(path, page, may_be_mosaic=may_be_mosaic)
        refuse_cut_short(path, page, len(content))
        refuse_size(path, page.shape, page.dtype.itemsize if page.dtype is not None else 1)
        values = page_values(path, page)
        if page.photometric == PALETTE:
            return _of_palette(path, values, page.colormap)
    if values.ndim == 2:
        return values
    return np.ascontiguousarray(values[..., 0] if page.photometric == BLACK_IS_ZERO else values[..., :3])


def _refuse_other_meaning(path: Path, page: Any, *, may_be_mosaic: bool) -> None:
    """Refuse numbers that are neither grey values nor red, green and blue, by the tags."""
    meaning, samples = page.photometric, page.samplesperpixel
    if meaning == WHITE_IS_ZERO:
        raise CaptureError(f"{path}: its tags state that 0 is white; save it anew with 0 as black")
    if meaning == MOSAIC and not may_be_mosaic:
        raise CaptureError(f"{path}: a mosaic of colours by its tags; `radiometer import` reads it")
    is_grey = meaning in (BLACK_IS_ZERO, PALETTE, MOSAIC) and samples == 1
    is_grey |= meaning == BLACK_IS_ZERO and tuple(page.extrasamples) in ((_ASSOCIATED,), (_UNASSOCIATED,))
    is_colour = meaning == RGB or (meaning == Y_CB_CR and page.compression == _JPEG)  # which libtiff makes RGB
    if not (is_grey or (is_colour and samples >= 3)):
        raise CaptureError(
            f"{path}: {samples} samples per pixel of PhotometricInterpretation {int(meaning)}, which are neither grey"
            " values nor red, green and blue; save it as one of them"
        )


def _of_palette(path: Path, numbers: NDArray[Any], palette: Any) -> NDArray[Any]:
    """Return the grey values of a palette of greys, such as monochrome cameras' programs write."""
    greys = np.asarray(palette)
    if greys.ndim == 2 and bool(np.all(greys == greys[0])) and int(numbers.max(initial=0)) < greys.shape[1]:
        return np.asarray((greys[0] >> 8).astype(np.uint8)[numbers])  # TIFF 6.0, section 5: 65535 is full intensity
    raise CaptureError(
        f"{path}: its colours are indices into a palette, so they are not the camera's values; use the camera's own"
        " file"
    )
