"""Takes whatever a user names (capture set, photographs, EMVA descriptor, table of a meter or lamp), reconciles it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Protocol

from radiometer.data import CaptureSet, Frame
from radiometer.data.capture_set import CaptureHeader
from radiometer.errors import CaptureError, OutputError
from radiometer.importing import imported_of, is_foreign, open_capture, statistics_of
from radiometer.importing.drive_table import is_drive_table
from radiometer.reconciliation.drive.drive_fit import reconcile_drive_table
from radiometer.reconciliation.engine import Say, examine, whole_catalogue
from radiometer.reconciliation.inputs.light_meter import reconcile_meter_table
from radiometer.reconciliation.inputs.photographs import reconcile_photographs
from radiometer.reconciliation.measure.reduce import Progress
from radiometer.reconciliation.propose import Proposal
from radiometer.reconciliation.result import ReconcileResult
from radiometer.reconciliation.search.outcome import Reconciled
from radiometer.reporting.origin import Origin
from simulators.chain.camera_model import CameraModel


class Done(Protocol):
    """A result that can write its files."""

    @property
    def result(self) -> ReconcileResult:
        """Return the result."""
        ...

    def write_model(self, path: Path, *, provisional: bool = False) -> str:
        """Write the new model and return its name."""
        ...

    def write_report(self, path: Path) -> str:
        """Write the HTML report and return its name."""
        ...

    def write_plan(self, path: Path) -> bool:
        """Write the next capture as a plan for `radiometer bracket`, and return whether there is one."""
        ...


class DoneCapture:
    """A reconciled capture set."""

    def __init__(
        self, reconciled: Reconciled, source: Path, content_hash: Callable[[], str] | None, header: CaptureHeader,
        model: str,
    ) -> None:  # fmt: skip
        self._reconciled, self._source, self._hash = reconciled, source, content_hash
        self._header, self._model = header, model

    @property
    def result(self) -> ReconcileResult:
        """Return the result."""
        return self._reconciled.result

    def propose(self, folder: Path) -> Proposal | None:
        """Write the law that explains the unnamed disagreement best as effect, test and plan, and return it.

        None where everything has a name already, or where no law is beyond chance.

        Raises:
            OutputError: If a file cannot be written.
        """
        from radiometer.reconciliation.propose import propose_law, write_files

        effects = self.result.effects
        if not any(effect.name == "unnamed" or effect.other_law is not None for effect in effects):
            return None
        found = propose_law(self._reconciled.start)
        if found is not None:
            write_files(found, folder, self._source.name)
        return found

    def write_model(self, path: Path, *, provisional: bool = False) -> str:
        """Write the model with what was found."""
        from radiometer.reconciliation.report.write_back import reconciled_model

        digest = self._hash() if self._hash else None
        reconciled_model(self._reconciled, digest, provisional=provisional).write(path)
        return str(path)

    def write_report(self, path: Path) -> str:
        """Write the HTML report."""
        from radiometer.reconciliation.report.html import write_report

        write_report(path, self._reconciled, self._source.name, self._origin())
        return str(path)

    def _origin(self) -> Origin:
        """Return what the capture set states of camera, lens, date and conditions."""
        further = (("model", self._model), ("capture set", str(self._source)))
        return Origin.of_captures([self._header], further=further)

    def write_plan(self, path: Path) -> bool:
        """Write the captures of this set and the next one as a plan, and return whether there is a next one."""
        from radiometer.reconciliation.advice.next_capture import write_plan

        return write_plan(path, self._reconciled.result, self._reconciled.outcome.state.design)


def reconcile_source(
    path: Path,
    *,
    model_path: Path | None = None,
    without: tuple[str, ...] = (),
    photographs: Sequence[Sequence[Frame]] = (),
    progress: Progress | None = None,
    say: Say = lambda line: None,
    doubt: Say = lambda line: None,
) -> Done:
    """Return the result for a capture set, photographs, files of a laboratory (FITS, TIFF, EMVA) or a table.

    A table is of a light meter, or of a light engine's drives.

    Args:
        path: What the user names.
        model_path: Model file to start from.
        without: Entries to leave out of the catalogue.
        photographs: Frames of a folder of photographs by colour, the one to report on first, read by the caller.
        progress: Called with frames done and frames in all.
        say: Told what happens.
        doubt: Told what is missing and what is doubted of files that are read where they are.

    Raises:
        CaptureError: If the path holds nothing that can be reconciled.
    """
    model = CameraModel.read(model_path) if model_path else None
    entries = {name: kind for name, kind in whole_catalogue().items() if name not in without}
    if path.suffix.lower() == ".csv" and statistics_of(path) is None:
        return reconcile_drive_table(path) if is_drive_table(path) else reconcile_meter_table(path)
    if photographs:
        return reconcile_photographs(photographs[0], photographs[1:], str(path))
    if path.is_file() and not is_foreign(path):
        raise CaptureError(
            f"{path}: give a capture set's folder, FITS or raw TIFF files, an EMVA 1288 descriptor (.txt) or a meter "
            "table (.csv)"
        )
    capture = open_capture(path)
    for line in imported_of(capture).lines() if capture.store else ():
        doubt(line)
    shape = capture.read_frame(0).shape
    found = examine(capture.header, capture.read_frame, shape, model, catalogue=entries, progress=progress, say=say)
    return DoneCapture(found, path, lambda: _hash(capture), capture.header, str(model_path or "ideal, of the header"))


def _hash(capture: CaptureSet) -> str:
    try:
        return capture.content_hash()
    except OSError as error:
        raise OutputError(f"cannot read {capture.path} again for its hash: {error}") from error
