"""Histories out of a table of results."""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from radiometer.archive.trend import Trend, fit_trend
from radiometer.data.reader_limits import bounded_reader
from radiometer.errors import InputError

if TYPE_CHECKING:
    import pandas as pd

_LONGEST_HEADING: Final = 10_000  # bytes; a batch writes some 300, and pandas takes a minute for a million columns


@bounded_reader(error=InputError)
def read_histories(table: Path, quantity: str) -> list[Trend]:
    """Return the trend of a quantity for every patch of a table of results.

    Args:
        quantity: Such as "radiance".

    Raises:
        InputError: If the file is no such table, or a patch has too few readings.
    """
    try:
        frame = _parquet(table) if table.suffix == ".parquet" else _csv(table)
    except (OSError, ValueError) as error:
        raise InputError(f"cannot read {table}: {' '.join(str(error).split())[:200]}") from error
    missing = {"captured", "quantity", "patch", "value", "u", "unit", "status"} - set(frame.columns)
    if missing:
        raise InputError(f"{table}: column {sorted(missing)[0]!r} is missing; it is no table of `radiometer batch`")
    chosen = frame[(frame["quantity"] == quantity) & (frame["status"] == "ok") & frame["captured"].notna()]
    try:
        chosen = chosen.astype(dict.fromkeys(("captured", "value", "u"), float))
    except (ValueError, TypeError) as error:
        raise InputError(f"{table}: a time, value or uncertainty is no number ({error})") from error
    return [_history(str(name), quantity, rows) for name, rows in chosen.groupby("patch")]


@bounded_reader(error=InputError, apart="pyarrow")
def _parquet(table: Path) -> pd.DataFrame:
    import pandas as pd

    return pd.read_parquet(table)


def _csv(table: Path) -> pd.DataFrame:
    import pandas as pd

    with table.open("rb") as stream:
        if len(stream.readline(_LONGEST_HEADING + 1)) > _LONGEST_HEADING:
            raise InputError(f"{table}: its first line is longer than {_LONGEST_HEADING} bytes; this is no table")
    return pd.read_csv(table)


def _history(patch: str, quantity: str, rows: pd.DataFrame) -> Trend:
    """Return the trend of one patch, with when its settings changed and what its readings were flagged."""
    trend = fit_trend(
        np.asarray(rows["captured"], float),
        np.asarray(rows["value"], float),
        np.asarray(rows["u"], float),
        patch=patch,
        quantity=quantity,
        unit=str(rows["unit"].iloc[0]),
    )
    flags: Counter[str] = Counter()
    if "flags" in rows:
        for written in rows["flags"].dropna():
            flags.update(flag for flag in re.split(r"[\s,;|]+", str(written)) if flag)
    changes: tuple[float, ...] = ()
    if "fingerprint" in rows:  # of settings, calibration and code
        ordered = rows.sort_values("captured", kind="stable")
        marks, times = (
            ordered["fingerprint"].astype("string").fillna("").to_numpy(),
            ordered["captured"].to_numpy(float),
        )
        changes = tuple(float(t) for t in times[1:][marks[1:] != marks[:-1]])
    return replace(trend, changes_s=changes, flags=dict(flags))
