"""Names are held to laws of no entry: on both sides of what they must bring, and on a session that hides a glow."""

import pytest

from radiometer.reconciliation.propose.search import own_covariates
from radiometer.reconciliation.result import Verdict
from simulators.effects.dark_current import DarkCurrent
from simulators.effects.display_nonuniformity import DisplayNonuniformity
from simulators.effects.led_thermal_droop import LedThermalDroop
from simulators.effects.mechanical_vignetting import MechanicalVignetting
from simulators.effects.natural_vignetting import NaturalVignetting
from simulators.effects.response_nonlinearity import ResponseNonlinearity
from testing.outside import two
from testing.outside.two_hidden import HIDDEN


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


@pytest.mark.slow
def test_the_glow_of_an_amplifier_is_no_dark_current(tmp_path):
    """A Gaussian from a corner in proportion to the exposure is named as glow, not as dark current."""
    from radiometer.reconciliation.engine import reconcile_capture

    session = two.make(11, HIDDEN["corner_glow"], "darks")
    result = reconcile_capture(session.write(tmp_path / "set")).result
    assert result.verdict is Verdict.EFFECTS_FOUND
    assert [effect.name for effect in result.effects] == ["amplifier_glow"]
