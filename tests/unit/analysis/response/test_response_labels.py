"""Exposure labels that lie are found and named."""

from __future__ import annotations

from dataclasses import replace

import pytest

from radiometer.analysis.response.labels import exposure_labels, refuse_lying_labels
from radiometer.data import Bracket
from radiometer.errors import CaptureError


def _relabelled(bracket: Bracket, index: int, exposure_s: float) -> Bracket:
    frames = list(bracket.frames)
    frames[index] = replace(frames[index], settings=replace(frames[index].settings, exposure_s=exposure_s))
    return Bracket.from_frames(frames)


def test_honest_labels_pass(make_stack):
    """A bracket whose brightness rises with its times is accepted."""
    refuse_lying_labels(make_stack("gamma", bit_depth=8))


@pytest.mark.parametrize(("index", "exposure_s", "looks"), [(2, 0.1, "shorter"), (6, 0.0011, "longer")])
def test_wrong_label_is_named(make_stack, index, exposure_s, looks):
    """The frame whose stated time contradicts its brightness is named, and so is the direction."""
    with pytest.raises(CaptureError, match=rf"{index:04}\.png says .* looks like a {looks} exposure") as caught:
        refuse_lying_labels(_relabelled(make_stack("gamma", bit_depth=8), index, exposure_s))
    assert str(caught.value).count(".png says") == 1


def test_reciprocal_times_are_recognised(make_stack):
    """Times that are wrong throughout are said to be so instead of accusing every frame."""
    bracket = make_stack("linear")
    frames = [replace(f, settings=replace(f.settings, exposure_s=1 / f.settings.exposure_s)) for f in bracket]
    with pytest.raises(CaptureError, match="1/t instead of t"):
        refuse_lying_labels(Bracket.from_frames(frames))


def test_equal_frames_with_different_labels_are_refused_by_name(make_stack):
    """Four copies of one frame said to be 0.5 to 4 s long are refused with the names of those alike."""
    frame = make_stack("gamma", bit_depth=8).frames[4]
    frames = [
        replace(frame, settings=replace(frame.settings, exposure_s=0.5 * 2.0**k), extra={"file": f"{k}.jpg"})
        for k in range(4)
    ]
    with pytest.raises(CaptureError, match=r"0\.jpg \(0\.5 s\) and 1\.jpg \(1 s\).*2\.jpg \(2 s\) and 3\.jpg \(4 s\)"):
        refuse_lying_labels(Bracket.from_frames(frames))


def test_equal_black_frames_are_no_lie(make_stack):
    """Two frames without light are alike whatever their labels say."""
    bracket = make_stack("gamma", bit_depth=8)
    dark = [
        replace(
            bracket.frames[0], dn=bracket.frames[0].dn * 0, settings=replace(bracket.frames[0].settings, exposure_s=s)
        )
        for s in (1e-6, 2e-6)
    ]
    refuse_lying_labels(Bracket.from_frames([*dark, *bracket.frames]))


def test_equal_exposures_are_no_lie_whatever_their_brightness(make_stack):
    """Frames that all state one exposure say nothing of labels: that one exposure is too few is said elsewhere."""
    bracket = make_stack("gamma", bit_depth=8)
    equal = [replace(f, settings=replace(f.settings, exposure_s=0.1)) for f in reversed(bracket.frames)]
    refuse_lying_labels(Bracket.from_frames(equal))


def test_an_exposure_is_called_as_it_is_stated(make_stack):
    """A label that is found wrong is told by file, time and speed, not by the product of time and gain."""
    frames = make_stack("gamma", bit_depth=8).frames[:3]
    stated = [{"gain_db": 0.0, "iso": 100.0}, {"gain_db": 6.0206, "iso": 200.0}, {"gain_db": 6.0206, "iso": None}]
    bracket = Bracket.from_frames(
        replace(f, settings=replace(f.settings, exposure_s=2.0 ** (k - 6), **gain), extra={"file": f"p{k}.jpg"})
        for k, (f, gain) in enumerate(zip(frames, stated, strict=True))
    )
    labels = ["0.01562 s at ISO 100 (p0.jpg)", "0.03125 s at ISO 200 (p1.jpg)", "0.0625 s at 6.02 dB (p2.jpg)"]
    assert exposure_labels(bracket) == labels
    assert exposure_labels(replace(bracket, frames=bracket.frames[:1])) == ["0.01562 s (p0.jpg)"]
