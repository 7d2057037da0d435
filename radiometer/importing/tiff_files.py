"""TIFF files with EXIF and XMP: raw frames of machine and multispectral cameras."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from radiometer.data.frame import FrameSettings
from radiometer.data.guards import refuse_size
from radiometer.data.reader_limits import bounded_reader
from radiometer.data.statements import Statement, StatementMap, first_stated, places
from radiometer.data.tiff_pixels import (
    MOSAIC,
    PALETTE,
    WHITE_IS_ZERO,
    full_size,
    opened_tiff,
    page_values,
    pictures_without_directory,
    refuse_cut_short,
)
from radiometer.errors import CaptureError
from radiometer.importing.exif import (
    corners_of_plane,
    exposure_of,
    f_number_of,
    fall_off_of,
    iso_of,
    numbers,
    numbers_of,
    read_xmp,
    row_exposure_of,
    statements_of_page,
)
from radiometer.importing.file_names import claims_of, contradictions, read_bytes
from radiometer.importing.found import FoundFrame
from radiometer.importing.micro_manager import completed, planes_of
from radiometer.units import BASE_ISO

_XMP, _MAKE, _MODEL, _DATE_TIME = 700, 271, 272, 306  # TIFF 6.0 and XMP part 3
_WHITE_LEVEL, _SERIAL = 50717, 50735  # DNG 1.7, chapter 4
# DNG 1.7, chapter 4: BlackLevel is rows × columns × samples of the repeating pattern; the deltas add to it by column
# and row.
_BLACK_LEVEL, _BLACK_REPEATS, _BLACK_DELTAS = 50714, 50713, (50715, 50716)
_DOUBTFUL_BLACK_SHARE: Final = 0.01  # of the stated black level: what masked rows may differ from it unnoticed


@bounded_reader()
def read_tiff_headers(path: Path, mapped: StatementMap = StatementMap()) -> list[FoundFrame]:
    """Return the frames of a TIFF file, one per full-size directory, without keeping their pixels.

    Every directory's own tags count, then those of the directory that holds it. Directories of reduced pictures are
    reported as not used.

    Args:
        mapped: Where the user states that facts stand.

    Raises:
        CaptureError: If the file is damaged or truncated, or its pages are not of one channel.
        UnsettledError: If a number has no unit that is known.
    """
    with _opened(path) as tiff:
        pages, reduced = full_size(tiff)
        if not pages:
            raise CaptureError(f"{path}: the TIFF holds no page")
        top = [page for page, _ in pages]
        pages += [pages[0]] * pictures_without_directory(tiff, top)
        planes = planes_of(path, [page for page, _ in pages], tiff.ome_metadata if tiff.is_ome else None)
        stated = _image_j(tiff)
        frames = []
        for number, ((page, parents), plane) in enumerate(zip(pages, planes, strict=True)):
            facts = _facts(page, parents, {**stated, **(plane.header() if plane else {})})
            frame = _frame(path, page, number, len(pages), facts, mapped)
            frames.append(frame if plane is None else completed(frame, plane, mapped))
    return [replace(frame, not_used=reduced) for frame in frames]


@bounded_reader()
def read_tiff_pixels(path: Path, part: int) -> NDArray[Any]:
    """Return the stored values of one page. Raises CaptureError if the file is damaged or truncated."""
    with _opened(path) as tiff:
        pages = [page for page, _ in full_size(tiff)[0]]
        stacked = pictures_without_directory(tiff, pages)
        page = pages[0 if stacked else part]
        refuse_cut_short(path, page, tiff.filehandle.size)
        refuse_size(path, (1 + stacked, *page.shape), page.dtype.itemsize)
        values = tiff.series[0].asarray().reshape(-1, *page.shape)[part] if stacked else page_values(path, page)
        table = page.tags.get(_LINEARIZATION)
        if table is not None:  # DNG 1.7, chapter 4: what is stored is the number of an entry
            entries = np.asarray(table.value, dtype=np.uint16)
            values = entries[np.minimum(values, entries.size - 1)]
        if page.photometric == WHITE_IS_ZERO:
            values = np.iinfo(values.dtype).max - values
    return np.asarray(values[..., 0] if values.ndim == 3 and values.shape[-1] == 1 else values)


_LINEARIZATION: Final = 50712


def _image_j(tiff: Any) -> dict[str, Statement]:
    """Return the "key = value" and "key: value" lines of ImageJ's Info, where a user may point to."""
    info = str((tiff.imagej_metadata or {}).get("Info", "")) if tiff.is_imagej else ""
    found = (re.match(r"\s*([^=:]{1,60}?)\s*[=:]\s*(.+)", line) for line in info.splitlines())
    return {line[1]: Statement(line[2].strip()) for line in found if line}


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    with opened_tiff(path, read_bytes(path)) as tiff:
        yield tiff


