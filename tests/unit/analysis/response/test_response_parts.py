"""The parts that the response methods share: limits, groups, noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from radiometer.analysis.response.curves import rising
from radiometer.analysis.response.left_out import prediction_error_dn
from radiometer.analysis.response.limits import ValueLimits, find_limits
from radiometer.analysis.response.mitsunaga1999 import Pairs
from radiometer.analysis.response.noise import LogNoise, fit_log_noise, mean_exposure_dn
from radiometer.analysis.response.pixel_noise import pixel_noise
from radiometer.analysis.response.samples import gather_samples
from radiometer.data import Bracket, Frame, FrameSettings, ResponseCurve


def test_saturation_below_full_scale_is_found(make_stack):
    """A sensor that stops at 3500 DN gathers its highlights there: that is its saturation level."""
    frames = [Frame(np.minimum(f.dn, 3500), 12, f.settings) for f in make_stack("linear").light]
    assert find_limits([Bracket.from_frames(frames)]).saturated_dn == 3500


def test_unclipped_frames_keep_full_scale():
    """Where nothing piles up, saturation is full scale."""
    ramp = np.arange(40, 200, dtype=np.uint8)[None, :].repeat(50, axis=0)
    frames = [Frame(ramp, 8, FrameSettings(t)) for t in (1.0, 2.0)]
    assert find_limits([Bracket.from_frames(frames)]).saturated_dn == 255


def _noisy_behind_the_clipping(sigma_dn, seed=5):
    """Return frames of a linear sensor that clips at black and white before noise of `sigma_dn` is added to it."""
    rng = np.random.default_rng(seed)
    light = np.exp(rng.uniform(-9.0, 2.0, (120, 160)))
    frames = []
    for time in 2.0 ** np.arange(6):
        clipped = 255.0 * np.clip(0.05 * time * light - 0.01, 0.0, 1.0)
        stored = np.clip(np.rint(clipped + rng.normal(0.0, sigma_dn, light.shape)), 0, 255).astype(np.uint8)
        frames.append(Frame(stored, 8, FrameSettings(float(time))))
    return Bracket.from_frames(frames)


@pytest.mark.parametrize(("sigma_dn", "black_dn", "saturated_dn"), [(0.0, 0, 255), (0.6, 1, 254)])
def test_noise_behind_the_clipping_is_black_and_white_with_it(sigma_dn, black_dn, saturated_dn):
    """What was clipped and got noise afterwards lies at several values: the next one too is no light."""
    limits = find_limits([_noisy_behind_the_clipping(sigma_dn)])
    assert (limits.black_dn, limits.saturated_dn) == (black_dn, saturated_dn)


def test_white_that_is_noisy_does_not_pass_for_the_noise_of_pixels():
    """Noise of 0.6 DN behind the clipping is found to 5 %: some thousand residuals tell it to 2 %."""
    bracket = _noisy_behind_the_clipping(0.6)
    limits = find_limits([bracket])
    g = np.log(np.maximum(np.arange(256) / 255.0 + 0.01, 1e-9))
    curve = ResponseCurve(g, np.zeros(256), valid_dn=(limits.black_dn + 3, limits.saturated_dn - 1))
    assert pixel_noise(bracket, curve).digital == pytest.approx(0.36, rel=0.1)


def test_every_pixel_counts_once_per_frame_where_it_does_not_clip(make_stack):
    """Groups hold all pixels; rows of a frame in which a group clips are left out."""
    samples = gather_samples(make_stack("linear"))
    assert samples.pixel_count == 192 * 256
    assert samples.dn.max() < samples.limits.saturated_dn
    assert np.all(np.diff(samples.group) >= 0)
    per_frame = np.bincount(samples.frame, samples.pixels)
    assert per_frame.max() <= 192 * 256


def test_group_means_keep_the_ratio_of_exposures(make_stack):
    """On a linear stack the group means double from frame to frame, to 0.5 % where they exceed 200 DN."""
    samples = gather_samples(make_stack("linear"))
    follows = (np.diff(samples.group) == 0) & (np.diff(samples.frame) == 1) & (samples.dn[:-1] > 200)
    ratio = (samples.dn[1:] / samples.dn[:-1])[follows]
    assert np.average(ratio, weights=samples.pixels[:-1][follows]) == pytest.approx(2.0, rel=0.005)


def test_pixels_that_contradict_their_exposure_are_left_out(make_stack):
    """A region that turns black in one longer exposure (something moved) does not enter any group."""
    frames = list(make_stack("gamma", bit_depth=8).light)
    moved = np.array(frames[5].dn)
    moved[:40, :40] = 0
    disturbed = [*frames[:5], Frame(moved, 8, frames[5].settings), *frames[6:]]
    counted = [gather_samples(Bracket.from_frames(stack)) for stack in (frames, disturbed)]
    lost = [c.pixels[c.frame == 5].sum() for c in counted]
    assert lost[0] - lost[1] >= 0.8 * np.sum(np.array(frames[5].dn)[:40, :40] < 250)


def test_noise_parameters_are_found_again():
    """Shot and read noise put into residuals come out within 10 % (4000 rows: 2 % in theory)."""
    rng = np.random.default_rng(4)
    g = rng.uniform(-5.0, 0.7, 4000)
    slope = np.exp(-g) / 2000.0
    pixels = np.full(4000, 100.0)
    truth = LogNoise(2e-4, 1e-6, 0.0, 0.0)
    residual = rng.standard_normal(4000) * np.sqrt(truth.variance(g, slope, pixels))
    found = fit_log_noise(residual, np.zeros(4000), g, slope, pixels)
    expected = truth.variance(g, slope, pixels)
    assert found.variance(g, slope, pixels) == pytest.approx(expected, rel=0.1)


def test_mean_behind_a_gamma_curve_is_moved_to_the_mean_exposure(make_stack):
    """Mean M of noisy exposures through a gamma of 1/2.2 becomes the M of their mean, to a tenth of the shift."""
    rng = np.random.default_rng(8)
    exposure = 0.02 + 0.004 * rng.standard_normal(400_000)
    numbers = 4095 * np.clip(exposure, 0, 1) ** (1 / 2.2)
    g = 2.2 * np.log(np.maximum(np.arange(4096), 0.5) / 4095)
    mean, variance = numbers.mean(), numbers.var() + 1 / 12
    predicted = 4095 * exposure.mean() ** (1 / 2.2)
    found = mean_exposure_dn(np.array([mean]), np.array([variance]), g, find_limits([make_stack("gamma")]))[0]
    assert abs(found - predicted) < 0.1 * abs(mean - predicted)


def _film(rng, fog, knee, times):
    """Return frames of a scene through a response that ends in fog below and in a soft knee above."""
    radiance = np.exp(rng.uniform(-6.0, 2.0, (90, 120)))
    frames = []
    for time in times:
        dn = fog + (knee - fog) * (radiance * time / (1.0 + radiance * time)) ** 0.7
        stored = np.clip(np.round(dn + rng.normal(0.0, 0.7, radiance.shape)), 0, 255).astype(np.uint8)
        frames.append(Frame(stored, 8, FrameSettings(float(time))))
    return Bracket.from_frames(frames)


def test_fog_and_knee_are_seen_where_values_stand_still():
    """Values that do not move while the exposure grows are black (fog at 15) and white (a soft knee at 240)."""
    limits = find_limits([_film(np.random.default_rng(3), 15, 240, 2.0 ** np.arange(-14, 16, 2))])
    assert limits.black_dn == pytest.approx(15, abs=1)
    assert 235 <= limits.saturated_dn <= 240


def test_values_that_move_with_the_exposure_are_neither_black_nor_white():
    """The same film, exposed where nothing stands still, has no fog and no knee."""
    limits = find_limits([_film(np.random.default_rng(3), 15, 240, 2.0 ** np.arange(-2, 4))])
    assert (limits.black_dn, limits.saturated_dn) == (0, 255)


def test_samples_without_a_quadrant_lack_its_pixels():
    """The four parts without a quadrant, and the quadrants themselves, hold the pixels of the whole between them."""
    rng = np.random.default_rng(1)
    radiance = np.exp(rng.uniform(-5.0, 0.0, (64, 64)))
    frames = [
        Frame(np.clip(radiance * t * 255, 0, 255).astype(np.uint8), 8, FrameSettings(float(t))) for t in (1, 2, 4, 8)
    ]
    samples = gather_samples(Bracket.from_frames(frames))
    whole = samples.pixels[samples.frame == 1].sum()
    own = [part.pixels[part.frame == 1].sum() for part in samples.quadrants]
    without = [part.pixels[part.frame == 1].sum() for part in samples.without_quadrant]
    assert sum(own) == pytest.approx(whole, rel=0.05)
    assert sum(without) == pytest.approx(3.0 * whole, rel=0.05)
    assert min(without) > 2.0 * max(own)


def test_a_left_out_row_is_predicted_by_the_other_frames_of_its_group():
    """Behind a straight line a row's prediction is the others' mean exposure times its time; the error is in DN."""
    samples = gather_samples(Bracket.from_frames(_ramp_frames((1.0, 2.0))))
    g = np.log(np.arange(256) + 1e-3)
    errors = prediction_error_dn(samples, g)
    assert np.nanmax(np.abs(errors)) < 1.1  # half a number of rounding in either frame
    doubled = prediction_error_dn(samples, g, np.array([0.0, np.log(1.5)]))
    later = samples.frame == 1
    assert np.nanmedian(doubled[later] / samples.dn[later]) == pytest.approx(0.5, abs=0.02)
    assert np.nanmedian(doubled[~later] / samples.dn[~later]) == pytest.approx(-1.0 / 3.0, abs=0.02)


@pytest.mark.parametrize(
    ("dn", "expected"),
    [((100, 200), (0.0, 0.0)), ((200, 100), (50.0 - 200.0, 255.0 - 100.0)), ((100, 100), (-50.0, 100.0))],
)
def test_rows_at_the_ends_are_predicted_by_each_other(dn, expected):
    """Where no row of a group is between black and white they count alike; none is NaN. Behind a line, by M/t."""
    samples = gather_samples(Bracket.from_frames(_ramp_frames((1.0, 2.0))))
    two = replace(
        samples,
        dn=np.array(dn, float), log_time=np.log([1.0, 2.0]), group=np.zeros(2, np.intp), frame=np.arange(2),
        pixels=np.ones(2), variance=np.ones(2), limits=ValueLimits(100, 200),
    )  # fmt: skip
    assert prediction_error_dn(two, np.log(np.arange(256) + 1e-9)) == pytest.approx(expected, abs=0.01)


def _ramp_frames(times):
    ramp = np.tile(np.linspace(10.0, 120.0, 128), (64, 1))
    return [Frame(np.round(ramp * t).astype(np.uint8), 8, FrameSettings(t)) for t in times]


def test_levelling_listens_to_what_is_known():
    """A fall among values of large u levels these, and leaves the well-known ones where they were."""
    g = np.array([0.0, 1.0, 2.0, 3.0, 9.0, 4.0, 5.0, 6.0])
    u = np.array([0.1, 0.1, 0.1, 0.1, 9.0, 0.1, 0.1, 0.1])
    level = rising(g, u, (0, 7))
    assert np.all(np.diff(level) >= 0)
    assert np.max(np.abs(level - g)[[0, 1, 2, 3, 5, 6, 7]]) < 0.01


def test_ratios_of_exposures_are_means_by_inverse_variance():
    """Steps of 1 ± 1 and 2 ± 2 in ln H make 1.2; frames without a common row keep the ratio that they state."""
    pairs = Pairs(
        shorter=np.array([10, 10]),
        longer=np.array([20, 30]),
        pair=np.array([0, 0]),
        sigma=np.array([1.0, 2.0]),
        group=np.array([0, 1]),
        nominal_log_ratio=np.array([0.7, 0.69]),
        frames=np.array([0, 1]),
    )
    assert pairs.log_ratios(0.1 * np.arange(256.0)) == pytest.approx([1.2, 0.69])
