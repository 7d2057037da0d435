"""Whatever a laboratory names (file, folder, pattern, list of them) as capture sets."""

from __future__ import annotations

import glob
import hashlib
import math
import re
import shutil
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from radiometer.data import (
    CameraDescription,
    CaptureHeader,
    CaptureSet,
    CaptureSetWriter,
    FrameEntry,
    FrameSettings,
    LensDescription,
    SourceDescription,
)
from radiometer.data.capture_set import HEADER_NAME, read_digital_numbers, read_header
from radiometer.data.frame import DigitalNumbers
from radiometer.data.guards import safe_file_name
from radiometer.data.mosaic import shifted
from radiometer.data.reader_limits import refuse_endless
from radiometer.data.statements import StatementMap
from radiometer.data.storage import write_yaml_atomic
from radiometer.data.validation import validate
from radiometer.errors import (
    CaptureError,
    DamagedFileError,
    InputError,
    MissingLibrary,
    OutputError,
    UnsettledError,
    UsageError,
)
from radiometer.importing.emva_listing import EmvaListing, find_descriptor
from radiometer.importing.file_names import kind_of
from radiometer.importing.fits_files import read_fits_headers, read_fits_pixels
from radiometer.importing.found import (
    FoundFrame,
    ImportOptions,
    ImportRecord,
    by_wording,
    doubts_about,
    named,
    not_used_of,
    record_in,
    taken_from,
)
from radiometer.importing.micro_manager import FACT as ACQUISITION
from radiometer.importing.photograph_times import PhotographSettings, find_list, read_list
from radiometer.importing.statistics_table import is_statistics_table, read_statistics_table
from radiometer.importing.tiff_files import read_tiff_headers, read_tiff_pixels

_LOOKED_AT: Final = 4  # frames whose codes are looked at for padding and clipping
_FEWEST_CODES: Final = 10  # different ones: all even by chance once in a thousand
_CODES_FROM: Final = 65_536  # pixels of a frame that show its codes
_FEWEST_CLIPPED: Final = 4  # noise alone puts hardly two pixels on the same highest code
_CAMERA_KEYS: Final = (
    "vendor", "model", "serial", "unit", "mode", "band", "wavelength_nm", "binning", "pixel_pitch_um",
    "conversion_gain_e_per_dn", "read_noise_e", "taps",
    "mosaic",
)  # fmt: skip
# What a set is called by among several.
_OWN_KEYS: Final = ("vendor", "model", "serial", "band", "binning", "mode", "scene")
_UNBINNED: Final = ("binning", "1")  # as frames that state nothing of it
_MASKED_SAME_DN: Final = 1.0  # masked rows are read to a fraction of a DN
_UNEVEN_PERCENT: Final = 0.5  # of light that a calibration moves, above which it is reported


@dataclass(frozen=True, slots=True)
class Assembled:
    """The header of one camera's frames, and the frame behind each name in it."""

    title: str
    header: CaptureHeader
    frames: Mapping[str, FoundFrame]


def by_camera(frames: Iterable[FoundFrame]) -> dict[str, list[FoundFrame]]:
    """Return the frames by camera: maker, model, serial number, band, binning, own settings, scene and frame size.

    Frames that state no gain are a separate set where others state one: their gain is unknown, and not 0 dB.
    """
    keys: dict[tuple[Any, ...], list[FoundFrame]] = {}
    for frame in frames:
        own = [None if (k, frame.camera.get(k)) == _UNBINNED else frame.camera.get(k) for k in _OWN_KEYS]
        key = (*own, *frame.shape, "gain_db" in frame.taken, frame.camera.get("unit"))
        keys.setdefault(key, []).append(frame)
    titles = _titles(list(keys))
    return dict(zip(titles, keys.values(), strict=True))


def _titles(keys: Sequence[tuple[Any, ...]]) -> list[str]:
    """Return a short unique name for each camera: the parts in which they differ."""
    if len(keys) <= 1:
        return ["camera"] * len(keys)
    differing = [i for i in range(len(keys[0]) - 1) if len({key[i] for key in keys}) > 1]
    words = ["-".join(str(key[i]) for i in differing if key[i] is not None) or "camera" for key in keys]
    seen: Counter[str] = Counter()
    unique = []
    for word in (safe_file_name(re.sub(r"[^\w.+-]+", "_", word)) for word in words):  # they become folders
        seen[word] += 1
        unique.append(word if seen[word] == 1 else f"{word}-{seen[word]}")
    return unique


