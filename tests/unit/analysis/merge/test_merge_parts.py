"""Parts of a merge by hand: which frames agree, whose edge goes with it, displacement, where pictures lie."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from radiometer.analysis.merge import alignment, parts
from radiometer.analysis.merge.alignment import (
    _after,
    _alike,
    _corner_u_px,
    _full_size,
    _has_white_rims,
    _inside,
    _quantiles,
    _reduced,
    _reference,
    _rim,
    _steady,
    _summit,
)
from radiometer.analysis.merge.displaced import MeanDisplacement, excess_scatter, relative_shift
from radiometer.analysis.merge.frames import _lowest_dn
from radiometer.analysis.merge.ghosts import _agreement, find_strays, signals
from radiometer.analysis.merge.records import scatter_limit
from radiometer.analysis.merge.sums import FRAMES_PER_PLANE, MergeSample, MergeSums
from radiometer.analysis.merge.tables import _ROOT_TABLE_SIZE, MergeTables
from radiometer.data import Bracket, Frame, FrameSettings, SensorNoise

STILL = np.eye(2, 3)


def tables(exposures, *, variance=25.0, kappa=0.0, slack=0.01, clips_at=4000.0, sigma_clip=5.0, bounds=(4000.0, 1.0)):
    """Return the tables of linear frames of the same noise."""
    frames = np.array([[t, variance, clips_at, sigma_clip, 0.0, variance] for t in exposures])
    return MergeTables(frames, kappa, np.array([*bounds, slack]), np.ones(len(exposures)), None, None, 1.0, np.zeros(2))


def sample(dn, index=0):
    """Return a frame of a linear sensor without black, which clips at 4095."""
    dn = np.asarray(dn, np.uint16).ravel()
    terms = SimpleNamespace(low_dn=0, high_dn=4095, black_dn=0.0, gain=1.0, dark=np.zeros(1), exposure=1.0)
    return MergeSample(dn, terms, None, index)


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize(
    ("of", "reach"), [(None, (20.0, 20.0)), (0, (4 * 50**0.5, 4 * 125**0.5)), (1, (4 * 31.25**0.5, 4 * 50**0.5))]
)
def test_frames_agree_within_four_sigma_and_a_hundredth(side, of, reach):
    """Of noise of 5 at 100 and 200; a frame's own value has its own noise beside, by the ratio of the exposures."""
    found = tables([1.0, 2.0])
    expected, slack = np.array([100.0, 200.0]), np.array([1.0, 2.0])
    for k in (0, 1):
        for factor, agrees in ((0.999, True), (1.001, False)):
            x = expected.copy()
            x[k] += side * factor * (reach[k] + slack[k])
            told, information = _agreement(
                found, np.array([100.0]), x[:, None], np.ones((2, 1), bool), np.zeros((2, 1), bool), np.zeros(1), of
            )
            assert told[:, 0].tolist() == [agrees if j == k else True for j in (0, 1)]
            assert information[:, 0] == pytest.approx([1.0 / 25.0, 4.0 / 25.0])


@pytest.mark.parametrize(("rate", "agrees"), [(3931.0, True), (3938.0, True), (3900.0, False)])
def test_a_frame_that_clips_agrees_where_it_need_not_have(rate, agrees):
    """From four of its sigma and a hundredth below 4000 on; with a displacement of a hundredth farther below."""
    ask = (np.zeros((1, 1)), np.zeros((1, 1), bool), np.ones((1, 1), bool))
    found, _ = _agreement(tables([1.0]), np.array([rate]), *ask, np.zeros(1), None)
    border = (4000.0 - 20.0) / 1.01
    assert bool(found[0, 0]) is (rate >= border) or not agrees
    assert bool(found[0, 0]) is (rate > border)
    moved, _ = _agreement(tables([1.0]), np.array([3900.0]), *ask, np.array([0.01]), None)
    assert moved[0, 0]


@pytest.mark.parametrize(
    ("core", "taken"), [(((1, 1), (1, 2), (1, 3), (2, 1)), True), (((1, 1), (1, 2), (1, 3)), False)]
)
def test_the_edge_of_what_moved_goes_with_four_of_its_eight_neighbours(core, taken):
    """A pixel beside four that one frame alone shows otherwise is left out of it too, beside three it stays."""
    scene = np.full((5, 5), 100)
    other = scene.copy()
    for place in core:
        other[place] = 900
    samples = [sample(scene, 0), sample(other, 1), sample(scene, 2)]
    found = find_strays(samples, tables([1.0, 1.0, 1.0]), other > 100, ())
    places = {divmod(int(p), 5) for p in found.pixels}
    assert places == {*core, *(((2, 2),) if taken else ())}
    assert set(found.left_out.tolist()) == {0b010}
    assert not found.alone.any()


