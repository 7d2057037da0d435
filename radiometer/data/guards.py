"""Refuses files that say little and ask for much: pictures, nesting and repetitions beyond any real one.

Sizes are taken from a file's header before anything is decoded; the limits are stated in every refusal.
"""

from __future__ import annotations

import hashlib
import io
import math
import re
import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import yaml
from PIL import Image, UnidentifiedImageError

from radiometer.errors import CaptureError, InputError, UsageError

MOST_PICTURE_BYTES: Final = 400_000_000  # decoded; the largest sensors sold have 151 million pixels of 16 bits
MOST_FILE_BYTES: Final = 800_000_000  # twice the largest picture: headers and padding
MOST_YAML_BYTES: Final = 64_000_000  # a capture set of 100,000 frames
MOST_DIRECTORIES: Final = 1_000_000  # of a TIFF: a day of frames at 10 per second
DEEPEST_NESTING: Final = 64  # files of this program nest some ten levels
# Of a JPEG; libtiff allows as many in a TIFF (JPEG_MAX_SCAN_NUMBER). Encoders write ten, and thumbnails have their own.
MOST_SCANS: Final = 100
MOST_ENTRIES: Final = 5_000_000  # after all repetitions are written out
_Loader: Final = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
_PNG_SIGNATURE: Final = b"\x89PNG\r\n\x1a\n"
_PNG_CHANNELS: Final = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}  # PNG specification, 11.2.2: channels of each colour type
_HDR_RESOLUTION: Final = re.compile(rb"[-+][XY] +(\d{1,12}) +[-+][XY] +(\d{1,12})\s")
_LONGEST_HEAD: Final = 65_536  # bytes; real headers have some hundred
_LONGEST_NAME: Final = 64  # characters, of at most three bytes each: Linux file systems take 255 bytes
_EXR_CHANNELS: Final = 4
_MODE_BYTES: Final = {"1": 1, "L": 1, "P": 1, "I;16": 2, "I;16B": 2, "I": 4, "F": 4, "RGB": 3, "RGBA": 4, "CMYK": 4}


def refuse_size(path: Path, shape: Sequence[int], bytes_each: int) -> None:
    """Refuse a picture or table that is too large once decoded.

    Args:
        path: The file, for the message.
        shape: Its extents, such as height, width and channels, as its header states them.
        bytes_each: Size of one value in bytes.

    Raises:
        CaptureError: If it exceeds the limit.
    """
    size = math.prod(int(extent) for extent in shape) * bytes_each
    if size > MOST_PICTURE_BYTES:
        extents = " × ".join(str(extent) for extent in shape)
        raise CaptureError(
            f"{path}: its header states {extents} values, {size / 1e6:.0f} MB decoded; at most"
            f" {MOST_PICTURE_BYTES / 1e6:.0f} MB are read: crop the picture, or look whether the file is what it says"
        )


