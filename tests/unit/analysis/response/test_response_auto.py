"""The best estimate on stacks whose response and times are known."""

from __future__ import annotations

import numpy as np
import pytest

from radiometer.analysis.response.auto import recover_response_auto


@pytest.mark.parametrize("response", ["gamma", "linear", "sigmoid"])
@pytest.mark.parametrize(("bit_depth", "limit"), [(8, 0.0022), (12, 0.002), (16, 0.002)])
def test_response_comes_back(make_stack, inner_error, response, bit_depth, limit):
    """The scatter of ln H over 5–95 % stays under half of 0.0044, the best peer's at 8 bits."""
    curve = recover_response_auto(make_stack(response, bit_depth=bit_depth)).curve
    assert np.std(inner_error(curve, response)) < limit


def test_disjoint_thirds_differ_as_much_as_stated(make_stack):
    """The mean reduced chi-square of disjoint thirds lies between 0.7 and 1.3, their difference under 1 %."""
    found = [
        recover_response_auto(make_stack("gamma", bit_depth=b, seed=s)).stability for s in range(8) for b in (8, 12)
    ]
    assert 0.7 < np.mean([stability.reduced_chi2 for stability in found]) < 1.3
    assert max(stability.rms_log for stability in found) < 0.01


def _mean_square_in_u(make_stack, inner_error, bit_depth, responses):
    """Return the mean over responses of the mean squared error of ln H in units of its stated uncertainty."""
    squares = []
    for seed, response in enumerate(responses):
        curve = recover_response_auto(make_stack(response, bit_depth=bit_depth, seed=seed)).curve
        error = inner_error(curve, response)
        first = int(np.ceil(0.05 * (2**bit_depth - 1)))
        u = curve.u_log_exposure[first : first + error.size]
        away = u > 0.1 * np.median(u)  # at the gauge point both vanish
        squares.append(np.mean((error[away] / u[away]) ** 2))
    return np.mean(squares)


@pytest.mark.parametrize("bit_depth", [8, 12])
def test_errors_are_what_the_uncertainty_says(make_stack, inner_error, bit_depth):
    """Over ten responses with bends at all levels the mean squared error in units of u is near 1: 0.4 to 2.5.

    The frames are whole stops apart, so that much of the error is what smoothness decides: some 10 free values each.
    """
    films = [f"film{k}" for k in range(10)]
    assert 0.4 < _mean_square_in_u(make_stack, inner_error, bit_depth, films) < 2.5


@pytest.mark.parametrize("bit_depth", [8, 12])
def test_errors_of_smooth_responses_stay_within_the_uncertainty(make_stack, inner_error, bit_depth):
    """Where a response is smoother than u must allow for, errors are smaller than u, not larger."""
    smooth = ["gamma", "linear", *(f"tone{k}" for k in range(8))]
    assert _mean_square_in_u(make_stack, inner_error, bit_depth, smooth) < 1.0


def test_right_times_are_left_alone(make_stack):
    """Where the labels are right no time errors are fitted: the ratios are the given ones, without uncertainty."""
    estimate = recover_response_auto(make_stack("gamma"))
    assert estimate.details["time_spread"] == 0.0
    assert np.all(estimate.u_exposure_ratios == 0)


def test_wrong_time_is_found_and_taken_out(make_stack, inner_error):
    """A frame 3 % longer than its label is found, to within 5 u + 0.1 %, and does not bend the curve."""
    estimate = recover_response_auto(make_stack("gamma", time_errors={4: 1.03}))
    assert estimate.details["time_spread"] > 0
    true = np.full(8, 2.0) * [1, 1, 1, 1.03, 1 / 1.03, 1, 1, 1]
    # The exponent is fixed by the times on average, so the whole ladder may be stretched by its fit.
    stretch = np.polyfit(np.arange(9), np.concatenate([[0], np.cumsum(np.log(true / 2))]), 1)[0]
    expected = true / np.exp(stretch)
    assert np.all(np.abs(estimate.exposure_ratios - expected) < 5 * estimate.u_exposure_ratios + 0.002)
    assert any("labels" in note for note in estimate.notes)
    assert np.std(inner_error(estimate.curve, "gamma")) < 0.01


def test_black_level_is_respected(make_stack):
    """With a black level of 64 DN nothing at or below it counts as supported."""
    from dataclasses import replace

    from radiometer.data import Bracket, Frame

    frames = [
        Frame(
            np.minimum(f.dn.astype(np.uint32) + 64, 4095).astype(np.uint16),
            12,
            replace(f.settings, black_level_dn=64.0),
        )
        for f in make_stack("linear")
    ]
    curve = recover_response_auto(Bracket.from_frames(frames)).curve
    assert curve.valid_dn is not None
    assert curve.valid_dn[0] > 64
    g = np.exp(curve.log_exposure[[564, 1064, 2064]])
    assert g / g[0] == pytest.approx([1, 2, 4], rel=0.01)


@pytest.mark.parametrize("response", ["gamma", "linear"])
@pytest.mark.parametrize("bit_depth", [8, 16])
def test_noise_behind_the_curve_is_borne_as_well(true_log_exposure, response, bit_depth):
    """With 1 DN of noise added behind the curve, close to white too, ln H over 5–95 % scatters under 0.3 %."""
    from radiometer.data import Bracket, Frame, FrameSettings

    rng = np.random.default_rng(1)
    full_scale, power = 2**bit_depth - 1, {"gamma": 1 / 2.2, "linear": 1.0}[response]
    radiance = np.exp(np.linspace(-7.0, 0.0, 256))[None, :].repeat(192, axis=0)
    frames = []
    for exposure_s in 2.0 ** np.arange(-1, 8):
        numbers = np.clip(radiance * exposure_s, 0, 1) ** power * full_scale + rng.standard_normal(radiance.shape)
        stored = np.clip(np.round(numbers), 0, full_scale).astype(np.uint8 if bit_depth == 8 else np.uint16)
        frames.append(Frame(stored, bit_depth, FrameSettings(float(exposure_s))))
    curve = recover_response_auto(Bracket.from_frames(frames)).curve
    inside = slice(int(0.05 * full_scale) + 1, int(0.95 * full_scale))
    assert np.std((curve.log_exposure - true_log_exposure(response, bit_depth))[inside]) < 0.003


def test_thirds_that_differ_are_explained(make_stack):
    """With 60 electrons at white a third of the pixels cannot know ln H to 1 %; the note and the bound say so."""
    estimate = recover_response_auto(make_stack("gamma", bit_depth=8, full_well_e=60.0))
    assert estimate.stability.rms_log > 0.01
    assert any("disjoint thirds" in note for note in estimate.notes)
    # Two curves that are each open by 1/√2 % differ by 1 %.
    assert estimate.details["least_u_of_a_third"] > 0.01 / np.sqrt(2.0)
    assert not any("disjoint thirds" in note for note in recover_response_auto(make_stack("gamma")).notes)
