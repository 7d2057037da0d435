"""FITS files: header to settings, data units to frames (one per plane of a cube), amplifiers to taps.

Sections are `[x1:x2,y1:y2]`, counted from 1, both ends included. A range that falls is read from its higher end.
Keywords are those of NOAO and IRAF (CCDPROC, MSCRED) and their spellings in use: DATASEC or TRIMSEC and BIASSEC, with a
number or letter where one picture holds several amplifiers; DETSEC places a unit's pixels on the detector.
"""

from __future__ import annotations

import io
import math
import re
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from radiometer.data.capture_header import TapDescription, as_binning
from radiometer.data.frame import FrameSettings
from radiometer.data.guards import refuse_size
from radiometer.data.mosaic import shifted
from radiometer.data.reader_limits import bounded_reader
from radiometer.data.statements import (
    Place,
    Statement,
    StatementMap,
    first_stated,
    gain_unit_of_maker,
    is_unknown,
    places,
    text_stated,
    value_of,
)
from radiometer.errors import CaptureError, DamagedFileError, MissingLibrary
from radiometer.importing.file_names import DARK_FLAT, claims_of, contradictions, read_bytes
from radiometer.importing.found import FoundFrame
from radiometer.moments import moment_of
from radiometer.units import BASE_ISO, gain_factor, read_number, unit_in_words

_SECTION: Final = re.compile(r"\[?\s*(\d+)\s*:\s*(\d+)\s*,\s*(\d+)\s*:\s*(\d+)\s*\]?")
# The trimmed section comes first: a data section may hold columns at the edge that are to be cut.
_DATA: Final = ("TRIMSEC", "TSEC", "DATASEC", "DSEC")
_OVERSCAN: Final = ("BIASSEC", "BSEC")
_OF_DETECTOR: Final = ("DETSEC", "CCDSEC")
_SUFFIX: Final = re.compile(r"(?:TRIMSEC|TSEC|DATASEC|DSEC)_?(\d{1,2}|[A-P])")


class Section(NamedTuple):
    """A rectangle of pixels, counted from 0, and whether its ranges fall."""

    x: int
    y: int
    width: int
    height: int
    x_falls: bool
    y_falls: bool

    @classmethod
    def of(cls, header: Mapping[str, Statement], keys: Sequence[str]) -> Section | None:
        """Return the first of several keywords that holds a section; None where none does."""
        for key in keys:
            found = _SECTION.fullmatch(str(header[key].written).strip()) if key in header else None
            if found is not None and all(int(end) > 0 for end in found.groups()):
                x1, x2, y1, y2 = (int(end) for end in found.groups())
                return cls(min(x1, x2) - 1, min(y1, y2) - 1, abs(x2 - x1) + 1, abs(y2 - y1) + 1, x2 < x1, y2 < y1)
        return None

    def fits(self, shape: tuple[int, int]) -> bool:
        """Return whether it is wholly within a picture of (height, width)."""
        return self.x + self.width <= shape[1] and self.y + self.height <= shape[0]

    def turned(self, on: Section, shape: tuple[int, ...]) -> Section:
        """Return it in a picture of (height, width) that is turned where the ranges of its place fall."""
        x = shape[1] - self.x - self.width if on.x_falls else self.x
        y = shape[0] - self.y - self.height if on.y_falls else self.y
        return self._replace(x=x, y=y)

    def moved(self, x: int, y: int) -> Section:
        """Return it in a larger picture, whose part at (x, y) it counts in."""
        return self._replace(x=self.x + x, y=self.y + y)


def taps_of(header: Mapping[str, Statement], shape: tuple[int, int], doubts: list[str]) -> tuple[TapDescription, ...]:
    """Return the taps that the header of one picture of (height, width) states; empty where it states none."""
    suffixes = sorted({found[1] for key in header if (found := _SUFFIX.fullmatch(key))})
    taps = []
    for suffix in suffixes or [""]:
        data = Section.of(header, [f"{key}{_}{suffix}" for key in _DATA for _ in ("", "_")])
        if data is None:
            continue
        if not data.fits(shape):
            doubts.append(f"the data section{' ' + suffix if suffix else ''} reaches beyond the picture: not used")
            continue
        overscan = Section.of(header, [f"{key}{_}{suffix}" for key in _OVERSCAN for _ in ("", "_")])
        taps.append(_tap(suffix or "1", data, overscan if overscan and overscan.fits(shape) else None, None))
    whole = len(taps) == 1 and (taps[0].width, taps[0].height) == shape[::-1]
    return () if whole else tuple(taps)


def _tap(name: str, data: Section, overscan: Section | None, corner: str | None) -> TapDescription:
    return TapDescription(
        name=name, x=data.x, y=data.y, width=data.width, height=data.height,
        overscan=(tuple(overscan[:4]),) if overscan else (), first_pixel=corner,
    )  # fmt: skip