@dataclass(frozen=True, slots=True)
class _Facts:
    """What a directory states."""

    tags: Mapping[int, Any]  # its tags by number
    header: Mapping[str, Statement]  # its tags and EXIF by name
    further: Mapping[str, Statement]  # what else is stated of it (XMP, acquisition programs), where a user may point to
    xmp: Mapping[str, tuple[str, ...]]  # its XMP packet

    def by_user(self, fact: str, mapped: StatementMap, doubts: list[str], where: str) -> tuple[str, float] | None:
        """Return what the user's place of a fact states; None where there is none."""
        return first_stated(fact, {**self.further, **self.header}, (), mapped, doubts, where)


def _facts(page: Any, parents: Sequence[Any], further: Mapping[str, Statement]) -> _Facts:
    tags = {int(tag.code): numbers_of(tag) for directory in (*parents, page) for tag in directory.tags}
    packet = tags.get(_XMP, b"")
    packet = bytes(packet) if isinstance(packet, bytes | tuple) else str(packet).encode()
    xmp = read_xmp(packet)
    more = {name: Statement(" ".join(values)) for name, values in xmp.items()}
    return _Facts(tags, statements_of_page(page, *parents), {**more, **further}, xmp)


def _frame(path: Path, page: Any, number: int, count: int, facts: _Facts, mapped: StatementMap) -> FoundFrame:
    shape = tuple(int(n) for n in page.shape)
    shape = shape[:2] if len(shape) == 3 and shape[2] == 1 else shape
    if len(shape) != 2:
        raise CaptureError(f"{path}: a page of shape {page.shape}; frames need one channel (raw, not in colour)")
    refuse_cut_short(path, page, page.parent.filehandle.size)
    taken, doubts, extra = dict[str, str](), _meaning_of_numbers(path, page), dict[str, Any]()
    where = str(path)
    exposure_s = _exposure(facts, path, mapped, taken, doubts)
    claims = claims_of(path)
    is_dark = claims.kind == "dark"
    if is_dark:
        taken["shutter"] = "file name"
    if taken.get("exposure_s") != "file name":
        doubts += contradictions(claims, exposure_s, is_dark=is_dark)
    black = _black_level(facts, mapped, where, taken, doubts)
    doubts += _masked_rows(facts, black, extra)
    settings = FrameSettings(
        exposure_s=exposure_s or 0.0,
        gain_db=_gain_db(facts, mapped, where, taken, doubts, extra),
        f_number=f_number_of(facts.header, doubts, where),
        black_level_dn=black,
        temperature_c=_temperature(facts, mapped, where, taken, doubts),
        timestamp_s=_timestamp(facts, taken),
        shutter="closed" if is_dark else "open",
    )
    lens = _lens(facts, shape, exposure_s, extra)
    stored = "uint16" if _LINEARIZATION in page.tags else np.dtype(page.dtype).name
    return FoundFrame(
        path, (shape[0], shape[1]), stored, settings, number, count, exposure_s is not None,
        _camera(facts, taken), lens, taken, tuple(doubts), extra,
    )  # fmt: skip


