"""Reconciles whatever a user names: capture set, photographs, EMVA descriptor, table of a meter or lamp.

What was found is written as report, plan, law, or as a camera model that the simulator loads.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from radiometer.data import CaptureSet, Frame
from radiometer.data.capture_set import CaptureHeader
from radiometer.data.provenance import utc_now
from radiometer.data.storage import write_text_atomic
from radiometer.errors import CaptureError, OutputError
from radiometer.importing import imported_of, is_foreign, open_capture, statistics_of
from radiometer.importing.light_tables import is_drive_table
from radiometer.reconciliation.descent import effect_covariance, fitted_parameters
from radiometer.reconciliation.engine import Say, examine, limit_at, whole_catalogue
from radiometer.reconciliation.photographs import PhotographsReconciled, reconcile_photographs
from radiometer.reconciliation.propose import Proposal, propose_law, write_files
from radiometer.reconciliation.reduce import Progress
from radiometer.reconciliation.report_page import report_html
from radiometer.reconciliation.result import FoundEffect, ReconcileResult, Verdict
from radiometer.reconciliation.search import Reconciled
from radiometer.reconciliation.separability import write_plan
from radiometer.reconciliation.state import FitState
from radiometer.reconciliation.tables import DriveFit, MeterReconciled, reconcile_drive_table, reconcile_meter_table
from radiometer.reporting.origin import Origin
from simulators.chain.camera_model import CameraModel
from simulators.chain.undeclared import completed
from simulators.effects.base import Stage
from simulators.effects.catalogue import CatalogueEffect
from simulators.effects.registry import EffectEntry


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
        effects = self.result.effects
        if not any(effect.name == "unnamed" or effect.other_law is not None for effect in effects):
            return None
        found = propose_law(self._reconciled.start)
        if found is not None:
            write_files(found, folder, self._source.name)
        return found

    def write_model(self, path: Path, *, provisional: bool = False) -> str:
        """Write the model with what was found."""
        digest = self._hash() if self._hash else None
        reconciled_model(self._reconciled, digest, provisional=provisional).write(path)
        return str(path)

    def write_report(self, path: Path) -> str:
        """Write the HTML report."""
        write_text_atomic(path, report_html(self._reconciled, self._source.name, self._origin()))
        return str(path)

    def _origin(self) -> Origin:
        further = (("model", self._model), ("capture set", str(self._source)))
        return Origin.of_captures([self._header], further=further)

    def write_plan(self, path: Path) -> bool:
        """Write the captures of this set and the next one as a plan, and return whether there is a next one."""
        return write_plan(path, self._reconciled.result, self._reconciled.outcome.state.design)


Done = DoneCapture | PhotographsReconciled | MeterReconciled | DriveFit


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
        without: Entries to leave out of the catalogue.
        photographs: Frames of a folder of photographs by colour, the one to report on first, read by the caller.
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


# ---- model file -----------------------------------------------------------------------------------------------------
_SMALLEST, _LARGEST = 0.01, 1.0  # quantum efficiency


def reconciled_model(
    reconciled: Reconciled, capture_hash: str | None = None, *, provisional: bool = False
) -> CameraModel:
    """Return the camera model with the found effects, the fitted responsivity and whatever no datasheet declared.

    Effects of an incomplete result are written switched off, for their names may still change.
    """
    state, well = reconciled.outcome.state, limit_at(Stage.WELL)
    found = {effect.name: effect for effect in reconciled.result.effects}
    model = _base(state)
    # Where no fit holds it, the full well is the one that the brightest pixels show.
    if well.name in found and all(effect.name != well.name for effect in state.effects):
        shown_e = found[well.name].parameters[well.fitted[0]].value
        camera = model.camera.model_copy(update={"full_well_e": shown_e})
        model = CameraModel.ideal(camera, model.lens, model.wavelength_nm)
    for effect in state.model.given:
        model = model.with_effect(effect)
    enabled = provisional or reconciled.result.verdict is not Verdict.INCOMPLETE
    for effect in state.effects:
        model = model.with_effect(effect, _notes(state, effect, found.get(effect.name), capture_hash))
        if not enabled:
            entries = [EffectEntry(e.effect, False, e.notes) if e.effect is effect else e for e in model.entries]
            model = CameraModel(model.camera, tuple(entries), model.lens, model.wavelength_nm)
    return model


def _base(state: FitState) -> CameraModel:
    header, off = state.design.header, state.nuisance.off
    declared = header.camera
    known: dict[str, Any] = {
        "dark_current_e_per_s": max((declared.dark_current_e_per_s or 0.0) + off.dark_e_per_s, 0.0)
    }
    if declared.black_level_dn is None:
        known["black_level_dn"] = max(off.black_dn, 0.0)
    camera = completed(declared, off)
    known["quantum_efficiency"] = efficiency = camera.quantum_efficiency or _LARGEST
    if any(value is not None for tile in state.design.tiles for value in tile.radiance):
        taken = np.prod([effect.responsivity_taken() for effect in state.effects])
        fitted = efficiency * float(np.exp(off.log_responsivity) / taken)
        # Beyond the bounds the pixels must be larger or smaller, or the light other, than declared.
        known["quantum_efficiency"] = min(max(fitted, _SMALLEST), _LARGEST)
        known["pixel_pitch_um"] = (camera.pixel_pitch_um or 1.0) * float(np.sqrt(fitted / known["quantum_efficiency"]))
    return CameraModel.ideal(camera.model_copy(update=known), header.lens, header.source.wavelength_nm or 550.0)


def _notes(
    state: FitState, effect: CatalogueEffect, found: FoundEffect | None, capture_hash: str | None
) -> dict[str, Any]:
    parameters = fitted_parameters(state)[effect.name]
    names, covariance = _covariance(state, effect)
    notes: dict[str, Any] = {
        "found_by": "radiometer reconcile",
        "created": utc_now(),
        "u": {name: entry.u for name, entry in parameters.items() if entry.u is not None},
        "covariance": {"parameters": names, "matrix": covariance},
    }
    if capture_hash:
        notes["capture_sha256"] = capture_hash
    if found is not None:
        notes |= {
            "where": found.where,
            "gap_before": found.gap_before,
            "gap_after": found.gap_after,
            "gain_nats": found.gain_nats,
            "alternatives": list(found.alternatives),
            "provisional": found.provisional,
        }
    return notes


def _covariance(state: FitState, effect: CatalogueEffect) -> tuple[list[str], list[list[float]]]:
    own = state.parameters
    index = state.effects.index(effect)
    free = [i for i in range(own.size) if i not in state.frozen]
    mine = [k for k, i in enumerate(free) if own.owner[i] == index]
    block = effect_covariance(state)[np.ix_(mine, mine)]
    scale = own.scale[[free[k] for k in mine]]
    scaled = block * scale[:, None] * scale[None, :]
    return [own.names[free[k]] for k in mine], [[float(v) for v in row] for row in scaled]
