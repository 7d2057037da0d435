"""The camera model that a reconciliation writes: what was found, with its evidence, switched on where it is sure."""

from dataclasses import replace

import numpy as np
import pytest

from radiometer.reconciliation.engine import examine, whole_catalogue
from radiometer.reconciliation.result import Verdict
from radiometer.reconciliation.sources import reconciled_model
from simulators.chain.camera_model import CameraModel

PLAN = [{"t": float(t)} for t in np.geomspace(1e-4, 6e-3, 9)] + [{"t": t, "shutter": "closed"} for t in (1e-4, 1.0)]
NAME, OFFSET_S = "exposure_time_offset", 8e-6


@pytest.fixture(scope="module")
def late(make_capture):
    """Return what is found of a camera whose exposures are 8 µs too long, where that is the only entry."""
    captured = make_capture(seed=82, plan=PLAN, exposure=lambda t: t + OFFSET_S)
    entries = {NAME: whole_catalogue()[NAME]}
    read = captured.frames.__getitem__
    return examine(captured.header, read, captured.frames[0].shape, catalogue=entries, with_limits=False)


def entry_of(model):
    """Return the one entry of the effect in a model."""
    (entry,) = [entry for entry in model.entries if entry.effect.name == NAME]
    return entry


def test_the_effect_is_written_with_its_value_and_evidence(late, tmp_path):
    """Value within 4 u of the truth, u and covariance agree, evidence and capture are named; it all reads back."""
    model = reconciled_model(late, "abc123")
    model.write(tmp_path / "model.yaml")
    entry = entry_of(CameraModel.read(tmp_path / "model.yaml"))
    (name,) = entry.notes["u"]
    u = entry.notes["u"][name]
    assert abs(entry.effect.values()[name] - OFFSET_S) < 4.0 * u
    assert u < 1e-6
    assert entry.enabled
    assert entry.notes["covariance"]["parameters"] == [name]
    assert entry.notes["covariance"]["matrix"][0][0] == pytest.approx(u**2, rel=1e-3, abs=0.0)
    (found,) = late.result.effects
    assert (entry.notes["where"], entry.notes["gain_nats"]) == ("exposure_s", found.gain_nats)
    assert entry.notes["gap_before"] > entry.notes["gap_after"] == pytest.approx(1.0, abs=0.2)
    assert entry.notes["capture_sha256"] == "abc123"
    assert entry.notes["found_by"] == "radiometer reconcile"


def test_names_that_may_change_are_off_and_responsivity_is_efficiency(late):
    """Provisional ones are asked for; what no efficiency can be becomes larger pixels."""
    incomplete = replace(late, result=replace(late.result, verdict=Verdict.INCOMPLETE))
    assert not entry_of(reconciled_model(incomplete)).enabled
    assert entry_of(reconciled_model(incomplete, provisional=True)).enabled
    assert "capture_sha256" not in entry_of(reconciled_model(incomplete)).notes
    state = late.outcome.state
    camera = state.design.header.camera
    model = reconciled_model(late)
    factor = float(np.exp(state.nuisance.off.log_responsivity))
    declared = camera.quantum_efficiency or 1.0
    efficiency, pitch = model.camera.quantum_efficiency, model.camera.pixel_pitch_um
    assert 0.0 < efficiency <= 1.0
    assert efficiency * pitch**2 == pytest.approx(declared * factor * (camera.pixel_pitch_um or 1.0) ** 2, rel=1e-6)
