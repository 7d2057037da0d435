"""Black and white of frames, and pixels that see no light, on either side of every bound."""

from __future__ import annotations

import numpy as np
import pytest

from radiometer.analysis.response.limits import ValueLimits, _common_peak, _piles_up, _stands_still, find_limits
from radiometer.analysis.response.samples import _at_edges, _contradictory, _edge_scatter, _rows, _unmoved
from radiometer.data import Bracket, Frame, FrameSettings
from radiometer.errors import MeasurementError

FULL = 4095  # a 128th of it, by which a peak may move, is 31


def frame(dn, seconds=1.0):
    return Frame(np.asarray(dn, np.uint16).reshape(10, -1), 12, FrameSettings(seconds))


@pytest.mark.parametrize("inwards", [1, -1])
@pytest.mark.parametrize(("beside", "count", "piled"), [(10, 80, False), (10, 81, True), (0, 8, False), (0, 9, True)])
def test_a_value_piles_up_against_its_eight_inner_neighbours(inwards, beside, count, piled):
    """Where it has more than eight times their mean, and eight pixels; what lies outwards or further in counts not."""
    histogram = np.full(41, 1_000_000)
    histogram[20 + inwards : 20 + 8 * inwards : inwards] = 0
    histogram[20 + 8 * inwards], histogram[20] = 8 * beside, count
    assert _piles_up(histogram, 20, inwards) is piled


def with_peak(value, part=0.06):
    """Return 1000 values, a part of them one, the rest evenly over all others."""
    dn = np.linspace(200, 3900, 1000).round()
    dn[: round(part * dn.size)] = value
    return frame(np.where((np.abs(dn - value) < 40) & (dn != value), 2500, dn))


@pytest.mark.parametrize(
    ("values", "part", "found"),
    [
        ((500, 500, 500), 0.06, 500), ((500, 531, 520), 0.06, 531), ((500, 532, 520), 0.06, None),
        ((500, 500, 500), 0.051, 500), ((500, 500, 500), 0.047, None),
        ((93, 93, 93), 0.06, 93), ((92, 92, 92), 0.06, None), ((4002,) * 3, 0.06, 4002), ((4003,) * 3, 0.06, None),
    ],
)  # fmt: skip
def test_a_peak_stands_still_where_it_is_large_clear_of_the_ends_and_hardly_moves(values, part, found):
    """5 % of the pixels, within a 128th of full scale, three such widths from black and white; the highest is taken."""
    assert _common_peak([with_peak(value, part) for value in values], FULL) == found


