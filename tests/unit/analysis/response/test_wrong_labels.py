"""Wrong labels of frames that show little: light in one corner, short shutters, digital numbers near to nothing."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from radiometer.analysis.response.debevec1997 import curve_debevec1997
from radiometer.analysis.response.planes import JointFit, LeftOut, Plane
from radiometer.analysis.response.samples import gather_samples
from radiometer.analysis.response.settle import Choices, FittedResponse, fit_with
from radiometer.analysis.response.wrong_labels import (
    WrongLabel,
    _as_well,
    _convincing,
    _Tried,
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
def test_the_label_of_a_frame_that_shows_one_corner_is_told(wrong: int, ratio: float) -> None:
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
    """With its u: right ones beside a wrong one, and that of a frame in the dark not at all."""
    plane = church(5, 1.35)
    dark = replace(plane, samples=plane.samples.changed(lambda one: one.kept(one.frame != 0)))
    told = freed_one_by_one([dark], (5,))
    assert told[0] == (0.0, math.inf)
    value, u = np.array(told[1:]).T
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


@pytest.fixture(scope="module")
def fitted() -> FittedResponse:
    plane = church(None, 1.0)
    return fit_with(plane.samples, plane.start, Choices(smoothing=1e3))


def tried(fitted: FittedResponse, errors_dn: Sequence[float], seconds: float = 0.1, other_dn: float = 1.0) -> _Tried:
    """Return a fit that predicts frame 1 so well in each share that shows it, and frame 0 and the rest alike."""
    times = np.where(np.arange(TIMES.size) == 1, math.log(seconds), math.log(0.1))
    timed = replace(fitted, samples=replace(fitted.samples, frame_log_time=times))
    rows = np.zeros((4, 3))
    rows[:, 0], rows[: len(errors_dn), 1], rows[:, 2] = 10.0, 10.0, 100.0
    errors = other_dn * rows
    errors[: len(errors_dn), 1] = 10.0 * np.array(errors_dn)
    return _Tried(JointFit.of([timed]), [], LeftOut(errors, rows))


def label(ratio: float, u: float = 0.01, gain: float = 0.9, frame: int = 1) -> WrongLabel:
    return WrongLabel(frame, ratio, u * ratio, gain)


@pytest.mark.parametrize(
    ("before", "after", "convinces"),
    [
        ([5, 5, 5, 5], [3, 3, 3, 3], True),
        ([5, 5, 5, 5], [4.0, 4.0, 4.0, 4.0], True),
        ([5, 5, 5, 5], [4.1, 4.1, 4.1, 4.1], False),
        ([8, 4, 4, 4], [3, 4.1, 4.1, 3.5], True),
        ([11, 4, 4, 4], [3, 4.2, 4.2, 4.2], False),
        ([20, 5], [4, 5], True),
        ([20, 5], [4, 5.1], False),
        ([20], [4], False),
        ([1.2, 1.2, 1.2, 1.2], [0.65, 0.65, 0.65, 0.65], True),
        ([1.2, 1.2, 1.2, 1.2], [0.75, 0.75, 0.75, 0.75], False),
    ],
)
def test_a_label_convinces_by_its_frame_in_any_shares(
    fitted: FittedResponse, before: list[float], after: list[float], convinces: bool
) -> None:
    """A fifth less and half a DN less in all, and less whichever share is not counted: of one none is left."""
    assert _convincing(label(1.5), tried(fitted, after), tried(fitted, before)) is convinces


@pytest.mark.parametrize(
    ("ratio", "u", "gain", "seconds", "convinces"),
    [
        (1.09, 0.01, 0.9, 0.1, True),
        (1 / 1.09, 0.01, 0.9, 0.1, True),
        (1.07, 0.01, 0.9, 0.1, False),
        (1.5, 0.13, 0.9, 0.1, True),
        (1.5, 0.14, 0.9, 0.1, False),
        (1.5, 0.01, 1.0, 0.1, True),
        (1.5, 0.01, 1.01, 0.1, False),
        (1.36, 0.01, 0.9, 1.25e-4, False),
        (1.4, 0.01, 0.9, 1.25e-4, True),
        (1.13, 0.01, 0.9, 5e-4, False),
        (1.16, 0.01, 0.9, 5e-4, True),
    ],
)
def test_a_label_convinces_by_its_size(
    fitted: FittedResponse, ratio: float, u: float, gain: float, seconds: float, convinces: bool
) -> None:
    """From 8 % in ln, 30 us besides in a short exposure, three of its u, where all frames together are no worse."""
    after, before = (tried(fitted, [error] * 4, seconds) for error in (2.0, 5.0))
    assert _convincing(label(ratio, u, gain), after, before) is convinces


@pytest.mark.parametrize(
    ("ratio", "others_dn", "rival"), [(0.9, 2.4, True), (0.9, 2.6, False), (0.93, 2.4, False), (1.1, 2.4, True)]
)
def test_a_rival_predicts_both_frames_within_a_quarter(
    fitted: FittedResponse, ratio: float, others_dn: float, rival: bool
) -> None:
    """The frame itself and the one named; a label that is nearly right is none, however well it predicts."""
    best = tried(fitted, [3.0] * 4, other_dn=1.0)
    other = tried(fitted, [others_dn] * 4, other_dn=others_dn)
    assert _as_well(label(ratio, frame=0), other, label(1.5), best) is rival
