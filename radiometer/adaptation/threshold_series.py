"""Thresholds over time, as a dark-adaptation test gives them."""

from __future__ import annotations

import csv
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radiometer.errors import InputError, MeasurementError

TIME_NAMES: Final = ("time_min", "time", "t", "minutes")
THRESHOLD_NAMES: Final = ("log10_threshold", "log_threshold", "threshold", "thrs")
SIGMA_NAMES: Final = ("u_log10_threshold", "sigma", "u")
FEWEST: Final = 8
LEAST_RECOVERY: Final = 0.15  # log10 units; a series that moves by less shows no recovery


@dataclass(frozen=True, slots=True, eq=False)
class ThresholdSeries:
    """Thresholds of one eye after one bleach.

    Attributes:
        time_min: Minutes after the bleach ended, ascending, shape (n,).
        log_threshold: log10 of the threshold, shape (n,); of whatever unit the stimulus was calibrated in.
        sigma: Relative weights' standard deviations in log10 units, shape (n,); None where all count alike.
    """

    time_min: NDArray[np.float64]
    log_threshold: NDArray[np.float64]
    sigma: NDArray[np.float64] | None = None

    def __post_init__(self) -> None:
        for name in ("time_min", "log_threshold", "sigma"):
            values = getattr(self, name)
            if values is not None and not np.all(np.isfinite(values)):
                raise InputError(f"the series holds a {name} that is not a number")
        if self.time_min.shape != self.log_threshold.shape or self.time_min.ndim != 1:
            raise InputError("a threshold series needs one threshold per time")
        if np.any(np.diff(self.time_min) < 0):
            raise InputError("the times of a threshold series must ascend")

    @classmethod
    def read(cls, path: Path) -> ThresholdSeries:
        """Return the series in a CSV file with columns of time in min and log10 threshold, with or without header.

        Raises:
            InputError: If the file is missing or not of that form.
        """
        try:
            with path.open(encoding="utf-8-sig", newline="") as stream:
                rows = [row for row in csv.reader(stream) if any(cell.strip() for cell in row)]
        except (OSError, UnicodeDecodeError) as error:
            raise InputError(f"cannot read {path}: {error}") from error
        if not rows:
            raise InputError(f"{path} is empty; expected columns time_min,log10_threshold")
        columns, first = _columns(path, rows[0])
        numbers = [_numbers(path, number, row, columns) for number, row in enumerate(rows[first:], first + 1)]
        table = np.array(sorted(numbers), dtype=np.float64).reshape(-1, len(columns))
        return cls(table[:, 0], table[:, 1], table[:, 2] if len(columns) == 3 else None)

    def require_recovery(self) -> None:
        """Refuse a series from which no adaptation can be told.

        Raises:
            MeasurementError: If there are too few thresholds, or they do not fall: who never pressed, pressed always or
                left gives no adaptation curve.
        """
        count = self.time_min.size
        if count < FEWEST:
            raise MeasurementError(f"{count} thresholds are too few for a fit; at least {FEWEST} are needed")
        edge = max(3, count // 4)
        spread = float(np.ptp(self.log_threshold))
        fall = float(np.median(self.log_threshold[:edge]) - np.median(self.log_threshold[-edge:]))
        if spread < 1e-9:
            raise MeasurementError(
                f"all {count} thresholds are {self.log_threshold[0]:g}: "
                "the button was never, or always, pressed; there is nothing to fit"
            )
        # Standard error of a difference of two medians of `edge` values; noise from differences of neighbours.
        noise = 1.4826 * float(np.median(np.abs(np.diff(self.log_threshold)))) / math.sqrt(2)
        if fall < max(LEAST_RECOVERY, 2.5 * 1.2533 * noise * math.sqrt(2 / edge)):
            raise MeasurementError(
                f"the threshold falls by {fall:.2f} log units from beginning to end: no recovery is seen; "
                "check the bleach, and whether the subject was there"
            )


def _columns(path: Path, header: list[str]) -> tuple[tuple[int, ...], int]:
    """Return positions of time, threshold (and sigma), and the number of the first row of numbers."""
    words = [word.strip().lower() for word in header]
    if all(_is_number(word) for word in words if word):
        if len(words) < 2:
            raise InputError(f"{path}: expected columns time_min,log10_threshold")
        return tuple(range(min(len(words), 3))), 0
    found = []
    for names in (TIME_NAMES, THRESHOLD_NAMES, SIGMA_NAMES):
        position = next((words.index(name) for name in names if name in words), None)
        if position is None and names is not SIGMA_NAMES:
            raise InputError(f"{path}: no column {names[0]} in its header ({', '.join(header)})")
        found += [] if position is None else [position]
    return tuple(found), 1


def _numbers(path: Path, number: int, row: list[str], columns: tuple[int, ...]) -> tuple[float, ...]:
    try:
        values = tuple(float(row[column]) for column in columns)
    except (IndexError, ValueError) as error:
        raise InputError(f"{path}, line {number}: expected numbers, found {','.join(row)!r}") from error
    if len(values) == 3 and values[2] <= 0:
        raise InputError(f"{path}, line {number}: a standard deviation must be above 0")
    return values


def _is_number(word: str) -> bool:
    try:
        return math.isfinite(float(word))
    except ValueError:
        return False
