"""SQLite's connections as a test sees them: each that is opened, and statements that are refused."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest


class Watched(sqlite3.Connection):
    """A connection that refuses some statements on request."""

    refused: tuple[str, int] | None = None  # words of a statement, and SQLite's code for why

    def execute(self, statement: str, *more: Any) -> sqlite3.Cursor:
        """Execute a statement, or refuse it."""
        self._look(statement)
        return super().execute(statement, *more)

    def executemany(self, statement: str, *more: Any) -> sqlite3.Cursor:
        """Execute a statement for several rows, or refuse it."""
        self._look(statement)
        return super().executemany(statement, *more)

    def _look(self, statement: str) -> None:
        if Watched.refused is not None and Watched.refused[0] in statement:
            error = sqlite3.OperationalError("refused")
            error.sqlite_errorcode = Watched.refused[1]
            raise error


@contextmanager
def refusing(words: str, code: int = sqlite3.SQLITE_FULL) -> Iterator[None]:
    """Refuse the statements that hold these words, as a full disk does."""
    Watched.refused = (words, code)
    try:
        yield
    finally:
        Watched.refused = None


def watch(monkeypatch: pytest.MonkeyPatch) -> list[Watched]:
    """Return the connections to journals that are opened from now on, in their order."""
    made: list[Watched] = []
    real = sqlite3.connect

    def connect(*place: Any, **options: Any) -> sqlite3.Connection:
        if ".sqlite" not in str(place):  # the record of coverage is a database, too
            return real(*place, **options)
        made.append(real(*place, **{**options, "factory": Watched}))
        return made[-1]

    monkeypatch.setattr(sqlite3, "connect", connect)
    return made