def test_of_two_frames_that_contradict_each_other_one_stands_alone():
    """The surer one stays: the longer exposure; what shows nothing there is left out besides, and nobody else is."""
    scene, other = np.full((3, 3), 100), np.full((3, 3), 800)
    doubtful = np.zeros((3, 3), bool)
    doubtful[1, 1] = True
    absent = [np.zeros((3, 3), bool) for _ in range(3)]
    absent[2][1, 1] = True
    samples = [sample(scene, 0), sample(other, 1), sample(scene, 2)]
    found = find_strays(samples, tables([1.0, 2.0, 4.0]), doubtful, absent)
    assert (found.pixels.tolist(), found.left_out.tolist(), found.alone.tolist()) == ([4], [0b101], [True])


def test_signals_are_those_of_frames_that_show_something():
    """From the lowest used number to below clipping; where a frame shows nothing it neither speaks nor clips."""
    one = sample([0, 10, 4094, 4095])
    x, used, high = signals([one, one], np.array([1, 2, 3]), np.array([[False] * 3, [True] * 3]))
    assert (x.tolist(), used.tolist()) == ([[10.0, 4094.0, 0.0], [0.0] * 3], [[True, True, False], [False] * 3])
    assert high.tolist() == [[False, False, True], [False] * 3]


def test_weights_of_displaced_frames_are_those_of_their_information():
    """t²/v of 1 and 9: √(0.1² + 0.9²); where the longer clips the shorter has all; where nothing is known, one."""
    found = MeanDisplacement.of(tables([1.0, 3.0], clips_at=300.0, bounds=(300.0, 1.0)))
    rates = np.exp(found.lowest + np.arange(found.factors.size) / 16.0)
    both, one = rates < 100.0, (rates > 100.0) & (rates < 300.0)
    assert found.lowest == pytest.approx(0.0)
    assert found.factors[both] == pytest.approx(math.hypot(0.1, 0.9))
    assert found.factors[one] == pytest.approx(1.0)
    assert rates[-1] >= 300.0
    shot = MeanDisplacement.of(tables([1.0, 3.0], variance=1e-9, kappa=1.0))
    assert shot.factors[4] == pytest.approx(math.hypot(1.0, 3.0) / 4.0)  # of photons alone the weights go as t


def test_a_shift_at_the_border_is_that_of_one_step():
    """L = exp(0.1·x + 0.2·y): δ·√(0.01 + 0.04) everywhere, the rim included; a single row knows its own direction."""
    y, x = np.mgrid[:5, :7]
    ramp = np.exp(0.1 * x + 0.2 * y).astype(np.float32)
    nothing = np.zeros_like(ramp)
    assert relative_shift(ramp, nothing, 0.5) == pytest.approx(np.full((5, 7), 0.5 * math.sqrt(0.05)), rel=1e-4)
    assert relative_shift(ramp[:1], nothing[:1], 2.0) == pytest.approx(np.full((1, 7), 0.2), rel=1e-4)
    doubtful = np.full_like(ramp, 2.0 * ramp.max())
    assert not relative_shift(ramp, doubtful, 0.5).any()  # all count as their uncertainty
    assert not relative_shift(nothing, nothing, 0.5).any()


@pytest.mark.parametrize("shift", [0.0, 0.01])
@pytest.mark.parametrize("factor", [0.0, 0.5, 0.999, 1.001])
def test_frames_may_scatter_by_noise_and_displacement_together(shift, factor):
    """Two of 1000 ± 5 and, displaced by a hundredth, ± 10 beside: up to the limit of two degrees of freedom."""
    variance = 25.0 + (1000.0 * shift) ** 2
    half = factor * math.sqrt(variance * scatter_limit(2.0))
    samples = [sample([1000], 0), sample([1000], 1)]
    for one, value in zip(samples, (1000.0 - half, 1000.0 + half), strict=True):
        one.terms.black_dn = 1000.0 - value
    found = excess_scatter(samples, tables([1.0, 1.0], slack=0.0), np.array([0]), np.array([1000.0]), np.array([shift]))
    assert found[0] == (pytest.approx(factor**2 * scatter_limit(2.0)) if factor < 1.0 else np.inf)