@pytest.mark.parametrize(
    ("count", "times", "low", "high"),
    [
        (6, (1.0, 2.0, 3.0, 10.0, 20.0, 30.0), 500, 3500), (6, (1.0, 2.0, 2.9, 10.0, 20.0, 29.0), 0, FULL),
        (6, (1.0, 2.0, 3.0, 10.0, 20.0, 29.0), 500, FULL), (6, (1.0, 2.0, 2.9, 10.0, 20.0, 30.0), 0, 3500),
        (5, (1.0, 2.0, 3.0, 10.0, 30.0), 0, FULL),
    ],
)  # fmt: skip
def test_three_frames_at_either_end_that_grow_threefold_tell_fog_and_knee(count, times, low, high):
    """The commonest value of the three shortest and of the three longest; of five frames none says so."""
    values = [500] * (count // 2) + [3500] * (count - count // 2)
    bracket = Bracket.from_frames(
        Frame(with_peak(value).dn, 12, FrameSettings(seconds)) for value, seconds in zip(values, times, strict=True)
    )
    assert _stands_still(bracket, FULL) == (low, high)


@pytest.mark.parametrize("wrong", [0, 1, 2, 3, 12, 13, 14, 15])
@pytest.mark.parametrize("ratio", [0.35, 0.7, 1.4, 2.9])
def test_fog_and_knee_are_seen_whatever_one_label_says(wrong, ratio):
    """As many frames at either end as grow threefold by their labels: a wrong one may want one or two frames more."""
    times = 2.0 ** np.arange(16)
    times[wrong] *= ratio
    values = [500] * 6 + [*range(700, 3300, 650)] + [3500] * 6
    bracket = Bracket.from_frames(
        Frame(with_peak(value).dn, 12, FrameSettings(float(seconds)))
        for value, seconds in zip(values, times, strict=True)
    )
    assert _stands_still(bracket, FULL) == (500, 3500)


def test_fog_is_dark_and_a_knee_is_bright():
    """A bright value that the shortest frames keep is no black, nor is a dark one that the longest keep white."""
    bracket = Bracket.from_frames(
        Frame(with_peak(value).dn, 12, FrameSettings(seconds))
        for value, seconds in zip([2100] * 3 + [1900] * 3, (1.0, 2.0, 3.0, 10.0, 20.0, 30.0), strict=True)
    )
    assert _stands_still(bracket, FULL) == (0, FULL)


@pytest.mark.parametrize(
    ("numbers", "growth", "unmoved"),
    [
        ((2000, 2080), 4.0, True), ((2000, 2083), 4.0, False), ((2000, 2080), 3.9, False),
        ((1001, 1001), 4.0, True), ((999, 999), 4.0, False), ((3599, 3599), 4.0, True), ((3601, 3601), 4.0, False),
    ],
)  # fmt: skip
def test_a_middle_tone_that_stays_sees_no_light(numbers, growth, unmoved):
    """Between a quarter and nine tenths of white, within 2 % of full scale, though the exposure grows fourfold."""
    shown = [np.full(100, number) for number in numbers]
    bracket = Bracket.from_frames([frame(shown[0], 1.0), frame(shown[1], growth)])
    assert np.all(_unmoved(bracket, ValueLimits(0, 4000)) == unmoved)


@pytest.mark.parametrize(("numbers", "bad"), [((2000, 1591, 1800), False), ((2000, 1590, 1800), True)])
def test_a_pixel_that_falls_by_a_tenth_of_full_scale_did_not_see_one_thing(numbers, bad):
    """From the highest number of any shorter exposure."""
    bracket = Bracket.from_frames(frame(np.full(100, number), 2.0**k) for k, number in enumerate((100, *numbers)))
    assert np.all(_contradictory(bracket) == bad)


@pytest.mark.parametrize(
    ("clipped", "above_black", "growth", "used"),
    [
        (2, 50.0, 2.0, True), (3, 50.0, 2.0, False), (0, 4.1, 2.0, True), (0, 3.9, 2.0, False),
        (0, 50.0, 1.05, True), (0, 50.0, 1.035, False),
    ],
)  # fmt: skip
def test_a_group_counts_where_it_hardly_clips_and_shows_two_exposures(clipped, above_black, growth, used):
    """Two pixels of a thousand may clip, the mean lies 4 DN above black, exposures differ by 4 %; the rest is a row."""
    sums = np.zeros((4, 2, 1))
    for index, dn in enumerate((100.0 + above_black, 300.0)):
        sums[:, index, 0] = 1000.0, 1000.0 * dn, 1000.0 * (dn**2 + 7.0), clipped
    bracket = Bracket.from_frames([frame(np.full(100, 300), 1.0), frame(np.full(100, 300), growth)])
    found = _rows(bracket, sums, ValueLimits(100, 4000), 1, 6)
    assert found.dn == pytest.approx([100.0 + above_black, 300.0] if used else [])
    assert found.frame.tolist() == ([6, 7] if used else [])
    assert found.log_time == pytest.approx([0.0, np.log(growth)] if used else [])
    assert found.variance == pytest.approx([7.0, 7.0] if used else [])


@pytest.mark.parametrize(("count", "mean", "told"), [(20, 50.0, 3.0), (19, 50.0, 1.0), (20, 4.1, 3.0), (20, 3.9, 1.0)])
def test_scatter_at_edges_is_told_by_twenty_pixels_above_black(count, mean, told):
    """A variance of 6 DN² beside one of 2; of fewer pixels, or next to black, nothing is said."""
    even, edges = (np.array([count, count * mean, count * (mean**2 + v), 0.0]).reshape(4, 1, 1) for v in (2.0, 6.0))
    assert _edge_scatter(even, edges) == pytest.approx(told)


@pytest.mark.parametrize("turned", [False, True])
def test_pixels_by_a_step_are_those_at_edges(turned):
    """A step in the middle of eight is seen two pixels away, the next of one colour on a mosaic: by half of them."""
    step = np.repeat([[100, 100, 100, 100, 300, 300, 300, 300]], 6, axis=0)
    shown = step.T if turned else step
    bracket = Bracket.from_frames([Frame(shown.astype(np.uint16), 12, FrameSettings(1.0))])
    edges = _at_edges(bracket, np.zeros(48, np.intp)).reshape(shown.shape)
    expected = np.repeat([[0, 0, 1, 1, 1, 1, 0, 0]], 6, axis=0)
    assert np.array_equal(edges, expected.T if turned else expected)


@pytest.mark.parametrize(("value", "said"), [(FULL, "67 % .*saturated, 33 % black.*shorter"), (0, "33 % .*longer")])
def test_where_all_is_clipped_it_is_said_which_way_to_go(value, said):
    """More white than black calls for shorter exposures, more black for longer ones."""
    values = np.repeat([value, value, FULL - value], 10)
    with pytest.raises(MeasurementError, match=said):
        find_limits([Bracket.from_frames([frame(values), frame(values, 2.0)])])