def _meaning_of_numbers(path: Path, page: Any) -> list[str]:
    """Return what is to be reported of what a page's numbers mean.

    Raises:
        CaptureError: If they are numbers of colours.
    """
    if page.photometric == PALETTE:
        raise CaptureError(f"{path}: its numbers are places in a table of colours; save it as grey values")
    found = []
    if page.photometric == WHITE_IS_ZERO:
        if page.dtype.kind != "u":
            raise CaptureError(
                f"{path}: its tags state that 0 is white, in numbers without a greatest one; save it anew"
            )
        found.append("its tags state that 0 is white: the numbers are turned")
    if page.photometric == MOSAIC:
        found.append("a mosaic of colours by its tags: pixels under several filters count as one channel")
    if _LINEARIZATION in page.tags:
        found.append("its tags hold a LinearizationTable, which is applied")
    return found


def _exposure(
    facts: _Facts, path: Path, mapped: StatementMap, taken: dict[str, str], doubts: list[str]
) -> float | None:
    if (named := facts.by_user("exposure", mapped, doubts, str(path))) is not None:
        taken["exposure_s"] = named[0]
        return named[1]
    if (found := exposure_of(facts.header, doubts, str(path))) is not None:
        taken["exposure_s"] = f"EXIF {found[0]}"
        return found[1]
    claims = claims_of(path)
    if claims.doubt:
        doubts.append(f"{claims.doubt}: the exposure is not taken from it; rename it to end in such as 8ms")
    elif claims.exposure_s is not None:
        taken["exposure_s"] = "file name"
        return claims.exposure_s
    return None


def _black_level(
    facts: _Facts, mapped: StatementMap, where: str, taken: dict[str, str], doubts: list[str]
) -> float | None:
    """Return the mean black level in DN over the pattern, the rows and the columns."""
    if (named := facts.by_user("black_level", mapped, doubts, where)) is not None:
        taken["black_level_dn"] = named[0]
        return named[1]
    levels = facts.tags.get(_BLACK_LEVEL)
    if not isinstance(levels, tuple) or not levels or not np.isfinite(levels).all():
        return None
    repeats = facts.tags.get(_BLACK_REPEATS, (1, 1))
    if len(set(levels)) > 1 and isinstance(repeats, tuple) and len(levels) % max(1, math.prod(repeats)):
        doubts.append(f"tag BlackLevel has {len(levels)} values, BlackLevelRepeatDim {repeats}: their mean is used")
    deltas = [
        d for code in _BLACK_DELTAS if isinstance(d := facts.tags.get(code), tuple) and np.isfinite(d).all() and d
    ]
    spread = [max(values) - min(values) for values in (levels, *deltas)]
    if max(spread) > 0:
        doubts.append(f"the black level differs by up to {max(spread):g} DN over the pixels: its mean is used")
    taken["black_level_dn"] = "tag BlackLevel" + (" with its deltas by row and column" if deltas else "")
    return float(np.mean(levels) + sum(np.mean(values) for values in deltas))


def _masked_rows(facts: _Facts, black: float | None, extra: dict[str, Any]) -> list[str]:
    rows = numbers(facts.xmp, "DarkRowValue")
    if not rows:
        return []
    masked = float(np.mean(rows))
    extra["masked_rows_dn"] = masked
    if black is None or abs(masked - black) <= _DOUBTFUL_BLACK_SHARE * black:
        return []
    return [
        f"the black level tag says {black:g}, the masked rows read {min(rows):g} to {max(rows):g} "
        f"({masked - black:+.0f} DN): the tag is used"
    ]


