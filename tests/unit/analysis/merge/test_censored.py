"""What frames that clip still say, against the likelihood that they have: "at least so much", no more and no less."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize_scalar
from scipy.stats import norm

from radiometer.analysis.merge.finish import NEAREST, RECORD_SIZE, include_nearest_censored, with_censored

# Exposure, noise variance and clipping level of each frame, as `fill_record` has them, with the noise at clipping last.
FRAMES = np.array(
    [[1.0, 25.0, 4000.0, 1.0, 0.0, 25.0], [2.0, 49.0, 215.0, 1.0, 0.0, 49.0], [3.0, 64.0, 312.0, 1.0, 0.0, 64.0]]
)


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


def test_many_pixels_at_a_time_hear_their_nearest_frame():
    """Rates from where it has to clip to where it contradicts, of two sets of frames: as one by one."""
    records = np.zeros((2, RECORD_SIZE))
    records[:, NEAREST] = 1, 2  # the second frame is not in the one set, the third in the other not
    rates = np.concatenate([np.linspace(0.0, 130.0, 83), np.linspace(90.0, 110.0, 84)])
    variances, slots = np.geomspace(0.5, 9.0, rates.size), (np.arange(rates.size) % 2).astype(np.uint16)
    heard, their_variances, contradictions = rates.copy(), variances.copy(), np.zeros(rates.size, np.uint8)
    include_nearest_censored(heard, their_variances, slots, records, FRAMES, 0.3, contradictions)
    singly = [
        with_censored(rate, variance, np.uint64(0b101 if slot == 0 else 0b011), FRAMES, 0, 3, 0.3)
        for rate, variance, slot in zip(rates, variances, slots, strict=True)
    ]
    assert np.allclose(np.column_stack([heard, their_variances, contradictions]), singly, rtol=1e-12, atol=1e-12)
    assert {bool(one) for one in contradictions} == {True, False}
    assert 20 < np.count_nonzero(heard > rates) < rates.size - 20


def test_a_frame_without_noise_in_the_dark_is_heard_or_passed_over_in_numbers():
    """No read noise and no light: a frame far above contradicts or says nothing, and no value is lost to 0 times ∞."""
    frames = np.array([[1.0, 0.0, 40.0, 1.0, 0.0, 0.0], [4.0, 0.0, 40.0, 1.0, 0.0, 0.0]])
    for rate in (-0.3, 0.0):
        found = with_censored(rate, 0.2, np.uint64(0b01), frames, 0, 2, 0.3)
        assert found == (rate, pytest.approx(0.2, rel=1e-12), False)


def test_noise_that_arises_behind_the_curve_counts_at_clipping():
    """No read noise and no light behind a curve: a much longer clipped frame may raise the value, in numbers.

    Its only noise is that of the codes at clipping; the estimate lies 2 u below 0, its u times the exposure far above
    the clipping level.
    """
    frames = np.array([[1.0, 0.0, 4.6, 0.0, 0.0, 0.0], [1e4, 0.0, 4.6, 1.3e-2, 0.0, 1.7e-4]])
    value, variance, contradiction = with_censored(-2e-3, 1e-6, np.uint64(0b01), frames, 0, 2, 4e-7)
    assert -2e-3 < value < 4.6e-4 + 2e-3
    assert 0.0 < variance < 1e-6
    assert not contradiction
