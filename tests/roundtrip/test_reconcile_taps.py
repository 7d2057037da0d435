"""Reconcile names what several output amplifiers do, hidden by equations other than the catalogue's."""

from __future__ import annotations

import pytest

from radiometer.data import TapDescription
from radiometer.reconciliation import reconcile
from testing.generator.rig import Rig
from testing.generator.session import make_session

RIG = Rig()


def quarters(width: int, height: int) -> tuple[TapDescription, ...]:
    """Return four taps of a sensor."""
    w, h = width // 2, height // 2
    return tuple(TapDescription(name=f"{x}{y}", x=x * w, y=y * h, width=w, height=h) for y in (0, 1) for x in (0, 1))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "seed"),
    [("tap_offset", 9411), ("tap_gain", 9412), ("tap_noise", 9413), ("tap_nonlinearity", 9414), ("half_timing", 9415),
     ("amplifier_glow", 9416)],
)  # fmt: skip
def test_an_amplifier_s_effect_is_named_alone(name: str, seed: int) -> None:
    """Twice its smallest usual size in a rich session: the effect is named and nothing else is."""
    session = make_session(name, camera_seed=seed, scale=2.0)
    camera = session.header.camera.model_copy(update={"taps": quarters(RIG.columns, RIG.rows)})
    header = session.header.model_copy(update={"camera": camera})
    found = reconcile(header, list(session.frames()), with_limits=False)
    assert [effect.name for effect in found.effects] == [name]
