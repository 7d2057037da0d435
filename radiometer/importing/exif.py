"""EXIF, TIFF tags and XMP of a file as statements by their names, and makers' models of lens and rows."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import tifffile
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

from radiometer.data.capture_header import AUTOMATIC
from radiometer.data.raw_files import RAW_SUFFIXES
from radiometer.data.statements import Statement, StatementMap, first_stated, places, text_stated
from radiometer.data.tiff_pixels import DAMAGE, directories

Header = Mapping[str, Statement]

EXIF_DIRECTORY: Final = 34665  # TIFF tag of the EXIF directory (EXIF 2.32, 4.6.3)
# Exif 2.32, sections 4.6.3 and 4.6.5, and DNG 1.7, chapter 4: names by code, for writers' libraries differ in them.
_NAMES: Final = {
    271: "Make", 272: "Model", 33434: "ExposureTime", 33437: "FNumber",
    34855: "PhotographicSensitivity", 34865: "StandardOutputSensitivity",
    34866: "RecommendedExposureIndex", 34867: "ISOSpeed", 36867: "DateTimeOriginal", 37377: "ShutterSpeedValue",
    37378: "ApertureValue", 37382: "SubjectDistance", 37384: "LightSource", 37386: "FocalLength",
    37521: "SubsecTimeOriginal",
    41985: "CustomRendered", 41987: "WhiteBalance", 41990: "SceneCaptureType", 41992: "Contrast", 41993: "Saturation",
    42033: "BodySerialNumber", 50713: "BlackLevelRepeatDim", 50714: "BlackLevel",
    50715: "BlackLevelDeltaH", 50716: "BlackLevelDeltaV",
}  # fmt: skip
_ALIASES: Final = {"ISOSpeedRatings": "PhotographicSensitivity"}
_RATIONALS: Final = (5, 10)  # TIFF types RATIONAL and SRATIONAL: pairs of numerator and denominator
_EXPOSURE: Final = places("ExposureTime:s")
# Exif 2.3, annex G: 65535 in the 16-bit tag means "more"; the speed is then in one of the others.
_ISO: Final = places(
    "PhotographicSensitivity:ISO RecommendedExposureIndex:ISO ISOSpeed:ISO StandardOutputSensitivity:ISO"
)
_F_NUMBER: Final = places("FNumber:1")
_DEVELOPMENT: Final = ("Contrast", "Saturation", "CustomRendered", "SceneCaptureType")  # what bends or mixes colours
_INFINITELY_M: Final = 1e6  # Exif 2.32, section 4.6.5: 2³² − 1 stands for infinity
_LARGEST_APEX: Final = 32.0  # 2³² s and 2⁻³² s: no shutter has them
_APEX_SAME_STOPS: Final = 0.5  # ShutterSpeedValue and ExposureTime may be of the dial's and of the real time


def statements_of_page(page: Any, *parents: Any) -> dict[str, Statement]:
    """Return by name and by "tag NUMBER" what a TIFF directory states, then what only those above it state."""
    found: dict[str, Statement] = {}
    for directory in (page, *parents):
        for tag in directory.tags:
            if tag.code == EXIF_DIRECTORY and isinstance(tag.value, Mapping):
                for name, value in tag.value.items():
                    found.setdefault(_ALIASES.get(str(name), str(name)), Statement(_of_exif(value)))
                continue
            statement = Statement(_single(numbers_of(tag)))
            own_name = _ALIASES.get(str(tag.name), str(tag.name))
            found.setdefault(_NAMES.get(int(tag.code), own_name), statement)
            found.setdefault(f"tag {tag.code}", statement)
    return found


def numbers_of(tag: Any) -> Any:
    """Return a tag's numbers as its type has them: a tuple, rationals divided; its text where it is text."""
    value = tag.value
    if isinstance(value, str | bytes | Mapping):
        return value
    flat = tuple(value) if isinstance(value, tuple | list) else (value,)
    if int(tag.dtype) in _RATIONALS:
        return tuple(_divided(*flat[n : n + 2]) for n in range(0, len(flat) - 1, 2))
    return flat


