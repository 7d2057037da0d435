"""What real sensors and lamps do between frames and captures is found where it is hidden."""

from __future__ import annotations

import pytest

from radiometer.reconciliation.result import Verdict
from testing.reconciled import reconcile

PARAMETERS = {
    "lamp_step": ("step_rel", "step"),
    "first_frame_offset": ("offset_dn", "offset_dn"),
    "readout_dark_charge": ("doubling_K", "doubling_K"),
    "line_start_offset": ("decay_share", "decay_share"),
    "correlated_read_noise": ("sigma_e", "sigma_e"),
    "residual_charge": ("share", "share"),
    "event_offset": ("tau_s", "tau_s"),
    "row_dependent_exposure": ("added_s", "added_s"),
}


@pytest.mark.parametrize("name", sorted(PARAMETERS))
def test_it_is_named_with_its_size(hidden_session, name, request):
    """A jumping lamp, unsettled first frames and lines, charge of readout or of traps: named alone, within four u."""
    if name != "lamp_step":
        request.getfixturevalue("laws_left_out")
    session = hidden_session(name, camera_seed=5101)
    found = reconcile(session.header, list(session.frames()), with_limits=False)
    assert found.verdict is Verdict.EFFECTS_FOUND
    assert [effect.name for effect in found.effects] == [name]
    own, true = PARAMETERS[name]
    fitted = found.effects[0].parameters[own]
    assert fitted.u is not None
    assert fitted.value == pytest.approx(session.truth[name][true], abs=4.0 * fitted.u)


def test_a_leak_is_not_distinguished_from_rows_of_longer_exposure(hidden_session, request):
    """The same equation: the one of fewer parameters has the name, the other is next to it."""
    request.getfixturevalue("laws_left_out")
    session = hidden_session("parasitic_light_sensitivity", camera_seed=5102)
    (found,) = reconcile(session.header, list(session.frames()), with_limits=False).effects
    assert found.name == "parasitic_light_sensitivity"
    assert "row_dependent_exposure" in found.alternatives