def assemble(
    title: str,
    frames: Sequence[FoundFrame],
    root: Path,
    options: ImportOptions,
    read: Any,
    left_out: Sequence[str] = (),
    bit_depth: int | None = None,
) -> Assembled:
    """Return the header of a capture set for frames of one camera, by the time they were taken.

    Args:
        root: Folder that the names of the frames are relative to.
        read: Returns the digital numbers of a frame, for a look at their codes.
        left_out: Lines about files that could not be used.
        bit_depth: Bits per pixel where a descriptor states them.

    Raises:
        CaptureError: If no frame's exposure is known, or frames of several unknown gains are mixed.
    """
    known = [f for f in frames if f.exposure_known and (f.settings.exposure_s > 0 or f.settings.is_dark)]
    without = by_wording((f.label, _why_no_exposure(f)) for f in frames if f not in known)
    if not known:
        raise CaptureError(
            f"{root}: {'; '.join(without)}. Name it: radiometer import … --map exposure=PLACE:UNIT, "
            "or --map exposure=NUMBER:UNIT where one number is true of all frames, or write a file exposures.txt into "
            "the folder with one line per file: `name seconds`"
        )
    lines = [*left_out, *without]
    ordered = _plain_patterns(_by_time(known))
    codes = _Codes.of(ordered, options, read, bit_depth)
    camera, disagreeing = _camera(ordered, codes, options)
    origin_s = ordered[0].settings.timestamp_s
    entries = {_name(frame, root): (frame, _entry(frame, root, origin_s)) for frame in ordered}
    record = ImportRecord(
        taken_from(ordered),
        tuple(_missing(ordered, camera)),
        (*doubts_about(ordered), *disagreeing, *codes.doubts, *_black_by_gain(ordered), *_uncorrected(ordered)),
        tuple(lines),
        not_used_of(frames),
        options.mapped.words(),
    )
    header = validate(
        CaptureHeader,
        {
            "camera": camera,
            "lens": _lens(ordered, options),
            "source": SourceDescription(kind="sphere" if ordered[0].photons is not None else "scene"),
            "patterns": tuple(dict.fromkeys(f.settings.pattern for f in ordered)),
            "frames": tuple(entry for _, entry in entries.values()),
            "imported": record.to_mapping(),
            **({"created": datetime.fromtimestamp(origin_s, UTC).isoformat()} if origin_s and origin_s > 1e9 else {}),
        },
        str(root),
        CaptureError,
    )
    return Assembled(title, header, {name: frame for name, (frame, _) in entries.items()})


def _why_no_exposure(frame: FoundFrame) -> tuple[str, ...]:
    reported = tuple(doubt for doubt in frame.doubts if "exposure" in doubt)
    return reported or ("no exposure time is known",)


def _by_time(frames: Sequence[FoundFrame]) -> list[FoundFrame]:
    stamps = [f.settings.timestamp_s for f in frames]
    if any(stamp is None for stamp in stamps):
        return sorted(frames, key=lambda f: (str(f.file), f.part))
    return sorted(frames, key=lambda f: (f.settings.timestamp_s or 0.0, str(f.file), f.part))


def _plain_patterns(frames: Sequence[FoundFrame]) -> list[FoundFrame]:
    """Return the frames with one pattern's name where only one occurs in the light; darks have none."""
    lit = {f.settings.pattern for f in frames if not f.settings.is_dark}
    return [
        f if len(lit) > 1 and not f.settings.is_dark else replace(f, settings=replace(f.settings, pattern="default"))
        for f in frames
    ]


def _name(frame: FoundFrame, root: Path) -> str:
    try:
        name = frame.file.relative_to(root).as_posix()
    except ValueError:
        name = frame.file.as_posix()
    return name if frame.parts == 1 else f"{name}#{frame.part}"


def _entry(frame: FoundFrame, root: Path, origin_s: float | None) -> FrameEntry:
    settings = frame.settings
    if origin_s is not None and settings.timestamp_s is not None and origin_s > 1e9:
        settings = replace(settings, timestamp_s=round(settings.timestamp_s - origin_s, 6))
    return FrameEntry.of(_name(frame, root), settings, photons=frame.photons, **frame.extra)


