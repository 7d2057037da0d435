"""Which capture sets an archive holds."""

from __future__ import annotations

import glob
from pathlib import Path

from radiometer.data.capture_set import HEADER_NAME
from radiometer.errors import InputError


def find_captures(archive: str) -> tuple[list[Path], list[Path]]:
    """Return the finished capture sets of an archive and the folders that look unfinished, both sorted.

    Args:
        archive: A folder, searched at any depth, or a glob such as "2026-*/bench-1".

    Raises:
        InputError: If there is no capture set.
    """
    matches = [archive] if Path(archive).is_dir() else glob.glob(archive, recursive=True)  # noqa: PTH207 (any root)
    roots = [Path(found) for found in matches]
    finished = sorted({header.parent for root in roots if root.is_dir() for header in root.rglob(HEADER_NAME)})
    unfinished = sorted(
        {
            frames.parent
            for root in roots
            if root.is_dir()
            for frames in root.rglob("frames")
            if frames.is_dir() and not (frames.parent / HEADER_NAME).exists()
        }
    )
    if not finished:
        raise InputError(
            f"{archive}: holds no capture set (no folder with {HEADER_NAME}); name their folder, or a glob"
        )
    return finished, unfinished
