"""Parts of a merge: tables of a curve, defects, the climb to the likeliest radiance, how photographs lie."""

import itertools
import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.optimize import minimize_scalar
from scipy.stats import norm

from radiometer.analysis.merge import bracket
from radiometer.analysis.merge.alignment import Alignment, Climb, Movement, aligned, find_alignment
from radiometer.analysis.merge.bracket import repair_defects
from radiometer.analysis.merge.displaced import relative_shift
from radiometer.analysis.merge.finish import MergeTables, merge_tables, with_censored
from radiometer.analysis.merge.frames import frame_terms
from radiometer.analysis.signal.situation import situation_of
from radiometer.data import (
    Bracket,
    CameraDescription,
    Frame,
    FrameSettings,
    LensDescription,
    PixelMask,
    ResponseCurve,
    SensorNoise,
)
from radiometer.data.setup import Setup
from radiometer.errors import MeasurementError
from testing.relative_scale import relative_calibration


def tables(exposures, *, variance=25.0, kappa=0.0, slack=0.01, clips_at=4000.0, sigma_clip=5.0, bounds=(4000.0, 1.0)):
    """Return the tables of linear frames of the same noise."""
    frames = np.array(
        [[t, variance, clips_at, sigma_clip, 0.0, variance, -np.inf, variance, t**0.35] for t in exposures]
    )
    return MergeTables(frames, kappa, np.array([*bounds, slack]), np.ones(len(exposures)), None, None, 1.0, np.zeros(2))


def test_weights_of_displaced_frames_are_those_of_their_information():
    """t²/v of 1 and 9: √(0.1² + 0.9²); where the longer clips the shorter has all; where nothing is known, one."""
    found = tables([1.0, 3.0], clips_at=300.0, bounds=(300.0, 1.0)).at_levels()
    rates = np.exp(found.lowest + np.arange(found.root_sum_square.size) / 16.0)
    both, one = rates < 100.0, (rates > 100.0) & (rates < 300.0)
    assert found.lowest == pytest.approx(0.0)
    assert found.root_sum_square[both] == pytest.approx(math.hypot(0.1, 0.9))
    assert found.root_sum_square[one] == pytest.approx(1.0)
    assert rates[-1] >= 300.0
    shot = tables([1.0, 3.0], variance=1e-9, kappa=1.0).at_levels()
    assert shot.root_sum_square[4] == pytest.approx(math.hypot(1.0, 3.0) / 4.0)  # of photons alone the weights go as t


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


@pytest.mark.parametrize(("width", "rows"), [(100, 327), (1 << 15, 1), ((1 << 15) + 1, 1), (1, 1 << 15)])
def test_blocks_are_whole_rows_that_cover_a_part_once(width, rows):
    """As many rows as 32 768 pixels hold, one at least; the last block is what is left."""
    assert bracket.block_size(width) == rows * width
    start, stop = 3 * width, (3 + 2 * rows + 1) * width
    found = list(bracket.blocks(start, stop, width))
    assert [end - begin for begin, end in found] == [rows * width, rows * width, width]
    assert (found[0][0], found[-1][1]) == (start, stop)
    assert all(one[1] == two[0] for one, two in itertools.pairwise(found))


@pytest.mark.parametrize("shape", [(1, 7), (37, 5), (64, 3)])
@pytest.mark.parametrize("cores", [1, 3, None])
def test_all_cores_together_do_every_pixel_once(shape, cores, monkeypatch):
    """In whole rows, four parts for each core, fewer where there are fewer rows."""
    monkeypatch.setattr(bracket.os, "cpu_count", lambda: cores)
    done = []
    bracket.on_all_cores(shape, lambda start, stop: done.append((start, stop)))
    done.sort()
    pixels = [k for start, stop in done for k in range(start, stop)]
    assert pixels == list(range(shape[0] * shape[1]))
    assert all(start % shape[1] == stop % shape[1] == 0 for start, stop in done)
    assert len(done) <= 4 * (cores or 1)
    assert len(done) > 2 * (cores or 1) or len(done) == shape[0]


CODES = np.arange(256)

TIMES = (1.0, 2.0, 4.0)

CAMERA, LENS = CameraDescription(bit_depth=8), LensDescription()

NOISE = SensorNoise(conversion_gain_e_per_dn=8000.0 / 255.0, read_noise_e=6.0, full_well_e=8000.0, post_curve_dn2=0.4)


