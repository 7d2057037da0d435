"""TIFF files with EXIF and XMP: raw frames of machine and multispectral cameras."""

from __future__ import annotations

import io
import math
import struct
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

import numpy as np
import tifffile
from numpy.typing import NDArray

from radiometer.data.frame import FrameSettings
from radiometer.data.guards import refuse_endless_tiff, refuse_size
from radiometer.data.reader_limits import bounded_reader
from radiometer.errors import CaptureError
from radiometer.importing.file_bytes import read_bytes
from radiometer.importing.file_names import claims_of, contradictions
from radiometer.importing.found import FoundFrame
from radiometer.importing.maker_models import corners_of_plane, fall_off_of, row_exposure_of
from radiometer.importing.micro_manager import completed, planes_of
from radiometer.importing.xmp import numbers, read_xmp

_EXIF, _XMP, _MAKE, _MODEL, _DESCRIPTION, _DATE_TIME = 34665, 700, 271, 272, 270, 306
_BLACK_LEVEL, _WHITE_LEVEL, _SERIAL = 50714, 50717, 50735  # DNG 1.7, chapter 4
_ISO_KEYS: Final = ("ISOSpeed", "PhotographicSensitivity", "ISOSpeedRatings", "RecommendedExposureIndex")
_BASE_ISO: Final = 100.0
_DOUBTFUL_BLACK_SHARE: Final = 0.01  # of the stated black level: what masked rows may differ from it unnoticed


@bounded_reader()
def read_tiff_headers(path: Path) -> list[FoundFrame]:
    """Return the frames of a TIFF file, one per page, without keeping their pixels.

    Raises:
        CaptureError: If the file is damaged or truncated, or its pages are not of one channel.
    """
    with _opened(path) as tiff:
        pages = [page for page in tiff.pages if not _is_reduced(page)]
        if not pages:
            raise CaptureError(f"{path}: the TIFF holds no page")
        facts = _facts(pages[0])
        frames = [_frame(path, page, number, len(pages), facts) for number, page in enumerate(pages)]
        said = planes_of(path, pages, tiff.ome_metadata if tiff.is_ome else None)
    return [frame if plane is None else completed(frame, plane) for frame, plane in zip(frames, said, strict=True)]


@bounded_reader()
def read_tiff_pixels(path: Path, part: int) -> NDArray[Any]:
    """Return the stored values of one page.

    Raises:
        CaptureError: If the file is damaged or truncated.
    """
    with _opened(path) as tiff:
        pages = [page for page in tiff.pages if not _is_reduced(page)]
        _refuse_cut_short(path, pages[part], tiff.filehandle.size)
        refuse_size(path, pages[part].shape, pages[part].dtype.itemsize)
        values = pages[part].asarray()
    return np.asarray(values[..., 0] if values.ndim == 3 and values.shape[-1] == 1 else values)


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    content = read_bytes(path)
    refuse_endless_tiff(path, content)
    try:
        with tifffile.TiffFile(io.BytesIO(content)) as tiff:
            yield tiff
    except CaptureError:
        raise
    # The library raises nearly any built-in error on damaged tags or data.
    except (
        tifffile.TiffFileError, OSError, ValueError, TypeError, KeyError, IndexError, AttributeError, struct.error,
        RuntimeError, ZeroDivisionError, OverflowError,
    ) as error:  # fmt: skip
        said = (str(error).strip().splitlines() or [type(error).__name__])[0]
        raise CaptureError(f"{path}: not a readable TIFF file (damaged or truncated): {said}") from error


def _is_reduced(page: Any) -> bool:
    return bool(page.is_reduced) and page.index > 0


def _refuse_cut_short(path: Path, page: Any, size: int) -> None:
    """Refuse a page whose data end beyond the file: decoders would fill what is missing with zeros."""
    ends = [o + c for o, c in zip(page.dataoffsets, page.databytecounts, strict=False)]
    if not ends or max(ends) > size:
        raise CaptureError(f"{path}: the TIFF is truncated (its data end beyond the file); copy it again")


