"""Exposure times that are labelled wrong."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from radiometer.analysis.response.debevec1997 import curve_debevec1997
from radiometer.analysis.response.labels import exposure_labels, refuse_equal_throughout, reject_inconsistent_exposures
from radiometer.analysis.response.planes import Plane
from radiometer.analysis.response.samples import gather_samples
from radiometer.analysis.response.wrong_labels import (
    WrongLabel,
    find_wrong_labels,
    freed_one_by_one,
    smallest_label_error,
)
from radiometer.data import Bracket, Frame, FrameSettings
from radiometer.errors import CaptureError


def _relabelled(bracket: Bracket, index: int, exposure_s: float) -> Bracket:
    frames = list(bracket.light)
    frames[index] = replace(frames[index], settings=replace(frames[index].settings, exposure_s=exposure_s))
    return Bracket.from_frames(frames)


def test_honest_labels_pass(make_stack):
    """A bracket whose brightness rises with its times is accepted."""
    reject_inconsistent_exposures(make_stack("gamma", bit_depth=8))


@pytest.mark.parametrize(("index", "exposure_s", "looks"), [(2, 0.1, "shorter"), (6, 0.0011, "longer")])
def test_wrong_label_is_named(make_stack, index, exposure_s, looks):
    """The frame whose stated time contradicts its brightness is named, and so is the direction."""
    with pytest.raises(CaptureError, match=rf"{index:04}\.png says .* looks like a {looks} exposure") as caught:
        reject_inconsistent_exposures(_relabelled(make_stack("gamma", bit_depth=8), index, exposure_s))
    assert str(caught.value).count(".png says") == 1


def test_reciprocal_times_are_recognised(make_stack):
    """Times that are wrong throughout are reported to be so instead of accusing every frame."""
    bracket = make_stack("linear")
    frames = [replace(f, settings=replace(f.settings, exposure_s=1 / f.settings.exposure_s)) for f in bracket.light]
    with pytest.raises(CaptureError, match="1/t instead of t"):
        reject_inconsistent_exposures(Bracket.from_frames(frames))


def test_equal_frames_with_different_labels_are_refused_by_name(make_stack):
    """Four copies of one frame stated to be 0.5 to 4 s long are refused with the names of those alike."""
    frame = make_stack("gamma", bit_depth=8).light[4]
    frames = [
        replace(frame, settings=replace(frame.settings, exposure_s=0.5 * 2.0**k), extra={"file": f"{k}.jpg"})
        for k in range(4)
    ]
    with pytest.raises(CaptureError, match=r"0\.jpg \(0\.5 s\) and 1\.jpg \(1 s\).*2\.jpg \(2 s\) and 3\.jpg \(4 s\)"):
        reject_inconsistent_exposures(Bracket.from_frames(frames))
    with pytest.raises(CaptureError, match=r"0\.jpg \(0\.5 s\) and 1\.jpg \(1 s\)"):
        refuse_equal_throughout(Bracket.from_frames(frames))


def test_one_frame_that_is_brighter_can_tell_which_label_is_wrong(make_stack):
    """Where not all are alike, or all labels are the same, nothing is refused before labels are judged."""
    first, brighter = make_stack("gamma", bit_depth=8).light[4:6]
    times = [replace(first.settings, exposure_s=one) for one in (0.5, 1.0, 2.0)]
    alike = [replace(first, settings=one) for one in times]
    refuse_equal_throughout(
        Bracket.from_frames([*alike, replace(brighter, settings=replace(times[0], exposure_s=4.0))])
    )
    refuse_equal_throughout(Bracket.from_frames([alike[0], alike[0]]))


def test_equal_black_frames_are_no_lie(make_stack):
    """Two frames without light are alike whatever their labels say."""
    bracket = make_stack("gamma", bit_depth=8)
    dark = [
        replace(bracket.light[0], dn=bracket.light[0].dn * 0, settings=replace(bracket.light[0].settings, exposure_s=s))
        for s in (1e-6, 2e-6)
    ]
    reject_inconsistent_exposures(Bracket.from_frames([*dark, *bracket.light]))


def _two_frames(seconds, of_middle=(60, 3000), part=0.5, rise=0.0):
    """Return frames of 16 bits, some pixels at a part of full scale, the second by a rise above, the rest black."""
    count, pixels = of_middle
    shown = np.zeros((2, pixels))
    shown[0, :count], shown[1, :count] = part, part + rise
    dn = np.rint(65535.0 * shown).astype(np.uint16).reshape(2, 10, -1)
    return Bracket.from_frames(Frame(one, 16, FrameSettings(t)) for one, t in zip(dn, seconds, strict=True))


@pytest.mark.parametrize(
    ("changes", "refused"),
    [
        ({}, True), ({"of_middle": (59, 3000)}, False), ({"of_middle": (50, 1000)}, True),
        ({"of_middle": (49, 1000)}, False), ({"part": 0.09}, False), ({"part": 0.11}, True), ({"part": 0.89}, True),
        ({"part": 0.91}, False), ({"rise": 0.0038}, True), ({"rise": 0.0042}, False),
        ({"seconds": (1.0, 1.26)}, True), ({"seconds": (1.0, 1.24)}, False),
    ],
)  # fmt: skip
def test_equal_frames_need_enough_middle_tones_and_labels_that_differ(changes, refused):
    """50 pixels and 2 % between a tenth and nine tenths of full scale, alike to 0.4 % of it, labels a quarter apart."""
    bracket = _two_frames(**({"seconds": (1.0, 2.0)} | changes))
    if refused:
        with pytest.raises(CaptureError, match="equally bright though their stated exposures differ"):
            reject_inconsistent_exposures(bracket)
    else:
        reject_inconsistent_exposures(bracket)


@pytest.mark.parametrize(("count", "fall", "refused"), [(60, 0.0038, False), (60, 0.0042, True), (49, 0.0042, False)])
def test_a_longer_exposure_may_be_darker_by_noise(count, fall, refused):
    """By 0.4 % of full scale where neither clips; of fewer than 50 such pixels the whole picture is asked instead."""
    bracket = _two_frames((1.0, 1.1), (count, 3000), rise=-fall)
    if refused:
        with pytest.raises(CaptureError, match="get darker"):
            reject_inconsistent_exposures(bracket)
    else:
        reject_inconsistent_exposures(bracket)


def test_equal_exposures_are_no_lie_whatever_their_brightness(make_stack):
    """Frames that all state one exposure say nothing of labels: that one exposure is too few is stated elsewhere."""
    bracket = make_stack("gamma", bit_depth=8)
    equal = [replace(f, settings=replace(f.settings, exposure_s=0.1)) for f in reversed(bracket.light)]
    reject_inconsistent_exposures(Bracket.from_frames(equal))


def test_an_exposure_is_called_as_it_is_stated(make_stack):
    """A label that is found wrong is reported with file, time and speed, not by the product of time and gain."""
    frames = make_stack("gamma", bit_depth=8).light[:3]
    stated = [{"gain_db": 0.0, "iso": 100.0}, {"gain_db": 6.0206, "iso": 200.0}, {"gain_db": 6.0206, "iso": None}]
    bracket = Bracket.from_frames(
        replace(f, settings=replace(f.settings, exposure_s=2.0 ** (k - 6), **gain), extra={"file": f"p{k}.jpg"})
        for k, (f, gain) in enumerate(zip(frames, stated, strict=True))
    )
    labels = ["0.01562 s at ISO 100 (p0.jpg)", "0.03125 s at ISO 200 (p1.jpg)", "0.0625 s at 6.02 dB (p2.jpg)"]
    assert exposure_labels(bracket) == labels
    assert exposure_labels(replace(bracket, light=bracket.light[:1])) == ["0.01562 s (p0.jpg)"]


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
