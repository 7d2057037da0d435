"""The parts that the response methods share: limits, groups, noise, threads."""

from __future__ import annotations

import numpy as np
import pytest
from threadpoolctl import threadpool_info

from radiometer.analysis.response.limits import find_limits
from radiometer.analysis.response.noise import LogNoise, fit_log_noise
from radiometer.analysis.response.noise_shift import mean_exposure_dn
from radiometer.analysis.response.samples import gather_samples
from radiometer.analysis.response.threads import on_one_blas_thread
from radiometer.data import Bracket, Frame, FrameSettings


def test_saturation_below_full_scale_is_found(make_stack):
    """A sensor that stops at 3500 DN gathers its highlights there: that is its saturation level."""
    frames = [Frame(np.minimum(f.dn, 3500), 12, f.settings) for f in make_stack("linear")]
    assert find_limits([Bracket.from_frames(frames)]).saturated_dn == 3500


def test_unclipped_frames_keep_full_scale():
    """Where nothing piles up, saturation is full scale."""
    ramp = np.arange(40, 200, dtype=np.uint8)[None, :].repeat(50, axis=0)
    frames = [Frame(ramp, 8, FrameSettings(t)) for t in (1.0, 2.0)]
    assert find_limits([Bracket.from_frames(frames)]).saturated_dn == 255


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
    frames = list(make_stack("gamma", bit_depth=8))
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
    wanted = 4095 * exposure.mean() ** (1 / 2.2)
    found = mean_exposure_dn(np.array([mean]), np.array([variance]), g, find_limits([make_stack("gamma")]))[0]
    assert abs(found - wanted) < 0.1 * abs(mean - wanted)


def test_blas_is_held_to_one_thread_and_released():
    """Inside, BLAS has one thread; afterwards what it had before."""

    @on_one_blas_thread
    def threads() -> list[int]:
        return [pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"]

    before = [pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"]
    assert set(threads()) == {1}
    assert [pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"] == before