def _facts(page: Any) -> dict[str, Any]:
    tags = {int(tag.code): tag.value for tag in page.tags}
    exif = tags.get(_EXIF)
    packet = tags.get(_XMP, b"")
    return {
        "tags": tags,
        # Some writers put EXIF tags beside the others instead of into their own directory.
        "exif": {tag.name: tag.value for tag in page.tags} | dict(exif if isinstance(exif, Mapping) else {}),
        "xmp": read_xmp(packet if isinstance(packet, bytes) else str(packet).encode()),
    }


def _frame(path: Path, page: Any, number: int, count: int, facts: Mapping[str, Any]) -> FoundFrame:
    shape = tuple(int(n) for n in page.shape)
    shape = shape[:2] if len(shape) == 3 and shape[2] == 1 else shape
    if len(shape) != 2:
        raise CaptureError(f"{path}: a page of shape {page.shape}; frames need one channel (raw, not in colour)")
    _refuse_cut_short(path, page, page.parent.filehandle.size)
    taken, doubts, extra = dict[str, str](), list[str](), dict[str, Any]()
    exposure_s = _exposure(facts, path, taken)
    claims = claims_of(path)
    is_dark = claims.kind == "dark"
    if is_dark:
        taken["shutter"] = "file name"
    if taken.get("exposure_s") != "file name":
        doubts += contradictions(claims, exposure_s, is_dark=is_dark)
    black = _black_level(facts, taken)
    doubts += _masked_rows(facts, black, extra)
    settings = FrameSettings(
        exposure_s=exposure_s or 0.0,
        gain_db=_gain_db(facts["exif"], taken, extra),
        f_number=_rational(facts["exif"].get("FNumber")),
        black_level_dn=black,
        temperature_c=_temperature(facts["xmp"], taken),
        timestamp_s=_timestamp(facts, taken),
        shutter="closed" if is_dark else "open",
    )
    lens = _lens(facts, shape, exposure_s, extra)
    return FoundFrame(
        path, (shape[0], shape[1]), np.dtype(page.dtype).name, settings, number, count, exposure_s is not None,
        _camera(facts, taken), lens, taken, tuple(doubts), extra,
    )  # fmt: skip


def _exposure(facts: Mapping[str, Any], path: Path, taken: dict[str, str]) -> float | None:
    for key, value in (("ExposureTime", facts["exif"].get("ExposureTime")), ("tag 33434", facts["tags"].get(33434))):
        seconds = _rational(value)
        if seconds is not None and seconds >= 0:
            taken["exposure_s"] = f"EXIF {key}"
            return seconds
    claimed = claims_of(path).exposure_s
    if claimed is not None:
        taken["exposure_s"] = "file name"
    return claimed


def _black_level(facts: Mapping[str, Any], taken: dict[str, str]) -> float | None:
    value = facts["tags"].get(_BLACK_LEVEL)
    levels = [_rational(v) for v in (value if isinstance(value, tuple) and len(value) != 2 else (value,))]
    known = [level for level in levels if level is not None]
    if not known:
        return None
    taken["black_level_dn"] = "tag BlackLevel"
    return float(np.mean(known))


def _masked_rows(facts: Mapping[str, Any], black: float | None, extra: dict[str, Any]) -> list[str]:
    rows = numbers(facts["xmp"], "DarkRowValue")
    if not rows:
        return []
    masked = float(np.mean(rows))
    extra["masked_rows_dn"] = masked
    if black is None or abs(masked - black) <= _DOUBTFUL_BLACK_SHARE * black:
        return []
    return [
        f"the black level tag says {black:g}, the masked rows read {min(rows):g} to {max(rows):g} "
        f"({masked - black:+.0f} DN): the tag is kept as what is believed"
    ]


