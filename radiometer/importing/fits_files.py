"""FITS files: header to settings, data units to frames (one per plane of a cube)."""

from __future__ import annotations

import io
import math
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from radiometer.data.frame import FrameSettings
from radiometer.data.guards import refuse_size
from radiometer.data.reader_limits import bounded_reader
from radiometer.errors import CaptureError, MissingLibrary
from radiometer.importing.file_bytes import read_bytes
from radiometer.importing.file_names import claims_of, contradictions
from radiometer.importing.found import FoundFrame

# Keys in the order in which they are believed; the first set is the standard's own or the commonest.
_EXPOSURE: Final = ("EXPTIME", "EXPOSURE", "EXP_TIME", "ITIME", "INTTIME", "EXPTIME1", "TEXP")
_TEMPERATURE: Final = ("CCD-TEMP", "CCDTEMP", "DET-TEMP", "DETTEMP", "SENSTEMP", "TEMPERAT", "CHIPTEMP", "TEMP")
_SET_TEMPERATURE: Final = ("SET-TEMP", "SETTEMP", "CCD-TSET")
_TIME: Final = ("DATE-OBS", "DATE-BEG", "DATE_OBS", "DATE")
_CAMERA_NAME: Final = ("INSTRUME", "CAMERA", "DETECTOR", "DETNAM")
_ELECTRONS_PER_DN: Final = ("EGAIN", "E-GAIN", "GAINEL", "CCDGAIN")
_READ_NOISE: Final = ("RDNOISE", "READNOIS", "RON", "READNOISE")
_KIND: Final = ("IMAGETYP", "IMAGETYPE", "OBSTYPE", "FRAME", "FRAMETYP", "EXPTYPE", "PICTTYPE", "OBJECT")
_DARK_WORDS: Final = ("bias", "dark", "zero", "offset")
_LIGHT_WORDS: Final = ("light", "flat", "object", "science", "lamp", "dome", "sky", "tricolor", "target")
_PROCESSED_WORDS: Final = (
    "dark subtract", "darksub", "bias subtract", "bias-subtract", "flat field", "flatfield", "flat-field",
    "calibrat", "combine", "averag", "median", "stack", "reduc", "resampl", "overscan correct", "zerocor", "darkcor",
)  # fmt: skip
_KELVIN_FROM_C: Final = 150.0  # a temperature above it in a header can only be kelvins
_SETTLED_K: Final = 1.0
_ASI_GAIN_DB: Final = 0.1  # ZWO states its GAIN in tenths of a decibel


@bounded_reader()
def read_fits_headers(path: Path) -> list[FoundFrame]:
    """Return the frames of a FITS file, gzipped or not, without keeping their pixels.

    Raises:
        CaptureError: If the file is damaged or truncated, or holds no picture.
        MissingLibrary: If astropy is not installed.
    """
    with _opened(path) as units:
        unit = _picture(units, path)
        header = {**_cards(units[0].header), **_cards(unit.header)}
        shape = tuple(int(n) for n in unit.shape)
        stored = _stored(unit.header)
        history = _history(units[0].header) + (_history(unit.header) if unit is not units[0] else "")
    return _frames(path, header, history, shape, stored)