def _gain_db(
    facts: _Facts, mapped: StatementMap, where: str, taken: dict[str, str], doubts: list[str], extra: dict[str, Any]
) -> float:
    if (named := facts.by_user("gain", mapped, doubts, where)) is not None:
        taken["gain_db"] = named[0]
        return named[1]
    found = facts.by_user("iso", mapped, doubts, where) or iso_of(facts.header, doubts, where)
    if found is None:
        return 0.0
    taken["gain_db"] = f"EXIF {found[0]} (0 dB at ISO {BASE_ISO:g})"
    extra["iso"] = found[1]
    return 20.0 * math.log10(found[1] / BASE_ISO)


def _temperature(
    facts: _Facts, mapped: StatementMap, where: str, taken: dict[str, str], doubts: list[str]
) -> float | None:
    known = places("SensorTemperature:degC ImagerTemperatureC:degC")  # of XMP: Parrot, MicaSense
    if (found := first_stated("temperature", {**facts.header, **facts.further}, known, mapped, doubts, where)) is None:
        return None
    taken["temperature_C"] = found[0] if "(--map)" in found[0] else f"XMP {found[0]}"
    return found[1]


def _timestamp(facts: _Facts, taken: dict[str, str]) -> float | None:
    header = facts.header
    text = header["DateTimeOriginal"].written if "DateTimeOriginal" in header else facts.tags.get(_DATE_TIME)
    try:
        moment = datetime.strptime(str(text).strip(), "%Y:%m:%d %H:%M:%S").replace(tzinfo=UTC)
    except ValueError:
        return None
    taken["timestamp_s"] = "EXIF DateTimeOriginal"
    fraction = str(header["SubsecTime"].written if "SubsecTime" in header else "").strip("\x00 -")
    return moment.timestamp() + (float(f"0.{fraction}") if fraction.isdigit() else 0.0)


def _camera(facts: _Facts, taken: dict[str, str]) -> dict[str, Any]:
    tags, xmp = facts.tags, facts.xmp
    camera: dict[str, Any] = {}
    for key, code in (("vendor", _MAKE), ("model", _MODEL), ("serial", _SERIAL)):
        if tags.get(code):
            camera[key] = str(tags[code]).strip("\x00 ")
    white = tags.get(_WHITE_LEVEL)
    top = float(min(white)) if isinstance(white, tuple) and white else 0.0  # one of each channel
    if top > 1:
        taken["white_level_dn"] = "tag WhiteLevel"
        camera |= {"stated_top_dn": top, "stated_white_dn": top}
    centre = numbers(xmp, "VignettingCenter")
    if centre and "serial" not in camera:
        # Each unit has a separate lens calibration, so that it distinguishes units where no serial number does.
        camera["unit"] = f"{centre[0]:.2f}"
    for key, name in (("band", "BandName"), ("wavelength_nm", "CentralWavelength")):
        if xmp.get(name):
            camera[key] = float(xmp[name][0]) if key == "wavelength_nm" else xmp[name][0]
            taken[key] = f"XMP {name}"
    return camera


def _lens(facts: _Facts, shape: tuple[int, ...], exposure_s: float | None, extra: dict[str, Any]) -> dict[str, Any]:
    lens: dict[str, Any] = {}
    model, rows = fall_off_of(facts.xmp), row_exposure_of(facts.xmp)
    corners = model.corners((shape[0], shape[1])) if model else corners_of_plane(facts.xmp)
    if model:
        lens["maker_fall_off"] = {"centre_px": list(model.centre_px), "coefficients": list(model.coefficients)}
    if corners:
        lens["maker_corner_illumination"] = [round(v, 4) for v in corners]
    if rows and exposure_s:
        lens["maker_row_exposure"] = {"a2_s": rows.a2_s, "a3": rows.a3}
        extra["maker_row_gain_last"] = round(rows.gain_at(shape[0] - 1.0, exposure_s), 4)
    focal = facts.header["FocalLength"].written if "FocalLength" in facts.header else None
    if isinstance(focal, int | float) and math.isfinite(focal) and focal > 0:
        lens["focal_length_mm"] = float(focal)
    return lens
