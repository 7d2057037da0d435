"""The shutter's offset: a known time comes back with its uncertainty, none comes of none, and a wrong label is none."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from radiometer.analysis.response import auto, shutter_offset
from radiometer.analysis.response.auto import recover_response_auto
from radiometer.analysis.response.shutter_offset import (
    Exposures,
    ShutterOffset,
    find_exposures,
    find_offset,
    with_offset,
)
from radiometer.analysis.response.wrong_labels import UNSTATED_OFFSET_S, WrongLabel
from radiometer.data import ResponseCurve
from testing.brackets_of_a_shutter import LABELS_S, photographed, plane

OFFSET_S = 25e-6


@pytest.mark.parametrize("offset_s", [OFFSET_S, -20e-6])
def test_a_known_time_comes_back(offset_s):
    """Within three of its u, which is 1.5 us at most: a hundredth of the shortest exposure."""
    found = find_offset([plane(photographed(offset_s))])
    assert found.u_seconds < 1.5e-6
    assert found.seconds == pytest.approx(offset_s, abs=min(3.0 * found.u_seconds, 1e-6))
    assert found.gain < 0.5


@pytest.mark.slow
def test_an_offset_s_u_holds_each_exposure_and_colours_share_it():
    """Shutters that scatter by 1 %; two colours know it better."""
    found = [find_offset([plane(photographed(OFFSET_S, scatter=0.01, seed=seed))]) for seed in range(5)]
    z = np.array([(one.seconds - OFFSET_S) / one.u_seconds for one in found if one is not None])
    assert z.size >= 4  # one may not stand out of its u
    assert 0.05 < np.sqrt(np.mean(z**2)) < 1.5
    assert min(one.u_seconds for one in found if one is not None) > 2e-6
    colours = [plane(photographed(OFFSET_S, power=power, scatter=0.0, seed=4)) for power in (0.6, 0.5)]
    each = [find_offset([one]) for one in colours]
    both = find_offset(colours)
    assert both.seconds == pytest.approx(OFFSET_S, abs=1e-6)
    assert both.u_seconds < max(one.u_seconds for one in each if one is not None)


@pytest.mark.slow
@pytest.mark.parametrize("scatter", [0.0, 0.02])
def test_no_time_comes_of_none(scatter):
    """Not of exact labels, nor of exposures that scatter by 2 %: nothing is taken, and samples stay what they are."""
    one = plane(photographed(0.0, scatter=scatter, seed=3))
    found = find_exposures([one])
    assert found == Exposures(None, ())
    assert found.timed(one.samples) is one.samples


@pytest.mark.parametrize(
    ("slower", "offset_s", "found"),
    [
        (8, 2.5e-4, True),  # of 1/1024 s
        (8, 5e-4, True),  # of a worn shutter
        (16, 9.5e-4, False),  # three times what curtains are adjusted to
        (1, 130e-6, False),  # more than 1/8192 s: another stop
        (512, 1e-3, False),  # of 1/16 s and longer: nothing that a shutter does counts
    ],
)
def test_only_what_a_shutter_can_do_is_taken(slower, offset_s, found):
    """Up to 0.9 ms, a stop of the shortest label, and of labels up to 10 ms."""
    reported = find_offset([plane(photographed(offset_s, labels_s=slower * LABELS_S))])
    assert (reported is not None) is found
    assert reported is None or reported.seconds == pytest.approx(offset_s, rel=0.05)


@pytest.mark.slow
@pytest.mark.parametrize(("wrong", "ratio"), [(0, 1.4), (1, 1 / 1.4), (2, 1.4)])
def test_one_wrong_short_label_is_no_offset(wrong, ratio):
    """It is named with its ratio, and the shutter stays as labelled."""
    found = find_exposures([plane(photographed(0.0, wrong, ratio))])
    assert found.offset is None
    (label,) = found.wrong
    assert label.frame == wrong
    assert label.ratio == pytest.approx(ratio, abs=0.03)


@pytest.mark.slow
@pytest.mark.parametrize(("wrong", "ratio"), [(0, 1.5), (6, 0.7)])
def test_a_wrong_label_next_to_an_offset_is_named(wrong, ratio):
    """Both come out: the time without that frame, and the frame against label and time."""
    found = find_exposures([plane(photographed(OFFSET_S, wrong, ratio))])
    assert found.offset.seconds == pytest.approx(OFFSET_S, abs=1.5e-6)
    (label,) = found.wrong
    assert (label.frame, label.ratio) == (wrong, pytest.approx(ratio, rel=0.03))
    stated = found.of_printed(label, LABELS_S)
    assert stated.ratio == pytest.approx(ratio * (1.0 + OFFSET_S / LABELS_S[wrong]), rel=0.03)


@pytest.mark.slow
def test_the_time_is_not_multiplied_by_the_gain():
    """At twice and four times the gain it is the same time of the shutter, and so it is estimated."""
    gains = np.where(np.arange(LABELS_S.size) < 2, 4.0, 1.0)
    bracket = photographed(OFFSET_S, gains=gains)
    samples = plane(bracket).samples
    stated = np.array([frame.settings.exposure_s for frame in bracket.light])
    assert samples.exposures_s == pytest.approx(stated)
    longer = with_offset(samples, 1e-4)
    gain = np.array([frame.settings.effective_exposure_s for frame in bracket.light]) / stated
    assert np.exp(longer.frame_log_time) == pytest.approx((stated + 1e-4) * gain)
    assert longer.log_time == pytest.approx(longer.frame_log_time[longer.frame])
    for part in (*longer.shares, *longer.without_share, *longer.quadrants, *longer.without_quadrant):
        assert part.log_time == pytest.approx(longer.frame_log_time[part.frame])
    found = find_offset([plane(bracket)])
    assert found.seconds == pytest.approx(OFFSET_S, abs=1e-6)


def test_labels_are_judged_with_what_the_offset_may_be():
    """Three of its u, 30 us at most; ratio, u and rivals by the printed label."""
    assert Exposures(None, ()).allowed_s == UNSTATED_OFFSET_S == 30e-6
    assert Exposures(ShutterOffset(2e-5, 2e-6, 0.5), ()).allowed_s == pytest.approx(6e-6)
    assert Exposures(ShutterOffset(2e-5, 2e-5, 0.5), ()).allowed_s == 30e-6
    offset, label = ShutterOffset(2e-5, 1e-6, 0.5), WrongLabel(1, 0.5, 0.01, 0.9, ((0, 2.0),))
    reported = Exposures(offset, (label,)).of_printed(label, np.array([1e-4, 4e-4]))
    assert (reported.frame, reported.ratio, reported.u_ratio) == (
        1,
        pytest.approx(0.5 * 1.05),
        pytest.approx(0.01 * 1.05),
    )
    assert reported.rivals == ((0, pytest.approx(2.0 * 1.2)),)
    assert Exposures(None, (label,)).of_printed(label, np.array([1e-4, 4e-4])) is label


def test_the_offset_is_reported_without_wrong_labels_and_labels_with_the_offset(monkeypatch):
    """What was found wrong says nothing of the offset; the labels found with it count."""
    asked: list[Any] = []
    label = WrongLabel(2, 1.4, 0.01, 0.5)
    later = ShutterOffset(OFFSET_S, 1e-6, 0.5)

    def offset(_planes: Any, wrong: Any = ()) -> ShutterOffset | None:
        asked.append(tuple(wrong))
        return later if wrong else None

    def wrong(planes: Any, allowed_s: float) -> tuple[WrongLabel, ...]:
        asked.append((float(planes[0].samples.exposures_s[0]), allowed_s))
        return (label,)

    monkeypatch.setattr(shutter_offset, "find_offset", offset)
    monkeypatch.setattr(shutter_offset, "find_wrong_labels", wrong)
    found = find_exposures([plane(photographed(0.0))])
    assert found == Exposures(later, (label,))
    first = float(LABELS_S[0])
    assert asked == [(), (pytest.approx(first), 30e-6), (2,), (pytest.approx(first + OFFSET_S), pytest.approx(3e-6))]


@pytest.mark.slow
def test_the_response_says_it_and_holds_it(tmp_path):
    """In notes, details, the file and the exposure ratios; the curve is the true one, which the labels bend."""
    bracket = photographed(OFFSET_S)
    found = recover_response_auto(bracket)
    seconds, u = found.details["shutter_offset_s"], found.details["u_shutter_offset_s"]
    assert seconds == pytest.approx(OFFSET_S, abs=1e-6)
    assert f"all exposures are {1e6 * seconds:.1f} ± {1e6 * u:.1f} µs longer than their labels" in found.notes[0]
    assert f"0.0001221 s has {1.0 + 8192 * seconds:.3f} of that" in found.notes[0]
    assert found.exposure_ratios[0] == pytest.approx(2.0 * (1 + 4096 * seconds) / (1 + 8192 * seconds))
    step = found.exposure_ratios[0] * (1.0 / (2.0**-13 + seconds) - 1.0 / (2.0**-12 + seconds))
    assert found.u_exposure_ratios[0] == pytest.approx(step * u, rel=1e-6)
    found.curve.write(tmp_path / "curve.yaml")
    kept = ResponseCurve.read(tmp_path / "curve.yaml").provenance
    assert kept.parameters["shutter_offset_s"] == pytest.approx(seconds)
    assert kept.parameters["u_shutter_offset_s"] == pytest.approx(u)
    assert np.exp(kept.parameters["log_time_errors"]) == pytest.approx(1.0 + seconds / LABELS_S)
    assert any("the shutter's offset found from these frames" in text for text in kept.assumptions)
    dn = np.arange(20, 236)
    exposure = 0.3 / ((255.0 / dn) ** (1 / 0.6) - 1.0)
    gap = found.curve.log_exposure[dn] - np.log(exposure)
    assert np.std(gap) < 0.004
    assert np.all(found.curve.u_log_exposure[dn] < 0.05)


@pytest.mark.slow
def test_a_response_without_it_says_nothing_of_it():
    """No key, no note, the labels as they are."""
    found = recover_response_auto(photographed(0.0))
    assert "shutter_offset_s" not in found.details
    assert "shutter_offset_s" not in found.curve.provenance.parameters
    assert not any("offset" in note for note in found.notes)
    assert found.exposure_ratios == pytest.approx(np.full(LABELS_S.size - 1, 2.0))
    assert not any(found.curve.provenance.parameters["log_time_errors"])


@pytest.mark.slow
def test_what_the_offset_leaves_open_is_in_the_curve(monkeypatch):
    """A u ten times as large makes the curve's larger, by what so much more time would change it."""
    bracket = photographed(OFFSET_S)
    found = []
    for u in (1e-9, 2e-5):
        known = Exposures(ShutterOffset(OFFSET_S, u, 0.5), ())
        monkeypatch.setattr(auto, "find_exposures", lambda _planes, known=known: known)
        found.append(recover_response_auto(bracket).curve)
    more = Exposures(ShutterOffset(OFFSET_S + 2e-5, 1e-9, 0.5), ())
    monkeypatch.setattr(auto, "find_exposures", lambda _planes: more)
    moved = recover_response_auto(bracket).curve
    dn = slice(30, 226)
    wider = np.sqrt(found[1].u_log_exposure[dn] ** 2 - found[0].u_log_exposure[dn] ** 2)
    apart = np.abs(moved.log_exposure[dn] - found[0].log_exposure[dn])
    assert float(np.max(apart)) > 0.01
    assert np.sqrt(np.mean(wider**2)) == pytest.approx(np.sqrt(np.mean(apart**2)), rel=0.3)


def test_planes_without_shares_tell_nothing():
    """Nor do brackets of too few frames that show anything."""
    one = plane(photographed(OFFSET_S))
    assert find_offset([replace(one, samples=replace(one.samples, shares=()))]) is None
    assert find_offset([plane(photographed(OFFSET_S, labels_s=LABELS_S[:3]))]) is None
