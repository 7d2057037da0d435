"""Photographs from the hand: how they lie to each other, and what becomes of their values."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from radiometer.analysis.merge.alignment import Alignment, Movement, aligned, find_alignment
from radiometer.data import Bracket, Frame, FrameSettings

HEIGHT, WIDTH = 220, 300
STOPS = 2.0 ** np.arange(5)


@pytest.fixture(scope="module")
def waves():
    """Return amplitude, wave numbers and phases of a scene that is known between pixels too."""
    rng = np.random.default_rng(4)
    length = rng.uniform(8.0, 60.0, 60)
    angle, phase = rng.uniform(0.0, 2.0 * math.pi, (2, 60))
    return 0.28, 2.0 * math.pi / length * np.cos(angle), 2.0 * math.pi / length * np.sin(angle), phase


def _radiance(waves, place):
    """Return the scene at the pixels of a photograph: a wave's phase is a sum of a row's part and a column's."""
    amplitude, kx, ky, phase = waves
    (a, b), (c, d) = place[:, :2]
    of_rows = np.exp(1j * ((kx * c + ky * d) * (np.arange(HEIGHT)[:, None] - place[1, 2]) + phase))
    of_columns = np.exp(1j * (kx * a + ky * b) * (np.arange(WIDTH)[:, None] - place[0, 2]))
    return np.exp(amplitude * (of_rows @ of_columns.T).imag)


def _place(shift, degrees):
    """Return the matrix from the scene to a photograph turned about its middle and shifted."""
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    turn, middle = np.array([[c, -s], [s, c]]), np.array([WIDTH / 2, HEIGHT / 2])
    return np.column_stack([turn, middle + shift - turn @ middle])


def _photograph(waves, place, seconds, rng=None):
    """Return what a camera with a tone curve makes of the scene from its place: x_scene = Rᵀ(x − d)."""
    light = _radiance(waves, place) * seconds * 25.0
    electrons = light if rng is None else rng.poisson(light)
    dn = 255.0 * (electrons / 1500.0) ** 0.45 + (0.0 if rng is None else rng.normal(0.0, 0.5, light.shape))
    return Frame(np.clip(np.rint(dn), 0, 255).astype(np.uint8), 8, FrameSettings(float(seconds)))


def _corner_gap(found, expected):
    corners = np.array([(0, 0), (WIDTH - 1, 0), (0, HEIGHT - 1), (WIDTH - 1, HEIGHT - 1)], float)
    gap = corners @ (found[:, :2] - expected[:, :2]).T + found[:, 2] - expected[:, 2]
    return float(np.linalg.norm(gap, axis=1).max())


def _relative(place, reference):
    """Return the matrix from the reference photograph's pixels to another's."""
    turn = reference[:, :2].T
    return np.column_stack([place[:, :2] @ turn, place[:, 2] - place[:, :2] @ turn @ reference[:, 2]])


def test_shifts_and_turns_are_found_to_a_tenth_of_a_pixel(waves):
    """Five noisy photographs, up to seven pixels and 0.7° apart, behind a tone curve without a statement."""
    rng = np.random.default_rng(8)
    shifts = rng.uniform(-5.0, 5.0, (5, 2))
    places = [_place(shift, turn) for shift, turn in zip(shifts, rng.uniform(-0.7, 0.7, 5), strict=True)]
    bracket = Bracket.from_frames(_photograph(waves, *one, rng) for one in zip(places, STOPS, strict=True))
    found = find_alignment(bracket)
    assert found.needed
    assert all(one.known for one in found.movements)
    gaps = [
        _corner_gap(one.to_frame, _relative(place, places[found.reference]))
        for one, place in zip(found.movements, places, strict=True)
    ]
    assert max(gaps) < 0.1
    assert "aligned to" in found.sentence([f"p{k}" for k in range(5)])


def test_still_photographs_are_left_alone(waves):
    """Noise and exposure alone are no movement."""
    rng = np.random.default_rng(9)
    found = find_alignment(Bracket.from_frames(_photograph(waves, _place(0.0, 0.0), s, rng) for s in STOPS))
    assert not found.needed
    assert found.largest_px < 0.1
    assert found.sentence(["p"] * 5).startswith("aligned already")


def test_moved_values_are_those_of_the_scene(waves):
    """Brought back, a photograph shows what one from the reference's place shows, and says where it shows nothing."""
    place = _place(np.array([3.3, -2.6]), 0.4)
    still, moved = _photograph(waves, _place(0.0, 0.0), 8.0), _photograph(waves, place, 8.0)
    shape = (HEIGHT, WIDTH)
    back, absent = aligned(Bracket.from_frames([moved]), Alignment((Movement(place),), 0, shape))
    shown = back.light[0].dn.astype(int)
    seen = ~absent[0]
    gap = np.abs(shown - still.dn)[seen]
    assert gap.max() <= 5
    assert gap.mean() < 0.6
    assert np.mean(seen) > 0.8
    # The photograph moved by 2.6 pixels upwards: the reference's first rows lie above its own first row.
    assert absent[0][0].mean() > 0.9
    assert absent[0][110, 4:296].mean() < 0.2
    clipped = still.dn == 255
    assert clipped.any()
    # What is only partly read off clipped pixels is unknown, not clipped.
    assert np.mean(shown[seen & ~clipped] == 255) < 0.002


