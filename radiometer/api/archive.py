"""Archives of captures: one job over all of them, drift over months, and the passport of a camera."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from radiometer.api.files import PathLike
from radiometer.api.meter import PatchLike, as_patch
from radiometer.api.result import Progress, Result
from radiometer.archive.jobs import JOBS, JobSettings
from radiometer.archive.passport import Passport as Passport
from radiometer.archive.passport import passports
from radiometer.archive.run import BatchSummary, run_batch
from radiometer.archive.sessions import find_captures, read_sessions
from radiometer.archive.trend import Trend as Trend
from radiometer.archive.trend import read_histories
from radiometer.archive.trend_report import trend_report
from radiometer.data.event_journal import journal_of
from radiometer.data.storage import check_outputs, write_text_atomic
from radiometer.errors import InputError, UsageError
from radiometer.plausible import AnyCount
from radiometer.progress import counted, unseen


@dataclass(frozen=True, repr=False)
class Batch(Result):
    """How a job over an archive went.

    Attributes:
        summary: Numbers of capture sets, and the rows of those that failed.
        table: The table of results.
        unfinished: Folders of frames or photographs and no header, which were left out.
    """

    summary: BatchSummary
    table: Path
    unfinished: tuple[Path, ...] = ()

    def to_mapping(self) -> dict[str, Any]:
        return self.plain("table", "unfinished", **asdict(self.summary))

    def __str__(self) -> str:
        one = self.summary
        return f"{self.table}: {one.rows_in_table} rows; {one.done} done, {one.skipped} as before"

    @property
    def notes(self) -> list[str]:
        """Return which sets were not read, which failed, how many were done, and whether it was stopped."""
        return [
            *(
                f"left out: {path} holds frames but no capture.yaml (unfinished, or `radiometer import` it first)"
                for path in self.unfinished
            ),
            *(f"failed: {row['capture']}: {row['error']}" for row in self.summary.failures),
            str(self),
            *(["stopped by the user; run the same words again to go on"] if self.summary.interrupted else []),
        ]


@dataclass(frozen=True, repr=False)
class Trends(Result):
    """Drift of every patch in a table of results.

    Attributes:
        trends: One per patch.
        source: The table.
    """

    trends: tuple[Trend, ...]
    source: str

    def to_mapping(self) -> dict[str, Any]:
        return self.plain("trends")

    def write_report(self, path: PathLike) -> None:
        """Write the report (HTML): outcome, histories, figures. Raises OutputError."""
        write_text_atomic(Path(path), trend_report(list(self.trends), self.source))

    def __str__(self) -> str:
        return ", ".join(f"{one.patch}: {one.verdict}" for one in self.trends)


@dataclass(frozen=True, repr=False)
class Passports(Result):
    """What stayed and what changed between the sessions of each camera.

    Attributes:
        cameras: One passport per camera.
    """

    cameras: tuple[Passport, ...]

    def __str__(self) -> str:
        lines = []
        for one in self.cameras:
            changed = ", ".join(change.quantity for change in one.changes if change.changed) or "nothing"
            lines.append(f"{' '.join(one.camera)}: {len(one.sessions)} sessions, changed: {changed}")
        return "; ".join(lines)


def batch(
    archive: PathLike,
    do: str = "measure",
    output: PathLike = "results.csv",
    *,
    scheduler: str | None = None,
    workers: AnyCount = 0,
    calibration: PathLike | None = None,
    patch: PatchLike | None = None,
    maps: PathLike | None = None,
    force: bool = False,
    progress: Progress | None = None,
) -> Batch:
    """Do one job on every capture set of an archive and write one table of results.

    What the table holds already of the same captures, settings and code is not done again. A capture set that fails
    becomes a row with its error and does not stop the rest. An interrupt leaves a usable table.

    Examples:
        >>> import radiometer as rm
        >>> rm.batch("out/chart", "measure", "results.csv", patch=(8, 8, 16, 16))
        <Batch results.csv: 1 rows; 1 done, 0 as before>

    Args:
        archive: Folder of capture sets at any depth, or a glob.
        do: "merge", "response", "measure", "characterise" or "reconcile".
        output: Table to write, .parquet or .csv; what it holds already is not done again.
        scheduler: Dask scheduler that runs already: tcp://HOST:PORT.
        workers: Local worker processes; 0 works in this process.
        calibration: Calibration file; relative values without one.
        patch: Region; each capture set's own patches by default.
        maps: Folder for radiance maps (Zarr), with "merge".
        force: Replace a table whose journal is missing.
        progress: Called after every capture set.

    Raises:
        UsageError: If there is no such job, or the table's name has no known ending.
        OutputError: If the table cannot be written.
    """
    if do not in JOBS:
        raise UsageError(f"--do {do!r}: there is no such job; there are {', '.join(JOBS)}")
    check_outputs(Path(output), force=force or journal_of(Path(output)).exists())
    region = as_patch(patch)
    captures, unfinished = find_captures(str(archive))
    settings = JobSettings(
        do,
        calibration=str(calibration) if calibration else None,
        patch=(region.x, region.y, region.width, region.height) if region else None,
        maps=str(Path(maps).resolve()) if maps else None,
    )
    report = counted(progress, do)
    summary = run_batch(
        captures, settings, Path(output), scheduler=scheduler, workers=workers,
        progress=lambda done, total, _rows: report(done, total),
    )  # fmt: skip
    return Batch(summary, Path(output), tuple(unfinished))


def trend(results: PathLike, quantity: str = "radiance") -> Trends:
    """Find the drift of a source or of the instrument over months, with its uncertainty.

    Neighbours may be correlated and seasons may cycle: both are in the model, and a drift is claimed only where chance
    would show it in fewer than one archive in a hundred.

    Examples:
        >>> import radiometer as rm
        >>> rm.trend("history.csv")
        <Trends lamp: drift>

    Args:
        results: Table written by `batch`.
        quantity: Quantity to follow.

    Raises:
        InputError: If the table cannot be read, or holds no dated rows of that quantity.
    """
    found = read_histories(Path(results), quantity)
    if not found:
        raise InputError(f"{results}: holds no dated {quantity!r} rows that succeeded; run `radiometer batch` first")
    return Trends(tuple(found), str(results))


def passport(archive: PathLike, *, progress: Progress | None = None) -> Passports:
    """Compare the sessions of each camera in an archive: what changed, what did not, and what was the light.

    Fits one law of the dark current to all sessions, compares the stated gain with the gain from light and from darks,
    and lists the figures that changed. Changes of the light are listed separately from changes of the camera.

    Examples:
        >>> import radiometer as rm
        >>> rm.passport("out/chart")
        <Passports FLIR BFS-U3-19S4M 22500001...: 1 sessions, changed: nothing>

    Args:
        archive: Folder of sessions at any depth: capture sets, FITS or raw TIFF frames.
        progress: Called before every session.

    Raises:
        InputError: If it holds no session.
    """
    report = progress or unseen
    return Passports(tuple(passports(read_sessions(Path(archive), lambda name: report(f"reading {name}", 0, None)))))
