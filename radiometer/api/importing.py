"""What laboratories have, as capture sets."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from radiometer.api.files import PathLike
from radiometer.api.meter import PatchLike, as_patch
from radiometer.api.result import Progress, Result
from radiometer.data.statements import StatementMap
from radiometer.importing import ImportOptions, import_into
from radiometer.importing.sources import WrittenSet
from radiometer.plausible import Count, Positive
from radiometer.progress import counted


@dataclass(frozen=True, repr=False)
class Imported(Result):
    """Capture sets made of foreign files.

    Attributes:
        capture_sets: One per camera and band.
    """

    capture_sets: tuple[WrittenSet, ...]

    def to_mapping(self) -> dict[str, Any]:
        return {"capture_sets": [_mapping(one) for one in self.capture_sets]}

    def __str__(self) -> str:
        return ", ".join(
            f"{one.path}: {one.frames} frames" if one.frames else f"{one.path}: {one.settings} settings"
            for one in self.capture_sets
        )


def import_capture(
    sources: PathLike | Sequence[PathLike],
    output: PathLike,
    *,
    crop: PatchLike | None = None,
    sample: Count = 1,
    full_scale: Positive | None = None,
    pedestal: float = 0.0,
    mapped: StatementMap | Sequence[str] = (),
    progress: Progress | None = None,
) -> Imported:
    """Turn frames and tables of any laboratory into capture sets.

    Reports what was taken from where, what is missing, what is doubted and what of the files is not used. A number
    without a known unit stops the import; `mapped` settles it. Frames of several cameras, bands or unknown gains
    become a capture set each, in folders of their names.

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
        mapped: Where a fact stands, and its unit: "exposure=IMG_EXP:ms", "gain=GAIN:0.1dB", or a YAML file of such.
        progress: Called while headers are read.

    Raises:
        UsageError: If a table of statistics is not named alone.
        UnsettledError: If a number has no unit that is known.
        CaptureError: If the files cannot be read or contradict each other.
        OutputError: If the folder is not empty or cannot be written.
    """
    several = [sources] if isinstance(sources, str | os.PathLike) else sources
    stated = StatementMap.of(mapped)
    options = ImportOptions(as_patch(crop), sample, full_scale, pedestal, stated)
    report = counted(progress, "reading headers")
    return Imported(tuple(import_into([Path(one) for one in several], Path(output), options, report)))


def _mapping(one: WrittenSet) -> dict[str, Any]:
    counted = {"frames": one.frames} if one.frames else {"settings": one.settings}
    return {"path": str(one.path), **counted, **one.record.to_mapping()}
