"""Runs a job over an archive: in this process, on local workers, or on a Dask cluster that stands already."""

from __future__ import annotations

import ctypes
import errno
import fcntl
import os
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from io import BytesIO
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Self

from radiometer.archive.jobs import COLUMNS, JobSettings, Row, run_job
from radiometer.data.event_journal import journal_of
from radiometer.data.json_text import json_text, parsed_json
from radiometer.data.storage import write_bytes_atomic
from radiometer.errors import DeviceNotFound, OutputError, OutputRefused, UsageError, required_library
from radiometer.one_thread import on_one_blas_thread
from radiometer.reporting.plain_text import spreadsheet_cell

if TYPE_CHECKING:
    from distributed import Client

# So many tasks are handed out ahead per worker thread: enough to keep it busy, few enough to stop soon.
_AHEAD = 3
# Captures per task: handing a task out and taking its result back costs as much as a small capture itself.
_LARGEST_TASK = 8
# How long a scheduler may take to answer, in s.
SCHEDULER_PATIENCE_S = 10.0
_Task = tuple[Path, JobSettings, frozenset[str]]
Progress = Callable[[int, int, list[Row]], None]

# mallopt(3): parameter numbers of glibc, and the largest block that a thread's heap may hold on 64-bit machines.
_TRIM_THRESHOLD: Final = -1
_MMAP_THRESHOLD: Final = -3  # malloc.h of glibc
_LARGEST_BLOCK: Final = 32 << 20  # glibc's own upper limit on 64 bits
_KEPT_BYTES: Final = 256 << 20  # a capture's frames are read again and again: giving them back costs page faults
_BEGINNING: Final = f'[{{"{COLUMNS[0]}":'  # of every journal, even where a kill cut its first line short
_NUMBERS: Final = ("value", "u", "captured")
TABLE_ENDINGS = (".parquet", ".csv")


class ResultJournal:
    """Rows in a journal next to the table, one JSON line per capture set, flushed to disk as each task ends.

    A line that a kill cut short is left out when reading; its capture set is simply done again.

    Args:
        table: The table's file, ending in .parquet or .csv; the journal is next to it.
    """

    def __init__(self, table: Path) -> None:
        if table.suffix not in TABLE_ENDINGS:
            raise UsageError(f"-o {table}: the table's name must end in {' or '.join(TABLE_ENDINGS)}")
        self.table, self.path = table, journal_of(table)
        self._rows: list[Row] = []
        self._descriptor = -1

    def __enter__(self) -> Self:
        try:
            self._descriptor = os.open(self.path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o666)
            self._take_lock()
            self._rows = list(self._read())
            if self.path.stat().st_size and not self.path.read_bytes().endswith(b"\n"):
                os.write(self._descriptor, b"\n")
        except OSError as error:
            self.__exit__()
            raise OutputError(f"cannot write {self.path}: {error.strerror or error}") from error
        except OutputRefused:
            self.__exit__()
            raise
        return self

    def _take_lock(self) -> None:
        """Let no other program add to the table: each would write it without the rows of the other."""
        try:
            fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise OutputRefused(f"another program adds to {self.table}; wait for it, or name another table") from error
        except OSError as error:
            if error.errno not in (errno.ENOLCK, errno.EOPNOTSUPP):  # a file system without locks
                raise

    def add(self, finished: list[list[Row]]) -> None:
        """Append the rows of some capture sets, a line each. Raises OutputError if the disk refuses them."""
        lines = [json_text(rows, ascii_only=True).encode() + b"\n" for rows in finished if rows]
        if not lines:
            return
        try:
            os.write(self._descriptor, b"".join(lines))
            os.fsync(self._descriptor)
        except OSError as error:
            raise OutputError(f"cannot write {self.path}: {error.strerror or error}") from error
        self._rows += [row for rows in finished for row in rows]

    def done(self, fingerprint: str) -> dict[str, str]:
        """Return capture → content hash of what is done already under a fingerprint; failures are tried again."""
        return {
            row["capture"]: row["content_hash"]
            for row in self._rows
            if row["fingerprint"] == fingerprint and row["status"] == "ok"
        }

    def write_table(self) -> int:
        """Write the table, sorted and whole or not at all, and return its number of rows.

        For each capture, job, patch and quantity the newest row stands.
        """
        import pandas as pd

        newest = {(r["capture"], r["job"], r["patch"], r["quantity"]): r for r in self._without_old_failures()}
        ordered = sorted(
            newest.values(), key=lambda r: tuple(str(r[k]) for k in ("capture", "job", "patch", "quantity"))
        )
        # No column of text holds a name that is not UTF-8.
        ordered = [row | {"capture": row["capture"].encode(errors="backslashreplace").decode()} for row in ordered]
        frame = pd.DataFrame(ordered, columns=list(COLUMNS)).astype(dict.fromkeys(_NUMBERS, float))
        content = BytesIO()
        if self.table.suffix == ".parquet":
            frame.to_parquet(content, index=False)
        else:
            content.write(frame.map(spreadsheet_cell).to_csv(index=False).encode())
        write_bytes_atomic(self.table, content.getvalue())
        return len(frame)

    def __exit__(self, *_: object) -> None:
        if self._descriptor >= 0:
            os.close(self._descriptor)

    def _without_old_failures(self) -> Iterable[Row]:
        """Leave out what a later run of the same capture and job has replaced."""
        last = {(row["capture"], row["job"]): (row["fingerprint"], row["status"]) for row in self._rows}
        return [r for r in self._rows if last[r["capture"], r["job"]] == (r["fingerprint"], r["status"])]

    def _read(self) -> Iterable[Row]:
        text = self.path.read_text(encoding="utf-8", errors="replace")
        if not _BEGINNING.startswith(text[: len(_BEGINNING)]):
            raise OutputRefused(f"{self.path} is no journal of a table; move it away, or name another table")
        for line in text.splitlines():
            try:
                rows = parsed_json(line)
            except ValueError:
                continue
            if isinstance(rows, list) and all(map(_is_row, rows)):
                yield from rows