@pytest.mark.parametrize("gain_db", [0.0, 6.0])
def test_every_code_has_its_own_doubt_and_variance(gain_db):
    """A curve M = 255·x^(1/2.2) whose u grows from 1 % at black to 5 %, and to 20 % at white: to 2 % of them."""
    with np.errstate(divide="ignore"):
        g = 2.2 * np.log(CODES / 255.0)
    u_log = np.linspace(0.01, 0.05, 256)
    u_log[-1] = 0.2
    curve = ResponseCurve(g, u_log, absolute=True, valid_dn=(1, 254))
    calibration = relative_calibration(CAMERA, NOISE, response=curve)
    situation = situation_of(Setup(CAMERA, LENS, calibration))
    settings = [FrameSettings(seconds, gain_db) for seconds in TIMES]
    tables = merge_tables([frame_terms(s, situation, (), through_lens=False) for s in settings], situation.model)
    codes = np.array([8.0, 20.0, 90.0, 200.0, 253.0, 254.5, 255.0])
    gain = 10.0 ** (gain_db / 20.0)
    at_0_db = np.interp(codes, CODES, np.exp(g))  # between two codes the model is a straight line
    variance, u_rel = tables.variance(np.tile(at_0_db / gain, (len(TIMES), 1)))
    for k, one in enumerate(settings):
        assert u_rel[k] == pytest.approx(np.interp(codes, CODES, u_log), rel=0.02)
        assert variance[k] == pytest.approx(situation.model.variance(at_0_db / gain, one), rel=0.02)


def images(size=5):
    """Return a picture that rises by one a pixel, u 0.1 everywhere, and an empty mask."""
    radiance = np.arange(float(size * size), dtype=np.float32).reshape(size, size)
    return radiance, np.full((size, size), 0.1, np.float32), np.zeros((size, size), np.uint8)


@pytest.mark.parametrize(("x", "y", "count"), [(2, 2, 8), (0, 0, 3), (4, 2, 5)])
def test_a_defect_takes_the_mean_of_its_sound_neighbours(x, y, count):
    """Eight, five at the side, three in the corner; u is the mean's noise and the neighbours' scatter in squares."""
    radiance, u, mask = images()
    window = [
        float(radiance[j, i])
        for j in range(max(y - 1, 0), min(y + 2, 5))
        for i in range(max(x - 1, 0), min(x + 2, 5))
        if (i, j) != (x, y)
    ]
    radiance[y, x], u[y, x] = 1e6, 1e3
    repair_defects(radiance, u, mask, [(x, y)])
    assert len(window) == count
    assert radiance[y, x] == pytest.approx(np.mean(window))
    assert u[y, x] == pytest.approx(math.sqrt(0.01 / count + np.var(window, ddof=1)))
    assert mask[y, x] == PixelMask.DEFECTIVE
    assert np.count_nonzero(mask) == 1


def test_neighbours_that_are_defective_or_clipped_tell_nothing():
    """Only sound ones count; marked defects keep their other marks; those outside the picture are none."""
    radiance, u, mask = images()
    mask[1, 1], mask[2, 2] = PixelMask.SATURATED, PixelMask.INCONSISTENT
    radiance[1, 1] = radiance[2, 3] = 1e6
    repair_defects(radiance, u, mask, [(2, 2), (3, 2), (-1, 0), (0, 5), (5, 5)])
    assert radiance[2, 2] == pytest.approx(np.mean([7, 8, 11, 16, 17, 18]))
    assert mask[2, 2] == PixelMask.DEFECTIVE | PixelMask.INCONSISTENT
    assert np.count_nonzero(mask & PixelMask.DEFECTIVE) == 2
    lonely = np.array([[5.0, 6.0]], np.float32), np.array([[0.1, 0.1]], np.float32), np.zeros((1, 2), np.uint8)
    repair_defects(*lonely, [(0, 0)])
    assert (lonely[0][0, 0], lonely[1][0, 0]) == (5.0, 5.0)


STILL = np.eye(2, 3)


def scene(seed=1, shape=(150, 200)):
    """Return a smooth picture in DN."""
    rough = np.random.default_rng(seed).normal(0.0, 400.0, shape).astype(np.float32)
    return np.asarray(cv2.GaussianBlur(rough, (0, 0), 3.0) + 100.0, np.float32)