@pytest.mark.parametrize(("slack", "u_curve", "reach"), [(0.0, 0.02, 100.0), (0.1, 0.0, 100.0), (0.06, 0.016, 100.0)])
@pytest.mark.parametrize("factor", [0.99, 1.01])
def test_frames_may_differ_by_what_is_not_known_of_their_curve(slack, u_curve, reach, factor):
    """Without noise, by five times its relative uncertainty, and by what is granted to every frame, in quadrature."""
    plain = tables([1.0, 1.0], variance=1e-6, slack=slack)
    known = replace(
        plain, quantisation=np.zeros(_ROOT_TABLE_SIZE), curve=np.full(_ROOT_TABLE_SIZE, u_curve), top=4095.0
    )
    samples = [sample([1000], 0), sample([1000], 1)]
    for one, sign in zip(samples, (-1.0, 1.0), strict=True):
        one.terms.black_dn = sign * factor * reach
    found = excess_scatter(samples, known, np.array([0]), np.array([1000.0]), np.zeros(1))
    assert bool(np.isfinite(found[0])) is (factor < 1.0)


def test_a_frame_that_shows_nothing_scatters_nothing():
    """Left out, the other stands alone."""
    samples = [sample([1000], 0), sample([1100], 1)]
    gone = [np.array([[False]]), np.array([[True]])]
    lone = excess_scatter(samples, tables([1.0, 1.0], slack=0.0), np.array([0]), np.array([1000.0]), np.zeros(1), gone)
    assert lone[0] == pytest.approx(0.0)


@pytest.mark.parametrize(("rate", "told"), [(3971.0, True), (3969.0, False)])
def test_a_frame_that_clips_contradicts_from_six_sigma_below_on(rate, told):
    """Of noise of 5 below 4000: 3970; then no scatter is explained."""
    samples = [sample([round(rate)], 0), sample([4095], 1)]
    found = excess_scatter(samples, tables([1.0, 1.0], slack=0.0), np.array([0]), np.array([rate]), np.zeros(1))
    assert bool(np.isfinite(found[0])) is told


@pytest.mark.parametrize(("black_sigmas", "lowest"), [(3.9, 1), (4.0, 0), (4.1, 0)])
def test_the_number_0_is_used_where_black_lies_four_sigma_above_it(black_sigmas, lowest):
    """Read noise of 5 e⁻ at 2.5 e⁻ per DN is 2 DN, at 6.02 dB 4 DN."""
    noise = SensorNoise(conversion_gain_e_per_dn=2.5, read_noise_e=5.0, full_well_e=1e4)
    for gain_db, sigma_dn in ((0.0, 2.0), (20.0 * math.log10(2.0), 4.0)):
        black_dn = black_sigmas * sigma_dn * (1.0 + 1e-12)
        model = SimpleNamespace(noise=noise, black_of=lambda _, black_dn=black_dn: black_dn)
        assert _lowest_dn(model, FrameSettings(1.0, gain_db), 1.0) == lowest


@pytest.mark.parametrize(("width", "rows"), [(100, 327), (1 << 15, 1), ((1 << 15) + 1, 1), (1, 1 << 15)])
def test_blocks_are_whole_rows_that_cover_a_part_once(width, rows):
    """As many rows as 32 768 pixels hold, one at least; the last block is what is left."""
    assert parts.block_size(width) == rows * width
    start, stop = 3 * width, (3 + 2 * rows + 1) * width
    found = list(parts.blocks(start, stop, width))
    assert [end - begin for begin, end in found] == [rows * width, rows * width, width]
    assert (found[0][0], found[-1][1]) == (start, stop)
    assert all(one[1] == two[0] for one, two in itertools.pairwise(found))


@pytest.mark.parametrize("shape", [(1, 7), (37, 5), (64, 3)])
@pytest.mark.parametrize("cores", [1, 3, None])
def test_all_cores_together_do_every_pixel_once(shape, cores, monkeypatch):
    """In whole rows, four parts for each core, fewer where there are fewer rows."""
    monkeypatch.setattr(parts.os, "cpu_count", lambda: cores)
    done = []
    parts.on_all_cores(shape, lambda start, stop: done.append((start, stop)))
    done.sort()
    pixels = [k for start, stop in done for k in range(start, stop)]
    assert pixels == list(range(shape[0] * shape[1]))
    assert all(start % shape[1] == stop % shape[1] == 0 for start, stop in done)
    assert len(done) <= 4 * (cores or 1)
    assert len(done) > 2 * (cores or 1) or len(done) == shape[0]