def _divided(numerator: float, denominator: float) -> float:
    return numerator / denominator if denominator else math.nan


def _single(value: Any) -> Any:
    """Return the one number of a tag; several as text, which is no number."""
    if isinstance(value, tuple):
        return value[0] if len(value) == 1 else " ".join(map(str, value))
    return value.decode("latin-1", "replace") if isinstance(value, bytes) else value


def _of_exif(value: Any) -> Any:
    """Return a value of the EXIF directory, of which tifffile keeps no type: pairs are rationals there."""
    if isinstance(value, tuple) and len(value) == 2 and all(isinstance(v, int) for v in value):
        return _divided(*value)
    return _single(value)


def exposure_of(header: Header, doubts: list[str], where: str) -> tuple[str, float] | None:
    """Return where the exposure in s stands, and the exposure; None where it is unknown.

    Without ExposureTime, ShutterSpeedValue is read, which is −log2 of the exposure in s (Exif 2.32, annex C: APEX).
    """
    found = first_stated("exposure", header, _EXPOSURE, StatementMap(), doubts, where)
    speed = first_stated("number", header, places("ShutterSpeedValue"), StatementMap(), [], where)
    if speed is None or abs(speed[1]) >= _LARGEST_APEX:
        return found
    by_speed = float(2.0 ** -speed[1])
    if found is None or found[1] == 0.0:
        return speed[0], by_speed
    if abs(math.log2(found[1] / by_speed)) > _APEX_SAME_STOPS:
        doubts.append(f"{found[0]} states {found[1]:.4g} s and {speed[0]} {by_speed:.4g} s: {found[0]} is used")
    return found


def iso_of(header: Header, doubts: list[str], where: str) -> tuple[str, float] | None:
    """Return where the ISO speed stands, and the speed; None, and doubts, where it is unknown."""
    reported = list[str]()
    found = first_stated("iso", header, _ISO, StatementMap(), reported, where)
    if found is None:
        doubts += reported
    return found


def f_number_of(header: Header, doubts: list[str], where: str) -> float | None:
    """Return the f-number; None where it is unknown."""
    found = first_stated("f_number", header, _F_NUMBER, StatementMap(), doubts, where)
    aperture = first_stated("number", header, places("ApertureValue"), StatementMap(), [], where)
    if found is None and aperture is not None and 0.0 < aperture[1] < _LARGEST_APEX:
        return float(2.0 ** (aperture[1] / 2.0))  # Exif 2.32, annex C: 2·log2 of the f-number
    return None if found is None else found[1]


def camera_of(header: Header, where: str) -> dict[str, str | float]:
    """Return what is stated of camera, lens and development, by the names that descriptions of both have.

    Numbers of the development are those of Exif 2.32, section 4.6.5.
    """
    found: dict[str, str | float] = {}
    for fact, tag in (("vendor", "Make"), ("model", "Model"), ("serial", "BodySerialNumber")):
        if (words := text_stated(fact, header, (tag,), StatementMap(), where)) is not None:
            found[fact] = words[1]
    numbers = {
        tag: stated[1]
        for tag in ("FocalLength", "SubjectDistance", "WhiteBalance", "LightSource", *_DEVELOPMENT)
        if (stated := first_stated("number", header, places(tag), StatementMap(), [], where)) is not None
    }
    if numbers.get("FocalLength", 0.0) > 0.0:
        found["focal_length_mm"] = numbers["FocalLength"]
    if 0.0 < numbers.get("SubjectDistance", 0.0) < _INFINITELY_M:
        found["focus_m"] = numbers["SubjectDistance"]
    if "WhiteBalance" in numbers:
        light = numbers.get("LightSource", 0.0)
        by_hand = "manual" + (f", light source {light:g}" if light else "")
        found["white_balance"] = AUTOMATIC if numbers["WhiteBalance"] == 0.0 else by_hand
    if settings := [f"{tag} {numbers[tag]:g}" for tag in _DEVELOPMENT if tag in numbers]:
        found["mode"] = ", ".join(settings)
    return found


