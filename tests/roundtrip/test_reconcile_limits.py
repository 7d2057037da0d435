"""The table of limits: what lies below is not named, what lies well above is."""

from __future__ import annotations

import pytest

from benchmarks.reconcile_limits import FIRST_SEED, answer_at, is_named
from radiometer.reconciliation.result import Limit
from testing.generator.session import make_session
from testing.reconciled import reconcile

pytestmark = pytest.mark.slow

# One entry of each block: mean, variance, spatial variance, columns, first frame, edge.
ENTRIES = ("black_level_offset", "excess_read_noise", "prnu", "column_pattern", "image_lag", "psf_blur")


@pytest.fixture(scope="module")
def stated() -> dict[str, Limit]:
    """Return the limits that a plain bracket states where nothing is hidden."""
    session = make_session(camera_seed=FIRST_SEED, plan="bracket")
    return dict(reconcile(session.header, list(session.frames())).limits)


@pytest.mark.parametrize("name", ENTRIES)
def test_half_the_limit_stays_hidden_and_twice_is_named(name: str, stated: dict[str, Limit]) -> None:
    """A limit is five sigma and a name asks for about four: 2.5 sigma (less, where it grows faster) pass, 10 do not."""
    limit = stated[name].amplitude
    assert limit is not None
    assert not is_named(name, answer_at(name, 0.5 * limit, FIRST_SEED, "bracket"))
    assert is_named(name, answer_at(name, 2.0 * limit, FIRST_SEED, "bracket"))


def test_named_effect_keeps_its_limit(stated: dict[str, Limit]) -> None:
    """What is named has the limit of data without it, not a share of its own uncertainty."""
    session = make_session("psf_blur", camera_seed=FIRST_SEED, plan="bracket")
    found = reconcile(session.header, list(session.frames()))
    assert [effect.name for effect in found.effects] == ["psf_blur"]
    with_it, without = found.limits["psf_blur"].amplitude, stated["psf_blur"].amplitude
    assert with_it == pytest.approx(without, rel=0.2)
