"""Wrong labels of frames that show little: light in one corner, short shutters, digital numbers near to nothing."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from radiometer.analysis.response.debevec1997 import curve_debevec1997
from radiometer.analysis.response.planes import Plane
from radiometer.analysis.response.samples import gather_samples
from radiometer.analysis.response.wrong_labels import (
    WrongLabel,
    find_wrong_labels,
    freed_one_by_one,
    smallest_label_error,
)
from radiometer.data import Bracket, Frame, FrameSettings

TIMES = 0.002 * 2.0 ** np.arange(10)


def church(wrong: int | None, ratio: float, seed: int = 5) -> Plane:
    """Return photographs of a dim room with a window in one quadrant, which alone is seen in the shortest of them.

    Args:
        wrong: Frame whose real exposure is `ratio` times its label.
        ratio: Real over stated exposure.
        seed: Of the noise.
    """
    rng = np.random.default_rng(seed)
    radiance = np.exp(rng.uniform(-7.0, -3.0, (96, 128)))
    radiance[8:40, 70:118] = np.exp(rng.uniform(2.0, 5.0, (32, 48)))
    frames = []
    for number, label in enumerate(TIMES):
        light = radiance * label * (ratio if number == wrong else 1.0)
        values = 255.0 * (light / (0.3 + light)) ** 0.6 + 0.8 * rng.standard_normal(radiance.shape)
        frames.append(Frame(np.clip(np.round(values), 0, 255).astype(np.uint8), 8, FrameSettings(float(label))))
    samples = gather_samples(Bracket.from_frames(frames))
    return Plane(samples, curve_debevec1997(samples).log_exposure)


@pytest.mark.slow
@pytest.mark.parametrize(("wrong", "ratio"), [(1, 1.6), (1, 0.6), (5, 1.35)])
def test_the_label_of_a_frame_that_shows_one_corner_is_reported(wrong: int, ratio: float) -> None:
    """By its own rows and by its size, however little it adds to the error of all frames; and it alone."""
    plane = church(wrong, ratio)
    shown = [int((part.frame == 1).sum()) for part in plane.samples.quadrants]
    assert shown[1] > 50
    assert max(shown[0], shown[2], shown[3]) < 10
    (label,) = find_wrong_labels([plane])
    assert label.frame == wrong
    assert label.ratio == pytest.approx(ratio, abs=3.0 * label.u_ratio)
    assert label.u_ratio < 0.1 * ratio
    assert label.rivals == ()


@pytest.mark.slow
def test_right_labels_of_frames_that_show_one_corner_are_left_alone() -> None:
    """Two draws of the noise."""
    assert [find_wrong_labels([church(None, 1.0, seed)]) for seed in (6, 7)] == [(), ()]


@pytest.mark.slow
def test_each_label_is_what_the_other_frames_say_of_it() -> None:
    """With its u: right ones next to a wrong one, and that of a frame in the dark not at all."""
    plane = church(5, 1.35)
    dark = replace(plane, samples=plane.samples.changed(lambda one: one.kept(one.frame != 0)))
    reported = freed_one_by_one([dark], (5,))
    assert reported[0] == (0.0, math.inf)
    value, u = np.array(reported[1:]).T
    true = np.where(np.arange(1, TIMES.size) == 5, math.log(1.35), 0.0)
    assert np.all(np.abs(value - true) < 3.5 * u + 0.003)
    assert max(u) < 0.1
    assert freed_one_by_one([replace(plane, samples=replace(plane.samples, shares=()))]) == [(0.0, math.inf)] * 10


@pytest.mark.slow
@pytest.mark.parametrize("wrong", [0, 1, 8])
def test_a_label_is_named_from_five_of_its_u_on(wrong: int) -> None:
    """Beyond what counts as wrong at all; either way."""
    value, u = freed_one_by_one([church(None, 1.0)])[wrong]
    least = smallest_label_error(float(TIMES[wrong])) + 5.0 * u
    for ratio in (math.exp(least - value), math.exp(-least - value)):
        assert [one.frame for one in find_wrong_labels([church(wrong, ratio)])] == [wrong]


def label(ratio: float, u: float = 0.01, gain: float = 0.9, frame: int = 1) -> WrongLabel:
    return WrongLabel(frame, ratio, u * ratio, gain)
