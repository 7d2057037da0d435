"""Names are held to laws of no entry: on both sides of what they must bring, and on a session that hides a glow."""

from __future__ import annotations

import numpy as np
import pytest

from radiometer.reconciliation.fit.covariance import fitted_parameters
from radiometer.reconciliation.fit.descent import refit
from radiometer.reconciliation.fit.state import with_effects
from radiometer.reconciliation.propose.search import own_covariates
from radiometer.reconciliation.result import Verdict
from radiometer.reconciliation.search.moves import in_a_looser_form, in_place_of_all
from radiometer.reconciliation.search.score import worth
from simulators.effects.black_level_offset import BlackLevelOffset
from simulators.effects.dark_current import DarkCurrent
from simulators.effects.display_nonuniformity import DisplayNonuniformity
from simulators.effects.dsnu import Dsnu
from simulators.effects.led_thermal_droop import LedThermalDroop
from simulators.effects.mechanical_vignetting import MechanicalVignetting
from simulators.effects.natural_vignetting import NaturalVignetting
from simulators.effects.response_nonlinearity import ResponseNonlinearity
from testing.outside import two
from testing.outside.two_hidden import HIDDEN
from testing.reduced import start_of


@pytest.mark.parametrize(
    ("effect", "along"),
    [
        (LedThermalDroop(), {"source_level"}),
        (ResponseNonlinearity(), {"signal", "value"}),
        (DarkCurrent(), {"temperature_C"}),  # what is not in proportion to the exposure is no current
        *((kind(), {"image_x", "image_y"}) for kind in (DisplayNonuniformity, NaturalVignetting)),
        (MechanicalVignetting(), {"image_x", "image_y", "f_number"}),
    ],
)
def test_the_covariates_of_laws_for_what_an_entry_goes_with(effect, along):
    """The charge and what the amplifier makes of it are one; a radius or a place of the screen is of the picture."""
    assert set(own_covariates(effect)) == along


def ramp(make_capture):
    """Return the starting camera fitted to darks whose black level rises by 2 DN over the rows, −1 to 1 DN."""
    rows = np.arange(64.0)[:, None]
    plan = [{"t": t, "g": g, "shutter": "closed"} for t in (1e-4, 1e-2) for g in (0.0, 12.0)] * 2
    captured = make_capture(6, extra_dn=lambda setting: 2.0 * (rows / 63.0 - 0.5), plan=plan)
    return start_of(captured)


def test_a_ramp_that_is_nothing_in_the_middle_is_an_offset_s_looser_form(make_capture):
    """A black level that rises over the rows, −1 to 1 DN, has no plain part: its tilt is met by itself."""
    start = ramp(make_capture)
    entries = {"dark_current": DarkCurrent, "black_level_offset": BlackLevelOffset}
    found = in_a_looser_form(start, worth(start), entries)
    reported = fitted_parameters(found)["black_level_offset"]
    per_half_side = 2.0 * 48.0 / 63.0  # the longer side has 96 pixels
    for name, value in (("offset_dn", 0.0), ("tilt_x_dn", 0.0), ("tilt_y_dn", per_half_side)):
        assert reported[name].u is not None
        assert abs(reported[name].value - value) < 3.5 * reported[name].u
    assert in_a_looser_form(start, worth(found) + 1.0, entries) is None
    assert in_a_looser_form(start, worth(start), {"dark_current": DarkCurrent}) is None
    left = float(start.comparison.residual(found.prediction) @ start.comparison.residual(found.prediction))
    assert in_a_looser_form(start, worth(start), entries, most=left - 50.0) is None
    assert in_a_looser_form(start, worth(start), entries, most=left + 50.0) is not None


def test_of_models_that_predict_as_well_the_one_of_a_single_cause_is_reported(make_capture):
    """A ramp stands in place of two names that do not explain it, of the ramp next to an idle name, and of no single
    name."""
    start, entries = ramp(make_capture), {"black_level_offset": BlackLevelOffset}
    tilted = in_a_looser_form(start, worth(start), entries)
    one, idle = refit(with_effects(start, [DarkCurrent(2.0)])), Dsnu(0.01)
    for several in ([DarkCurrent(2.0), idle], [idle, *tilted.effects]):
        found = in_place_of_all(start, refit(with_effects(start, several)), entries)
        assert [effect.name for effect in found.effects] == ["black_level_offset"]
        assert found.evidence == pytest.approx(tilted.evidence)
    assert in_place_of_all(start, one, entries) is None
    assert in_place_of_all(start, start, entries) is None


@pytest.mark.parametrize(("odds", "taken"), [(0.0, True), (-1e9, False)])
def test_a_single_cause_needs_the_odds_of_its_name(make_capture, monkeypatch, odds, taken):
    """An entry that is not expected beforehand pays for it against several names."""
    start, entries = ramp(make_capture), {"black_level_offset": BlackLevelOffset}
    monkeypatch.setattr(BlackLevelOffset, "log_prior_odds", odds)
    several = refit(with_effects(start, [DarkCurrent(2.0), Dsnu(0.01)]))
    assert (in_place_of_all(start, several, entries) is not None) is taken


@pytest.mark.slow
def test_the_glow_of_an_amplifier_is_no_dark_current(tmp_path):
    """A Gaussian from a corner in proportion to the exposure is named as glow, provisionally, not as dark current."""
    from radiometer.reconciliation.engine import reconcile_capture

    session = two.make(11, HIDDEN["corner_glow"], "darks")
    result = reconcile_capture(session.write(tmp_path / "set")).result
    assert result.verdict is Verdict.INCOMPLETE
    assert [effect.name for effect in result.effects] == ["amplifier_glow"]