@bounded_reader()
def read_fits_pixels(path: Path, part: int) -> NDArray[Any]:
    """Return the values of one plane of a FITS file, BSCALE and BZERO applied.

    Sixteen-bit integers with BZERO 32768 come as uint16, whole numbers stay whole.

    Raises:
        CaptureError: If the file is damaged or truncated.
    """
    with _opened(path) as units:
        unit = _picture(units, path)
        refuse_size(path, unit.shape, max(1, abs(int(unit.header.get("BITPIX", 8))) // 8))
        values = np.asarray(unit.data)
    plane = values.reshape(-1, *values.shape[-2:])[part]
    return _unsigned(plane.astype(plane.dtype.newbyteorder("="), copy=False))


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
        raise CaptureError(f"{path}: not a readable FITS file (damaged or truncated): {_first(error)}") from error
    except fits.VerifyError as error:
        raise CaptureError(f"{path}: its FITS header is damaged: {_first(error)}") from error


def _first(error: Exception) -> str:
    return (str(error).strip().splitlines() or [type(error).__name__])[0]


def _picture(units: Any, path: Path) -> Any:
    for unit in units:
        shape = getattr(unit, "shape", ()) or ()
        if unit.is_image and len(shape) in (2, 3) and min(shape) > 0:
            return unit
    raise CaptureError(f"{path}: the FITS file holds no picture of two or three dimensions")


def _cards(header: Any) -> dict[str, Any]:
    return {key: header[key] for key in header if key not in ("", "HISTORY", "COMMENT")}


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
    path: Path, header: Mapping[str, Any], history: str, shape: tuple[int, ...], stored: str
) -> list[FoundFrame]:
    taken, doubts = dict[str, str](), list[str]()
    exposure_s = _exposure(header, taken, doubts)
    is_dark = _is_dark(path, header, exposure_s, taken, doubts)
    doubts += contradictions(claims_of(path), exposure_s, is_dark=is_dark)
    doubts += _processing(header, history)
    name_of_filter = str(header.get("FILTER", "")).strip()
    settings = FrameSettings(
        exposure_s=exposure_s or 0.0,
        gain_db=_gain_db(header, taken, doubts),
        f_number=_positive(header, ("FNUMBER", "FRATIO", "APERTURE"), "f_number", taken),
        temperature_c=_temperature(header, taken, doubts),
        timestamp_s=_timestamp(header, taken),
        pattern=name_of_filter or "default",
        shutter="closed" if is_dark else "open",
    )
    camera = _camera(header, taken)
    planes = 1 if len(shape) == 2 else shape[0]
    extra = {"imagetyp": str(header["IMAGETYP"]).strip()} if "IMAGETYP" in header else {}
    return [
        FoundFrame(
            path, (shape[-2], shape[-1]), stored, settings, part, planes, exposure_s is not None, camera,
            taken=taken, doubts=tuple(doubts), extra=extra,
        )
        for part in range(planes)
    ]  # fmt: skip


def _exposure(header: Mapping[str, Any], taken: dict[str, str], doubts: list[str]) -> float | None:
    found = {key: value for key in _EXPOSURE if (value := _number(header.get(key))) is not None and value >= 0}
    if not found:
        return None
    key, seconds = next(iter(found.items()))
    taken["exposure_s"] = key
    for other, value in found.items():
        if not math.isclose(value, seconds, rel_tol=0.01, abs_tol=1e-6):
            doubts.append(f"{key} says {seconds:g} s and {other} {value:g}: {key} is taken")
    return seconds


def _is_dark(
    path: Path, header: Mapping[str, Any], exposure_s: float | None, taken: dict[str, str], doubts: list[str]
) -> bool:
    for key in _KIND:
        words = str(header.get(key, "")).lower()
        if any(word in words for word in _DARK_WORDS):
            taken["shutter"] = key
            return "flat" not in words  # a "dark flat" is a dark; a "bias-corrected flat" is not
        if any(word in words for word in _LIGHT_WORDS):
            taken["shutter"] = key
            if exposure_s == 0:
                doubts.append(f"{key} says {header[key]!s} of an exposure of 0 s: taken for a bias frame")
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


def _processing(header: Mapping[str, Any], history: str) -> list[str]:
    found = []
    said = history.lower()
    words = [word for word in _PROCESSED_WORDS if word in said]
    if words:
        found.append(f"HISTORY speaks of processing ({', '.join(words)}): these may be no raw numbers")
    status = str(header.get("CALSTAT", "")).strip()
    if status:
        found.append(f"CALSTAT {status}: bias, dark or flat were applied already")
    combined = _number(header.get("NCOMBINE")) or _number(header.get("SNAPSHOT"))
    if combined and combined > 1:
        found.append(f"{combined:g} frames were combined into it: its noise is not that of one frame")
    return found


def _gain_db(header: Mapping[str, Any], taken: dict[str, str], doubts: list[str]) -> float:
    value = _number(header.get("GAIN"))
    if value is None or value == 0:
        return 0.0
    name = " ".join(str(header.get(key, "")) for key in _CAMERA_NAME)
    if "ZWO" in name or "ASI" in name:
        taken["gain_db"] = "GAIN (tenths of a dB)"
        return _ASI_GAIN_DB * value
    if any(key in header for key in _ELECTRONS_PER_DN) and value > 10:
        doubts.append(f"GAIN {value:g} has no unit that is known: it is not taken as a gain")
    return 0.0


def _temperature(header: Mapping[str, Any], taken: dict[str, str], doubts: list[str]) -> float | None:
    key = next((k for k in _TEMPERATURE if _number(header.get(k)) is not None), None)
    if key is None:
        wanted = next((k for k in _SET_TEMPERATURE if _number(header.get(k)) is not None), None)
        if wanted is None:
            return None
        taken["temperature_C"] = wanted
        doubts.append(f"only the wanted temperature ({wanted}) is stated, not the one that was reached")
        return _celsius(float(header[wanted]))
    taken["temperature_C"] = key
    celsius = _celsius(float(header[key]))
    for wanted in _SET_TEMPERATURE:
        set_c = _number(header.get(wanted))
        if set_c is not None and abs(_celsius(set_c) - celsius) > _SETTLED_K:
            doubts.append(f"the sensor was at {celsius:.1f} °C, {wanted} asked for {_celsius(set_c):.1f} °C")
    return celsius


def _celsius(value: float) -> float:
    return value - 273.15 if value > _KELVIN_FROM_C else value


def _timestamp(header: Mapping[str, Any], taken: dict[str, str]) -> float | None:
    key = next((k for k in _TIME if k in header), None)
    if key is None:
        return None
    said = str(header[key]).strip()
    clock = str(header.get("TIME-OBS", header.get("UT", ""))).strip()
    if "T" not in said and clock:
        said = f"{said}T{clock}"
    try:
        moment = datetime.fromisoformat(said)
    except ValueError:
        return None
    taken["timestamp_s"] = key
    return moment.replace(tzinfo=moment.tzinfo or UTC).timestamp()


def _camera(header: Mapping[str, Any], taken: dict[str, str]) -> dict[str, Any]:
    camera: dict[str, Any] = {}
    name = next((str(header[k]).strip() for k in _CAMERA_NAME if str(header.get(k, "")).strip()), None)
    if name:
        camera["model"] = name
    serial = str(header.get("SERNUM", header.get("CAMSERNO", ""))).strip()
    if serial:
        camera["serial"] = serial
    gain = _positive(header, _ELECTRONS_PER_DN, "conversion_gain_e_per_dn", taken)
    if gain is None and "electron" in str(header.get("GAINUNIT", "")).lower():
        gain = _positive(header, ("GAIN",), "conversion_gain_e_per_dn", taken)
    if gain is not None:
        camera["conversion_gain_e_per_dn"] = gain
    noise = _positive(header, _READ_NOISE, "read_noise_e", taken)
    if noise is not None:
        camera["read_noise_e"] = noise
    pitch = _positive(header, ("PIXSIZE1", "XPIXSZ", "PIXSIZE"), "pixel_pitch_um", taken)
    binning = _number(header.get("XBINNING")) or 1.0
    if pitch is not None:
        camera["pixel_pitch_um"] = pitch
        if binning > 1:
            camera["binning"] = int(binning)
    top = _number(header.get("SATURATE")) or _number(header.get("DATAMAX"))
    if top is not None and top >= 1:
        camera["stated_top_dn"] = top
    return camera


def _positive(header: Mapping[str, Any], keys: tuple[str, ...], fact: str, taken: dict[str, str]) -> float | None:
    for key in keys:
        value = _number(header.get(key))
        if value is not None and value > 0:
            taken[fact] = key
            return value
    return None


def _number(value: object) -> float | None:
    if isinstance(value, bool) or value is None:
        return None
    try:
        number = float(value)  # type: ignore[arg-type]  # what a card holds: a number, or words that are none
    except (TypeError, ValueError):
        return None
    return number if math.isfinite(number) else None
