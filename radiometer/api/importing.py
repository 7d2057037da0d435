"""What laboratories have, as capture sets."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from radiometer.api.files import PathLike
from radiometer.api.meter import PatchLike, as_patch
from radiometer.api.result import Progress, Result
from radiometer.data import CaptureHeader
from radiometer.errors import OutputError, UsageError
from radiometer.importing import ImportOptions, ImportRecord, copy_into, import_sources, imported_of, statistics_of
from radiometer.importing.assembly import Assembled
from radiometer.importing.record import record_in
from radiometer.importing.sources import as_capture, write_statistics


@dataclass(frozen=True, repr=False)
class ImportedSet:
    """One capture set that was written.

    Attributes:
        path: Its folder.
        record: What was taken from where, what is missing, what is doubted.
        frames: Number of frames; 0 for statistics without pictures.
        settings: Number of settings of such statistics.
    """

    path: Path
    record: ImportRecord
    frames: int = 0
    settings: int = 0

    def to_mapping(self) -> dict[str, Any]:
        """Return the documented JSON form."""
        counted = {"frames": self.frames} if self.frames else {"settings": self.settings}
        return {"path": str(self.path), **counted, **self.record.to_mapping()}


@dataclass(frozen=True, repr=False)
class Imported(Result):
    """Capture sets made of foreign files.

    Attributes:
        capture_sets: One per camera and band.
    """

    capture_sets: tuple[ImportedSet, ...]

    def to_mapping(self) -> dict[str, Any]:
        """Return the documented JSON form."""
        return {"capture_sets": [one.to_mapping() for one in self.capture_sets]}

    def __str__(self) -> str:
        """Return folders with what they hold."""
        return ", ".join(
            f"{one.path}: {one.frames} frames" if one.frames else f"{one.path}: {one.settings} settings"
            for one in self.capture_sets
        )


def import_capture(
    sources: PathLike | Sequence[PathLike],
    output: PathLike,
    *,
    crop: PatchLike | None = None,
    sample: int = 1,
    full_scale: float | None = None,
    pedestal: float = 0.0,
    progress: Progress | None = None,
) -> Imported:
    """Turn frames and tables of any laboratory into capture sets.

    Examples:
        >>> import radiometer as rm
        >>> rm.import_capture("statistics.csv", "out/imported")
        <Imported out/imported: 4 settings>

    Args:
        sources: FITS or TIFF files, folders or patterns of them, an EMVA 1288 descriptor, or a table of statistics.
        output: Capture set to write: a new or empty folder. Several cameras become a folder each in it.
        crop: Keep this region only.
        sample: Keep every n-th row and column.
        full_scale: Full scale of files with 32-bit or floating-point numbers.
        pedestal: Value added to every pixel, where numbers go below zero.
        progress: Called while headers are read.

    Raises:
        UsageError: If a table of statistics is not named alone.
        CaptureError: If the files cannot be read or contradict each other.
        OutputError: If the folder is not empty or cannot be written.
    """
    paths = [Path(one) for one in ([sources] if isinstance(sources, str | Path) else list(sources))]  # type: ignore[arg-type]
    out, options = Path(output), ImportOptions(as_patch(crop), sample, full_scale, pedestal)
    table = statistics_of(paths[0]) if paths[0].exists() else None
    if table is not None and len(paths) > 1:
        raise UsageError("a table of statistics is a separate source; name it alone")
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise OutputError(f"{out} exists already and is not empty; name a new folder")
    return Imported(_of_table(table, out) if table is not None else _of_files(paths, options, out, progress))


def _of_table(header: CaptureHeader, out: Path) -> tuple[ImportedSet, ...]:
    write_statistics(header, out)
    return (ImportedSet(out, record_in(header), settings=len(header.statistics)),)


def _of_files(
    sources: list[Path], options: ImportOptions, out: Path, progress: Progress | None
) -> tuple[ImportedSet, ...]:
    def advance(done: int, total: int) -> None:
        if progress:
            progress("reading headers", done, total)

    found, existed = import_sources(sources, options, advance), out.exists()
    try:
        return tuple(_copied(one, out if len(found) == 1 else out / one.title, sources[0], options) for one in found)
    except BaseException:
        # Of several cameras all are written or none.
        shutil.rmtree(out, ignore_errors=True)
        if existed:
            out.mkdir(exist_ok=True)
        raise


def _copied(one: Assembled, out: Path, source: Path, options: ImportOptions) -> ImportedSet:
    written = copy_into(as_capture(one, source, options), out)
    return ImportedSet(out, imported_of(written), frames=len(written))
