"""Writing a capture set so that it is either finished or recognisably unfinished."""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import cv2

from radiometer.data.capture_header import (
    CameraDescription,
    LensDescription,
    PatchDescription,
    SourceDescription,
)
from radiometer.data.capture_set import HEADER_NAME, CaptureHeader, CaptureSet, FrameEntry
from radiometer.data.frame import Frame
from radiometer.data.storage import check_new_folder, dump_yaml, state_folder, write_bytes_atomic
from radiometer.errors import OutputError


class CaptureSetWriter:
    """Writes frames as they arrive and `capture.yaml` last.

    Use as a context manager: leaving it without an error finishes the set; leaving it with one removes
    what was written, so that no half-written capture set stays behind.

    Args:
        path: Folder to create; it must not exist, or be empty.
        camera: The camera as its datasheet believes it to be.
        lens: The lens.
        source: The light source.
        patches: Known regions of the scene.
        patterns: Names of the displayed patterns.
        extra: Further top-level keys of `capture.yaml`.
        rescue: Where the folder takes no more frames, go on in the user's state folder: frames of a camera cannot be
            taken again, those of other files can.
    """

    def __init__(
        self,
        path: Path,
        camera: CameraDescription,
        lens: LensDescription | None = None,
        source: SourceDescription | None = None,
        patches: tuple[PatchDescription, ...] = (),
        patterns: tuple[str, ...] = ("default",),
        extra: dict[str, object] | None = None,
        *,
        rescue: bool = True,
    ) -> None:
        self.path = path
        self._camera, self._lens, self._source = (
            camera,
            lens or LensDescription(),
            source or SourceDescription(),
        )
        self._patches, self._patterns, self._extra = patches, patterns, extra or {}
        self._entries: list[FrameEntry] = []
        self._rescue, self._failure = rescue, ""

    def __enter__(self) -> Self:
        check_new_folder(self.path)
        try:
            (self.path / "frames").mkdir(parents=True)
        except OSError as error:
            raise OutputError(f"cannot create {self.path}: {error.strerror or error}") from error
        return self

    def add(self, frame: Frame, **further: Any) -> None:
        """Write one frame: the camera's own raw file where it has one, its digital numbers as PNG where not.

        Args:
            frame: The frame.
            further: Further keys of its entry in `capture.yaml`.

        Raises:
            OutputError: If the disk refuses it.
        """
        suffix = frame.file.suffix if frame.file else ".png"
        name = f"frames/{len(self._entries):04d}{suffix}"
        self._write(name, frame.file.content if frame.file else self._as_png(frame))
        self._entries.append(FrameEntry.of(name, frame.settings, **further))

    def _as_png(self, frame: Frame) -> bytes:
        done, encoded = cv2.imencode(".png", frame.dn, [cv2.IMWRITE_PNG_COMPRESSION, 1])
        if not done:
            raise OutputError(f"cannot encode frame {len(self._entries)} as PNG")
        return encoded.tobytes()

    def _write(self, name: str, content: bytes) -> None:
        try:
            write_bytes_atomic(self.path / name, content, rescue=False)
        except OutputError as failure:
            if not self._rescue or self._failure or not self._go_elsewhere(failure):
                raise
            write_bytes_atomic(self.path / name, content, rescue=False)

    def _go_elsewhere(self, failure: OutputError) -> bool:
        """Move what was written to the user's state folder, and return whether that was possible."""
        try:
            state_folder().mkdir(parents=True, exist_ok=True)
            elsewhere = Path(tempfile.mkdtemp(prefix="saved-", dir=state_folder())) / self.path.name[-64:]
            shutil.copytree(self.path, elsewhere)
        except (OSError, shutil.Error):
            return False
        self._remove()
        self.path, self._failure = elsewhere, str(failure)
        return True

    def finish(self) -> CaptureSet:
        """Write `capture.yaml` and return the finished set.

        Raises:
            OutputError: If no frame was added or the disk refuses it. The message names the place of a set that had to
                be finished elsewhere.
        """
        if not self._entries:
            raise OutputError(f"{self.path}: no frame was captured, so there is nothing to finish")
        header = CaptureHeader(
            camera=self._camera,
            lens=self._lens,
            source=self._source,
            patterns=self._patterns,
            patches=self._patches,
            frames=tuple(self._entries),
            **self._extra,
        )
        self._write(HEADER_NAME, dump_yaml(header.to_mapping()).encode())
        if self._failure:
            raise OutputError(
                f"{self._failure}; the finished capture set is saved as {self.path}: move it to where it belongs"
            )
        return CaptureSet(self.path, header)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is not None:
            if not (self._failure and (self.path / HEADER_NAME).exists()):  # finished elsewhere: that is the error
                self._remove()
        elif not (self.path / HEADER_NAME).exists():
            try:
                self.finish()
            except BaseException:
                if not (self.path / HEADER_NAME).exists():
                    self._remove()
                raise

    def _remove(self) -> None:
        for file in (self.path / "frames").glob("*"):
            file.unlink(missing_ok=True)
        (self.path / HEADER_NAME).unlink(missing_ok=True)
        for folder in (self.path / "frames", self.path):
            if folder.is_dir() and not any(folder.iterdir()):
                folder.rmdir()