class Mosaic(NamedTuple):
    """One frame whose amplifiers are separate units of a file, laid next to each other as the detector has them.

    A unit that is read from the other end is turned, so that the frame is a picture but for the overscan in it.
    """

    places: tuple[tuple[int, int], ...]  # (row, column) of each unit, in the order of the file
    turned: tuple[tuple[bool, bool], ...]  # whether its rows and its columns are turned
    unit_shape: tuple[int, int]
    taps: tuple[TapDescription, ...]

    @classmethod
    def of(cls, headers: Sequence[Mapping[str, Statement]], shapes: Sequence[tuple[int, ...]]) -> Mosaic | None:
        """Return how units make one frame: two or more of one size, each at another place of the detector."""
        sections = [Section.of(header, _OF_DETECTOR) for header in headers]
        if len(shapes) < 2 or len(set(shapes)) > 1 or len(shapes[0]) != 2 or None in sections:
            return None
        known = [section for section in sections if section is not None]
        columns, rows = sorted({section.x for section in known}), sorted({section.y for section in known})
        places = tuple((rows.index(section.y), columns.index(section.x)) for section in known)
        if len(set(places)) < len(places) or len(places) != len(rows) * len(columns):
            return None
        height, width = shapes[0]
        taps = []
        for number, (header, (row, column), on) in enumerate(zip(headers, places, known, strict=True), 1):
            data = Section.of(header, _DATA) or Section(0, 0, width, height, False, False)
            overscan = Section.of(header, _OVERSCAN)
            if not data.fits((height, width)):
                return None
            if overscan is not None:
                overscan = overscan.turned(on, shapes[0]).moved(column * width, row * height)
            corner = f"{'lower' if on.y_falls else 'upper'} {'right' if on.x_falls else 'left'}"
            name = str(header["EXTNAME"].written).strip() if "EXTNAME" in header else str(number)
            data = data.turned(on, shapes[0]).moved(column * width, row * height)
            taps.append(_tap(name, data, overscan, corner))
        return cls(places, tuple((on.y_falls, on.x_falls) for on in known), (height, width), tuple(taps))

    @property
    def shape(self) -> tuple[int, int]:
        """Return (height, width) of the frame."""
        rows, columns = (1 + max(place[axis] for place in self.places) for axis in (0, 1))
        return rows * self.unit_shape[0], columns * self.unit_shape[1]

    def laid(self, pictures: Sequence[NDArray[Any]], path: Path) -> NDArray[Any]:
        """Return the frame from the units' pictures. Raises CaptureError if one has another type of numbers."""
        if len({picture.dtype for picture in pictures}) > 1:
            raise CaptureError(f"{path}: its amplifiers are stored in different types of numbers")
        height, width = self.unit_shape
        frame = np.zeros(self.shape, dtype=pictures[0].dtype)
        for (row, column), (rows, columns), picture in zip(self.places, self.turned, pictures, strict=True):
            part = picture[:: -1 if rows else 1, :: -1 if columns else 1]
            frame[row * height : (row + 1) * height, column * width : (column + 1) * width] = part
        return frame


