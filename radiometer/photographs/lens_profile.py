"""The fall-off of a photographic lens from lensfun's database, by what a photograph's EXIF record says of it."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Final

import numpy as np
from PIL import Image, UnidentifiedImageError

from radiometer.data import FlatField
from radiometer.data.reader_limits import bounded_reader
from radiometer.errors import CaptureError, InputError, required_library

# Exif 2.32, sections 4.6.4 and 4.6.5.
_EXIF_IFD, _MAKE, _MODEL = 0x8769, 271, 272
_F_NUMBER, _DISTANCE, _FOCAL_LENGTH, _LENS_MAKE, _LENS_MODEL = 33437, 37382, 37386, 42035, 42036
_SIDES, _PER_UNIT, _UNIT = (40962, 40963), 41486, 41488  # of the picture in pixels; pixels per unit of the sensor
_MM_OF_UNIT: Final = {2: 25.4, 3: 10.0, 4: 1.0, 5: 1e-3}
_CUT: Final = b'HasCrop="True"'  # XMP of Adobe's programs
_SAME_SHAPE_REL: Final = 0.01  # sides that are rounded to blocks of pixels
_WHOLE_REL: Final = 0.05  # resolutions of EXIF, and crop factors, are right to some per cent
_FULL_FRAME_MM: Final = 43.27  # diagonal of 36 × 24 mm, which crop factors count from
# The database's word for a far subject.
_FAR_M: Final = 1000.0
# Copies of a lens, real apertures, and the light that contributors measured by differ; a rectangle of some ±5 %.
LENSFUN_U_REL: Final = 0.03
_MOST_NAMED: Final = 8  # of the lenses that a name fits
_LEAST_SENSITIVITY: Final = 0.02


@dataclass(frozen=True, slots=True)
class LensRecord:
    """What a photograph says of camera and lens."""

    maker: str  # of the camera
    camera: str  # its model
    lens: str  # name of the lens; empty where not stated
    focal_length_mm: float  # focal length in mm
    f_number: float  # f-number
    distance_m: float | None = None  # distance of the subject in m; None where not stated
    diagonal_mm: float | None = None  # of the part of the sensor that the picture shows; None where not stated
    is_smaller: bool = False  # whether the file has fewer pixels than its record states: it was made smaller, or cut


@bounded_reader()
def read_lens_record(path: Path, lens: str | None = None) -> LensRecord:
    """Return what a photograph's EXIF record says of camera and lens.

    Args:
        lens: Name of the lens in place of the record's.

    Raises:
        CaptureError: If camera, lens, focal length or f-number are not stated, or the picture was cut.
    """
    try:
        with Image.open(path) as image:
            exif = image.getexif()
            tags: dict[int, Any] = {**exif, **exif.get_ifd(_EXIF_IFD)}
            sides, is_cut = image.size, _CUT in bytes(image.info.get("xmp", b""))
    except (OSError, UnidentifiedImageError, SyntaxError, ValueError) as error:
        raise CaptureError(f"{path}: has no readable EXIF record, which lensfun's fall-off needs: {error}") from error
    words = {tag: str(tags.get(tag, "")).strip("\0 ") for tag in (_MAKE, _MODEL, _LENS_MODEL)}
    numbers = {tag: _number(tags.get(tag)) for tag in (_FOCAL_LENGTH, _F_NUMBER, _DISTANCE)}
    missing = [
        what
        for what, known in (
            ("the camera's model", words[_MODEL]),
            ("the lens (name it with --lens)", lens or words[_LENS_MODEL]),
            ("the focal length", numbers[_FOCAL_LENGTH]),
            ("the f-number", numbers[_F_NUMBER]),
        )
        if not known
    ]
    if missing:
        raise CaptureError(f"{path}: its EXIF record does not state {', '.join(missing)}; lensfun's fall-off needs it")
    stated = [_number(tags.get(tag)) for tag in _SIDES]
    known = [one for one in stated if one]
    whole = known if len(known) == len(_SIDES) else [float(one) for one in sides]
    if is_cut or abs(max(sides) / min(sides) * min(whole) / max(whole) - 1.0) > _SAME_SHAPE_REL:
        raise CaptureError(
            f"{path}: its record states that the picture was cut, and lensfun's fall-off is that of the whole picture; "
            "use the whole one, or a flat field"
        )
    per_mm = (_number(tags.get(_PER_UNIT)) or 0.0) / _MM_OF_UNIT.get(int(_number(tags.get(_UNIT)) or 2), 25.4)
    return LensRecord(
        words[_MAKE],
        words[_MODEL],
        lens or words[_LENS_MODEL],
        numbers[_FOCAL_LENGTH] or 0.0,
        numbers[_F_NUMBER] or 0.0,
        numbers[_DISTANCE],
        math.hypot(*whole) / per_mm if per_mm else None,
        is_smaller=max(sides) < (1.0 - _SAME_SHAPE_REL) * max(whole),
    )


def lensfun_flat_field(record: LensRecord, shape: tuple[int, int]) -> tuple[FlatField, str]:
    """Return the fall-off of a lens as a flat field, and in a sentence what it was taken from.

    Args:
        shape: (height, width) of the frames: the whole picture of the camera, at any scale.

    Raises:
        InputError: If the database knows no such camera or lens, several of that name, or no fall-off of it.
        MissingLibrary: If lensfunpy is not installed.

    Source: lensfun's model "pa", relative illumination 1 + k₁r² + k₂r⁴ + k₃r⁶, r = 1 in the corner of the sensor
    that it was measured with.
    """
    base = _database()
    cameras = base.find_cameras(record.maker or None, record.camera, False)
    if not cameras:
        raise InputError(
            f"lensfun's database has no camera {record.maker} {record.camera}; use a flat field of your own"
        )
    lenses = base.find_lenses(cameras[0], None, record.lens, False)
    if not lenses:
        raise InputError(
            f"lensfun's database has no lens {record.lens!r} for the {record.camera}; name it with --lens as the "
            "database does, or use a flat field of your own"
        )
    whole_mm = _FULL_FRAME_MM / cameras[0].crop_factor
    if record.diagonal_mm is not None and record.diagonal_mm < (1.0 - _WHOLE_REL) * whole_mm:
        raise InputError(
            f"the photograph shows {record.diagonal_mm:.3g} mm of the sensor's diagonal of {whole_mm:.3g} mm: it was "
            "cut in the camera, and lensfun's fall-off is that of the whole picture; use a flat field of your own"
        )
    same = _of_one_name(lenses, record.lens)
    settings = record.focal_length_mm, record.f_number, record.distance_m or _FAR_M
    known = [(one, found) for one in same if (found := one.interpolate_vignetting(*settings)) is not None]
    lens, found = known[0] if known else (same[0], None)
    if found is None:
        raise InputError(
            f"lensfun's database knows no fall-off of the {lens.model} at {record.focal_length_mm:g} mm, "
            f"f/{record.f_number:g}; use a flat field of your own"
        )
    height, width = shape
    flat = FlatField(
        principal_point_px=((width - 1) / 2.0, (height - 1) / 2.0),
        radius_px=0.5 * math.hypot(height, width) * cameras[0].crop_factor / lens.crop_factor,
        coefficients=(float(found.terms[0]), float(found.terms[1]), float(found.terms[2])),
        u_rel=LENSFUN_U_REL,
        shape=shape,
        f_number=record.f_number,
    )
    corner = float(flat.at(np.zeros(1), np.zeros(1))[0])
    if not _LEAST_SENSITIVITY < corner < 1.5:
        raise InputError(f"lensfun's fall-off of the {lens.model} is {corner:.2g} in the corners, which no lens has")
    far = f"{record.distance_m:g} m" if record.distance_m else "a far subject (the distance is not stated)"
    is_named = _plain(lens.model, lens.maker) == _plain(record.lens, lens.maker)
    which = lens.model if is_named else f"{lens.model} (the only lens known that {record.lens!r} fits)"
    smaller = " (it has fewer pixels than its record states: made smaller and not cut)" if record.is_smaller else ""
    return flat, (
        f"fall-off by lensfun: {which} at {record.focal_length_mm:g} mm, f/{record.f_number:g}, {far}: "
        f"{100 * corner:.0f} % in the corners, known to {100 * LENSFUN_U_REL:g} %, of the whole picture of the "
        f"camera{smaller}"
    )


@cache
def _database() -> Any:
    lensfunpy = required_library(
        "lensfunpy",
        "the fall-off of lenses by lensfun needs lensfunpy; install it with `pip install 'radiometer[lens]'`, or "
        "give a calibration with a flat field",
    )
    return lensfunpy.Database()


def _of_one_name(lenses: Sequence[Any], name: str) -> list[Any]:
    """Return the entries of the one lens that a name fits; a lens may be there several times, on sensors of all sizes.

    Raises:
        InputError: If the name is that of none and a part of several.
    """
    same = [one for one in lenses if _plain(one.model, one.maker) == _plain(name, one.maker)] or list(lenses)
    models = list({_plain(one.model): one.model for one in same}.values())
    if len(models) > 1:
        named = ", ".join(models[:_MOST_NAMED]) + (", …" if len(models) > _MOST_NAMED else "")
        raise InputError(f"lensfun's database has several lenses for the name {name!r}: {named}; name one with --lens")
    return same


def _plain(name: str, maker: str = "") -> str:
    """Return a lens's name without its maker and what makers and databases write in different ways."""
    return re.sub(r"[\s/|]", "", name.lower().removeprefix(maker.lower()))


def _number(value: object) -> float | None:
    try:
        number = float(value)  # type: ignore[arg-type]  # EXIF rationals convert; anything else is refused here
    except (TypeError, ValueError, ZeroDivisionError):
        return None
    return number if math.isfinite(number) and number > 0 else None
