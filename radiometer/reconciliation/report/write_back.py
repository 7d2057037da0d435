"""Writes what was found into a camera model that the simulator loads."""

from __future__ import annotations

from typing import Any

import numpy as np

from radiometer.data import CameraDescription
from radiometer.data.provenance import utc_now
from radiometer.reconciliation.fit.covariance import effect_covariance, fitted_parameters
from radiometer.reconciliation.fit.state import FitState
from radiometer.reconciliation.full_well import limit_at
from radiometer.reconciliation.result import FoundEffect, Verdict
from radiometer.reconciliation.search.outcome import Reconciled
from simulators.chain.camera_model import CameraModel
from simulators.chain.undeclared import completed
from simulators.effects.base import Stage
from simulators.effects.catalogue import CatalogueEffect
from simulators.effects.registry import EffectEntry

_SMALLEST, _LARGEST = 0.01, 1.0  # quantum efficiency


def reconciled_model(
    reconciled: Reconciled, capture_hash: str | None = None, *, provisional: bool = False
) -> CameraModel:
    """Return the camera model with the found effects, the fitted responsivity and whatever no datasheet declared.

    Effects of an incomplete result are written switched off, for their names may still change.
    """
    state = reconciled.outcome.state
    found = {effect.name: effect for effect in reconciled.result.effects}
    model = _base(state, _other_well_e(state, found.get(limit_at(Stage.WELL).name)))
    enabled = provisional or reconciled.result.verdict is not Verdict.INCOMPLETE
    for effect in state.model.given:
        model = model.with_effect(effect)
    for effect in state.effects:
        notes = _notes(state, effect, found.get(effect.name), capture_hash)
        model = model.with_effect(effect, notes)
        if not enabled:
            entries = [_switched_off(entry, effect) for entry in model.entries]
            model = CameraModel(model.camera, tuple(entries), model.lens, model.wavelength_nm)
    return model


def _switched_off(entry: EffectEntry, effect: CatalogueEffect) -> EffectEntry:
    return EffectEntry(entry.effect, False, entry.notes) if entry.effect is effect else entry


def _other_well_e(state: FitState, found: FoundEffect | None) -> float | None:
    """Return the full well that the brightest pixels show in place of the declared one; None where it is fitted."""
    well = limit_at(Stage.WELL)
    fitted = any(effect.name == well.name for effect in state.effects)
    return None if found is None or fitted else found.parameters[well.fitted[0]].value


def _base(state: FitState, other_well_e: float | None = None) -> CameraModel:
    header = state.design.header
    camera = _completed(state)
    if other_well_e is not None:
        camera = camera.model_copy(update={"full_well_e": other_well_e})
    responsivity = float(np.exp(state.nuisance.off.log_responsivity))
    for effect in state.effects:
        responsivity /= effect.responsivity_taken()
    efficiency = camera.quantum_efficiency or _LARGEST
    if any(value is not None for tile in state.design.tiles for value in tile.radiance):
        # Beyond the bounds the pixels must be larger or smaller, or the light other, than declared.
        fitted, efficiency = efficiency * responsivity, min(max(efficiency * responsivity, _SMALLEST), _LARGEST)
        pitch = (camera.pixel_pitch_um or 1.0) * float(np.sqrt(fitted / efficiency))
        camera = camera.model_copy(update={"pixel_pitch_um": pitch})
    camera = camera.model_copy(update={"quantum_efficiency": efficiency})
    return CameraModel.ideal(camera, header.lens, header.source.wavelength_nm or 550.0)


def _completed(state: FitState) -> CameraDescription:
    """Return the camera with every figure that the ideal chain needs: declared, else fitted, else typical."""
    camera, off = state.design.header.camera, state.nuisance.off
    dark = {"dark_current_e_per_s": max((camera.dark_current_e_per_s or 0.0) + off.dark_e_per_s, 0.0)}
    black = {"black_level_dn": max(off.black_dn, 0.0)} if camera.black_level_dn is None else {}
    return completed(camera, off).model_copy(update=dark | black)


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
