"""Cameras of 8 bits: the read noise is a fraction of a code, and rounding no longer averages out."""

from __future__ import annotations

import pytest

from testing.generator.rig import Rig
from testing.generator.session import make_session
from testing.reconciled import reconcile

pytestmark = pytest.mark.slow

EIGHT_BITS = Rig(bit_depth=8, e_per_dn=41.6, black_dn=15.0)


def test_rounding_of_eight_bits_is_no_effect() -> None:
    """With noise of 0.06 codes in the dark means lie on whole codes: the model rounds too, and agrees."""
    session = make_session(camera_seed=12_000, rig=EIGHT_BITS, plan="short")
    answer = reconcile(session.header, list(session.frames()), with_limits=False)
    assert str(answer.verdict) == "agrees"
    assert answer.gap_before < 1.05


def test_eight_bits_still_show_an_offset_of_the_black_level() -> None:
    """An offset of the black level by one to two codes is named through the rounding, and is what was hidden."""
    session = make_session("black_level_offset", camera_seed=12_001, rig=EIGHT_BITS, plan="bracket")
    answer = reconcile(session.header, list(session.frames()), with_limits=False)
    assert [effect.name for effect in answer.effects] == ["black_level_offset"]
    found = answer.effects[0].parameters["offset_dn"]
    assert abs(found.value - session.truth["black_level_offset"]["offset_dn"]) < 3 * found.u