def place(right, down, degrees):
    """Return a movement."""
    cos, sin = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    return np.array([[cos, -sin, right], [sin, cos, down]])


def moved(picture, movement):
    """Return the picture that shows at each pixel's new place what the given one shows at the pixel."""
    size = picture.shape[::-1]
    return np.asarray(cv2.warpAffine(picture, movement, size, flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT))


@pytest.mark.parametrize("pedestal_dn", [0.0, 3000.0, 30000.0])
@pytest.mark.parametrize("left_out", ["nothing", "a rim", "a patch"])
def test_little_contrast_on_a_pedestal_is_climbed(pedestal_dn, left_out):
    """Thirty DN about a black level not subtracted, whatever is left out: to a tenth of a pixel at the corners.

    Up to the edges of the picture: beyond them is no light of 0 DN.
    """
    movement = place(1.5, 0.7, 0.4)
    here, there = (0.75 * picture - 75.0 for picture in (scene(4), moved(scene(4), movement)))
    assert here.std() == pytest.approx(30.0, rel=0.2)
    inside = np.full(here.shape, left_out != "a rim", np.uint8)
    inside[8:-8, 8:-8] = 1
    if left_out == "a patch":
        inside[40:70, 90:160] = 0
        there[45:65, 95:155] += 200.0
    here, there = (np.asarray(one + pedestal_dn, np.float32) for one in (here, there))
    correlation, found = Climb(here, there, inside).climbed(STILL, 60)
    corners = np.array([(0.0, 0.0, 1.0), (199.0, 0.0, 1.0), (0.0, 149.0, 1.0), (199.0, 149.0, 1.0)])
    assert np.linalg.norm(corners @ (found - movement).T, axis=1).max() < 0.1
    assert correlation > 0.99


def test_a_start_is_left_as_it_is():
    """A climb may be made again from the same place."""
    here, start = scene(), place(0.4, 0.0, 0.1)
    pair, kept = Climb(here, moved(here, place(1.0, 0.0, 0.0)), np.ones(here.shape, np.uint8)), start.copy()
    first, again = (pair.climbed(start, 5) for _ in range(2))
    assert np.array_equal(start, kept)
    assert first[0] == again[0]
    assert np.array_equal(first[1], again[1])


@pytest.mark.parametrize("way", ["flat", "opposite", "nothing shown"])
def test_pictures_that_are_not_alike_are_reported(way):
    """One without structure, one whose bright is the other's dark, and two of which nothing is shown."""
    here = scene()
    there = {"flat": np.full_like(here, 80.0), "opposite": 200.0 - here, "nothing shown": here}[way]
    inside = np.full(here.shape, way != "nothing shown", np.uint8)
    with pytest.raises(MeasurementError):
        Climb(here, there, inside).climbed(STILL, 15)


def test_stripes_are_left_where_they_are():
    """A picture of one slope and its copy: no step is the right one along the stripes, and none is made."""
    stripes = np.tile(100.0 + 50.0 * np.sin(np.arange(160.0) / 8.0), (90, 1)).astype(np.float32)
    correlation, found = Climb(stripes, stripes, np.ones(stripes.shape, np.uint8)).climbed(STILL, 5)
    assert correlation == pytest.approx(1.0, abs=1e-6)
    assert found == pytest.approx(STILL, abs=1e-4)


def frame_row(exposure, variance, clips_at, at_clipping=None, cut_at=-np.inf):
    """Return a frame as `fill_record` has it: noise variance in the dark, and at clipping where that is another."""
    at_clipping = variance if at_clipping is None else at_clipping
    return [exposure, variance, clips_at, 1.0, 0.0, at_clipping, cut_at, variance, exposure**0.35]


FRAMES = np.array([frame_row(1.0, 25.0, 4000.0), frame_row(2.0, 49.0, 215.0), frame_row(3.0, 64.0, 312.0)])


def likeliest(rate, variance, frames, kappa):
    """Return where the likelihood of a rate and of frames that clipped is highest, and its curvature's inverse."""

    def surprise(x):
        noise = np.sqrt(frames[:, 1] + kappa * x * frames[:, 0])
        return 0.5 * (x - rate) ** 2 / variance - norm.logsf((frames[:, 2] - x * frames[:, 0]) / noise).sum()

    best = minimize_scalar(surprise, bounds=(rate - 20.0, rate + 40.0), method="bounded", options={"xatol": 1e-9}).x
    step = 1e-3 * np.sqrt(variance)
    curvature = (surprise(best + step) - 2.0 * surprise(best) + surprise(best - step)) / step**2
    return best, 1.0 / curvature


