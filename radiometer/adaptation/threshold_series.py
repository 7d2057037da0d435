"""Thresholds over time, as a dark-adaptation test gives them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radiometer.adaptation.threshold_files import number_of, read_table
from radiometer.data.reader_limits import bounded_reader
from radiometer.data.statements import StatementMap
from radiometer.errors import InputError, MeasurementError
from radiometer.plausible import PLAUSIBLE
from radiometer.statistics.scale import MEDIAN_U, neighbour_sigma

FEWEST: Final = 8  # one more than the seven parameters of the largest model
LEAST_RECOVERY: Final = 0.15  # log10 units; a series that moves by less shows no recovery


@dataclass(frozen=True, slots=True, eq=False)
class ThresholdSeries:
    """Thresholds of one eye after one bleach."""

    time_min: NDArray[np.float64]  # minutes after the bleach ended, ascending, shape (n,)
    # log10 of the threshold, shape (n,); of whatever unit the stimulus was calibrated in
    log_threshold: NDArray[np.float64]
    # Relative weights' standard deviations in log10 units, shape (n,); None where all count alike
    sigma: NDArray[np.float64] | None = None
    # What the file says of itself in lines beginning with #, by lower-case name
    facts: Mapping[str, str] = field(default_factory=dict)
    taken: tuple[str, ...] = ()  # what was made of the file's form and units, in words

    def __post_init__(self) -> None:
        for name in ("time_min", "log_threshold", "sigma"):
            values = getattr(self, name)
            if values is not None and not np.all(np.isfinite(values)):
                raise InputError(f"the series holds a {name} that is not a number")
        if self.time_min.shape != self.log_threshold.shape or self.time_min.ndim != 1:
            raise InputError("a threshold series needs one threshold per time")
        if np.any(np.diff(self.time_min) < 0):
            raise InputError("the times of a threshold series must ascend")

    @property
    def u_method_log10(self) -> float:
        """Return the standard uncertainty of the method's bias, which all thresholds share; 0 where none is stated."""
        return number_of(self.facts, "u_method_bias_log10") or 0.0

    @property
    def level_name(self) -> str:
        """Return what the thresholds are log₁₀ of, for an axis: as the run states it, else that it is not known."""
        return self.facts.get("level_unit") or "unit not stated"

    @classmethod
    @bounded_reader(error=InputError)
    def read(cls, path: Path, mapped: StatementMap | None = None) -> ThresholdSeries:
        """Return the series in a file of any form that `read_table` knows, less the method's bias that it states.

        Args:
            path: The file.
            mapped: Where the user states that `time` and `threshold` are, and in which unit.

        Raises:
            InputError: If the file is missing or not of that form.
            UnsettledError: If a unit is not stated.
        """
        table = read_table(path, mapped)
        rows = table.rows
        for time, threshold in rows[:, :2]:
            PLAUSIBLE["time_in_dark"].check(f"{path}: time", time)
            PLAUSIBLE["log10_threshold"].check(f"{path}: log10 threshold after {time:g} min", threshold)
        sigma = rows[:, 2] if rows.shape[1] == 3 else None
        bias = number_of(table.facts, "method_bias_log10") or 0.0
        removed = (f"the method's bias of {bias:+.3f} log₁₀ units is removed from each threshold",) if bias else ()
        return cls(rows[:, 0], rows[:, 1] - bias, sigma, table.facts, (*table.taken, *removed))

    def require_recovery(self) -> None:
        """Refuse a series that can show no adaptation.

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
        noise = neighbour_sigma(np.diff(self.log_threshold))
        if fall < max(LEAST_RECOVERY, 2.5 * MEDIAN_U * noise * math.sqrt(2 / edge)):
            raise MeasurementError(
                f"the threshold falls by {fall:.2f} log units from beginning to end: no recovery is seen; "
                "check the bleach, and whether the subject was there"
            )