def read_exif_header(path: Path) -> dict[str, Statement]:
    """Return the tags of a photograph: JPEG, PNG, TIFF or camera raw file; empty where it has none or is damaged.

    All directories of a TIFF and of raw files built on it count, for the mosaic may be in one and EXIF in another.
    Pillow finds EXIF in other files, and LibRaw in raw files that neither reads (CR3, RAF, ORF, RW2).
    """
    found = _of_tiff(path) or _of_pillow(path)
    if "ExposureTime" not in found and path.suffix.lower() in RAW_SUFFIXES:
        found = _of_libraw(path) | found
    return found


def _of_tiff(path: Path) -> dict[str, Statement]:
    try:
        with tifffile.TiffFile(path) as tiff:
            pages = [page for page, _ in directories(tiff)]
            return statements_of_page(*pages) if pages else {}
    except DAMAGE:
        return {}


def _of_pillow(path: Path) -> dict[str, Statement]:
    try:
        with Image.open(path) as image:
            exif = image.getexif()
            tags = {**exif, **exif.get_ifd(EXIF_DIRECTORY)}
    except (OSError, UnidentifiedImageError, SyntaxError, ValueError):
        return {}  # unreadable here means unreadable as a picture: reported when its pixels are read
    return {_NAMES.get(code, f"tag {code}"): Statement(_plain(value)) for code, value in tags.items()}


def _plain(value: Any) -> Any:
    """Return a value of Pillow's: its rationals as numbers, one of a tuple as itself."""
    single = _single(value) if isinstance(value, tuple) else value
    try:
        return float(single) if not isinstance(single, str | bytes) else single
    except (TypeError, ValueError, ZeroDivisionError):
        return None


def _of_libraw(path: Path) -> dict[str, Statement]:
    try:
        import rawpy
    except ImportError:
        return {}  # reported when its pixels are read
    try:
        with rawpy.imread(str(path)) as raw:
            other = getattr(raw, "other", None)  # from rawpy 0.26 on
    except (rawpy.LibRawError, OSError):
        return {}
    stated = {
        "ExposureTime": getattr(other, "shutter_speed", 0.0),
        "FNumber": getattr(other, "aperture", 0.0),
        "PhotographicSensitivity": getattr(other, "iso_speed", 0.0),
    }
    # LibRaw has 32-bit numbers and 0 for "unknown".
    return {name: Statement(float(f"{value:.7g}")) for name, value in stated.items() if value and value > 0}


_RDF = "{http://www.w3.org/1999/02/22-rdf-syntax-ns#}"


def read_xmp(packet: bytes) -> Mapping[str, tuple[str, ...]]:
    """Return the properties of an XMP packet: local name → values in order; empty where the packet is damaged.

    A property may be an attribute of its description, an element with text, or an element that holds a sequence.

    Source: ISO 16684-1:2019, section 7.
    """
    start, end = packet.find(b"<x:xmpmeta"), packet.rfind(b"</x:xmpmeta>")
    if start < 0 or end < 0:
        return {}
    try:
        root = ElementTree.fromstring(packet[start : end + len(b"</x:xmpmeta>")])
    except ElementTree.ParseError:
        return {}
    found: dict[str, tuple[str, ...]] = {}
    for description in root.iter(f"{_RDF}Description"):
        for name, value in description.attrib.items():
            if not name.startswith(_RDF):
                found[_local(name)] = (value.strip(),)
        for entry in description:
            items = tuple((item.text or "").strip() for item in entry.iter(f"{_RDF}li"))
            found[_local(entry.tag)] = items or ((entry.text or "").strip(),)
    return found


