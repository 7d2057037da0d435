"""Brackets from what a user has on disk: capture sets and folders of photographs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from radiometer.data import Bracket, CaptureHeader, CaptureSet, Frame
from radiometer.data.capture_set import HEADER_NAME
from radiometer.data.iso_speeds import IsoSpeeds
from radiometer.errors import CaptureError
from radiometer.importing import imported_of, is_foreign, open_capture
from radiometer.importing.photograph_times import find_list
from radiometer.photographs.folder import image_files, read_photographs

_NAMED = 4  # folders that a message names
_UNREAD = frozenset({".heic", ".heif", ".avif", ".webp", ".jxl", ".jp2", ".bmp", ".gif"})


@dataclass(frozen=True, slots=True, eq=False)
class Source:
    """What a user has on disk."""

    path: Path  # where it is
    # Of a capture set one per displayed pattern and source level, of photographs one per channel
    brackets: list[Bracket]
    header: CaptureHeader | None = None  # what a capture set states of camera, lens and source; None of photographs
    listed: str | None = None  # name of the list that gives the exposures of photographs; None where EXIF does
    doubts: tuple[str, ...] = ()  # what is missing and what is doubted of files that are read where they are


def is_photographs(path: Path) -> bool:
    """Return whether a path is a folder of photographs: neither a capture set nor files of another kind."""
    if not path.is_dir() or (path / HEADER_NAME).exists() or is_foreign(path):
        return False
    return bool(image_files(path)) or not (path / "frames").is_dir()


def open_source(
    path: Path,
    channel: str = "luminance",
    *,
    report: Callable[[int, int], None] | None = None,
    speeds: IsoSpeeds | None = None,
    most_pixels: int | None = None,
    interpolated: bool = False,
) -> Source:
    """Return what is in a capture set, a folder of photographs, or files of a laboratory (FITS, raw TIFF, EMVA).

    Every frame carries its file's name in `extra["file"]`. A capture set gives one bracket per displayed pattern; a
    folder of colour photographs one of the requested channel, or three for "each".

    Args:
        path: Folder with `capture.yaml`, or with photographs whose times are in EXIF or in a list next to them; FITS or
            raw TIFF files, a folder or pattern of them, or an EMVA 1288 descriptor.
        channel: "luminance", "red", "green", "blue" or "each"; grey frames have one channel whatever is asked. A
            capture set of a colour camera gives one colour, green for "luminance".
        report: Called with (files read, files in all) as the work goes on.
        speeds: Photographs: what is known of the camera's ISO speeds beyond what it states.
        most_pixels: Photographs: take every n-th pixel where files hold more than this; None for all.
        interpolated: Camera raw files: fill in the colours that every pixel lacks, for pictures.

    Raises:
        CaptureError: If the folder is missing, empty, unfinished or inconsistent.
        UsageError: If there is no such channel, or ISO speeds were given for frames that have none.
    """
    if is_foreign(path):
        (speeds or IsoSpeeds()).refuse_unstated(str(path), set())
        return _of_capture(path, open_capture(path).in_colour(channel), report)
    if not path.exists():
        raise CaptureError(f"{path} does not exist; give a capture set or a folder of photographs")
    if not path.is_dir():
        raise CaptureError(f"{path} is not a folder; give a capture set or a folder of photographs")
    if (path / HEADER_NAME).exists():
        (speeds or IsoSpeeds()).refuse_unstated(str(path), set())
        return _of_capture(path, CaptureSet.read(path).in_colour(channel), report)
    if (path / "frames").is_dir() and not image_files(path):
        CaptureSet.read(path)  # raises: the capture was not finished
    if not any(path.iterdir()):
        raise CaptureError(f"{path} is empty; give a capture set or a folder of photographs")
    if not image_files(path) and find_list(path) is None:
        raise CaptureError(f"{path} holds neither {HEADER_NAME} nor photographs; {_instead(path)}")
    listing = find_list(path)
    brackets = read_photographs(
        path, channel, report=report, speeds=speeds, most_pixels=most_pixels, interpolated=interpolated
    )
    return Source(path, brackets, listed=listing.name if listing else None)


def _of_capture(path: Path, capture: CaptureSet, report: Callable[[int, int], None] | None) -> Source:
    lines = imported_of(capture).lines() if capture.store is not None else []
    doubts = tuple(f"{path.name}: {line}" for line in (*lines, *capture.mosaic_notes))
    return Source(path, _capture_brackets(capture, report), capture.header, doubts=doubts)


def _capture_brackets(capture: CaptureSet, report: Callable[[int, int], None] | None) -> list[Bracket]:
    frames = []
    for frame, entry in zip(capture.frames(), capture.header.frames, strict=True):
        frames.append(replace(frame, extra={**frame.extra, "file": entry.file}))
        if report is not None:
            report(len(frames), len(capture))
    dark = [frame for frame in frames if frame.settings.is_dark]
    light = [frame for frame in frames if not frame.settings.is_dark and frame.settings.source_level > 0]
    groups: dict[tuple[str, float], list[Frame]] = {}
    for frame in light:
        groups.setdefault((frame.settings.pattern, frame.settings.source_level), []).append(frame)
    if not groups:
        raise CaptureError(f"{capture.path}: holds no frame with the shutter open and the source on")
    return [
        Bracket.from_frames([*several, *dark], origin=_origin(capture, pattern, level, len(groups)))
        for (pattern, level), several in groups.items()
    ]


def _origin(capture: CaptureSet, pattern: str, level: float, count: int) -> str:
    return str(capture.path) if count == 1 else f"{capture.path} (pattern {pattern}, source level {level:g})"


def _instead(path: Path) -> str:
    """Return what to give in place of a folder that holds nothing itself: those of its folders that do, by name."""
    if unread := sorted({entry.suffix.lower() for entry in path.iterdir()} & _UNREAD):
        return f"its {', '.join(unread)} files are not read: save them as JPEG, PNG or TIFF"
    inner = sorted(p for p in path.iterdir() if p.is_dir() and ((p / HEADER_NAME).exists() or image_files(p)))
    if not inner:
        return "give a capture set or photographs"
    named = ", ".join(one.name for one in inner[:_NAMED]) + (" …" if len(inner) > _NAMED else "")
    return f"they are in folders below it ({named}); give one of these"
