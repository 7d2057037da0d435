"""Brackets of a scene of which no patches are stated: what may be named there, and what may not."""

from __future__ import annotations

import pytest

from radiometer.reconciliation.result import ReconcileResult
from testing.generator.session import make_session
from testing.reconciled import reconcile

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]


def _ask(name: str, *, with_limits: bool = False) -> ReconcileResult:
    session = make_session(name, camera_seed=7610, plan="bracket", known_patches=False)
    header = session.header.model_copy(update={"patches": ()})
    return reconcile(header, list(session.frames()), with_limits=with_limits)


def test_picture_left_behind_is_no_noise() -> None:
    """Lag leaves the last picture in the first frame of the next capture; it is named alone, and no read noise."""
    answer = _ask("image_lag")
    assert str(answer.verdict) == "effects_found"
    assert [effect.name for effect in answer.effects] == ["image_lag"]


@pytest.mark.usefixtures("laws_left_out")
def test_flicker_seen_at_short_exposures_alone_has_two_names() -> None:
    """Below 1.4 ms a ripple of the mains and a dimmed source look alike: either is next to the other."""
    effect = _ask("mains_ripple").effects[0]
    assert {effect.name, *effect.alternatives} == {"mains_ripple", "pwm_flicker"}


def test_saturation_is_judged_by_the_even_part_of_a_cell() -> None:
    """Borders of patches run through the cells: the even part of each shows the full well, and its limit."""
    answer = _ask("full_well_saturation", with_limits=True)
    assert [effect.name for effect in answer.effects] == ["full_well_saturation"]
    assert answer.effects[0].parameters["full_well_e"].value == pytest.approx(8430.08, abs=5.0)
    assert answer.limits["full_well_saturation"].amplitude == pytest.approx(8430.08, abs=5.0)
    assert answer.limits["exposure_time_offset"].amplitude is not None