def test_one_lamp_says_nothing_of_the_corners(waves):
    """A photograph that shows one lamp and else nothing stays where it is, and that is stated."""
    rng = np.random.default_rng(1)
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    lamp = 120.0 * np.exp(-((x - 60.0) ** 2 + (y - 50.0) ** 2) / 60.0)
    dark = Frame(np.rint(12.0 + lamp + rng.normal(0.0, 1.0, lamp.shape)).astype(np.uint8), 8, FrameSettings(0.1))
    brighter = Frame(
        np.rint(12.0 + 1.7 * np.roll(lamp, 3, axis=1) + rng.normal(0.0, 1.0, lamp.shape)).astype(np.uint8),
        8,
        FrameSettings(0.3),
    )
    found = find_alignment(Bracket.from_frames([dark, brighter]))
    assert [one.known for one in found.movements].count(False) == 1
    assert found.largest_px == 0.0
    assert "unknown for" in found.sentence(["a", "b"])


@pytest.mark.parametrize(("rim_dn", "contrast"), [(0, 0.2), (0, 0.02), (255, 0.02)])
def test_a_rim_of_one_value_is_no_scene(waves, rim_dn, contrast):
    """Rims that another program left where it moved foggy, dim scans do not pull them back: black, or white in blue."""
    rng = np.random.default_rng(2)
    frames = []
    for shift, seconds, width in ((0.0, 1.0, 3), (1.5, 2.0, 14), (0.0, 4.0, 6)):
        seen = _photograph(waves, _place(np.array([shift, 0.0]), 0.0), seconds, rng)
        dn = np.rint(40.0 + contrast * seen.dn).astype(np.uint8)
        dn[:, :width] = dn[:, -width:] = rim_dn
        frames.append(Frame(dn, 8, seen.settings))
    found = find_alignment(Bracket.from_frames(frames))
    middle = np.array([WIDTH / 2, HEIGHT / 2, 1.0])
    away = [one.to_frame[0] @ middle - middle[0] for one in found.movements]
    assert np.diff(away) == pytest.approx([1.5, -1.5], abs=0.15)


def test_the_frame_that_was_seen_to_move_is_named():
    """A frame of which it cannot be reported goes with its neighbour, and the neighbour is the one that is named."""
    moved = Movement(_place(np.array([3.0, 0.0]), 0.0))
    found = Alignment((replace(moved, known=False), moved, Movement(np.eye(2, 3))), 2, (HEIGHT, WIDTH))
    assert found.sentence(["a", "b", "c"]).startswith("aligned to c: moved by up to 3 pixels (b)")


def test_photographs_far_apart_are_found_from_afar(waves):
    """A quarter of the picture apart a climb from where both stand leads astray; one from the whole shift does not."""
    places = [_place(np.array(shift), 0.3 * k) for k, shift in enumerate([(0.0, 0.0), (62.0, -41.0)])]
    found = find_alignment(Bracket.from_frames(_photograph(waves, place, 8.0) for place in places))
    gaps = [
        _corner_gap(one.to_frame, _relative(place, places[found.reference]))
        for one, place in zip(found.movements, places, strict=True)
    ]
    assert max(gaps) < 0.2


def test_what_all_frames_show_is_left_by_the_largest_displacement():
    """7.2 pixels to a side, and one more for values between pixels, are cut off all around; never past a quarter."""

    def still(shift):
        return Movement(np.array([[1.0, 0.0, shift], [0.0, 1.0, 0.0]]))

    frames = [Frame(np.arange(60 * 80, dtype=np.uint16).reshape(60, 80), 16, FrameSettings(t)) for t in (0.1, 0.2)]
    for shift, rim in ((7.2, 9), (-7.2, 9), (500.0, 15)):
        alignment = Alignment((still(0.0), still(shift)), 0, (60, 80))
        trimmed = alignment.trimmed(Bracket.from_frames(frames))
        for one, frame in zip(trimmed.light, frames, strict=True):
            np.testing.assert_array_equal(one.dn, frame.dn[rim : 60 - rim, rim : 80 - rim])


@pytest.mark.parametrize(
    ("shift", "degrees", "needed"),
    [((0.24, 0.0), 0.0, False), ((0.0, -0.26), 0.0, True), ((0.15, 0.19), 0.0, False), ((0.19, 0.19), 0.0, True),
     ((0.0, 0.0), 0.07, False), ((0.0, 0.0), 0.09, True)],
)  # fmt: skip
def test_corners_that_move_by_a_quarter_pixel_call_for_alignment(shift, degrees, needed):
    """By whatever shift or turn: a corner of 300 by 220 lies 186 pixels from the middle, so that 0.077 degrees do."""
    moved = Movement(_place(np.array(shift), degrees))
    found = Alignment((Movement(np.eye(2, 3)), moved), 0, (HEIGHT, WIDTH))
    assert found.needed is needed
    assert found.sentence(["a", "b"]).startswith("aligned already") is not needed


@pytest.mark.parametrize("degrees", [0.05, 0.5, 20.0])
def test_a_turn_moves_the_farthest_corner_by_its_chord(degrees):
    """A picture turned about its first pixel: the opposite corner moves by 2·d·sin(θ/2), and by the shift besides."""
    turn = math.radians(degrees)
    turned = np.array([[math.cos(turn), -math.sin(turn), 0.0], [math.sin(turn), math.cos(turn), 0.0]])
    chord = 2 * math.hypot(59, 79) * math.sin(turn / 2)
    assert Movement(turned).largest_px((60, 80)) == pytest.approx(chord, rel=1e-9)
    assert Movement(turned).rotation_deg == pytest.approx(degrees)
    assert Movement(np.array([[1.0, 0.0, 3.0], [0.0, 1.0, -4.0]])).largest_px((60, 80)) == pytest.approx(5.0)
