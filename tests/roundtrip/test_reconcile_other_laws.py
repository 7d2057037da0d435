"""The right name where the catalogue's equation is wrong, and nothing else that only mends the equation."""

from __future__ import annotations

import pytest

from radiometer.reconciliation import ReconcileResult
from testing.generator.other_laws import OTHER_LAWS, session_of
from testing.reconciled import reconcile

pytestmark = pytest.mark.slow
STRAY = {"veiling_glare", "ambient_light_leak", "display_black_leak"}


def _asked(name: str, seed: int, **plan: str) -> ReconcileResult:
    session = session_of(name, seed, **plan)
    return reconcile(session.header, list(session.frames()), with_limits=False)


def _names(result: ReconcileResult) -> list[str]:
    return [effect.name for effect in result.effects]


@pytest.mark.parametrize("name", ["halo", "prnu", "settling", "falling"])
def test_another_law_has_the_right_name_alone(name: str) -> None:
    """A halo with a power's wings, coarse pixels in small patches, light that settles or falls within each setting."""
    result = _asked(name, 1)
    assert str(result.verdict) == "effects_found"
    assert _names(result) == [OTHER_LAWS[name][1]]
    assert result.gap_after < 1.05


def test_a_field_cut_by_another_law_takes_a_free_one() -> None:
    """A barrel that is no two circles: one name, its law a table along radius and stop, and nothing is left."""
    result = _asked("barrel", 1)
    (found,) = result.effects
    assert "mechanical_vignetting" in (found.name, *found.alternatives)
    assert found.curve is not None
    assert list(found.curve.along) == ["field_radius", "f_number"]
    mapping = found.to_mapping()
    assert mapping["law"] == "other than the catalogue's"
    assert len(mapping["curve"]["factor"]) == len(mapping["curve"]["u"]) == 6 * 4
    assert result.gap_after < 1.02


def test_a_gamma_before_the_black_level_is_a_gamma() -> None:
    """Its name, not a handful of others that bend together; what is left is one entry."""
    result = _asked("gamma", 1)
    assert _names(result) in (["gamma_enabled"], ["gamma_enabled", "unnamed"])


def test_chopped_light_is_a_flicker() -> None:
    """Light that is wholly off for a part of each period, exposures that hold none: one flicker."""
    result = _asked("chopped", 1)
    (found,) = result.effects
    assert "pwm_flicker" in (found.name, *found.alternatives)
    assert {found.name, *found.alternatives} <= {"mains_ripple", "pwm_flicker"}


def test_every_fifth_frame_dim_is_no_flicker() -> None:
    """What comes back in the order of the frames stands alone: no name next to it."""
    (found,) = _asked("fifth", 1).effects
    assert (found.name, found.where) == ("unnamed", "frame")
    assert found.parameters["period_frames"].value == 5.0


def test_stray_light_in_a_plain_bracket_has_all_its_names() -> None:
    """One scene at one level and darks: a veil, light from the room and a black that glows stand together."""
    (found,) = _asked("veil", 1, plan="bracket").effects
    assert {found.name, *found.alternatives} >= STRAY
