"""Takes whatever a user names (capture set, photographs, EMVA descriptor, light-meter table) and reconciles it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Protocol

from radiometer.data import Frame
from radiometer.data.capture_set import HEADER_NAME
from radiometer.errors import CaptureError, OutputError
from radiometer.other_data.emva_sets import find_descriptor, read_emva_set
from radiometer.other_data.light_meter import reconcile_meter_table
from radiometer.other_data.photographs import reconcile_photographs
from radiometer.reconcile.engine import Progress, Reconciled, Say, examine, reconcile_capture, whole_catalogue
from radiometer.reconcile.report.result import ReconcileResult
from simulators.camera_model import CameraModel


class Done(Protocol):
    """A result that can write what goes with it."""

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
        """Write the next capture as a plan for `radiometer bracket`, and tell whether there is one."""
        ...


class DoneCapture:
    """A reconciled capture set."""

    def __init__(self, reconciled: Reconciled, source: Path, content_hash: Callable[[], str] | None) -> None:
        self._reconciled, self._source, self._hash = reconciled, source, content_hash

    @property
    def result(self) -> ReconcileResult:
        """Return the result."""
        return self._reconciled.result

    def write_model(self, path: Path, *, provisional: bool = False) -> str:
        """Write the model with what was found."""
        from radiometer.reconcile.report.write_back import reconciled_model

        digest = self._hash() if self._hash else None
        reconciled_model(self._reconciled, digest, provisional=provisional).write(path)
        return str(path)

    def write_report(self, path: Path) -> str:
        """Write the HTML report."""
        from radiometer.reconcile.report.html import write_report

        write_report(path, self._reconciled, self._source.name)
        return str(path)

    def write_plan(self, path: Path) -> bool:
        """Write the captures of this set and the next one as a plan, and tell whether there is a next one."""
        from radiometer.reconcile.advice.next_capture import write_plan

        return write_plan(path, self._reconciled.result, self._reconciled.outcome.state.design)


def reconcile_source(
    path: Path,
    *,
    model_path: Path | None = None,
    without: tuple[str, ...] = (),
    photographs: Sequence[Frame] | None = None,
    progress: Progress | None = None,
    say: Say = lambda line: None,
) -> Done:
    """Return the result for a capture set, photograph folder, EMVA 1288 descriptor or light-meter table.

    Args:
        path: What the user names.
        model_path: Model file to start from.
        without: Entries to leave out of the catalogue.
        photographs: Frames of a folder of photographs, read by the caller.
        progress: Called with frames done and frames in all.
        say: Told what happens.

    Raises:
        CaptureError: If the path holds nothing that can be reconciled.
    """
    model = CameraModel.read(model_path) if model_path else None
    entries = {name: kind for name, kind in whole_catalogue().items() if name not in without}
    if path.suffix.lower() == ".csv":
        return reconcile_meter_table(path)
    if photographs is not None:
        return reconcile_photographs(photographs)
    descriptor = None if (path / HEADER_NAME).exists() else find_descriptor(path)
    if descriptor is not None:
        header, read, shape = read_emva_set(descriptor)
        found = examine(header, read, shape, model, catalogue=entries, progress=progress, say=say)
        return DoneCapture(found, descriptor, None)
    if path.is_file():
        raise CaptureError(
            f"{path}: give a capture set's folder, an EMVA 1288 descriptor (.txt) or a meter table (.csv)"
        )
    done = reconcile_capture(path, model, catalogue=entries, progress=progress, say=say)
    return DoneCapture(done, path, lambda: _hash(path))


def _hash(path: Path) -> str:
    from radiometer.data import CaptureSet

    try:
        return CaptureSet.read(path).content_hash()
    except OSError as error:
        raise OutputError(f"cannot read {path} again for its hash: {error}") from error
