"""Reconcile names what several output amplifiers do, hidden by equations other than the catalogue's."""

from __future__ import annotations

import pytest

from radiometer.reconciliation import reconcile
from testing.generator.session import make_session


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "seed"),
    [("tap_offset", 9411), ("tap_gain", 9412), ("tap_noise", 9413), ("tap_nonlinearity", 9414), ("half_timing", 9415),
     ("amplifier_glow", 9416)],
)  # fmt: skip
def test_an_amplifier_s_effect_is_named_alone(name: str, seed: int) -> None:
    """Twice its smallest usual size in a rich session: the effect is named and nothing else is."""
    session = make_session(name, camera_seed=seed, scale=2.0)
    found = reconcile(session.header, list(session.frames()), with_limits=False)
    assert [effect.name for effect in found.effects] == [name]