def test_bits_of_many_frames_stand_in_planes_of_sixteen():
    """Frame 35 is bit 3 of the third plane, and bit 35 of a pixel's pattern."""
    one = sample([5], 35)
    assert (FRAMES_PER_PLANE, one.plane, one.bit) == (16, 2, 8)
    sums = MergeSums.zeros(3)
    sums.make_room(35)
    assert len(sums.planes) == 3
    sums.make_room(36)
    assert len(sums.planes) == 3
    sums.planes[2][1] = 8
    assert sums.patterns().tolist() == [0, 1 << 35, 0]
    assert sums.part(1, 3).patterns().tolist() == [1 << 35, 0]


@pytest.mark.parametrize("scale", [2.0, 3.7])
def test_a_movement_of_reduced_pictures_takes_middles_to_middles(scale):
    """Through the reduced picture and back is the same as the full movement, at any place; and one after another."""
    c, s = math.cos(0.1), math.sin(0.1)
    moved = np.array([[c, -s, 3.0], [s, c, -2.0]])
    full = _full_size(moved, scale)
    for place in (np.array([0.0, 0.0]), np.array([40.0, 17.0])):
        reduced = (place + 0.5) / scale - 0.5
        there = moved[:, :2] @ reduced + moved[:, 2]
        assert full[:, :2] @ place + full[:, 2] == pytest.approx((there + 0.5) * scale - 0.5)
        once = full[:, :2] @ place + full[:, 2]
        twice = moved[:, :2] @ once + moved[:, 2]
        both = _after(moved, full)
        assert both[:, :2] @ place + both[:, 2] == pytest.approx(twice)
    assert _full_size(moved, 1.0) == pytest.approx(moved)


def test_a_picture_is_reduced_to_so_many_pixels_and_never_enlarged():
    """60 by 80 to a quarter of its pixels is 30 by 40, of the same mean; at or beyond its own size it stays."""
    picture = np.random.default_rng(1).integers(0, 255, (60, 80)).astype(np.uint8)
    small = _reduced(picture, 1200)
    assert small.shape == (30, 40)
    assert small.mean() == pytest.approx(picture.mean(), rel=1e-4)
    assert np.array_equal(_reduced(picture, 4800), picture)
    assert np.array_equal(_reduced(picture, 10**6), picture)
    assert _reduced(picture, 1).shape == (1, 1)


def test_the_reference_shows_most_between_a_twentieth_and_nineteen():
    """Of 8 bits numbers from 13 to 242; the first of equals."""

    def frame(dn, count, seconds):
        numbers = np.zeros((4, 5), np.uint8)
        numbers.ravel()[:count] = dn
        return Frame(numbers, 8, FrameSettings(seconds))

    for edge, counts in ((12, False), (13, True), (242, True), (243, False)):
        bracket = [frame(100, 5, 1.0), frame(edge, 9, 2.0)]
        assert _reference(Bracket.from_frames(bracket)) == int(counts)
    assert _reference(Bracket.from_frames([frame(100, 5, 1.0), frame(120, 5, 2.0)])) == 0


def test_a_rim_hangs_together_with_an_edge():
    """Black that touches an edge of the picture, not that inside; around it five blurred pixels show nothing."""
    picture = np.full((30, 40), 50.0, np.float32)
    picture[:, :2] = 0.0
    picture[12:15, 20:23] = 0.0
    picture[1, 1:4] = 0.0
    rim = _rim(picture, 0.0)
    assert rim[:, :2].all()
    assert rim[1, 2:4].all()
    assert rim.sum() == 62
    shown = _inside(picture)
    assert shown[15].tolist() == [0] * 7 + [1] * 33
    assert _inside(picture, 50.0)[15].tolist() == [1] * 40 if not _rim(picture, 50.0)[15].any() else True


@pytest.mark.parametrize(("rows", "moved_share", "told"), [(1, 0.51, True), (1, 0.49, False), (0, 1.0, False)])
def test_white_at_the_edges_is_a_rim_where_it_does_not_clip_in_the_longest(rows, moved_share, told):
    """A thousandth of the picture, more than half of it not clipped in the longest exposure: no light does that."""
    shorter, longest = np.full((40, 100), 90.0, np.float32), np.full((40, 100), 200.0, np.float32)
    shorter[:rows] = 255.0
    longest[0, : round(100 * (1.0 - moved_share))] = 255.0
    assert _has_white_rims([shorter, longest], 255) is told