@pytest.mark.parametrize(("rate", "variance"), [(104.0, 4.0), (101.0, 4.0), (103.0, 2.25)])
@pytest.mark.parametrize("clipped", [(1,), (2,), (1, 2)])
def test_the_estimate_is_the_likeliest_and_its_variance_the_curvature(rate, variance, clipped):
    """To a thirtieth of sigma and 2 % of the variance, which two steps of Newton's leave; frames in use say no more."""
    pattern = np.uint64(sum(1 << k for k in range(3) if k not in clipped))
    found, u2, contradiction = with_censored(rate, variance, pattern, FRAMES, 0, len(FRAMES), 0.0)
    best, curvature = likeliest(rate, variance, FRAMES[list(clipped)], 0.0)
    assert best - rate > 0.1 * np.sqrt(variance)  # they do say something
    assert found == pytest.approx(best, abs=np.sqrt(variance) / 30.0)
    assert u2 == pytest.approx(curvature, rel=0.02)
    assert not contradiction


def test_shot_noise_makes_a_clipped_frame_say_less():
    """Noise that grows with the light, κ·x·t next to the rest: the same as that noise stated beforehand."""
    plain = FRAMES[1:2].copy()
    found = with_censored(104.0, 4.0, np.uint64(0), FRAMES, 1, 2, 0.8)
    plain[0, 5] += 0.8 * 2.0 * found[0]
    assert found[:2] == pytest.approx(with_censored(104.0, 4.0, np.uint64(0), plain, 0, 1, 0.0)[:2], rel=2e-3)
    assert found[0] < with_censored(104.0, 4.0, np.uint64(0), FRAMES, 1, 2, 0.0)[0]


@pytest.mark.parametrize(("clips_at", "heard"), [(120.0, False), (208.0, True)])
def test_a_frame_that_had_to_clip_says_nothing(clips_at, heard):
    """Where the others put the light far above its clipping level, that it clips is no news."""
    frames = FRAMES[1:2].copy()
    frames[0, 2] = clips_at
    found, variance, _ = with_censored(105.0, 1.0, np.uint64(0), frames, 0, len(frames), 0.0)
    assert (found > 105.0, variance != 1.0) == (heard, heard)


@pytest.mark.parametrize(("rate", "contradicts"), [(4.0, False), (30.0, True), (90.0, False)])
def test_a_frame_that_clips_far_below_its_level_contradicts(rate, contradicts):
    """Six sigma below it, and not near black where the dark end is cut off: then the scene has changed."""
    # At 90 the frame lies 35 below its level of 215 with a noise of 7.3: 4.8 sigma.
    found, _, text = with_censored(rate, 1.0, np.uint64(0), FRAMES, 1, 2, 0.0)
    assert text is contradicts
    assert (found == rate) is (rate < 50.0)


def test_a_frame_without_noise_in_the_dark_is_heard_or_passed_over_in_numbers():
    """No read noise and no light: a frame far above contradicts or says nothing, and no value is lost to 0 times ∞."""
    frames = np.array([frame_row(1.0, 0.0, 40.0), frame_row(4.0, 0.0, 40.0)])
    for rate in (-0.3, 0.0):
        found = with_censored(rate, 0.2, np.uint64(0b01), frames, 0, 2, 0.3)
        assert found == (rate, pytest.approx(0.2, rel=1e-12), False)


def test_noise_that_arises_behind_the_curve_counts_at_clipping():
    """No read noise and no light behind a curve: a much longer clipped frame may raise the value, in numbers.

    Its only noise is that of the codes at clipping; the estimate lies 2 u below 0, its u times the exposure far above
    the clipping level.
    """
    frames = np.array([frame_row(1.0, 0.0, 4.6), frame_row(1e4, 0.0, 4.6, at_clipping=1.7e-4)])
    value, variance, contradiction = with_censored(-2e-3, 1e-6, np.uint64(0b01), frames, 0, 2, 4e-7)
    assert -2e-3 < value < 4.6e-4 + 2e-3
    assert 0.0 < variance < 1e-6
    assert not contradiction


# Photographs from the hand: how they lie to each other, and what becomes of their values.


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