def _gain_db(exif: Mapping[str, Any], taken: dict[str, str], extra: dict[str, Any]) -> float:
    for key in _ISO_KEYS:
        value = exif.get(key)
        iso = _rational(value[0] if isinstance(value, tuple) and len(value) == 1 else value)
        if iso is not None and iso > 0:
            taken["gain_db"] = f"EXIF {key} (0 dB at ISO {_BASE_ISO:g})"
            extra["iso"] = iso
            return 20.0 * math.log10(iso / _BASE_ISO)
    return 0.0


def _temperature(xmp: Mapping[str, tuple[str, ...]], taken: dict[str, str]) -> float | None:
    for key in ("SensorTemperature", "ImagerTemperatureC"):
        value = numbers(xmp, key)
        if value:
            taken["temperature_C"] = f"XMP {key}"
            return value[0]
    return None


def _timestamp(facts: Mapping[str, Any], taken: dict[str, str]) -> float | None:
    said = facts["exif"].get("DateTimeOriginal") or facts["tags"].get(_DATE_TIME)
    try:
        moment = datetime.strptime(str(said).strip(), "%Y:%m:%d %H:%M:%S").replace(tzinfo=UTC)
    except ValueError:
        return None
    taken["timestamp_s"] = "EXIF DateTimeOriginal"
    fraction = str(facts["exif"].get("SubsecTime", "")).strip("\x00 -")
    return moment.timestamp() + (float(f"0.{fraction}") if fraction.isdigit() else 0.0)


def _camera(facts: Mapping[str, Any], taken: dict[str, str]) -> dict[str, Any]:
    tags, xmp = facts["tags"], facts["xmp"]
    camera: dict[str, Any] = {}
    for key, code in (("vendor", _MAKE), ("model", _MODEL), ("serial", _SERIAL)):
        if tags.get(code):
            camera[key] = str(tags[code]).strip("\x00 ")
    white = tags.get(_WHITE_LEVEL)
    top = _rational(white[0] if isinstance(white, tuple) else white)
    if top is not None and top > 1:
        camera["stated_top_dn"] = top
    centre = numbers(xmp, "VignettingCenter")
    if centre and "serial" not in camera:
        # Each unit has a lens calibration of its own, so that it tells units apart where no serial number does.
        camera["unit"] = f"{centre[0]:.2f}"
    for key, name in (("band", "BandName"), ("wavelength_nm", "CentralWavelength")):
        if xmp.get(name):
            camera[key] = float(xmp[name][0]) if key == "wavelength_nm" else xmp[name][0]
            taken[key] = f"XMP {name}"
    return camera


def _lens(
    facts: Mapping[str, Any], shape: tuple[int, ...], exposure_s: float | None, extra: dict[str, Any]
) -> dict[str, Any]:
    lens: dict[str, Any] = {}
    model, rows = fall_off_of(facts["xmp"]), row_exposure_of(facts["xmp"])
    corners = model.corners((shape[0], shape[1])) if model else corners_of_plane(facts["xmp"])
    if model:
        lens["maker_fall_off"] = {"centre_px": list(model.centre_px), "coefficients": list(model.coefficients)}
    if corners:
        lens["maker_corner_illumination"] = [round(v, 4) for v in corners]
    if rows and exposure_s:
        lens["maker_row_exposure"] = {"a2_s": rows.a2_s, "a3": rows.a3}
        extra["maker_row_gain_last"] = round(rows.gain_at(shape[0] - 1.0, exposure_s), 4)
    focal = _rational(facts["exif"].get("FocalLength"))
    if focal:
        lens["focal_length_mm"] = focal
    return lens


def _rational(value: Any) -> float | None:
    """Return a tag's number: a rational (numerator, denominator) or a plain one; None where it is neither."""
    if isinstance(value, bytes | str) or value is None:
        return None
    try:
        number = float(value[0]) / float(value[1]) if isinstance(value, tuple) and len(value) == 2 else float(value)
    except (TypeError, ValueError, ZeroDivisionError, IndexError):
        return None
    return number if math.isfinite(number) else None