def test_a_corner_is_known_by_the_slopes_and_by_what_differs():
    """Twice the difference in DN is twice the doubt; a picture of one slope tells no place; twice the contrast half."""
    rng = np.random.default_rng(2)
    picture = rng.normal(100.0, 20.0, (60, 80)).astype(np.float32)
    inside = np.ones(picture.shape, np.uint8)
    u = _corner_u_px(picture, picture, inside, 1.0)
    assert _corner_u_px(picture, picture, inside, 4.0) == pytest.approx(2.0 * u)
    assert _corner_u_px(2.0 * picture, 2.0 * picture, inside, 1.0) == pytest.approx(0.5 * u, rel=1e-3)
    ramp = np.tile(np.arange(80.0, dtype=np.float32), (60, 1))
    assert _corner_u_px(ramp, ramp, inside, 1.0) > 100.0 * u
    lamp = np.zeros_like(picture)
    lamp[24:26, 33:36] = 200.0
    assert math.isinf(_corner_u_px(lamp, lamp, inside, 1.0))  # all that tells it lies in one part of the picture


def test_neighbours_are_brought_to_the_values_of_the_darker():
    """By their ranks, whatever the tone curve; cut off where the brighter clips; in whatever order they are given."""
    dark = np.random.default_rng(3).uniform(10.0, 120.0, (50, 60)).astype(np.float32)
    bright = np.minimum(255.0 * (dark / 100.0) ** 0.45, 255.0).astype(np.float32)
    inside = np.ones(dark.shape, np.uint8)
    here, there = _alike(dark, bright, inside, 255)
    back_there, back_here = _alike(bright, dark, inside, 255)
    end = 100.0 * 0.97 ** (1.0 / 0.45)
    assert here == pytest.approx(np.minimum(dark, end), abs=1.0)
    assert there == pytest.approx(here, abs=0.5)
    assert np.array_equal(here, back_here)
    assert np.array_equal(there, back_there)
    assert _alike(dark, bright, np.zeros_like(inside), 255) == (None, None)
    assert _alike(dark, np.full_like(bright, 255.0), inside, 255) == (None, None)
    flat = np.full_like(dark, 50.0)
    assert _alike(flat, flat + 1.0, inside, 255) == (None, None)


@pytest.mark.parametrize("count", [1, 2, 1000, 1025, 5000])
def test_quantiles_of_counted_numbers_are_numpys(count):
    """Of numbers that hardly repeat and of ones that many pixels share."""
    rng, shares = np.random.default_rng(5), np.linspace(0.0, 1.0, 1025)
    for values in (rng.integers(0, 9999, count), rng.integers(3, 9, count)):
        counts = np.bincount(values, minlength=12000).astype(np.float32)
        assert _quantiles(counts, shares) == pytest.approx(np.quantile(values, shares), abs=1e-8)


def test_what_moved_is_left_out_with_its_surroundings():
    """A square that one picture alone shows, and five pixels around it; noise alone leaves all in."""
    rng = np.random.default_rng(4)
    scene = rng.normal(100.0, 30.0, (80, 100))
    one, two = (np.asarray(scene + rng.normal(0.0, 1.0, scene.shape), np.float32) for _ in range(2))
    inside = np.ones(scene.shape, np.uint8)
    assert _steady(one, two, inside, STILL).mean() > 0.999
    two[30:40, 50:60] += 200.0
    found = _steady(one, two, inside, STILL)
    assert not found[30:40, 50:60].any()
    assert not found[26:44, 46:64].any()
    assert found[:20].all()
    assert found[:, :35].all()


@pytest.mark.parametrize(
    ("step_px", "here", "there", "taken"),
    [(0.019, 0.5, 0.9, "here"), (0.021, 0.5, 0.9, "there"), (0.021, 0.9, 0.5, "here"), (0.1, 0.5, 0.9, "there")],
)
def test_of_two_places_the_better_is_taken_unless_they_are_one(monkeypatch, step_px, here, there, taken):
    """A step of less than 0.02 pixels has arrived; of a longer one, the end that correlates better."""
    first, second = np.eye(2, 3), np.eye(2, 3)
    second[0, 2] = step_px
    told = iter([(0.4, first), (here, second), (there, first)])
    monkeypatch.setattr(alignment, "_climbed", lambda *_: next(told))
    height, place = _summit(SimpleNamespace(shape=(9, 9)), first)
    assert (height, place is {"here": first, "there": second}[taken]) == ({"here": here, "there": there}[taken], True)


def test_where_nothing_correlates_no_further_step_is_made(monkeypatch):
    """A climb that fails says so by a negative height, and is asked once."""
    told = iter([(-1.0, np.eye(2, 3))])
    monkeypatch.setattr(alignment, "_climbed", lambda *_: next(told))
    assert _summit(SimpleNamespace(shape=(9, 9)), np.eye(2, 3))[0] == -1.0
