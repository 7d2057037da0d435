"""Thresholds of a list of trials, as the R package OPI gives them: when a level was shown, and whether it was seen."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radiometer.errors import InputError

SEEN_WORDS: Final = ("seen", "response", "answer", "detected")
ONSET_WORDS: Final = ("onset", "onset_s", "presented", "timestamp", "elapsed", "clock", "start", "t", "minutes", "time")
YES: Final = ("true", "t", "1", "yes", "y", "seen")
NO: Final = ("false", "f", "0", "no", "n", "unseen", "not seen")
WIDEST_GAP: Final = 1.5  # times the typical gap: a search that begins anew far off shows little of the threshold


def column_of_answers(header: Sequence[str]) -> int | None:
    """Return the column that says whether a trial was seen; None where there is none."""
    words = [cell.strip().lower() for cell in header]
    return next((words.index(word) for word in SEEN_WORDS if word in words), None)


def column_of_onsets(path: Path, header: Sequence[str], rows: Sequence[Sequence[str]], without: int) -> int:
    """Return the column of when each trial was shown: the first of a known name whose numbers ascend.

    OPI's own `time` is the reaction time in ms: it does not ascend. Raises InputError if there is none.
    """
    stems = [re.sub(r"[^a-z]+", "_", re.sub(r"[\[(].*?[\])]", "", cell.lower())).strip("_") for cell in header]
    for word in ONSET_WORDS:
        for at, stem in enumerate(stems):
            named = stem == word or stem.startswith(word + "_") or stem.endswith("_" + word)
            if at != without and named and _ascends([row[at] for row in rows if at < len(row)]):
                return at
    raise InputError(
        f"{path}: a list of trials ({', '.join(header)}) without the time at which each was shown; OPI's `time` is the "
        "reaction time: add a column `onset_s` with the time since the bleach in s"
    )


def _ascends(cells: Sequence[str]) -> bool:
    try:
        values = np.array([float(cell) for cell in cells])
    except ValueError:
        return False
    return values.size > 1 and bool(np.all(np.diff(values) >= 0)) and bool(values[-1] > values[0])


def changes_of_answer(path: Path, trials: NDArray[np.float64], answers: Sequence[str]) -> NDArray[np.float64]:
    """Return time and log10 threshold, shape (m, 2), wherever the answer changes from one trial to the next.

    The brighter of the two levels is the one that was seen, else one of the answers was an error; levels far apart,
    where a search begins anew, are left out. The threshold is midway between the levels, its time between the times.

    Args:
        trials: Times in min, ascending, and log10 levels, shape (n, 2).

    Raises:
        InputError: If an answer is neither yes nor no, or none changes.
    """
    seen = np.array([_answer(path, word) for word in answers])
    level = trials[:, 1]
    rise = np.where(seen[1:], level[1:] - level[:-1], level[:-1] - level[1:])
    changes = (seen[1:] != seen[:-1]) & (rise > 0)
    if not changes.any():
        raise InputError(f"{path}: a list of trials in which the answer never changes between two levels")
    upward = changes & seen[1:]  # from not seen to seen: the steps of the search, not its new beginnings
    typical = float(np.median(rise[upward] if upward.any() else rise[changes]))
    kept = changes & (rise <= WIDEST_GAP * typical)
    middle = 0.5 * (trials[1:] + trials[:-1])
    return np.asarray(middle[kept], dtype=np.float64)


def _answer(path: Path, word: str) -> bool:
    plain = word.strip().strip('"').lower()
    if plain not in YES and plain not in NO:
        raise InputError(f"{path}: the answer {word!r} is neither TRUE nor FALSE")
    return plain in YES