def _is_row(row: Any) -> bool:
    """Return whether a value is a row as `run_job` makes it."""
    if not isinstance(row, dict) or not row.keys() >= set(COLUMNS):
        return False
    return all(isinstance(row[name], int | float | None) for name in _NUMBERS)


@cache
def keep_freed_memory() -> bool:
    """Let this process keep up to 256 MB that it has freed, and return whether that could be set (glibc only).

    By default an array of a few megabytes comes from the kernel page by page and goes back when it is freed; Dask sets
    its workers so that even less is kept. Half of a worker's processor time then goes into clearing pages.
    """
    if not sys.platform.startswith("linux"):
        return False
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (OSError, AttributeError):  # another C library
        return False
    return bool(mallopt(_MMAP_THRESHOLD, _LARGEST_BLOCK)) and bool(mallopt(_TRIM_THRESHOLD, _KEPT_BYTES))


@dataclass(frozen=True, slots=True)
class BatchSummary:
    """How a run over an archive went: numbers of capture sets, and the rows of those that failed."""

    done: int
    skipped: int
    failures: tuple[Row, ...]
    rows_in_table: int
    interrupted: bool = False


def run_batch(
    captures: list[Path],
    settings: JobSettings,
    table: Path,
    *,
    scheduler: str | None = None,
    workers: int = 0,
    progress: Progress | None = None,
) -> BatchSummary:
    """Do a job on every capture set that is not done yet and write the table.

    Args:
        table: Table to write, .parquet or .csv; what it holds of the same captures, settings and code is kept.
        scheduler: Address of a Dask scheduler, "tcp://HOST:PORT"; None for this machine.
        workers: Local worker processes; 0 works in this process. Ignored with a scheduler.
        progress: Called after every capture set with how many are done, how many there are, and its rows.

    Raises:
        UsageError: If the table's name has no known ending.
        OutputError: If the table cannot be written.
        DeviceNotFound: If no scheduler answers.
        MissingLibrary: If the extra `cluster` is not installed.
    """
    done = skipped = 0
    failures: list[Row] = []
    interrupted = False
    with ResultJournal(table) as journal:
        known = journal.done(settings.fingerprint())
        try:
            for finished in _results(captures, settings, known, scheduler, workers):
                journal.add(finished)
                for rows in finished:
                    done, skipped = done + bool(rows), skipped + (not rows)
                    failures += [row for row in rows if row["status"] == "failed"]
                    if progress:
                        progress(done + skipped, len(captures), rows)
        except KeyboardInterrupt:
            interrupted = True
        count = journal.write_table()
    return BatchSummary(done, skipped, tuple(failures), count, interrupted)


def _results(
    captures: list[Path], settings: JobSettings, known: dict[str, str], scheduler: str | None, workers: int
) -> Iterator[list[list[Row]]]:
    """Yield the rows of every capture set, those of one task together."""
    tasks: list[_Task] = [
        (path, settings, frozenset({known[str(path)]} if str(path) in known else ())) for path in captures
    ]
    if scheduler is None and workers == 0:
        yield from (_run_jobs([task]) for task in tasks)
        return
    with _client(scheduler, workers) as client:
        yield from _on_cluster(client, tasks)


@on_one_blas_thread  # the order of a sum's terms depends on the number of threads, and Dask's workers have one
def _run_jobs(tasks: list[_Task]) -> list[list[Row]]:
    keep_freed_memory()
    return [run_job(*task) for task in tasks]


def _on_cluster(client: Client, tasks: list[_Task]) -> Iterator[list[list[Row]]]:
    """Yield results as they come, handing out a new task for each; a task lost with its worker is run again."""
    from distributed import as_completed

    threads = max(1, sum(client.nthreads().values()))
    size = max(1, min(_LARGEST_TASK, len(tasks) // (4 * threads)))
    waiting = iter([tasks[first : first + size] for first in range(0, len(tasks), size)])

    def submit(several: list[_Task]) -> Any:
        return client.submit(_run_jobs, several, pure=False, retries=2)

    running = as_completed([submit(several) for several in islice(waiting, _AHEAD * threads)])
    for future in running:
        for several in islice(waiting, 1):
            running.add(submit(several))
        yield future.result()
        future.release()


@contextmanager
def _client(scheduler: str | None, workers: int) -> Iterator[Client]:
    distributed = required_library(
        "distributed", "Dask is not installed; `pip install 'radiometer[cluster]'`, or use --workers 0"
    )
    if scheduler is not None:
        try:
            client = distributed.Client(scheduler, timeout=SCHEDULER_PATIENCE_S)
        except (OSError, TimeoutError, ValueError) as error:
            raise DeviceNotFound(
                f"no Dask scheduler answers at {scheduler}: start one, or leave out --scheduler"
            ) from error
        with client:
            yield client
        return
    with (
        distributed.LocalCluster(n_workers=workers, threads_per_worker=1, dashboard_address=None) as cluster,
        distributed.Client(cluster) as client,
    ):
        yield client
