"""Reads times and thresholds from files that R saves (`save`, `saveRDS`), such as those of the package `Dark`."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from radiometer.data.reader_limits import bounded_reader, unpacked
from radiometer.errors import InputError

# gzip, bzip2 and xz, in which R packs; its own binary and ASCII forms, with and without the head of `save`.
_BEGINNINGS: Final = (
    b"\x1f\x8b", b"BZh", b"\xfd7zXZ", b"RDX2\n", b"RDX3\n", b"RDA2\n", b"RDA3\n", b"X\n", b"A\n3\n", b"A\n2\n",
)  # fmt: skip
_MOST_BYTES: Final = 64_000_000  # unpacked; a study of a hundred runs has less than 1 MB
AS_TEXT: Final = "write.csv(data.frame(time=dark$time, thrs=dark$thrs), 'run.csv')"
_TIME: Final = ("time", "Time", "t")
_THRESHOLD: Final = ("thrs", "thresholds", "threshold", "Thrs")


def is_r_file(beginning: bytes) -> bool:
    """Return whether a file with these first bytes is one that R saved."""
    return beginning.startswith(_BEGINNINGS)


@bounded_reader(error=InputError, apart="rdata")
def read_r_lists(path: Path) -> tuple[str, list[float], list[float]]:
    """Return name, times and thresholds of the one object with `time` and `thrs` in a file of R.

    Args:
        path: What `save`, `saveRDS` or `save(ascii = TRUE)` wrote.

    Raises:
        InputError: If there is none or several, `rdata` is not installed, or the file is damaged.
    """
    try:
        import rdata
    except ImportError as error:
        raise InputError(
            f"{path}: a file of R; `pip install 'radiometer[r]'` reads it, or write it as text there: {AS_TEXT}"
        ) from error
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # classes that it does not know, such as "dark", are read as plain lists
            parsed = rdata.parser.parse_data(unpacked(path, path.read_bytes(), _MOST_BYTES))
            known = rdata.conversion.convert(parsed)
    except (InputError, MemoryError):
        raise
    except Exception as error:  # whatever a damaged file makes the library raise
        raise InputError(f"{path}: R's file cannot be read ({error}); write it as text there: {AS_TEXT}") from error
    found = list(_with_thresholds("", known))
    if len(found) != 1:
        problem = "no object with time and thrs" if not found else f"several objects: {', '.join(f[0] for f in found)}"
        raise InputError(f"{path}: holds {problem}; write one as text in R: {AS_TEXT}")
    name, times, thresholds = found[0]
    if len(times) != len(thresholds):
        raise InputError(f"{path}: its list has {len(times)} times and {len(thresholds)} thresholds")
    return name or "it", times, thresholds


def _with_thresholds(name: str, known: Any) -> Iterator[tuple[str, list[float], list[float]]]:
    """Yield what has times and thresholds, in lists and data frames and lists of them."""
    if not (isinstance(known, Mapping) or hasattr(known, "columns")):
        return
    keys = list(known)
    time = next((key for key in _TIME if key in keys), None)
    threshold = next((key for key in _THRESHOLD if key in keys), None)
    if time is not None and threshold is not None:
        yield name, _numbers(known[time]), _numbers(known[threshold])
    elif isinstance(known, Mapping):
        for key, value in known.items():
            yield from _with_thresholds(f"{name}${key}" if name else str(key), value)


def _numbers(values: Any) -> list[float]:
    return [float(value) for value in np.asarray(values, dtype=np.float64).ravel()]
