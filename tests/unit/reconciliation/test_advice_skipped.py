"""Limits and next captures are advice: whatever happens to them, the answer stands."""

from dataclasses import replace

import numpy as np
import pytest

from radiometer.reconciliation import engine
from radiometer.reconciliation.fit.descent import refit
from radiometer.reconciliation.fit.state import with_effects
from simulators.effects.full_well_saturation import FullWellSaturation
from simulators.effects.veiling_glare import VeilingGlare
from testing.reconciled import reconcile
from testing.reduced import start_of

PLAN = [{"t": float(t)} for t in np.geomspace(1e-4, 6e-3, 6) for _ in range(2)] + [{"t": 1e-2, "shutter": "closed"}]


@pytest.mark.long
def test_answer_stands_where_advice_fails(make_capture, monkeypatch):
    """An error in the limits and in the next capture is reported among the assumptions; the name is still found."""

    def broken(*given):
        raise IndexError("index 7 is out of bounds for axis 1 with size 7")

    captured = make_capture(seed=31, plan=PLAN, extra_dn=lambda s: 3.0)
    for name in ("limits", "propose", "propose_for_unnamed", "propose_for_blind"):
        monkeypatch.setattr(engine, name, broken)
    after = reconcile(captured.header, captured.frames)
    assert [effect.name for effect in after.effects] == ["black_level_offset"]
    assert (after.limits, after.next_capture) == ({}, None)
    assert any(text.startswith("the limits could not be computed (IndexError: index 7") for text in after.assumptions)


def test_fit_holds_a_parameter_though_a_term_before_it_falls_to_nothing(make_capture):
    """A ceiling's spread goes to zero, where the ceiling is sharp and has one parameter less; the veil stays held."""
    captured = make_capture(seed=32, plan=PLAN)
    start = start_of(captured)
    added = with_effects(start, [FullWellSaturation(9_000.0, 0.05), VeilingGlare(0.01)])
    assert added.parameters.names == ("full_well_e", "spread_rel", "share")
    fitted = refit(replace(added, frozen=frozenset({2})))
    assert fitted.parameters.names == ("full_well_e", "share")
    assert fitted.effects[1] == VeilingGlare(0.01)