@dataclass(frozen=True, slots=True)
class _Codes:
    """What the codes of some frames say of the converter."""

    bit_depth: int
    step_dn: int
    doubts: tuple[str, ...]

    @classmethod
    def of(cls, frames: Sequence[FoundFrame], options: ImportOptions, read: Any, stated: int | None) -> _Codes:
        looked = [frames[i] for i in np.unique(np.linspace(0, len(frames) - 1, _LOOKED_AT).astype(int))]
        pixels = list[DigitalNumbers]()
        damage: DamagedFileError | None = None
        for frame in looked:
            try:
                pixels.append(read(frame, options))
            except DamagedFileError as error:  # left out and named when the frames are copied
                damage = error
        if damage is not None and not pixels:
            raise damage
        bits = 0
        for dn in pixels:
            bits |= int(np.bitwise_or.reduce(dn, axis=None))
        step = bits & -bits if _determines_step(pixels, bits) else 1
        container = 8 * max(dn.dtype.itemsize for dn in pixels)
        depth, doubts = (stated, []) if stated else _converter_bits(pixels, container, looked)
        if step > 1 and not stated:
            real = container - (step.bit_length() - 1)
            doubts.append(
                f"all values are multiples of {step}: {real} bits written in {container} (padded), so that rounding "
                f"has steps of {step} DN"
            )
        if any(np.dtype(f.stored).kind == "f" or np.dtype(f.stored).itemsize > 2 for f in looked):
            top = options.full_scale or 0.0
            doubts.append(f"{looked[0].stored} values were taken with the stated full scale of {top:g}")
        return cls(depth, step, tuple(doubts))