def numbers(properties: Mapping[str, tuple[str, ...]], name: str) -> tuple[float, ...]:
    """Return a property's numbers, whether they are in a sequence or between commas; () where there are none."""
    words = [word for value in properties.get(name, ()) for word in value.replace(",", " ").split()]
    try:
        return tuple(float(word) for word in words)
    except ValueError:
        return ()


def _local(name: str) -> str:
    return name.rpartition("}")[2]


@dataclass(frozen=True, slots=True)
class FallOff:
    """A maker's model of vignetting: relative illumination k = 1 + Σ k_i·r^i, r in pixels from the centre.

    Source: MicaSense, RedEdge camera radiometric calibration model: I_corrected = I/k, k = 1 + k_0·r + k_1·r² + …
    """

    centre_px: tuple[float, float]  # (x, y) of the centre in pixels
    coefficients: tuple[float, ...]  # k_1 … k_n in px^-i

    def relative_illumination(self, x_px: NDArray[np.float64], y_px: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the illumination relative to the centre at places in pixels."""
        radius = np.hypot(x_px - self.centre_px[0], y_px - self.centre_px[1])
        return np.asarray(np.polynomial.polynomial.polyval(radius, (1.0, *self.coefficients)), dtype=np.float64)

    def corners(self, shape: tuple[int, int]) -> tuple[float, ...]:
        """Return the relative illumination of the four corners of a frame of (height, width) pixels."""
        height, width = shape
        x = np.array([0.0, width - 1.0, 0.0, width - 1.0])
        y = np.array([0.0, 0.0, height - 1.0, height - 1.0])
        return tuple(float(v) for v in self.relative_illumination(x, y))


@dataclass(frozen=True, slots=True)
class RowExposure:
    """A maker's model of a row's extra exposure: signal ∝ exposure_s + a2·y − a3·exposure_s·y.

    Source: MicaSense, RedEdge camera radiometric calibration model:
    L = V·a1/g·(p − p_BL)/(t_e + a2·y − a3·t_e·y).
    """

    a2_s: float  # added exposure per row in s
    a3: float  # relative loss per row

    def gain_at(self, row: float, exposure_s: float) -> float:
        """Return the signal of a row relative to row 0."""
        return 1.0 + self.a2_s * row / exposure_s - self.a3 * row


def fall_off_of(properties: Mapping[str, tuple[str, ...]]) -> FallOff | None:
    """Return the radial vignetting model of an XMP packet; None where there is none."""
    centre, coefficients = numbers(properties, "VignettingCenter"), numbers(properties, "VignettingPolynomial")
    if len(centre) != 2 or not coefficients:
        return None
    return FallOff((centre[0], centre[1]), coefficients)


def row_exposure_of(properties: Mapping[str, tuple[str, ...]]) -> RowExposure | None:
    """Return the row model of an XMP packet; None where there is none."""
    stated = numbers(properties, "RadiometricCalibration")
    return RowExposure(stated[1], stated[2]) if len(stated) == 3 else None


def corners_of_plane(properties: Mapping[str, tuple[str, ...]]) -> tuple[float, ...]:
    """Return the relative illumination of the corners by a polynomial in x and y (Parrot Sequoia); () without one.

    The terms' powers are in pairs in `VignettingPolynomial2DName`; x and y run from 0 to 1 over the frame. Values
    are relative to the frame's middle.

    Source: Parrot, Sequoia application note "How to correct vignetting in images".
    """
    powers = numbers(properties, "VignettingPolynomial2DName")
    coefficients = np.array(numbers(properties, "VignettingPolynomial2D"))
    if not coefficients.size or len(powers) != 2 * coefficients.size:
        return ()
    pairs = np.array(powers).reshape(-1, 2)
    places = np.array([(0.5, 0.5), (0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)])
    terms = places[:, None, 0] ** pairs[None, :, 0] * places[:, None, 1] ** pairs[None, :, 1]
    values = terms @ coefficients
    return tuple(float(v) for v in values[1:] / values[0]) if values[0] > 0 else ()