Header = Mapping[str, Statement]
# Places in the order in which they are believed, each with the unit that its definition gives: XPOSURE and TELAPSE by
# the FITS standard 4.0, table 34; EXPTIME and EXPOSURE by HEASARC's keyword dictionary; EXPOINUS by ZWO's ASICap. The
# others are in use without a definition: their unit must be stated.
_EXPOSURE: Final = places("XPOSURE:s EXPTIME:s EXPOSURE:s EXPOINUS:us EXP_TIME ITIME INTTIME EXPTIME1 TEXP EXPOSED")
_TEMPERATURE: Final = (
    "CCD-TEMP", "CCDTEMP", "DET-TEMP", "DETTEMP", "SENSTEMP", "TEMPERAT", "CHIPTEMP", "CAMTEMP", "TEMP",
)  # fmt: skip
_SET_TEMPERATURE: Final = ("SET-TEMP", "SETTEMP", "CCD-TSET")
_TIME: Final = ("DATE-OBS", "DATE-BEG", "DATE_OBS", "DATE")
_CAMERA_NAME: Final = ("INSTRUME", "CAMERA", "DETECTOR", "DETNAM")
_ELECTRONS_PER_DN: Final = places("EGAIN:e-/DN E-GAIN:e-/DN EPERADU:e-/DN GAINEL:e-/DN CCDGAIN:e-/DN")
_SATURATED_FROM: Final = ("SATURATE", "SATLEVEL")
_READ_NOISE: Final = places("RDNOISE:e- READNOIS:e- RON:e- READNOISE:e-")
# One wheel or several: light passes all of them.
_FILTERS: Final = re.compile(r"FILT(?:ER|NAM|NAME|ID)?S?[0-9]{0,2}|INSFILTE|(?:ESO INS )?FILT[0-9]? NAME")
_BINNING: Final = (
    ("XBINNING", "YBINNING"), ("CCDXBIN", "CCDYBIN"), ("BINX", "BINY"), ("HBIN", "VBIN"), ("BINNING",), ("CCDSUM",),
    ("CCDBIN1", "CCDBIN2"), ("XBIN", "YBIN"), ("BIN",), ("BINMODE",), ("ESO DET WIN1 BINX", "ESO DET WIN1 BINY"),
)  # fmt: skip
# A sensor's comment says nothing of these.
_ELSEWHERE: Final = re.compile(r"ambient|outside|outdoor|air|dome|mirror|focus|weather|room|tube", re.IGNORECASE)
_F_NUMBER: Final = places("FNUMBER:1 FRATIO:1")
# Settings that change gain or offset by a maker's steps: frames that differ in one are separate sets.
_MODE: Final = (
    "OFFSET", "BLKLEVEL", "READOUTM", "READMODE", "EMGAIN", "EMREALGN", "CONVGAIN", "LOWNOISE", "FULLWELL", "PREAMP",
)  # fmt: skip
# Extensions that hold no frames: errors, flags, weights (NASA and ESO use these names).
_NO_FRAMES: Final = ("ERR", "ERROR", "DQ", "MASK", "VAR", "VARIANCE", "UNCERT", "WHT", "WEIGHT", "BPM")
_KIND: Final = ("IMAGETYP", "IMAGETYPE", "OBSTYPE", "FRAME", "FRAMETYP", "EXPTYPE", "PICTTYPE", "OBJECT")
# OBJECT names the target: it states a kind of frame where it holds nothing else, such as "dark", "BIAS 12", "dark 10s".
_KIND_ALONE: Final = re.compile(
    r"(master|super)?[ _-]*(bias|dark|zero|offset|light|flat|object|science|lamp|dome|sky)s?"
    r"([ _-]*(flat|frame|field|image|exposure))?s?[ _-]*[\d.]*\s*(s|sec|ms)?"
)
_DARK_WORDS: Final = ("bias", "dark", "zero", "offset")
_SHUTTER: Final = ("SHUTTER", "SHUTSTAT", "SHSTAT")
_LIGHT_WORDS: Final = ("light", "flat", "object", "science", "lamp", "dome", "sky", "tricolor", "target")
_PROCESSED_WORDS: Final = (
    "dark subtract", "darksub", "bias subtract", "bias-subtract", "flat field", "flatfield", "flat-field",
    "calibrat", "combine", "averag", "median", "stack", "reduc", "resampl", "overscan correct", "zerocor", "darkcor",
)  # fmt: skip
_KELVINS: Final = (150.0, 400.0)  # without a unit, a number between them can only be kelvins
_SETTLED_K: Final = 1.0  # coolers hold a tenth of a kelvin once they have settled
# Counts of frames in a sum or mean: NOAO's, ESO's and Keck's keywords, Seestar's and Siril's, MaxIm's.
_COMBINED: Final = (
    "NCOMBINE", "SNAPSHOT", "STACKCNT", "NSUBEXP", "NCOADD", "NCOADDS", "COADDS", "NCOADDED", "NEXP", "NDIT",
    "ESO DET NDIT", "NSUMEXP", "NUMFRAME", "NFRAMES", "NSTACK", "NIMAGES", "NUMCOMB",
)  # fmt: skip
# Units of data that are numbers of the converter (FITS standard 4.0, table 4; the rest are spellings in use).
_DATA_UNITS: Final = ("", "adu", "dn", "count", "counts", "ct", "pixel value")
_COLOURS: Final = ("CTYPE3", "COLORSPC", "COLORTYP", "COLORTYPE", "COLORSPACE")
_MOSAIC: Final = ("BAYERPAT", "CFAPAT", "CFA")
_MOSAIC_OFFSETS: Final = ("XBAYROFF", "YBAYROFF")
_CELLS: Final = ("RGGB", "GRBG", "GBRG", "BGGR")
_ROW_ORDER, _FROM_TOP = "ROWORDER", "TOP-DOWN"
_OR: Final = " or "  # between the values of a keyword that stands several times
_EXPOSURES_SAME_REL: Final = 0.01  # by which two keywords of the exposure may differ unnoticed


@bounded_reader()
def read_fits_headers(path: Path, mapped: StatementMap = StatementMap()) -> list[FoundFrame]:
    """Return the frames of a FITS file, gzipped or not, without keeping their pixels.

    A picture whose header states an exposure is a frame; of pictures without, the first is. All other units
    of the file are reported as not used.

    Args:
        mapped: Where the user states that facts stand.

    Raises:
        CaptureError: If the file is damaged or truncated, or holds no picture.
        UnsettledError: If a number has no unit that is known.
        MissingLibrary: If astropy is not installed.
    """
    with _opened(path) as units:
        pictures = _pictures(units, path)
        if (mosaic := _mosaic(pictures)) is not None:
            return [_of_mosaic(path, units, pictures, mosaic, mapped)]
        used = [unit for unit in pictures if _is_frame(unit, mapped)] if len(pictures) > 1 else []
        used = used if len(used) > 1 else pictures[:1]
        not_used = tuple(
            f"unit {n} ({_described(unit)})" for n, unit in enumerate(units) if unit not in used and not _is_empty(unit)
        )
        total = sum(_planes(unit) for unit in pictures)
        frames, first = list[FoundFrame](), 0
        for unit in pictures:
            if unit in used:
                above = _cards(units[0].header) if unit is not units[0] else {}
                header = {**above, **_cards(unit.header)}
                history = _history(units[0].header) + (_history(unit.header) if unit is not units[0] else "")
                numbers = range(first, first + _planes(unit))
                shape = tuple(int(n) for n in unit.shape)
                found = _frames(path, header, history, shape, _stored(unit.header), numbers, total, mapped)
                doubts = _exposures_above(path, found[0], above)
                frames += [replace(frame, doubts=(*frame.doubts, *doubts)) for frame in found]
            first += _planes(unit)
    return [replace(frame, not_used=not_used) for frame in frames]


