"""Capture sets for the commands, whatever a user names, with what an import doubts said on standard error."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from radiometer.cli.console import note

if TYPE_CHECKING:
    from radiometer.data import CaptureSet


def opened(path: Path) -> CaptureSet:
    """Return the capture set behind a path: its own folder, or FITS, raw TIFF and EMVA 1288 files taken directly.

    Raises:
        CaptureError: If there is none, or it is damaged.
    """
    from radiometer.importing import imported_of, open_capture

    capture = open_capture(path)
    if capture.store is not None:
        for line in imported_of(capture).lines():
            note(f"{path.name}: {line}")
    return capture