def refuse_large_picture(path: Path, content: bytes) -> None:
    """Refuse a PNG, TIFF, JPEG, Radiance .hdr or OpenEXR that is too large once decoded, by its header alone.

    What is no such file is left to its decoder.

    Args:
        path: The file, for the message.
        content: Its bytes.

    Raises:
        CaptureError: If it exceeds the limit.
    """
    if content.startswith(_PNG_SIGNATURE) and len(content) >= 26:
        width, height, bits, colour = struct.unpack(">IIBB", content[16:26])
        refuse_size(path, (height, width, _PNG_CHANNELS.get(colour, 4)), 2 if bits == 16 else 1)
        return
    if content[:4] in (b"II*\x00", b"MM\x00*"):
        refuse_endless_tiff(path, content)
        for width, height, samples, bits in _tiff_sizes(content):
            refuse_size(path, (height, width, samples), max(1, (bits + 7) // 8))
        return
    if content.startswith(b"\xff\xd8"):
        refuse_many_scans(path, content)
    if (size := _hdr_size(content) or _exr_size(content)) is not None:
        refuse_size(path, size, 4)
        return
    try:
        with Image.open(io.BytesIO(content)) as image:
            refuse_size(path, (image.height, image.width), _MODE_BYTES.get(image.mode, 4))
    except Image.DecompressionBombError as error:
        raise CaptureError(f"{path}: {error}; look whether the file is what it says") from error
    except (UnidentifiedImageError, OSError, SyntaxError, ValueError, struct.error, OverflowError):
        return  # its decoder will say what is wrong with it


def refuse_many_scans(path: Path, content: bytes) -> None:
    """Refuse a JPEG that is decoded again and again: each of its scans, of a few bytes, goes over all pixels.

    Within a scan, the byte of the marker is always followed by 0 (ITU-T T.81, B.1.1.5), so each is a scan indeed.

    Raises:
        CaptureError: If it has more than `MOST_SCANS`.
    """
    if (scans := content.count(b"\xff\xda")) > MOST_SCANS:
        raise CaptureError(f"{path}: a JPEG of {scans} scans; at most {MOST_SCANS} are read: save it again")


def _hdr_size(content: bytes) -> tuple[int, int, int] | None:
    """Return rows, columns and channels of a Radiance picture (Radiance's filefmts, the resolution line)."""
    if not content.startswith((b"#?RADIANCE", b"#?RGBE")):
        return None
    found = _HDR_RESOLUTION.search(content[:_LONGEST_HEAD])
    return (int(found[1]), int(found[2]), 3) if found else None


def _exr_size(content: bytes) -> tuple[int, int, int] | None:
    """Return rows, columns and channels of an OpenEXR picture (OpenEXR file layout, attribute dataWindow)."""
    at = content.find(b"dataWindow\0box2i\0", 0, _LONGEST_HEAD)
    if not content.startswith(b"v/1\x01") or at < 0 or len(content) < at + 37:
        return None
    left, top, right, bottom = struct.unpack_from("<4i", content, at + 21)
    return abs(bottom - top) + 1, abs(right - left) + 1, _EXR_CHANNELS


def _tiff_sizes(content: bytes) -> list[tuple[int, int, int, int]]:
    """Return width, height, samples and bits of the first directory of a TIFF (TIFF 6.0, section 2); [] if damaged."""
    order = "<" if content[:2] == b"II" else ">"
    try:
        (offset,) = struct.unpack_from(f"{order}I", content, 4)
        (count,) = struct.unpack_from(f"{order}H", content, offset)
        found = {256: 0, 257: 0, 277: 1, 258: 8}
        for number in range(count):
            tag, kind, values = struct.unpack_from(f"{order}HHI", content, offset + 2 + 12 * number)
            if tag in found:
                at = offset + 10 + 12 * number
                if tag == 258 and values > 2:  # several samples: their depths stand elsewhere
                    (at,) = struct.unpack_from(f"{order}I", content, at)
                (found[tag],) = struct.unpack_from(f"{order}{'H' if kind == 3 else 'I'}", content, at)
    except struct.error:
        return []
    return [(found[256], found[257], found[277], found[258])]


def refuse_endless_tiff(path: Path, content: bytes) -> None:
    """Refuse a TIFF whose directories never end.

    A classic TIFF and a BigTIFF are walked (TIFF 6.0, section 2; BigTIFF design of the Aware Systems). A directory
    beyond the file ends the walk: its reader names it. One that points back to one before would be read for ever.

    Args:
        path: The file, for the message.
        content: Its bytes.

    Raises:
        CaptureError: If a directory comes twice, or there are more than `MOST_DIRECTORIES`.
    """
    order = "<" if content[:2] == b"II" else ">"
    big = content[2:4] in (b"+\x00", b"\x00+")
    counted, width, pointer = ("Q", 20, "Q") if big else ("H", 12, "I")
    seen = set[int]()
    try:
        (at,) = struct.unpack_from(f"{order}{pointer}", content, 8 if big else 4)
        while at:
            if at in seen or len(seen) >= MOST_DIRECTORIES:
                raise CaptureError(f"{path}: the chain of its TIFF directories never ends; write the file again")
            seen.add(at)
            (entries,) = struct.unpack_from(f"{order}{counted}", content, at)
            first = at + struct.calcsize(f"{order}{counted}")
            (at,) = struct.unpack_from(f"{order}{pointer}", content, first + width * entries)
    except struct.error:
        pass


def refuse_deep_yaml(text: str, where: str) -> None:
    """Refuse YAML that is nested too deeply, repeats itself too often or holds itself: reading it would not end.

    Raises:
        InputError: If it exceeds a limit.
        YAMLError: If it is no YAML.
    """
    if len(text) > MOST_YAML_BYTES:
        raise InputError(f"{where}: {len(text) / 1e6:.0f} MB of YAML; at most {MOST_YAML_BYTES / 1e6:.0f} MB are read")
    if "*" not in text and not _may_be_deep(text):
        return
    sizes, counting = dict[str, int](), list[tuple[str | None, int]]()
    total = 0
    for event in yaml.parse(text, Loader=_Loader):
        size = 0
        if isinstance(event, yaml.CollectionStartEvent):
            counting.append((event.anchor, 0))
            if len(counting) > DEEPEST_NESTING:
                at = f", line {event.start_mark.line + 1}" if event.start_mark else ""
                raise InputError(f"{where}{at}: nested more than {DEEPEST_NESTING} deep; no file of this program is")
            continue
        if isinstance(event, yaml.ScalarEvent):
            size = 1
        elif isinstance(event, yaml.AliasEvent):
            if any(anchor == event.anchor for anchor, _ in counting):
                at = f", line {event.start_mark.line + 1}" if event.start_mark else ""
                raise InputError(f"{where}{at}: *{event.anchor} holds itself; write the values out")
            size = sizes.get(str(event.anchor), 1)
        elif isinstance(event, yaml.CollectionEndEvent):
            anchor, inside = counting.pop()
            size = inside + 1
            if anchor is not None:
                sizes[anchor] = size
        if counting:
            anchor, inside = counting.pop()
            counting.append((anchor, inside + size))
            total = inside + size
        if total > MOST_ENTRIES:
            raise InputError(f"{where}: more than {MOST_ENTRIES} entries once its repetitions are written out")


def _may_be_deep(text: str) -> bool:
    """Return whether a text could be nested deeper than the limit; cheap, and true too often rather than too seldom."""
    openings = text.count("[") + text.count("{") + text.count("- ") + text.count("? ") + text.count("-\t")
    if openings > DEEPEST_NESTING // 2:
        return True
    return any(len(line) - len(line.lstrip(" ")) > DEEPEST_NESTING // 2 for line in text.splitlines())


def is_file(path: Path) -> bool:
    """Return whether a path that a file names is a file; one that can be none (too long, a zero in it) is not."""
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


def safe_file_name(text: str) -> str:
    """Return a text from outside as a name of one file or folder: a serial number, an instrument, a patch.

    Letters, digits, blanks and . _ - + stay. Any other character becomes _, and so does a dot, hyphen or blank at the
    start. A text that had to be changed gets four bytes of its SHA-256 appended, so that two texts never become one
    name.

    Returns:
        A name of 1 to 64 characters that leads to no other folder.
    """
    name = "".join(char if (char.isalnum() and char <= "\uffff") or char in " ._-+" else "_" for char in text)
    if name[:1] in " .-":
        name = f"_{name[1:]}"
    if name == text and 0 < len(name) <= _LONGEST_NAME and not name.endswith(" "):
        return name
    digest = hashlib.sha256(text.encode("utf-8", "surrogatepass")).hexdigest()[:8]
    return f"{name[: _LONGEST_NAME - 9].rstrip()}-{digest}"


def safe_name(name: str, what: str) -> str:
    """Return a name that a user chose, where `safe_file_name` leaves it as it is.

    Raises:
        UsageError: If it is empty, long, or holds what would lead to another folder.
    """
    if safe_file_name(name) != name:
        raise UsageError(
            f"{what} {name[:80]!r}: use letters, digits, blanks and . _ - + (at most {_LONGEST_NAME}, no dot or hyphen"
            " first): it becomes part of a file's name"
        )
    return name
