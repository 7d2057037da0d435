"""The bytes of a file, unpacked where it is gzipped, and what they begin with."""

from __future__ import annotations

import gzip
import zlib
from pathlib import Path
from typing import Final

from radiometer.data.guards import MOST_FILE_BYTES
from radiometer.data.tiff_pixels import TIFF_MAGICS
from radiometer.errors import CaptureError

_GZIP_MAGIC: Final = b"\x1f\x8b"
_FITS_MAGIC: Final = b"SIMPLE  ="  # FITS standard 4.0, section 4.4.1.1
_PNG_MAGIC: Final = b"\x89PNG"


def read_bytes(path: Path, most: int = -1) -> bytes:
    """Return a file's bytes, unpacked where it is gzipped.

    Args:
        most: How many bytes to return at most; -1 for all.

    Raises:
        CaptureError: If it is missing, or a gzip stream ends too early or is damaged.
    """
    try:
        with path.open("rb") as stream:
            packed = stream.read(2) == _GZIP_MAGIC
        if not packed:
            with path.open("rb") as stream:
                return stream.read(most)
        with gzip.open(path) as unpacked:
            content = unpacked.read(MOST_FILE_BYTES + 1 if most < 0 else most)
        if len(content) > MOST_FILE_BYTES:
            raise CaptureError(f"{path}: more than {MOST_FILE_BYTES / 1e6:.0f} MB once unpacked; cut it first")
        return content
    except (EOFError, zlib.error, gzip.BadGzipFile) as error:
        raise CaptureError(f"{path}: the gzip file is damaged or truncated ({error}); copy it again") from error
    except OSError as error:
        raise CaptureError(f"cannot read {path}: {error.strerror or error}") from error


def kind_of(path: Path) -> str:
    """Return "fits", "tiff", "png" or "" by a file's first bytes.

    Raises:
        CaptureError: If it cannot be opened, or is gzipped and damaged at once.
    """
    head = read_bytes(path, 16)
    if head.startswith(_FITS_MAGIC):
        return "fits"
    if head.startswith(TIFF_MAGICS):
        return "tiff"
    return "png" if head.startswith(_PNG_MAGIC) else ""
