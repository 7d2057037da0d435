"""The one rule for times in files and options: ISO 8601, and UTC where no zone is stated."""

from __future__ import annotations

import datetime as dt
from typing import Final

UNIX_S: Final = (1e9, 1e11)  # s since 1970 from 2001 on; as ms or days they would be before 1971 or after 5000


def moment_of(text: str) -> dt.datetime:
    """Return the moment of an ISO 8601 time, with its zone; a time without a zone is UTC, wherever it is read.

    Raises:
        ValueError: If it is no such time.
    """
    moment = dt.datetime.fromisoformat(text.strip())
    return moment if moment.tzinfo is not None else moment.replace(tzinfo=dt.UTC)
