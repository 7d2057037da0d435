"""A screen's calibration in the file forms of other programs."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Final

from radiometer.data.storage import write_bytes_atomic, write_text_atomic
from radiometer.errors import UsageError
from radiometer.screen.calibration import ScreenCalibration
from radiometer.screen.exports.formats import to_cal, to_csv, to_inverse_csv, to_psychopy_json, to_ti3, to_vcgt
from radiometer.screen.exports.icc import profile_notes, to_icc
from radiometer.screen.exports.report_page import to_page

# Kind on the command line: function, and ending of the file's name.
EXPORTS: Final[dict[str, tuple[Callable[[ScreenCalibration], str | bytes], str]]] = {
    "psychopy": (to_psychopy_json, ".json"),
    "ti3": (to_ti3, ".ti3"),
    "csv": (to_csv, ".csv"),
    "inverse": (to_inverse_csv, ".inverse.csv"),
    "vcgt": (to_vcgt, ".vcgt"),
    "cal": (to_cal, ".cal"),
    "icc": (to_icc, ".icc"),
    "page": (to_page, ".html"),
}
# What a form assumes and cannot hold itself, a line each.
NOTES: Final[dict[str, Callable[[ScreenCalibration], list[str]]]] = {"icc": profile_notes}


def write_export(calibration: ScreenCalibration, kind: str, path: Path) -> None:
    """Write one of `EXPORTS`. Raises UsageError if there is no such kind; OutputError if the file cannot be written."""
    if kind not in EXPORTS:
        raise UsageError(f"export {kind!r} is unknown; choose from {', '.join(EXPORTS)}")
    content = EXPORTS[kind][0](calibration)
    if isinstance(content, bytes):
        write_bytes_atomic(path, content)
    else:
        write_text_atomic(path, content)


__all__ = ["EXPORTS", "NOTES", "write_export"]
