"""A plain bracket of a scene of which nothing is known: no patches, tiles that hold anything."""

from __future__ import annotations

import warnings

import pytest

from radiometer.reconciliation.result import ReconcileResult
from testing.generator.session import make_session
from testing.reconciled import reconcile

pytestmark = pytest.mark.slow


def _answer(*hidden: str, seed: int = 80) -> ReconcileResult:
    session = make_session(*hidden, camera_seed=seed, plan="bracket")
    header = session.header.model_copy(update={"patches": ()})
    return reconcile(header, list(session.frames()), with_limits=False)


def test_unknown_scene_agrees_where_nothing_is_hidden() -> None:
    """Borders of patches run through the tiles: that is the scene, at every exposure alike, and no effect."""
    answer = _answer()
    assert str(answer.verdict) == "agrees"
    assert answer.gap_before < 1.05


SHOWN = ("exposure_time_offset", "excess_read_noise", "missing_codes", "column_pattern", "mains_ripple")


@pytest.mark.parametrize("name", SHOWN)
def test_unknown_scene_shows_what_needs_no_scene(name: str) -> None:
    """Timing, noise, codes, patterns of the sensor and what whole frames share are named without any patch."""
    answer = _answer(name)
    assert [effect.name for effect in answer.effects] == [name]
    assert str(answer.verdict) == "effects_found"


@pytest.mark.usefixtures("laws_left_out")
def test_fit_that_goes_astray_takes_smaller_steps_and_says_nothing() -> None:
    """A gamma bends a free scene so much that a whole step would overflow: no warning reaches the terminal."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        answer = _answer("gamma_enabled", seed=7500)
    assert "gamma_enabled" in [effect.name for effect in answer.effects]
    assert answer.gap_after < 0.01 * answer.gap_before
