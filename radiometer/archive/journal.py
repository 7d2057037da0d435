"""Rows on disk as they come: a journal that survives a kill, and the table made from it."""

from __future__ import annotations

import os
from collections.abc import Iterable
from io import BytesIO
from pathlib import Path
from typing import Self

from radiometer.archive.jobs import COLUMNS, Row
from radiometer.data.event_journal import journal_of
from radiometer.data.json_text import json_text, parsed_json
from radiometer.data.storage import write_bytes_atomic
from radiometer.errors import OutputError, UsageError
from radiometer.reporting.plain_text import spreadsheet_cell

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
        self._rows = list(self._read())
        try:
            self._descriptor = os.open(self.path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o666)
            if self.path.stat().st_size and not self.path.read_bytes().endswith(b"\n"):
                os.write(self._descriptor, b"\n")
        except OSError as error:
            raise OutputError(f"cannot write {self.path}: {error.strerror or error}") from error
        return self

    def add(self, finished: list[list[Row]]) -> None:
        """Append the rows of some capture sets, a line each. Raises OutputError if the disk refuses them."""
        lines = [json_text(rows).encode() + b"\n" for rows in finished if rows]
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
        frame = pd.DataFrame(ordered, columns=list(COLUMNS)).astype({"value": float, "u": float, "captured": float})
        content = BytesIO()
        if self.table.suffix == ".parquet":
            frame.to_parquet(content, index=False)
        else:
            content.write(frame.map(spreadsheet_cell).to_csv(index=False).encode())
        write_bytes_atomic(self.table, content.getvalue())
        return len(frame)

    def __exit__(self, *_: object) -> None:
        os.close(self._descriptor)

    def _without_old_failures(self) -> Iterable[Row]:
        """Leave out what a later run of the same capture and job has replaced."""
        last = {(row["capture"], row["job"]): (row["fingerprint"], row["status"]) for row in self._rows}
        return [r for r in self._rows if last[r["capture"], r["job"]] == (r["fingerprint"], r["status"])]

    def _read(self) -> Iterable[Row]:
        if not self.path.exists():
            return
        for line in self.path.read_text(encoding="utf-8", errors="replace").splitlines():
            try:
                rows = parsed_json(line)
            except (ValueError, RecursionError):
                continue
            yield from rows