def _determines_step(pixels: Sequence[DigitalNumbers], bits: int) -> bool:
    """Return whether the codes are many enough to be multiples of more than 1 by no chance."""
    if bits == 0 or bits & 1:
        return False
    codes = set[int]()
    for dn in pixels:
        codes.update(np.unique(dn.ravel()[:: max(dn.size // _CODES_FROM, 1)]).tolist())
    return len(codes) >= _FEWEST_CODES


def _converter_bits(
    pixels: Sequence[DigitalNumbers], container: int, frames: Sequence[FoundFrame]
) -> tuple[int, list[str]]:
    """Return the bits per pixel: fewer than the container's where pixels pile up at the top of fewer."""
    highest = max(int(dn.max(initial=0)) for dn in pixels)
    for bits in (10, 12, 14):
        top = (1 << bits) - 1
        piled = sum(int(np.count_nonzero(dn == top)) for dn in pixels)
        if highest == top and container == 16 and piled >= _FEWEST_CLIPPED:
            return bits, [f"{piled} pixels pile up at {top}, the highest value: {bits} bits are taken"]
    tops = {f.camera["stated_top_dn"] for f in frames if "stated_top_dn" in f.camera}
    top_stated = max(tops, default=0)
    for bits in (10, 12, 14):
        if top_stated == (1 << bits) - 1 and highest <= top_stated:
            return bits, []
    return container, []


def _camera(frames: Sequence[FoundFrame], codes: _Codes, options: ImportOptions) -> tuple[CameraDescription, list[str]]:
    facts: dict[str, Any] = {"bit_depth": codes.bit_depth}
    doubts = []
    for key in _CAMERA_KEYS:
        values = Counter(f.camera[key] for f in frames if key in f.camera)
        if values:
            facts[key] = values.most_common(1)[0][0]
        if len(values) > 1:
            doubts.append(f"headers disagree on {key}: {', '.join(map(str, values))}; the most frequent is taken")
    filters = {f.camera.get("filter") for f in frames if not f.settings.is_dark}
    if len(filters) == 1:  # of several, each is a pattern
        facts["filter"] = filters.pop()
    if "taps" in facts and (options.crop or options.sample > 1):
        del facts["taps"]
        doubts.append("the sections of amplifiers are left out: they hold for whole frames only")
    if "mosaic" in facts:
        doubts += _placed_mosaic(facts, options)
    if codes.step_dn > 1:
        facts["code_step_dn"] = codes.step_dn
    if "pixel_pitch_um" in facts and options.sample > 1:
        facts["pixel_spacing_um"] = facts["pixel_pitch_um"] * options.sample
    blacks = {f.settings.black_level_dn for f in frames if f.settings.black_level_dn is not None}
    if len(blacks) == 1:
        facts["black_level_dn"] = blacks.pop()
    top_dn, doubtful = _white_level(frames, codes, options)
    if top_dn is not None:
        facts["white_level_dn"] = top_dn
    return validate(CameraDescription, facts, frames[0].label, CaptureError), [*doubts, *doubtful]


def _placed_mosaic(facts: dict[str, Any], options: ImportOptions) -> list[str]:
    """Put the mosaic of the requested part in place of that of the whole frame; return what speaks against any."""
    of_cells = "binning" in facts and facts["binning"] != _UNBINNED[1]
    if of_cells or "taps" in facts or options.sample % 2 == 0:
        mosaic = facts.pop("mosaic")
        return [f"{mosaic}: pixels under filters of several colours count as one channel"]
    if options.crop is not None:
        facts["mosaic"] = shifted(facts["mosaic"], options.crop.x, options.crop.y)
    return []


def _white_level(frames: Sequence[FoundFrame], codes: _Codes, options: ImportOptions) -> tuple[float | None, list[str]]:
    """Return the digital number from which the files say that pixels are saturated, and what is doubtful of it."""
    full_scale = (1 << codes.bit_depth) - 1
    stated = sorted({f.camera["stated_white_dn"] + options.pedestal for f in frames if "stated_white_dn" in f.camera})
    if not stated or options.full_scale is not None:  # scaled numbers are none that a header speaks of
        return None, []
    lowest, highest = stated[0], stated[-1]
    if highest > full_scale + options.pedestal:
        return None, [f"headers state saturation at {highest:g}, above the {full_scale} of the files: not used"]
    doubts = (
        [f"headers state saturation from {lowest:g} to {highest:g}: the lowest is taken"] if lowest < highest else []
    )
    return (lowest if lowest < full_scale else None), doubts


def _lens(frames: Sequence[FoundFrame], options: ImportOptions) -> LensDescription:
    facts: dict[str, Any] = {}
    if options.crop is not None or options.sample > 1:  # the optical axis is where it was: at the middle of the file's
        facts["principal_point_px"] = options.place_of_middle(frames[0].shape)
    for frame in frames:
        for key, value in frame.lens.items():
            facts.setdefault(key, value)
    stops = {f.settings.f_number for f in frames if f.settings.f_number}
    if len(stops) == 1:
        facts["f_number"] = stops.pop()
    return validate(LensDescription, facts, frames[0].label, CaptureError)


def _black_by_gain(frames: Sequence[FoundFrame]) -> list[str]:
    """Return a line that reports how far masked rows are above the black level tag at each gain."""
    by_gain: dict[float, list[float]] = {}
    for frame in frames:
        masked, stated = frame.extra.get("masked_rows_dn"), frame.settings.black_level_dn
        if masked is not None and stated is not None:
            by_gain.setdefault(round(frame.settings.gain_db, 2), []).append(masked - stated)
    offsets = {gain: float(np.mean(values)) for gain, values in sorted(by_gain.items())}
    if not offsets or max(map(abs, offsets.values())) < _MASKED_SAME_DN:
        return []
    offsets_text = ", ".join(f"{offset:+.0f} DN at {gain:g} dB" for gain, offset in offsets.items())
    kind = "black_level_offset and black_level_gain_slope" if len(offsets) > 1 else "black_level_offset"
    return [f"masked rows differ from the black level tag by {offsets_text}: {kind}"]


def _uncorrected(frames: Sequence[FoundFrame]) -> list[str]:
    """Return what the maker's calibration says of rows and corners: raw frames hold it, nothing here takes it out."""
    lines = []
    rows = [100.0 * (f.extra["maker_row_gain_last"] - 1.0) for f in frames if "maker_row_gain_last" in f.extra]
    if rows and max(map(abs, rows)) > _UNEVEN_PERCENT:
        lines.append(
            "the maker's calibration states row-dependent exposure: the last row has "
            f"{_span(rows, '+.1f')} % more light than the first. The frames include it: row_dependent_exposure"
        )
    corners = [v for frame in frames for v in frame.lens.get("maker_corner_illumination", ())]
    if corners and 100.0 * (1.0 - min(corners)) > _UNEVEN_PERCENT:
        lines.append(
            f"the maker's calibration states {_span(corners, '.2f')} of the middle's light in the corners. "
            "The frames include it: natural_vignetting or mechanical_vignetting"
        )
    return lines


def _span(values: Sequence[float], how: str) -> str:
    low, high = f"{min(values):{how}}", f"{max(values):{how}}"
    return low if low == high else f"{low} to {high}"


def _missing(frames: Sequence[FoundFrame], camera: CameraDescription) -> list[str]:
    found = []
    if not any(f.settings.is_dark for f in frames):
        found += _without_darks(frames, camera)
    if all(f.settings.is_dark for f in frames):
        found.append("no frames with light: no photon transfer, no linearity, no saturation")
    if all(f.settings.temperature_c is None for f in frames):
        found.append("sensor temperature")
    if all(f.settings.timestamp_s is None for f in frames):
        found.append("time of the frames: their order is that of their names")
    if camera.conversion_gain_e_per_dn is None:
        found.append("conversion gain in e-/DN")
    counts = Counter((f.settings.exposure_s, f.settings.gain_db, f.settings.shutter) for f in frames)
    single = sum(1 for number in counts.values() if number == 1)
    if single:
        found.append(f"{single} of {len(counts)} settings have one frame only: no temporal noise from them")
    return found


def _without_darks(frames: Sequence[FoundFrame], camera: CameraDescription) -> list[str]:
    """Return what is missing without dark frames: less where the sensor reads pixels without light in every frame."""
    if all("masked_rows_dn" in frame.extra for frame in frames):
        return []
    if camera.taps and all(tap.overscan for tap in camera.taps):
        return ["no dark frames: overscan gives the black level, and the dark signal stays in the light"]
    return ["no dark frames: black level and read noise cannot be separated from the light"]


FITS_SUFFIXES: Final = (".fit", ".fits", ".fts", ".fz")
TIFF_SUFFIXES: Final = (".tif", ".tiff")
_RAW_TIFF_FACTS: Final = ("black_level_dn", "band", "temperature_C", ACQUISITION)
_WILDCARDS: Final = "*?["


@dataclass(slots=True)
class FileStore:
    """Frames that are read from the files they were found in."""

    frames: dict[str, FoundFrame]  # the frame behind each name of the header
    options: ImportOptions = field(default_factory=ImportOptions)  # how they are taken

    def read(self, file: str) -> DigitalNumbers:
        return read_found(self.frames[file], self.options)

    def digest(self) -> str:
        digest = hashlib.sha256(repr(self.options).encode())
        for file in dict.fromkeys(frame.file for frame in self.frames.values()):
            digest.update(file.name.encode())
            with file.open("rb") as stream:
                while block := stream.read(1 << 20):
                    digest.update(block)
        return digest.hexdigest()


def read_found(frame: FoundFrame, options: ImportOptions) -> DigitalNumbers:
    """Return the digital numbers of a found frame, as the options have it.

    Raises:
        DamagedFileError: If the file holds another number of values than its header states.
        CaptureError: If it cannot be read, or its numbers need a full scale or a pedestal that is not stated.
    """
    pixels, where = _pixels(frame), str(frame.file.with_name(frame.label))
    if pixels.shape != frame.shape:
        found, stated = (" × ".join(map(str, shape)) for shape in (pixels.shape, frame.shape))
        raise DamagedFileError(f"{where}: holds {found} values, its header states {stated}; copy the file again")
    return options.digital_numbers(pixels, where)


def _pixels(frame: FoundFrame) -> NDArray[Any]:
    name = frame.file.name.lower().removesuffix(".gz")
    if name.endswith(FITS_SUFFIXES):
        return read_fits_pixels(frame.file, frame.part)
    if name.endswith(TIFF_SUFFIXES) and frame.photons is None:
        return read_tiff_pixels(frame.file, frame.part)
    if frame.photons is None and kind_of(frame.file) == "fits":
        return read_fits_pixels(frame.file, frame.part)
    return read_digital_numbers(frame.file)


def is_foreign(path: Path) -> bool:
    """Return whether a path names frames or statistics that are no capture set and no plain folder of photographs.

    Foreign are FITS files, raw TIFF files of cameras, EMVA 1288 descriptors and tables of statistics; a folder that
    holds some at any depth; and a pattern such as `night/*_1.tif.gz`.
    """
    if path.is_file():
        return find_descriptor(path) is not None or is_statistics_table(path) or _is_frame_file(path)
    if not path.is_dir():
        return any(sign in str(path) for sign in _WILDCARDS) and bool(_matching(path))
    if (path / HEADER_NAME).exists() or (path / "frames").is_dir():
        return False
    if find_descriptor(path) is not None:
        return True
    files = _frame_files(path)
    fits = any(_plain_suffix(file) in FITS_SUFFIXES or file.suffix.lower() == ".gz" for file in files)
    return fits or (bool(files) and _is_raw_tiff(files[0]))


def open_capture(path: Path, options: ImportOptions | None = None) -> CaptureSet:
    """Return the capture set that a path names: its own, or one put together from what the files say.

    Args:
        path: Capture set, FITS or TIFF file, folder of them, pattern, or EMVA 1288 descriptor.

    Raises:
        CaptureError: If there is nothing to read, a named file is unreadable, or several cameras are mixed.
    """
    if not is_foreign(path) and not path.is_file():
        return CaptureSet.read(path)
    if path.is_file() and is_statistics_table(path):
        raise CaptureError(
            f"{path}: a table of statistics holds no pictures; radiometer characterise takes it, and what works on "
            "pixels cannot"
        )
    found = import_sources([path], options)
    if len(found) > 1:
        cameras = ", ".join(one.title for one in found)
        raise CaptureError(
            f"{path} holds frames of {len(found)} cameras, bands, gains or images ({cameras}); take one by a pattern "
            "such as 'folder/*_1.tif', or write each as a capture set with `radiometer import`"
        )
    return as_capture(found[0], path, options)


def as_capture(one: Assembled, path: Path, options: ImportOptions | None = None) -> CaptureSet:
    """Return the frames of one camera as a capture set that reads them where they are."""
    return CaptureSet.of_store(path, one.header, FileStore(dict(one.frames), options or ImportOptions()))


def statistics_of(path: Path, mapped: StatementMap | None = None) -> CaptureHeader | None:
    """Return the statistics that a table or a capture set without pictures holds; None where a path is neither.

    Args:
        mapped: Where the user states that facts stand.

    Raises:
        CaptureError: If the table is damaged.
        UnsettledError: If a column has no unit that is known.
    """
    if path.is_file():
        return read_statistics_table(path, mapped) if is_statistics_table(path, mapped) else None
    if not (path / HEADER_NAME).is_file():
        return None
    header = read_header(path)
    return None if header.frames else header


def import_sources(
    paths: Sequence[Path], options: ImportOptions | None = None, report: Callable[[int, int], None] | None = None
) -> list[Assembled]:
    """Return what files, folders and patterns hold, one entry per camera or band.

    A file of a folder that cannot be read is left out and named in the record; one that is named itself is an error.

    Args:
        report: Called with (files read, files in all).

    Raises:
        CaptureError: If nothing can be read, or a named file is damaged.
    """
    taking = options or ImportOptions()
    descriptors = [d for path in paths if path.exists() and (d := find_descriptor(path))]
    if descriptors:
        if len(paths) > 1:
            raise CaptureError("an EMVA 1288 descriptor is a complete source; name it alone")
        return [_of_descriptor(descriptors[0], taking)]
    files = [(file, path == file) for path in paths for file in _listed(path)]
    if not files:
        raise CaptureError(
            f"{named([str(p) for p in paths])}: no FITS or TIFF file, EMVA 1288 descriptor or table of statistics "
            "there; name one, or a folder that holds some"
        )
    frames, left_out = _found_in(files, taking.mapped, report)
    root = _common_root(paths)
    sets = []
    for title, several in by_camera(frames).items():
        readable, broken = _readable(several, taking)
        if readable:
            sets.append(assemble(title, readable, root, taking, read_found, [*left_out, *broken]))
        else:
            left_out += broken
    if not sets:
        raise CaptureError(left_out[0] if len(left_out) == 1 else f"{left_out[0]} (and {len(left_out) - 1} more)")
    return sets


@dataclass(frozen=True, slots=True)
class WrittenSet:
    """A capture set that an import wrote: its folder, its frames or settings, and the record of the import."""

    path: Path
    frames: int
    settings: int
    record: ImportRecord


def import_into(
    sources: Sequence[Path],
    output: Path,
    options: ImportOptions | None = None,
    report: Callable[[int, int], None] | None = None,
) -> list[WrittenSet]:
    """Write what files, folders and patterns hold as capture sets: all of them, or none where one cannot be taken.

    A damaged file among others is left out and named in the record.

    Args:
        output: Folder to write; one folder within it per camera where there are several.
        report: Called with (files read, files in all).

    Raises:
        OutputError: If the folder exists already and is not empty, or cannot be written.
        CaptureError: If nothing can be read.
        UnsettledError: If a number has no unit that is known.
        UsageError: If no source is named, or a table of statistics with other sources.
    """
    taking = options or ImportOptions()
    existed = output.exists()
    if existed and (not output.is_dir() or any(output.iterdir())):
        raise OutputError(f"{output} exists already and is not empty; name a new folder")
    if not sources:
        raise UsageError("no source is named; name a file or folder at least")
    table = statistics_of(sources[0], taking.mapped) if sources[0].exists() else None
    if table is not None:
        if len(sources) > 1:
            raise UsageError("a table of statistics is one source; name it alone")
        write_statistics(table, output)
        return [WrittenSet(output, 0, len(table.statistics), record_in(table))]
    found = import_sources(sources, taking, report)
    try:
        return [_written(one, output if len(found) == 1 else output / one.title, sources[0], taking) for one in found]
    except BaseException:
        shutil.rmtree(output, ignore_errors=True)
        if existed:
            output.mkdir(exist_ok=True)
        raise


def _written(one: Assembled, out: Path, source: Path, options: ImportOptions) -> WrittenSet:
    written = copy_into(CaptureSet(source, one.header, FileStore(dict(one.frames), options), colour=None), out)
    return WrittenSet(out, len(written), 0, record_in(written.header))


def copy_into(capture: CaptureSet, out: Path) -> CaptureSet:
    """Write a capture set's frames, as they are taken, as a capture set and return it.

    A frame whose file is damaged is left out, and the record names it; where all are, that is an error.

    Raises:
        OutputError: If the folder exists already and is not empty, or cannot be written.
        CaptureError: If a frame cannot be taken as the options have it, or no file is whole.
    """
    header = capture.header
    known = {"format", "camera", "lens", "source", "patterns", "patches", "frames", "statistics"}
    extra = {key: value for key, value in (header.model_extra or {}).items() if key not in known}
    damaged = list[DamagedFileError]()
    with CaptureSetWriter(
        out, header.camera, header.lens, header.source, header.patches, header.patterns, extra, rescue=False
    ) as writer:
        for index, entry in enumerate(header.frames):
            further = {"original": entry.file, **(entry.model_extra or {})}
            try:
                writer.add(capture.read_frame(index), photons=entry.photons, **further)
            except DamagedFileError as error:
                damaged.append(error)
        if len(damaged) == len(header.frames):
            raise damaged[0]
        if damaged and "imported" in extra:
            record = record_in(header)
            extra["imported"] = replace(record, left_out=(*record.left_out, *map(str, damaged))).to_mapping()
        return writer.finish()


def write_statistics(header: CaptureHeader, out: Path) -> None:
    """Write statistics without pictures as a capture set.

    Raises:
        OutputError: If the folder exists already and is not empty, or cannot be written.
    """
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise OutputError(f"{out} exists already and is not empty; name a new folder")
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"cannot create {out}: {error.strerror or error}") from error
    write_yaml_atomic(out / HEADER_NAME, header.to_mapping())


def _plain_suffix(file: Path) -> str:
    return Path(file.name.lower().removesuffix(".gz")).suffix


def _is_frame_file(path: Path) -> bool:
    suffix = _plain_suffix(path)
    return suffix in FITS_SUFFIXES or suffix in TIFF_SUFFIXES


def _is_raw_tiff(file: Path) -> bool:
    """Return whether a TIFF is a camera's raw frame, with facts that photographs do not carry."""
    try:
        first = read_tiff_headers(file)[0]
    except UnsettledError:
        return True  # it states something of a camera, though not in a known unit
    except (CaptureError, MissingLibrary):
        return False
    return any(fact in first.taken for fact in _RAW_TIFF_FACTS)


def _frame_files(folder: Path) -> list[Path]:
    return sorted(p for p in folder.rglob("*") if _is_frame_file(p) and p.is_file() and not p.name.startswith("."))


def _matching(path: Path) -> list[Path]:
    return sorted(Path(found) for found in glob.glob(str(path), recursive=True))  # noqa: PTH207 (any root)


def _listed(path: Path) -> list[Path]:
    """Return the files that a path names."""
    if path.is_dir():
        return _frame_files(path)
    if path.is_file():
        return [path]
    if any(sign in str(path) for sign in _WILDCARDS):
        return [file for found in _matching(path) for file in _listed(found)]
    refuse_endless(path, CaptureError)
    raise CaptureError(f"{path} does not exist; name a file, a folder or a pattern")


def _common_root(paths: Sequence[Path]) -> Path:
    first = paths[0]
    if len(paths) == 1 and first.is_dir():
        return first
    listed = [file.parent for path in paths for file in _listed(path)]
    root = listed[0]
    while not all(parent.is_relative_to(root) for parent in listed) and root != root.parent:
        root = root.parent
    return root


def _found_in(
    files: Iterable[tuple[Path, bool]], mapped: StatementMap, report: Callable[[int, int], None] | None
) -> tuple[list[FoundFrame], list[str]]:
    frames, left_out = list[FoundFrame](), list[str]()
    listed, lists = list(files), dict[Path, Mapping[str, PhotographSettings]]()
    for number, (file, is_named) in enumerate(listed, start=1):
        try:
            frames += [_listed_time(frame, lists) for frame in _headers(file, mapped)]
        except CaptureError as error:
            if is_named and len(listed) == 1:
                raise
            left_out.append(str(error))
        if report is not None:
            report(number, len(listed))
    return frames, left_out


def _listed_time(frame: FoundFrame, lists: dict[Path, Mapping[str, PhotographSettings]]) -> FoundFrame:
    """Return a frame whose file states no time with that of the list in its folder (exposures.txt), if there is one.

    Args:
        lists: The lists read so far, by folder; one that is met first is added.
    """
    folder = frame.file.parent
    if frame.exposure_known:
        return frame
    if folder not in lists:
        listing = find_list(folder)
        lists[folder] = {} if listing is None else read_list(listing)
    if (stated := lists[folder].get(frame.file.name)) is None:
        return frame
    settings = replace(frame.settings, exposure_s=stated.exposure_s)
    taken = {**frame.taken, "exposure_s": "list of exposure times"}
    return replace(frame, settings=settings, taken=taken, exposure_known=True)


def _headers(file: Path, mapped: StatementMap) -> list[FoundFrame]:
    kind = kind_of(file)
    if kind == "fits":
        return read_fits_headers(file, mapped)
    if kind == "tiff":
        return read_tiff_headers(file, mapped)
    raise CaptureError(
        f"{file}: not FITS or TIFF by its first bytes, no EMVA 1288 descriptor, and no table of means and variances "
        "over exposure (damaged, or of a kind that is not read)"
    )


def _readable(frames: Sequence[FoundFrame], options: ImportOptions) -> tuple[list[FoundFrame], list[str]]:
    """Return the frames whose kind of numbers can be taken, and lines about the others."""
    kept, refused = [], list[str]()
    for frame in frames:
        kind = frame.stored
        if kind in ("uint8", "uint16", "int16") or options.full_scale is not None:
            kept.append(frame)
        else:
            refused.append(
                f"{frame.file.with_name(frame.label)}: holds {kind} values, whose full scale no header states; take "
                "them by `radiometer import --full-scale VALUE`"
            )
    return kept, refused


def _of_descriptor(path: Path, options: ImportOptions) -> Assembled:
    """Return a descriptor's images; the photons give the light, whatever the exposures are."""
    try:
        listing = EmvaListing.read(path)
    except InputError as error:
        raise CaptureError(str(error)) from error
    if not 1 <= listing.bit_depth <= 16:
        raise CaptureError(f"{path}: {listing.bit_depth} bits per pixel; 1 to 16 can be read")
    stated = [e.exposure_s for e in listing.entries if e.photons > 0]
    shortest = min((s for s in stated if s > 0), default=1e-6)
    lit = [(e.exposure_s or shortest, e.photons) for e in listing.entries if e.photons > 0]
    brightest = max((photons / seconds for seconds, photons in lit), default=1.0)
    steady = _is_steady(lit, brightest)
    frames = []
    for entry in listing.entries:
        dark = entry.photons <= 0
        exposure_s = entry.exposure_s if dark else entry.exposure_s or shortest
        settings = FrameSettings(
            exposure_s,
            source_level=1.0 if dark or steady else entry.photons / exposure_s / brightest,
            shutter="closed" if dark else "open",
        )
        shape = (listing.height, listing.width)
        taken = {"exposure_s": "b and d lines", "photons": "b lines"}
        frames += [FoundFrame(f, shape, "uint16", settings, taken=taken, photons=entry.photons) for f in entry.files]
    unsteady = _light_off_exposure(lit)
    doubts = [unsteady] if unsteady else []
    if any(s == 0 for s in stated):
        doubts.append(f"images with light state an exposure of 0: {shortest:g} s is assumed; only the photons are used")
    frames[0] = frames[0].doubting(*doubts)
    return assemble("camera", frames, path.parent, options, read_found, bit_depth=listing.bit_depth)


def _is_steady(lit: Sequence[tuple[float, float]], brightest: float) -> bool:
    """Return whether all photons are those of one flux, rounded or cut to whole numbers."""
    flux = max(lit, default=(1.0, brightest))
    return all(abs(photons - flux[1] / flux[0] * seconds) <= 1.0 + 1e-4 * photons for seconds, photons in lit)


def _light_off_exposure(lit: Sequence[tuple[float, float]]) -> str | None:
    """Return a line where the photons are not proportional to the exposure."""
    fluxes = [photons / seconds for seconds, photons in lit]
    if not fluxes or math.isclose(max(fluxes), min(fluxes), rel_tol=0.02):
        return None
    return (
        f"the photons do not follow the exposure (their ratio varies by {max(fluxes) / min(fluxes):.3g}): the photons "
        "are taken as the light"
    )


__all__ = [
    "FileStore", "ImportRecord", "as_capture", "copy_into", "import_into", "import_sources", "is_foreign",
    "open_capture", "read_found", "statistics_of", "write_statistics",
]  # fmt: skip