@bounded_reader()
def read_fits_pixels(path: Path, part: int) -> NDArray[Any]:
    """Return the values of one plane of a FITS file, BSCALE and BZERO applied.

    Sixteen-bit integers with BZERO 32768 come as uint16, whole numbers stay whole.

    Raises:
        CaptureError: If the file is damaged or truncated.
    """
    with _opened(path) as units:
        pictures = _pictures(units, path)
        if (mosaic := _mosaic(pictures)) is not None:
            refuse_size(path, mosaic.shape, 4)
            return mosaic.laid([_plane(path, units, unit, 0) for unit in pictures], path)
        for unit in pictures:
            if part < _planes(unit):
                break
            part -= _planes(unit)
        return _plane(path, units, unit, part)


def _plane(path: Path, units: Any, unit: Any, part: int) -> NDArray[Any]:
    refuse_size(path, unit.shape, max(1, abs(int(unit.header.get("BITPIX", 8))) // 8))
    is_packed = type(unit).__name__ == "CompImageHDU"
    values = _unpacked_picture(path, units.index(unit)) if is_packed else np.asarray(unit.data)
    plane = values.reshape(-1, *values.shape[-2:])[part]
    return _unsigned(plane.astype(plane.dtype.newbyteorder("="), copy=False))


def _mosaic(pictures: Sequence[Any]) -> Mosaic | None:
    """Return how the pictures of a file make one frame; None where each is a frame or none by itself."""
    return Mosaic.of([_cards(unit.header) for unit in pictures], [_shape(unit) for unit in pictures])


def _of_mosaic(path: Path, units: Any, pictures: Sequence[Any], mosaic: Mosaic, mapped: StatementMap) -> FoundFrame:
    """Return the frame that units of amplifiers make; what they do not state alike is true of no whole frame."""
    cards = [_cards(unit.header) for unit in pictures]
    alike = {key: one for key, one in cards[0].items() if all(key in o and o[key] == one for o in cards)}
    header = {**_cards(units[0].header), **alike}
    frame = _frames(path, header, _history(units[0].header), mosaic.shape, _stored(pictures[0].header), range(1), 1,
                    mapped)[0]  # fmt: skip
    not_used = tuple(
        f"unit {n} ({_described(unit)})" for n, unit in enumerate(units) if unit not in pictures and not _is_empty(unit)
    )
    differing = sorted({*cards[0]} & {place.name for place in (*_ELECTRONS_PER_DN, *_READ_NOISE)} - {*alike})
    doubt = (f"its amplifiers state {', '.join(differing)} each: not used for the whole frame",) if differing else ()
    return replace(
        frame, camera={**frame.camera, "taps": mosaic.taps}, taken={**frame.taken, "taps": "sections of the detector"},
        doubts=(*frame.doubts, *doubt), not_used=not_used,
    )  # fmt: skip


@bounded_reader(apart="astropy")
def _unpacked_picture(path: Path, number: int) -> NDArray[Any]:
    """Return the values of a tiled compressed picture (FITS standard 4.0, chapter 10), the unit of a number."""
    with _opened(path) as units:
        return np.asarray(units[number].data)


def _pictures(units: Any, path: Path) -> list[Any]:
    found = [unit for unit in units if unit.is_image and len(shape := _shape(unit)) in (2, 3) and min(shape) > 0]
    if not found:
        raise CaptureError(f"{path}: the FITS file holds no picture of two or three dimensions")
    return found


def _shape(unit: Any) -> tuple[int, ...]:
    return tuple(getattr(unit, "shape", ()) or ())


def _planes(unit: Any) -> int:
    shape = _shape(unit)
    return 1 if len(shape) == 2 else int(shape[0])


def _is_frame(unit: Any, mapped: StatementMap) -> bool:
    """Return whether a unit states an exposure itself and is no map of errors or flags."""
    names = {*(place.name for place in _EXPOSURE), *(place.name for place in mapped.places.get("exposure", ()))}
    return any(name in unit.header for name in names) and str(unit.name).upper() not in _NO_FRAMES


def _is_empty(unit: Any) -> bool:
    return unit.is_image and not _shape(unit)


def _described(unit: Any) -> str:
    kind = "picture" if unit.is_image else "table"
    return f"{unit.name}, {kind}" if unit.name else kind


def _unsigned(plane: NDArray[Any]) -> NDArray[Any]:
    """Return small non-negative signed integers without their sign."""
    if plane.dtype == np.int16 and int(plane.min(initial=0)) >= 0:
        return plane.astype(np.uint16)
    return plane


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    try:
        from astropy.io import fits
        from astropy.utils.exceptions import AstropyWarning
    except ImportError as error:
        raise MissingLibrary(f"{path}: FITS needs astropy; install it with `pip install 'radiometer[fits]'`") from error
    content = read_bytes(path)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            # What astropy only warns of (a file shorter than its header says) is an error here.
            warnings.filterwarnings("error", message=".*truncated.*", category=AstropyWarning)
            with fits.open(io.BytesIO(content), memmap=False) as units:
                yield units
    except CaptureError:
        raise
    # The library raises nearly any built-in error on a damaged header or data unit.
    except (OSError, ValueError, TypeError, KeyError, IndexError, AttributeError, EOFError, AstropyWarning) as error:
        raise DamagedFileError(f"{path}: not a readable FITS file (damaged or truncated): {_first(error)}") from error
    except fits.VerifyError as error:
        raise DamagedFileError(f"{path}: its FITS header is damaged: {_first(error)}") from error


def _first(error: Exception) -> str:
    return (str(error).strip().splitlines() or [type(error).__name__])[0]


def _cards(header: Any) -> dict[str, Statement]:
    time_unit = str(header.get("TIMEUNIT", "")).strip()
    exposures = {place.name for place in _EXPOSURE}
    return {
        key: Statement(_of_all(header, key), time_unit if key in exposures else "", str(header.comments[key]))
        for key in header
        if key not in ("", "HISTORY", "COMMENT")
    }


def _of_all(header: Any, key: str) -> Any:
    """Return the value of a keyword; all of them in words where it stands several times with different ones.

    The FITS standard 4.0, section 4.4.1, leaves the value of such a keyword indeterminate.
    """
    if header.count(key) == 1:
        return header[key]
    values = list(dict.fromkeys(repr(header[key, n]) for n in range(header.count(key))))
    return header[key] if len(values) == 1 else _OR.join(f"'{value}'" for value in values)


def _history(header: Any) -> str:
    return " ".join(str(line) for line in header["HISTORY"]) if "HISTORY" in header else ""


def _stored(header: Any) -> str:
    bits = int(header.get("BITPIX", 16))
    if bits < 0:
        return f"float{-bits}"
    scaled = float(header.get("BSCALE", 1.0)) != 1.0
    unsigned = float(header.get("BZERO", 0.0)) == 2.0 ** (bits - 1) or bits == 8
    return "float32" if scaled else f"{'u' if unsigned else ''}int{bits}"


def _frames(
    path: Path, header: Header, history: str, shape: tuple[int, ...], stored: str, parts: range, total: int,
    mapped: StatementMap,
) -> list[FoundFrame]:  # fmt: skip
    taken, doubts = dict[str, str](), list[str]()
    exposure_s = _exposure(path, header, mapped, taken, doubts)
    is_dark = _is_dark(path, header, exposure_s, mapped, taken, doubts)
    if exposure_s is None and is_dark and _is_bias(header):
        exposure_s, taken["exposure_s"] = 0.0, f"{taken['shutter']} (a bias frame has no exposure)"
    doubts += contradictions(claims_of(path), exposure_s, is_dark=is_dark)
    doubts += _processing(header, history)
    mosaic, doubtful = _colours(path, header, shape)
    doubts += doubtful
    gain_db, mode = _gain(path, header, mapped, taken, doubts)
    filters = _filters(header, mapped, str(path))
    camera = _camera(path, header, mapped, taken, doubts) | ({"mode": mode} if mode else {})
    if "conversion_gain_e_per_dn" in camera:  # of the frame as it is; that of a camera is at 0 dB
        camera["conversion_gain_e_per_dn"] *= gain_factor(gain_db)
    if filters:
        camera["filter"] = filters[1]
    if mosaic is not None:
        camera["mosaic"] = mosaic
    if taps := taps_of(header, (shape[-2], shape[-1]), doubts):
        camera, taken["taps"] = camera | {"taps": taps}, "data sections"
    settings = FrameSettings(
        exposure_s=exposure_s or 0.0,
        gain_db=gain_db,
        f_number=_fact("f_number", "f_number", path, header, _F_NUMBER, mapped, taken, doubts),
        black_level_dn=_fact("black_level", "black_level_dn", path, header, (), mapped, taken, doubts),
        temperature_c=_temperature(path, header, mapped, taken, doubts),
        timestamp_s=_timestamp(header, mapped, taken),
        pattern=filters[1] if filters else "default",
        shutter="closed" if is_dark else "open",
    )
    extra = {"imagetyp": str(header["IMAGETYP"].written).strip()} if "IMAGETYP" in header else {}
    if exposure_s is None:
        doubts.append(_no_exposure(header))
    return [
        FoundFrame(
            path, (shape[-2], shape[-1]), stored, settings, part, total, exposure_s is not None, camera,
            taken=taken, doubts=tuple(doubts), extra=extra,
        )
        for part in parts
    ]  # fmt: skip


def _fact(
    fact: str, key: str, path: Path, header: Header, where: tuple[Place, ...], mapped: StatementMap,
    taken: dict[str, str], doubts: list[str],
) -> float | None:  # fmt: skip
    found = first_stated(fact, header, where, mapped, doubts, str(path))
    if found is None:
        return None
    taken[key] = found[0]
    return found[1]


def _exposure(
    path: Path, header: Header, mapped: StatementMap, taken: dict[str, str], doubts: list[str]
) -> float | None:
    seconds = _fact("exposure", "exposure_s", path, header, _EXPOSURE, mapped, taken, doubts)
    if seconds is None or "(--map)" in taken["exposure_s"]:
        return seconds
    key = taken["exposure_s"]
    # LIVETIME is the sum over the frames of a stack in Siril's files: compared, and not a source.
    others = (
        {"LIVETIME": "s"}
        | {place.name: place.unit for place in _EXPOSURE if place.unit}
        | {name: "" for name, card in header.items() if _is_exposure_in_words(card)}
    )
    for other, unit in others.items():
        if other != key and other in header:
            value = value_of(header[other], "exposure", other, [], defined=unit, where=str(path))
            if value is not None and not math.isclose(value, seconds, rel_tol=_EXPOSURES_SAME_REL, abs_tol=1e-6):
                doubts.append(f"{key} states {seconds:g} s and {other} {value:g} s: {key} is used")
    return seconds


def _is_exposure_in_words(card: Statement) -> bool:
    """Return whether a card is an exposure by its comment, which states the unit as well."""
    words = card.comment.lower()
    named = "exposure" in words or "integration" in words
    return named and isinstance(card.written, int | float) and unit_in_words(card.comment, "exposure")[0] is not None


def _exposures_above(path: Path, frame: FoundFrame, above: Header) -> list[str]:
    """Return what the primary header states of the exposure against that of the picture's own unit."""
    key = frame.taken.get("exposure_s", "")
    place = next((place for place in _EXPOSURE if place.name == key), None)
    if place is None or key not in above:
        return []
    value = value_of(above[key], "exposure", key, [], defined=place.unit, where=str(path))
    own = frame.settings.exposure_s
    if value is None or math.isclose(value, own, rel_tol=_EXPOSURES_SAME_REL, abs_tol=1e-6):
        return []
    return [f"the primary header states {key} {value:g} s, the picture's own {own:g} s: the latter is used"]


def _no_exposure(header: Header) -> str:
    """Return what to say of a header without a known keyword of the exposure: the keywords that may be it."""
    likely = [key for key in header if any(sign in key for sign in ("EXP", "INTEG", "SHUT", "ITIME", "DURAT"))]
    offered = f" (perhaps {', '.join(likely)})" if likely else ""
    return f"no known keyword states the exposure: name it by --map exposure=KEYWORD:UNIT{offered}"


def _is_bias(header: Header) -> bool:
    """Return whether a frame is stated to be a bias frame, which is read without an exposure."""
    kinds = (str(header[key].written).lower().split() for key in _KIND if key in header)
    return any(words and words[0] in ("bias", "zero") for words in kinds)


def _is_dark(
    path: Path, header: Header, exposure_s: float | None, mapped: StatementMap, taken: dict[str, str], doubts: list[str]
) -> bool:
    named = text_stated("kind", header, (), mapped, str(path))
    for key in (named[0],) if named else _KIND:
        words = str(header[key].written if key in header else named[1] if named else "").lower()
        if key == "OBJECT" and not _KIND_ALONE.fullmatch(words.strip()):
            continue  # a target's name: "Dark Nebula B33" is no dark frame
        if _OR in words:
            doubts.append(f"{key} states {words}: which of them is true is not known")
            continue
        if any(word in words for word in _DARK_WORDS):
            taken["shutter"] = key
            return "flat" not in words or DARK_FLAT.search(words) is not None
        if any(word in words for word in _LIGHT_WORDS):
            taken["shutter"] = key
            if (shutter := next((k for k in _SHUTTER if k in header), None)) and "clos" in _lower(header, shutter):
                doubts.append(f"{key} states {words}, {shutter} a closed shutter: {key} is used")
            if exposure_s == 0:
                doubts.append(f"{key} states {header[key].written} with an exposure of 0 s: a bias frame is assumed")
                return True
            return False
    kind = claims_of(path).kind
    if kind:
        taken["shutter"] = "file name"
        return kind == "dark"
    if exposure_s == 0:
        taken["shutter"] = "an exposure of 0 s"
        return True
    doubts.append("no IMAGETYP says whether the shutter was open: open is assumed")
    return False


def _lower(header: Header, key: str) -> str:
    return str(header[key].written).lower()


def _processing(header: Header, history: str) -> list[str]:
    found = []
    text = history.lower()
    words = [word for word in _PROCESSED_WORDS if word in text]
    if words:
        found.append(f"HISTORY mentions processing ({', '.join(words)}): these may be no raw numbers")
    status = str(header["CALSTAT"].written).strip() if "CALSTAT" in header else ""
    if status:
        found.append(f"CALSTAT {status}: bias, dark or flat corrections were applied already")
    combined = next((n for key in _COMBINED if (n := _number(header, key)) and n > 1), None)
    if combined:
        found.append(
            f"{combined:g} frames were combined into it: its noise is not that of one frame, and its exposure may be "
            "that of one or of all"
        )
    unit = str(header["BUNIT"].written).strip() if "BUNIT" in header else ""
    if unit.lower() not in _DATA_UNITS:
        found.append(f"BUNIT states {unit}: its values are no digital numbers of the converter")
    if (blank := _number(header, "BLANK")) is not None:  # FITS standard 4.0, section 4.4.2.5
        found.append(f"BLANK {blank:g}: pixels with this stored number hold no value, and count as numbers here")
    added = _number(header, "PEDESTAL")
    if added:
        found.append(f"PEDESTAL {added:g}: a program added numbers to it")
    return found


def _colours(path: Path, header: Header, shape: tuple[int, ...]) -> tuple[str | None, list[str]]:
    """Return the mosaic of colours, None where there is none, and what is doubted of it and of planes.

    Raises:
        CaptureError: If the planes are colours by the header.
    """
    stated = next((f"{key} {header[key].written}" for key in _COLOURS if _is_colour(header, key)), None)
    if len(shape) == 3 and stated is not None:
        raise CaptureError(f"{path}: its planes are colours ({stated}); frames need one channel: save one plane alone")
    key = next((key for key in _MOSAIC if key in header), "")
    if key and len(shape) == 2 and not is_unknown(written := str(header[key].written).strip()):
        x, y = (_number(header, offset) or 0.0 for offset in _MOSAIC_OFFSETS)
        if written.upper() not in _CELLS or not (x.is_integer() and y.is_integer()):
            return None, [f"{key} {written}: pixels under filters of several colours count as one channel"]
        order = str(header[_ROW_ORDER].written).strip().upper() if _ROW_ORDER in header else "not stated"
        doubts = [f"{key} {written} counts from the first stored row, as a camera's own files do: {_ROW_ORDER} {order}"]
        return shifted(written.upper(), int(x), int(y)), [] if order == _FROM_TOP else doubts
    if len(shape) == 3 and shape[0] == 3:
        planes = "it has three planes, which count as three frames of one exposure: save one alone if they are colours"
        return None, [planes]
    return None, []


def _is_colour(header: Header, key: str) -> bool:
    return key in header and "rgb" in str(header[key].written).lower()


def _gain(
    path: Path, header: Header, mapped: StatementMap, taken: dict[str, str], doubts: list[str]
) -> tuple[float, str]:
    """Return the gain in dB, 0 where its unit is the camera's own, and all settings of the camera's own units."""
    where = str(path)
    found = first_stated("gain", header, (), mapped, doubts, where)
    own = [key for key in _MODE if key in header] + [place.name for place in mapped.places.get("mode", ())]
    mode = [f"{key} {header[key].written}" for key in dict.fromkeys(own) if key in header]
    if found is None and (iso := first_stated("iso", header, places("ISOSPEED:ISO ISO:ISO"), mapped, doubts, where)):
        taken["gain_db"] = f"{iso[0]} (0 dB at ISO {BASE_ISO:g})"
        return 20.0 * math.log10(iso[1] / BASE_ISO), ", ".join(mode)
    if found is None and "GAIN" in header and not _is_conversion(header):
        name = " ".join(str(header[key].written) for key in _CAMERA_NAME if key in header)
        unit = gain_unit_of_maker(name)
        stated = unit_in_words(header["GAIN"].comment, "gain")[0]
        if unit or stated:
            found = first_stated("gain", header, (Place("GAIN", unit),), mapped, doubts, where)
        elif not is_unknown(header["GAIN"].written):
            mode.insert(0, f"GAIN {header['GAIN'].written}")
            doubts.append(
                f"the gain is {header['GAIN'].written} in a unit of the camera's own: it counts as 0 dB of this set; "
                "name it by --map gain=GAIN:UNIT (dB, 0.1dB, x) to compare gains"
            )
    if found is None:
        return 0.0, ", ".join(mode)
    taken["gain_db"] = found[0]
    return found[1], ", ".join(mode)


def _is_conversion(header: Header) -> bool:
    """Return whether GAIN is in electrons per DN, as observatories have it."""
    unit = str(header["GAINUNIT"].written) if "GAINUNIT" in header else ""
    return "electron" in unit.lower() or unit_in_words(header["GAIN"].comment, "conversion_gain")[0] is not None


def _temperature(
    path: Path, header: Header, mapped: StatementMap, taken: dict[str, str], doubts: list[str]
) -> float | None:
    known = _fact("temperature", "temperature_C", path, header, _celsius(header, _TEMPERATURE), mapped, taken, doubts)
    ignored = list[str]()
    asked = first_stated("temperature", header, _celsius(header, _SET_TEMPERATURE), StatementMap(), ignored, str(path))
    if known is None:
        if asked is not None:
            taken["temperature_C"] = asked[0]
            doubts.append(f"only the set temperature ({asked[0]}) is stated, not the one that was reached")
        return None if asked is None else asked[1]
    if asked is not None and abs(asked[1] - known) > _SETTLED_K:
        doubts.append(f"the sensor was at {known:.1f} °C, {asked[0]} asked for {asked[1]:.1f} °C")
    return known


def _celsius(header: Header, keys: tuple[str, ...]) -> tuple[Place, ...]:
    """Return places of temperatures: in °C as all makers write them; one that looks like K must state its unit."""
    here = [key for key in keys if key in header and not _ELSEWHERE.search(header[key].comment)]
    return tuple(Place(key, "" if _is_kelvin_by_size(header, key) else "degC") for key in here)


def _filters(header: Header, mapped: StatementMap, where: str) -> tuple[str, str] | None:
    """Return where the filters stand and their names; None where none is stated."""
    own = [key for key in header if _FILTERS.fullmatch(key)]
    found = [one for key in own if (one := text_stated("filter", header, (key,), mapped, where)) is not None]
    if not found or "filter" in mapped.places:
        return text_stated("filter", header, (), mapped, where)
    return ", ".join(key for key, _ in found), " + ".join(dict.fromkeys(words for _, words in found))


def _binning(header: Header) -> str | None:
    """Return how many pixels are one along a row and a column, such as "2 2"; None where nothing states it."""
    for keys in _BINNING:
        written = " ".join(str(header[key].written) for key in keys if key in header)
        if re.match(r"\W*\d{1,2}(?!\d)", written):
            return written
    return None


def _is_kelvin_by_size(header: Header, key: str) -> bool:
    value = _number(header, key)
    stated = key in header and unit_in_words(header[key].comment, "temperature")[0] is not None
    return value is not None and not stated and _KELVINS[0] < value < _KELVINS[1]


def _timestamp(header: Header, mapped: StatementMap, taken: dict[str, str]) -> float | None:
    named = (place.name for place in mapped.places.get("timestamp", ()))
    key = next((k for k in (*named, *_TIME) if k in header), None)
    if key is None:
        return None
    text = str(header[key].written).strip()
    clock = next((str(header[k].written).strip() for k in ("TIME-OBS", "UT") if k in header), "")
    if "T" not in text and clock:
        text = f"{text}T{clock}"
    try:
        moment = moment_of(text)
    except ValueError:
        return None
    taken["timestamp_s"] = key
    return moment.timestamp()


def _camera(
    path: Path, header: Header, mapped: StatementMap, taken: dict[str, str], doubts: list[str]
) -> dict[str, Any]:
    camera: dict[str, Any] = {}
    for key, fact, words in (("model", "model", _CAMERA_NAME), ("serial", "serial", ("SERNUM", "CAMSERNO"))):
        if (stated := text_stated(fact, header, words, mapped, str(path))) is not None:
            camera[key] = stated[1]
    gains = _ELECTRONS_PER_DN
    if "GAIN" in header and _is_conversion(header):
        gains = (*gains, Place("GAIN", "e-/DN"))
    for key, fact, where in (
        ("conversion_gain_e_per_dn", "conversion_gain", gains),
        ("read_noise_e", "read_noise", _READ_NOISE),
    ):
        value = _fact(fact, key, path, header, where, mapped, taken, doubts)
        if value:
            camera[key] = value
    pitch = next(((k, v) for k in ("PIXSIZE1", "XPIXSZ", "PIXSIZE") if (v := _number(header, k)) and v > 0), None)
    if pitch is not None:
        taken["pixel_pitch_um"], camera["pixel_pitch_um"] = pitch
    if (binning := _binning(header)) is not None:
        camera["binning"] = as_binning(binning)
    top = _number(header, "SATURATE") or _number(header, "DATAMAX")
    if top is not None and top >= 1:
        camera["stated_top_dn"] = top
    # DATAMAX is the largest value of this frame's data (FITS standard 4.0, table 22), not where pixels are saturated.
    place = next((k for k in _SATURATED_FROM if (_number(header, k) or 0.0) >= 1.0), None)
    if place is not None and unit_in_words(header[place].comment, "read_noise")[0] is not None:
        doubts.append(f"{place} is in electrons, not in DN: it is not used as the white level")
    elif place is not None:
        taken["white_level_dn"], camera["stated_white_dn"] = place, _number(header, place)
    return camera


def _number(header: Header, key: str) -> float | None:
    """Return a keyword's plain number; None where there is none."""
    if key not in header or is_unknown(header[key].written):
        return None
    try:
        return read_number(str(header[key].written))[0]
    except ValueError:
        return None
