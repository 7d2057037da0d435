"""A bracket names its light and its dark frames, and prints none of them."""

from __future__ import annotations

import numpy as np
import pytest

from radiometer.data import Bracket, Frame, FrameSettings


def bracket() -> Bracket:
    settings = (FrameSettings(2.0), FrameSettings(1.0), FrameSettings(2.0, shutter="closed"))
    return Bracket.from_frames([Frame(np.zeros((4, 5), np.uint16), 12, one) for one in settings], origin="here")


def test_a_loop_over_a_bracket_is_an_error_that_names_both():
    """Neither the light frames alone nor all of them: whoever loops must say which."""
    with pytest.raises(TypeError, match=r"bracket\.light, bracket\.dark"):
        list(bracket())


def test_light_and_dark_frames_are_apart():
    """Light ones ascend in exposure; new light frames keep the dark ones."""
    one = bracket()
    assert [frame.settings.exposure_s for frame in one.light] == [1.0, 2.0]
    assert [frame.settings.is_dark for frame in one.every_frame] == [True, False, False]
    assert one.with_light(one.light[:1]).dark == one.dark


def test_it_prints_in_one_line():
    """Counts, size, bits and times."""
    assert repr(bracket()) == "<Bracket here: 2 + 1 dark frames of 5 × 4 pixels, 12 bits, 1 to 2 s>"
