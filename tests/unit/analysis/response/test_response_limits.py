"""Black and white of frames, and pixels that see no light, on either side of every bound."""

from __future__ import annotations

import numpy as np
import pytest

from radiometer.analysis.response.limits import find_limits
from radiometer.data import Bracket, Frame, FrameSettings
from radiometer.errors import MeasurementError

FULL = 4095  # a 128th of it, by which a peak may move, is 31


def frame(dn, seconds=1.0):
    return Frame(np.asarray(dn, np.uint16).reshape(10, -1), 12, FrameSettings(seconds))


@pytest.mark.parametrize(("value", "message"), [(FULL, "67 % .*saturated, 33 % black.*shorter"), (0, "33 % .*longer")])
def test_where_all_is_clipped_it_is_reported_which_way_to_go(value, message):
    """More white than black calls for shorter exposures, more black for longer ones."""
    values = np.repeat([value, value, FULL - value], 10)
    with pytest.raises(MeasurementError, match=message):
        find_limits([Bracket.from_frames([frame(values), frame(values, 2.0)])])


def with_peak(value, part=0.06):
    """Return 1000 values, a part of them one, the rest evenly over all others."""
    dn = np.linspace(200, 3900, 1000).round()
    dn[: round(part * dn.size)] = value
    return frame(np.where((np.abs(dn - value) < 40) & (dn != value), 2500, dn)).dn


def black_of(values, times, part=0.06):
    """Return black of frames in each of which a part of the picture has one value."""
    frames = [
        Frame(with_peak(value, part), 12, FrameSettings(float(seconds)))
        for value, seconds in zip(values, times, strict=True)
    ]
    return find_limits([Bracket.from_frames(frames)]).black_dn


@pytest.mark.parametrize(
    ("values", "part", "black"),
    [
        ((500, 500, 500), 0.06, 500), ((500, 531, 520), 0.06, 531), ((500, 532, 520), 0.06, 0),
        ((500, 500, 500), 0.051, 500), ((500, 500, 500), 0.047, 0),
    ],
)  # fmt: skip
def test_fog_is_a_large_peak_that_hardly_moves(values, part, black):
    """5 % of the pixels, within a 128th of full scale; the highest is taken."""
    assert black_of([*values, 1200, 1800, 2600], 2.0 ** np.arange(6), part) == black


@pytest.mark.parametrize(("third", "black"), [(3.0, 500), (2.9, 0)])
def test_three_frames_that_grow_threefold_show_fog(third, black):
    """The commonest value of the three shortest, where their exposures grow threefold; of five frames none is fog."""
    assert black_of([500] * 3 + [3500] * 3, (1.0, 2.0, third, 10.0, 20.0, 30.0)) == black
    assert black_of([500] * 2 + [3500] * 3, (1.0, 2.0, 10.0, 20.0, 30.0)) == 0


@pytest.mark.parametrize("wrong", [0, 2, 13, 15])
@pytest.mark.parametrize("ratio", [0.35, 2.9])
def test_fog_is_seen_whatever_one_label_says(wrong, ratio):
    """As many frames as grow threefold by their labels: a wrong one may need one or two frames more."""
    times = 2.0 ** np.arange(16)
    times[wrong] *= ratio
    assert black_of([500] * 6 + [*range(700, 3300, 650)] + [3500] * 6, times) == 500


def test_fog_is_dark():
    """A bright value that the shortest frames keep is no black."""
    assert black_of([2100] * 3 + [1900] * 3, (1.0, 2.0, 3.0, 10.0, 20.0, 30.0)) == 0


@pytest.mark.parametrize(
    ("neighbour", "count", "piled"), [(10, 80, False), (10, 81, True), (1, 8, False), (1, 9, True)]
)
def test_the_lowest_value_is_black_where_it_piles_up(neighbour, count, piled):
    """Above eight times the mean of the eight values next above it."""
    counts = {1000: count, **dict.fromkeys(range(1001, 1009), neighbour)}
    dn = np.repeat([*counts, 2000], [*counts.values(), 10 - sum(counts.values()) % 10])
    found = find_limits([Bracket.from_frames([frame(dn), frame(dn, 2.0)])])
    assert found.black_dn == (1000 if piled else 0)
