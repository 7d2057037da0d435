"""Frames of many pixels: noise is known so well that the light must be followed exactly."""

from __future__ import annotations

import pytest

from testing.generator.rig import Rig
from testing.generator.session import make_session
from testing.reconciled import reconcile

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]

LARGER = Rig(rows=320, columns=432, spacing_um=15.0)  # tiles of 3,800 pixels, fifteen times those of the other tests


def test_veil_that_the_patches_had_taken_up_is_named_with_its_size() -> None:
    """The stated radiances bend to a hidden veil; with it they come back, and the noise of the dark patches too."""
    session = make_session("veiling_glare", camera_seed=1, rig=LARGER, plan="short")
    found = reconcile(session.header, list(session.frames()), with_limits=False)
    assert [effect.name for effect in found.effects] == ["veiling_glare"]
    share = found.effects[0].parameters["share"]
    assert share.u is not None
    assert abs(share.value - session.truth["veiling_glare"]["fraction"]) < 3 * share.u


def test_nothing_hidden_in_large_frames_nothing_found() -> None:
    """The finer eye of many pixels sees nothing where nothing is."""
    session = make_session(camera_seed=2, rig=LARGER, plan="short")
    assert str(reconcile(session.header, list(session.frames()), with_limits=False).verdict) == "agrees"
