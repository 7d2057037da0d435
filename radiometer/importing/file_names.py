"""What a file is before it is read: its bytes, unpacked, and the facts that its name states of its frame."""

from __future__ import annotations

import gzip
import math
import re
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from radiometer.data.guards import MOST_FILE_BYTES
from radiometer.data.tiff_pixels import TIFF_MAGICS
from radiometer.errors import CaptureError
from radiometer.units import unit_of

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


_NUMBER: Final = r"(\d+(?:[.,p]\d+)?(?:e[-+]?\d+)?)"
# A name cannot hold the stroke of 1/125 s: cameras' programs write 1-125s.
_FRACTION: Final = re.compile(r"(?<![a-z\d.])1-(\d+)(s|sec|secs)(?![a-z\d])")
_UNITS: Final = "ns|us|µs|μs|usec|ms|msec|s|sec|secs|min"
_MINUTES_AND_SECONDS: Final = re.compile(rf"(?<![\da-z.]){_NUMBER}m{_NUMBER}s(?![a-z])")
_TIME: Final = re.compile(rf"(?<![\d.,+])(?<!\de-){_NUMBER}({_UNITS})(?![a-z\d])")
_BARE: Final = re.compile(rf"(?:expos|exposure|exptime|exp){_NUMBER}(?![\d.,]*[a-z])")
_KINDS: Final = {"bias": "dark", "zero": "dark", "dark": "dark", "flat": "light", "light": "light"}
DARK_FLAT: Final = re.compile(r"dark[ _-]*flat|flat[ _-]*dark")  # dark frames for flats; "bias-corrected flat" is none
_SAME_REL: Final = 0.02  # names round exposures to two digits


@dataclass(frozen=True, slots=True)
class NameClaims:
    """What a name claims."""

    exposure_s: float | None  # exposure in s; None where it names none
    exposure_has_unit: bool  # False where it is a bare number, to compare with a header in s
    kind: str  # "dark", "light", or ""
    doubt: str = ""  # why the exposure is in doubt, in words; "" where it is clear


def claims_of(file: Path) -> NameClaims:
    """Return what a file's name claims, such as 90 s and darkness in `dark_series_0c_1m30s.00000001.DARK.FIT`."""
    words = file.name.lower()
    found = [kind for word, kind in _KINDS.items() if word in words]
    kind = "dark" if DARK_FLAT.search(words) else found[0] if len(set(found)) == 1 else ""
    seconds, has_unit = _exposure(words)
    doubt = "" if has_unit or seconds is None else f"the file's name states {seconds:g} without a unit"
    others = {unit.to_base(_value(n)) for n, u in _TIME.findall(words) if (unit := unit_of(u, "exposure"))} - {seconds}
    if len(others) > 0 and has_unit and not _MINUTES_AND_SECONDS.search(words):
        doubt = f"the file's name states {seconds:g} s and {min(others):g} s"
    if (fraction := _FRACTION.search(words)) and int(fraction[1]) > 0:
        seconds, has_unit = 1.0 / int(fraction[1]), True
        doubt = f"the file's name states {fraction[0]}, which is 1/{fraction[1]} s or {fraction[1]} s of number 1"
    return NameClaims(seconds, has_unit, kind, doubt)


def _exposure(words: str) -> tuple[float | None, bool]:
    both = _MINUTES_AND_SECONDS.search(words)
    if both:
        return 60.0 * _value(both[1]) + _value(both[2]), True
    timed = _TIME.search(words)
    if timed:
        unit = unit_of(timed[2], "exposure")
        return None if unit is None else unit.to_base(_value(timed[1])), True
    bare = _BARE.search(words)
    return (_value(bare[1]), False) if bare else (None, False)


def _value(digits: str) -> float:
    return float(digits.replace("p", ".").replace(",", "."))


def contradictions(claims: NameClaims, exposure_s: float | None, *, is_dark: bool) -> list[str]:
    """Return what a name claims against what the header says, in words; empty where they agree.

    Args:
        exposure_s: Exposure in s of the header; None where it states none.
    """
    found = []
    claimed = claims.exposure_s
    if claimed is not None and exposure_s is not None:
        close = math.isclose(claimed, exposure_s, rel_tol=_SAME_REL, abs_tol=1e-9)
        if not close:
            unit = "s" if claims.exposure_has_unit else "(s?)"
            found.append(f"the name states {claimed:g} {unit}, the header {exposure_s:g} s: the header is used")
    if claims.kind and (claims.kind == "dark") != is_dark:
        stated = "dark" if is_dark else "light"
        found.append(f"the name states {claims.kind}, the header {stated}: the header is used")
    return found
