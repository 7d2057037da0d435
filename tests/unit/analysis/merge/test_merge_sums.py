"""Sums of several frames at a time, what is kept of sets of frames, and neighbours: all as of each frame and pixel."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from radiometer.analysis.merge.bracket import merge
from radiometer.analysis.merge.frames import frame_terms
from radiometer.analysis.merge.sums import MergeSample, MergeSums, merge_passes
from radiometer.analysis.merge.tables import merge_tables
from radiometer.analysis.signal.situation import situation_of
from radiometer.data import (
    BlackLevel,
    Bracket,
    Calibration,
    CameraDescription,
    Frame,
    FrameSettings,
    LensDescription,
    PixelMask,
    ResponseCurve,
    Scale,
    SensorNoise,
)
from radiometer.data.setup import Setup

LENS, GAMMA, ELECTRONS, READ_E, AFTER_DN2 = LensDescription(), 2.2, 8000.0, 6.0, 0.4
TIMES = 2.0 ** np.arange(7)


def _calibration(bits, *, curve=None, dark_e_per_s=0.0):
    full = float((1 << bits) - 1)
    noise = SensorNoise(
        conversion_gain_e_per_dn=ELECTRONS / full,
        read_noise_e=READ_E,
        full_well_e=ELECTRONS,
        dark_current_e_per_s=dark_e_per_s,
        post_curve_dn2=AFTER_DN2,
    )
    scale = Scale(value=1.0, u_rel=0.0, method="relative")
    return Calibration(CameraDescription(bit_depth=bits), LENS, scale, curve, noise, BlackLevel(dn=0.0, u_dn=0.0))


def _behind_a_curve(**more):
    """Return a calibration of 8 bits, M = 255·x^(1/2.2) with x from 0 to 1 and data from 1 to 254."""
    with np.errstate(divide="ignore"):
        g = GAMMA * np.log(np.arange(256) / 255.0)
    curve = ResponseCurve(g, np.full(256, 1e-6), absolute=True, valid_dn=(1, 254))
    return _calibration(8, curve=curve, **more)


def _samples(calibration, numbers, bits, first=0):
    """Return numbers of shape (frames, pixels) as samples, the first of them frame number `first`."""
    situation = situation_of(Setup(calibration.camera, LENS, calibration))
    samples = []
    for k, (dn, seconds) in enumerate(zip(numbers, TIMES, strict=False)):
        settings = FrameSettings(float(seconds))
        terms = frame_terms(settings, situation, (), through_lens=False)
        table = None if calibration.response is None else situation.model.table(settings).astype(np.float32)
        samples.append(MergeSample.of(dn.astype(np.uint8 if bits == 8 else np.uint16), terms, table, first + k))
    return samples


@pytest.mark.parametrize(("bits", "curved"), [(12, False), (8, False), (8, True)])
@pytest.mark.parametrize(("count", "first"), [(4, 0), (5, 0), (7, 0), (7, 13)])
def test_several_frames_at_a_time_are_the_same_sums(bits, curved, count, first):
    """From black to white: sums, bits and clipping in fours and pairs are those of one by one, of 16 frames or more."""
    calibration = _behind_a_curve(dark_e_per_s=20.0) if curved else _calibration(bits, dark_e_per_s=20.0)
    rng = np.random.default_rng(1)
    numbers = rng.integers(0, 1 << bits, (count, 600))
    numbers[:, :40] = rng.choice([0, 1, (1 << bits) - 2, (1 << bits) - 1], (count, 40))
    samples = _samples(calibration, numbers, bits, first)
    together, singly = (MergeSums.zeros(600) for _ in range(2))
    for sums in (together, singly):
        sums.make_room(first + count)
    together.add(merge_passes(samples, 1.0), 0)
    for one in samples:
        singly.add(merge_passes([one], 1.0), 0)
    for name in ("first", "second", "squares", "mask"):
        assert np.array_equal(getattr(together, name), getattr(singly, name)), name
    assert np.array_equal(together.patterns(), singly.patterns())
    white = (numbers >= samples[0].limits[1]).any(axis=0)
    assert np.array_equal(together.mask, np.where(white, PixelMask.SATURATED, 0))


@pytest.mark.parametrize("curved", [True, False])
def test_noise_at_clipping_is_all_that_arises_there(curved):
    """Variance of x at clipping less the shot noise there: behind a curve the noise of its codes as well."""
    calibration = _behind_a_curve() if curved else _calibration(12)
    samples = _samples(calibration, np.zeros((2, 4), int), 8 if curved else 12)
    model = situation_of(Setup(calibration.camera, LENS, calibration)).model
    terms = [one.terms for one in samples]
    frames = merge_tables(terms, model).frames
    clips_at = frames[:, 2]
    there = [float(model.variance(x, FrameSettings(1.0))) for x in clips_at]
    assert frames[:, 5] == pytest.approx(there - clips_at / model.electrons_per_unit, rel=1e-6)
    assert np.all(frames[:, 5] > frames[:, 1]) == curved


def test_a_block_leaves_nothing_to_the_next():
    """Rows from dark to bright in blocks of eight: the map of the rows upside down is upside down, nothing clashes."""
    rng = np.random.default_rng(2)
    light = np.geomspace(2.0, 4000.0, 160)[:, None] * np.ones(4000)
    numbers = [
        np.clip(rng.normal(light * t, 2.0 + 0.5 * np.sqrt(light * t)), 0, 4095).astype(np.uint16) for t in (1, 4)
    ]
    calibration = _calibration(12)

    def merged(step):
        frames = [Frame(dn[::step], 12, FrameSettings(t)) for dn, t in zip(numbers, (1.0, 4.0), strict=True)]
        return merge(Bracket.from_frames(frames), Setup(calibration.camera, LENS, calibration))

    upright, upside_down = merged(1), merged(-1)
    for name in ("radiance", "u_radiance", "mask"):
        assert np.array_equal(getattr(upside_down, name)[::-1], getattr(upright, name)), name
    assert np.mean(upright.mask & PixelMask.INCONSISTENT > 0) < 1e-3


def _expected_u(rate):
    """Return u of the best mean of the frames that show a rate, by the noise of each at its expected number."""
    x = rate * TIMES[:, None]
    dn = 255.0 * np.minimum(x, 1.0) ** (1.0 / GAMMA)
    slope = GAMMA / 255.0 * (dn / 255.0) ** (GAMMA - 1.0)
    # Electrons are counted to the last number with data, and from there on the straight line through it.
    per_unit = ELECTRONS / 255.0 * 254.0 / (254.0 / 255.0) ** GAMMA
    variance = x / per_unit + (READ_E / per_unit) ** 2 + slope**2 * (AFTER_DN2 + 1.0 / 12.0)
    used = (np.rint(dn) >= 1.0) & (np.rint(dn) < 255.0)
    return np.where(used, TIMES[:, None] ** 2 / variance, 0.0).sum(axis=0) ** -0.5


def test_u_behind_a_curve_is_that_of_the_best_weights_at_every_level():
    """Over three decades, pixel by pixel: to 2.5 %, which two sums cost at most and rounding of the numbers leaves."""
    calibration = _behind_a_curve()
    rate = np.geomspace(2e-4, 0.9, 3000)
    numbers = np.rint(255.0 * np.minimum(rate * TIMES[:, None], 1.0) ** (1.0 / GAMMA))
    frames = [
        Frame(dn.astype(np.uint8)[None, :], 8, FrameSettings(float(t))) for dn, t in zip(numbers, TIMES, strict=True)
    ]
    found = merge(Bracket.from_frames(frames), Setup(calibration.camera, LENS, calibration))
    clear = (np.abs(np.log(rate[:, None] * TIMES)) > 0.3).all(axis=1)  # no frame near its end says "at least so much"
    ratio = found.u_radiance[0] / _expected_u(rate)
    assert ratio[clear] == pytest.approx(1.0, abs=0.025)
    assert np.median(ratio[clear]) == pytest.approx(1.0, abs=0.006)


@pytest.mark.parametrize("curved", [False, True])
def test_neighbours_of_other_frames_change_nothing(curved):
    """In any order of the pixels, alike ones side by side or mixed, each has its own value, u and flags."""
    calibration = _behind_a_curve() if curved else _calibration(12)
    bits = calibration.camera.bit_depth
    full = (1 << bits) - 1
    rng = np.random.default_rng(3)
    light = np.geomspace(1e-4, 2.0, 2500)
    numbers = full * (light * TIMES[:, None] / 8.0) ** (1.0 / GAMMA if curved else 1.0)
    numbers = np.clip(np.rint(numbers + rng.normal(0.0, 1.5, numbers.shape)), 0, full).astype(int)
    order = rng.permutation(light.size)

    def merged(these):
        dtype = np.uint8 if curved else np.uint16
        frames = [
            Frame(dn.astype(dtype)[None, :], bits, FrameSettings(float(t))) for dn, t in zip(these, TIMES, strict=True)
        ]
        return merge(Bracket.from_frames(frames), Setup(calibration.camera, LENS, calibration))

    sorted_, mixed = merged(numbers), merged(numbers[:, order])
    for name in ("radiance", "u_radiance", "mask"):
        assert np.allclose(getattr(mixed, name)[0], getattr(sorted_, name)[0, order], rtol=2e-6, atol=0.0), name


def test_of_two_frames_that_clip_nearby_both_are_heard():
    """Next to one just below clipping two that clip at 1.02 and 1.04 s raise the value more than either."""
    calibration = _calibration(12)

    def value(*clipped):
        frames = [Frame(np.full((2, 2), 3850, np.uint16), 12, FrameSettings(1.0))]
        frames += [Frame(np.full((2, 2), 4095, np.uint16), 12, FrameSettings(t)) for t in clipped]
        return merge(frames, Setup(calibration.camera, LENS, calibration)).radiance[0, 0]

    lone, one, other, both = value(), value(1.02), value(1.04), value(1.02, 1.04)
    assert both > max(one, other) > min(one, other) > lone
    assert value(1.02, 16.0) == pytest.approx(one, rel=1e-6)  # what had to clip says nothing


def test_more_sets_of_frames_than_are_kept_change_nothing():
    """Some 900 sets of ten frames behind a curve, in order and at random: the same value and u of every pixel."""
    calibration, rng = _behind_a_curve(), np.random.default_rng(5)
    times = np.linspace(1.0, 8.0, 10)
    missing = rng.integers(1, 1 << 10, 4000)
    missing.sort()
    numbers = np.rint(255.0 * (times[:, None] * rng.uniform(0.02, 0.1, 4000)) ** (1.0 / GAMMA))
    numbers[missing >> np.arange(10)[:, None] & 1 == 1] = 0
    order = rng.permutation(missing.size)

    def merged(these):
        frames = [Frame(dn.astype(np.uint8)[None, :], 8, FrameSettings(t)) for dn, t in zip(these, times, strict=True)]
        return merge(Bracket.from_frames(frames), Setup(calibration.camera, LENS, calibration))

    sorted_, mixed = merged(numbers), merged(numbers[:, order])
    for name in ("radiance", "u_radiance", "mask"):
        assert np.allclose(getattr(mixed, name)[0], getattr(sorted_, name)[0, order], rtol=2e-6, atol=0.0), name


def test_what_lies_outside_the_curves_data_is_marked_on_both_sides():
    """Data from 20 to 200 DN: marked are 10 DN, and light that a shorter frame puts above 200 DN of the longer."""
    plain = _behind_a_curve()
    calibration = replace(plain, response=replace(plain.response, valid_dn=(20, 200)))
    longer = np.repeat(np.array([10, 25, 190, 198], np.uint8), 50)
    # Half the light through the same curve; of the last a tenth too much.
    shorter = np.rint(longer * (0.5 * np.repeat([1.0, 1.0, 1.0, 1.1], 50)) ** (1.0 / GAMMA)).astype(np.uint8)
    frames = [Frame(dn[None, :], 8, FrameSettings(t)) for dn, t in ((shorter, 0.5), (longer, 1.0))]
    found = merge(Bracket.from_frames(frames), Setup(calibration.camera, LENS, calibration))
    outside = (found.mask & PixelMask.EXTRAPOLATED > 0).reshape(4, 50)
    assert outside.all(axis=1).tolist() == [True, False, False, True]
    assert not outside[1:3].any()
