"""Reconcile names what several output amplifiers do, hidden by equations other than the catalogue's."""

from __future__ import annotations

import pytest

from radiometer.data import TapDescription
from radiometer.reconciliation import ReconcileResult
from testing.generator.rig import Rig
from testing.generator.session import Session, make_session, session_of_taps
from testing.reconciled import reconcile

RIG = Rig()


def reconciled(session: Session, rows: int, columns: int) -> ReconcileResult:
    """Return what is found in a session whose camera is described with rows and columns of taps."""
    w, h = RIG.columns // columns, RIG.rows // rows
    taps = tuple(TapDescription(name=f"{x}{y}", x=x * w, y=y * h, width=w, height=h)
                 for y in range(rows) for x in range(columns))  # fmt: skip
    camera = session.header.camera.model_copy(update={"taps": taps})
    header = session.header.model_copy(update={"camera": camera})
    return reconcile(header, list(session.frames()), with_limits=False)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "seed"),
    [("tap_offset", 9411), ("tap_gain", 9412), ("tap_noise", 9413), ("tap_nonlinearity", 9414), ("half_timing", 9415),
     ("amplifier_glow", 9416), ("charge_transfer_inefficiency", 9417)],
)  # fmt: skip
def test_an_amplifier_s_effect_is_named_alone(name: str, seed: int) -> None:
    """Twice its smallest usual size in a rich session: the effect is named and nothing else is."""
    found = reconciled(make_session(name, camera_seed=seed, scale=2.0), 2, 2)
    assert [effect.name for effect in found.effects] == [name]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "seed"), [("tap_offset", 1301202), ("tap_gain", 1301201)])
def test_what_differs_between_sixteen_amplifiers_is_named(name: str, seed: int) -> None:
    """Two rows of eight taps, each with its size: the effect is named and nothing else is.

    A third of the patches are read by two amplifiers each.
    """
    found = reconciled(session_of_taps(name, (2, 8), seed), 2, 8)
    assert [effect.name for effect in found.effects] == [name]
