"""Capture sets: the folder that `radiometer bracket` writes and every analysis reads."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
from pydantic import Field

from radiometer.data.bracket import Bracket
from radiometer.data.capture_header import (
    CameraDescription,
    LensDescription,
    PatchDescription,
    SourceDescription,
)
from radiometer.data.frame import DigitalNumbers, Frame, FrameSettings
from radiometer.data.storage import read_yaml
from radiometer.data.validation import FileSection, validate
from radiometer.errors import CaptureError

FORMAT = "radiometer-capture/1"
HEADER_NAME = "capture.yaml"


class FrameEntry(FileSection):
    """One frame of a capture set as `capture.yaml` lists it."""

    file: str
    exposure_s: float = Field(gt=0)
    gain_db: float = 0.0
    f_number: float | None = Field(None, gt=0)
    black_level_dn: float | None = None
    temperature_C: float | None = None  # noqa: N815 (the file's key)
    timestamp_s: float | None = None
    source_level: float = Field(1.0, ge=0)
    pattern: str = "default"
    shutter: Literal["open", "closed"] = "open"

    @property
    def settings(self) -> FrameSettings:
        """Return the settings of the frame."""
        return FrameSettings(
            exposure_s=self.exposure_s,
            gain_db=self.gain_db,
            f_number=self.f_number,
            black_level_dn=self.black_level_dn,
            temperature_c=self.temperature_C,
            timestamp_s=self.timestamp_s,
            source_level=self.source_level,
            pattern=self.pattern,
            shutter=self.shutter,
        )

    @classmethod
    def of(cls, file: str, settings: FrameSettings) -> FrameEntry:
        """Return the entry for a frame stored under `file` (relative to the capture set)."""
        return cls(
            file=file,
            exposure_s=settings.exposure_s,
            gain_db=settings.gain_db,
            f_number=settings.f_number,
            black_level_dn=settings.black_level_dn,
            temperature_C=settings.temperature_c,
            timestamp_s=settings.timestamp_s,
            source_level=settings.source_level,
            pattern=settings.pattern,
            shutter=settings.shutter,
        )


class CaptureHeader(FileSection):
    """The whole of `capture.yaml`."""

    format: str = FORMAT
    camera: CameraDescription
    lens: LensDescription = LensDescription()
    source: SourceDescription = SourceDescription()
    patterns: tuple[str, ...] = ("default",)
    patches: tuple[PatchDescription, ...] = ()
    frames: tuple[FrameEntry, ...] = Field(min_length=1)

    def to_mapping(self) -> dict[str, Any]:
        """Return the plain mapping that stands in the file; what is unknown is left out."""
        unknown = {name for name in ("lens", "source") if getattr(self, name) == type(getattr(self, name))()}
        return self.model_dump(mode="json", exclude_none=True, exclude=unknown)


@dataclass(frozen=True, slots=True)
class CaptureSet:
    """A finished capture set on disk; frames are read when asked for.

    Attributes:
        path: The folder.
        header: What `capture.yaml` says.
    """

    path: Path
    header: CaptureHeader

    @classmethod
    def read(cls, path: Path) -> CaptureSet:
        """Return the capture set in a folder after checking that it is finished and its files exist.

        Raises:
            CaptureError: If the folder is missing, unfinished, or `capture.yaml` is wrong or names absent files.
        """
        if not path.is_dir():
            raise CaptureError(f"{path} is not a folder; a capture set is a folder that holds {HEADER_NAME}")
        header_path = path / HEADER_NAME
        if not header_path.exists():
            raise CaptureError(
                f"{path} holds no {HEADER_NAME}: the capture was not finished (it is written last); capture it again"
            )
        return cls(path, _checked_header(header_path))

    def __len__(self) -> int:
        return len(self.header.frames)

    def read_frame(self, index: int) -> Frame:
        """Return the frame at a position of the header's list.

        Raises:
            CaptureError: If its file is unreadable, not single-channel, or holds values above full scale.
        """
        entry = self.header.frames[index]
        dn = read_digital_numbers(self.path / entry.file)
        bit_depth = self.header.camera.bit_depth
        if bit_depth > 8 and dn.dtype == np.uint8:
            dn = dn.astype(np.uint16)
        frame = Frame(dn, bit_depth, entry.settings, frame_id=index)
        highest = int(dn.max(initial=0))
        if highest > self.header.camera.full_scale_dn:
            raise CaptureError(
                f"{self.path / entry.file}: holds the value {highest}, above the full scale "
                f"{self.header.camera.full_scale_dn} of camera.bit_depth {self.header.camera.bit_depth}"
            )
        return frame

    def frames(self) -> Iterator[Frame]:
        """Yield all frames in the header's order, one in memory at a time.

        Raises:
            CaptureError: If a file is unreadable or sizes differ.
        """
        shape: tuple[int, int] | None = None
        for index, entry in enumerate(self.header.frames):
            frame = self.read_frame(index)
            if shape is not None and frame.shape != shape:
                raise CaptureError(
                    f"{self.path / entry.file}: is {frame.shape[1]} × {frame.shape[0]} pixels, the frames before "
                    f"{shape[1]} × {shape[0]}; all frames of a capture set need one size"
                )
            shape = frame.shape
            yield frame

    def bracket(self, pattern: str | None = None) -> Bracket:
        """Return all frames of one pattern (dark frames always) as a bracket in memory.

        Raises:
            CaptureError: If there is no such frame.
        """
        wanted = self.header.patterns[0] if pattern is None and self.header.patterns else pattern
        chosen = [f for f in self.frames() if f.settings.is_dark or f.settings.pattern == wanted]
        if not any(not f.settings.is_dark for f in chosen):
            raise CaptureError(f"{self.path}: holds no frame of pattern {wanted!r} with the shutter open")
        return Bracket.from_frames(chosen, origin=str(self.path))

    def content_hash(self) -> str:
        """Return the SHA-256 of the header and all frame files, in hexadecimal."""
        digest = hashlib.sha256((self.path / HEADER_NAME).read_bytes())
        for entry in self.header.frames:
            with (self.path / entry.file).open("rb") as stream:
                while block := stream.read(1 << 20):
                    digest.update(block)
        return digest.hexdigest()


def read_digital_numbers(path: Path) -> DigitalNumbers:
    """Return the raw digital numbers of a single-channel 8- or 16-bit PNG or TIFF.

    Raises:
        CaptureError: If the file is missing, truncated, or of another form.
    """
    try:
        content = np.fromfile(path, np.uint8)
    except OSError as error:
        raise CaptureError(f"cannot read frame {path}: {error.strerror or error}") from error
    _refuse_truncated(path, head=content[:8].tobytes(), tail=content[-16:].tobytes())
    image = cv2.imdecode(content, cv2.IMREAD_UNCHANGED) if content.size else None
    if image is None:
        raise CaptureError(f"{path}: not a readable PNG or TIFF (damaged or truncated); capture it again")
    if image.ndim != 2 or image.dtype not in (np.uint8, np.uint16):
        raise CaptureError(
            f"{path}: expected one channel of 8 or 16 bits, found {image.dtype} with shape {image.shape}"
        )
    numbers: DigitalNumbers = image
    return numbers


def _refuse_truncated(path: Path, *, head: bytes, tail: bytes) -> None:
    """Refuse a PNG without its closing chunk: decoders fill the missing rows with zeros and say nothing."""
    if head.startswith(b"\x89PNG") and b"IEND" not in tail:
        raise CaptureError(f"{path}: the PNG is truncated (no closing chunk); copy or capture it again")


def _checked_header(header_path: Path) -> CaptureHeader:
    mapping: Mapping[str, Any] = read_yaml(header_path)
    found = mapping.get("format", FORMAT)
    if found != FORMAT:
        raise CaptureError(f"{header_path}: format is {found!r}; this version reads {FORMAT!r}")
    header = validate(CaptureHeader, mapping, str(header_path), CaptureError)
    folder = header_path.parent.resolve()
    for entry in header.frames:
        file = (folder / entry.file).resolve()
        if not file.is_relative_to(folder):
            raise CaptureError(f"{header_path}: frame {entry.file!r} lies outside the capture set")
        if not file.is_file():
            raise CaptureError(f"{header_path}: frame {entry.file!r} does not exist; the capture set is incomplete")
    _refuse_patches_outside(header, header_path)
    return header


def _refuse_patches_outside(header: CaptureHeader, header_path: Path) -> None:
    names = [patch.name for patch in header.patches]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise CaptureError(f"{header_path}: patch name {twice[0]!r} stands twice")
