"""By what power of the exposure numbers grow: worked out by hand for straight lines and gammas."""

from __future__ import annotations

import numpy as np
import pytest

from radiometer.analysis.response.limits import growth_power
from radiometer.data import Bracket, Frame, FrameSettings


def _frames(power, times=(1.0, 2.0, 4.0, 8.0, 16.0), black_dn=0.0, stated=None, scene=(-6.0, 0.0)):
    """Return frames whose numbers above black are the exposure to a power, read noise of one DN of 12 bits on top."""
    rng = np.random.default_rng(11)
    light = np.exp(rng.uniform(*scene, (60, 80)))
    frames = []
    for time, text in zip(times, stated or times, strict=True):
        dn = black_dn + (4095 - black_dn) * np.minimum(light * time / 4.0, 1.0) ** power
        stored = np.clip(np.rint(dn + rng.normal(0.0, 1.0, light.shape)), 0, 4095).astype(np.uint16)
        frames.append(Frame(stored, 12, FrameSettings(text)))
    return Bracket.from_frames(frames)


@pytest.mark.parametrize("power", [1.0, 1.0 / 2.2, 1.3])
def test_numbers_grow_by_the_power_they_were_made_with(power):
    """Ratios of thousands of pixels of 400 DN and more, each to 0.3 %, give the power to well under 0.002."""
    assert growth_power(_frames(power)) == pytest.approx(power, abs=2e-3)


def test_numbers_count_from_black():
    """Above a black level of 300 DN a straight line is one; from 0 it seems to grow more slowly."""
    bracket = _frames(1.0, black_dn=300.0)
    assert growth_power(bracket, 300.0) == pytest.approx(1.0, abs=2e-3)
    assert growth_power(bracket) < 0.9


def test_one_wrong_time_of_five_does_not_matter():
    """A label that is half of the truth moves two of four pairs, one up and one down: their median stays."""
    assert growth_power(_frames(1.0, stated=(1.0, 2.0, 2.5, 8.0, 16.0))) == pytest.approx(1.0, abs=2e-3)


@pytest.mark.parametrize(
    ("times", "scene"),
    [((1.0, 1.1), (-6.0, 0.0)), ((1.0, 64.0), (-6.0, 0.0)), ((1.0, 2.0), (3.0, 4.0))],
    ids=["exposures alike", "nothing in common", "all white"],
)
def test_frames_that_cannot_tell_say_nothing(times, scene):
    """Exposures nearer than a factor of 1.2, and no pixels between black and white in two frames, give None."""
    assert growth_power(_frames(1.0, times=times, scene=scene)) is None
