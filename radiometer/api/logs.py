"""What the log of a camera next to a reference meter lacks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from radiometer.api.files import PathLike
from radiometer.api.result import Result
from radiometer.data.statements import StatementMap
from radiometer.importing.log_table import read_log
from radiometer.reconciliation.log_fit import LogFit, fit_log
from radiometer.reconciliation.result import ReconcileResult


@dataclass(frozen=True, repr=False)
class LogFinding(Result):
    """The term that a log lacks against its reference, or that it lacks none.

    Attributes:
        fit: Result, errors before and after, and the negative control.
    """

    fit: LogFit

    @property
    def result(self) -> ReconcileResult:
        """Return the result in the form of reconcile."""
        return self.fit.result

    @property
    def taken(self) -> tuple[str, ...]:
        """Return how columns and units were read, a line each."""
        return tuple(self.fit.state.log.taken)

    @property
    def size(self) -> tuple[int, int]:
        """Return the number of readings and of nights."""
        return self.fit.state.log.size, self.fit.state.log.nights

    def to_mapping(self) -> dict[str, Any]:
        return self.result.to_mapping()

    def to_json(self) -> str:
        return self.result.to_json()

    def __str__(self) -> str:
        names = ", ".join(one.name for one in self.result.effects) or "nothing missing"
        before, after = 100 * self.fit.error_before, 100 * self.fit.error_after
        return f"{self.result.verdict}: {names}; error of a night {before:.2f} % → {after:.2f} %"


def log_fit(
    table: PathLike,
    reference_file: PathLike | None = None,
    *,
    mapped: StatementMap | Sequence[str] = (),
    black: float = 0.0,
    control: bool = True,
) -> LogFinding:
    """Name the term that the log of a camera under automatic exposure lacks against a reference meter.

    Candidates are a constant black, wrong gain steps, another passband than the reference's, temperature, dark current,
    a late shutter and a nonlinear response. The candidate that predicts each night best from the other nights is named,
    with its size.

    Examples:
        >>> import radiometer as rm
        >>> found = rm.log_fit("sky.csv", control=False)
        >>> found.size[1] > 1
        True

    Args:
        table: CSV of the camera's value and exposure, a reference, and perhaps gain, temperature, time, colour.
        reference_file: File of the reference meter with separate times, where it is not a column.
        mapped: Columns and units that the table does not state, such as ["value=roi", "exposure=t:ms", "gain=g:0.1dB"].
        black: Black level in DN to take off the value.
        control: Do the same search over values that lack nothing, as a negative control.

    Raises:
        InputError: If the table cannot be read or a column is missing.
        UnsettledError: If a column's unit is not stated, and `mapped` does not state it.
        MeasurementError: If it holds too few nights.
    """
    meter = Path(reference_file) if reference_file else None
    log = read_log(Path(table), StatementMap.of(mapped), meter, black_dn=black)
    return LogFinding(fit_log(log, control=control))
