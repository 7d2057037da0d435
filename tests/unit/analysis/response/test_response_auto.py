"""The best estimate on stacks whose response and times are known."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import radiometer as rm
from radiometer.analysis.response.auto import recover_response_auto
from radiometer.data import Bracket, Frame, FrameSettings
from radiometer.data.storage import write_yaml_atomic
from radiometer.errors import MeasurementError


def test_an_even_field_gives_no_response():
    """Where no number occurs at two times, the frames separate no curve from the times: one clear line."""
    rng = np.random.default_rng(1)
    frames = []
    for exposure_s in np.repeat([0.02, 0.05, 0.1, 0.2, 0.4, 0.8, 1.6], 2):
        electrons = rng.poisson(9000.0 * exposure_s, (64, 80)) + rng.normal(0.0, 4.0, (64, 80))
        dn = np.rint(200.0 + 0.5 * electrons).astype(np.uint16)
        frames.append(Frame(dn, 16, FrameSettings(float(exposure_s))))
    with pytest.raises(MeasurementError, match="no response follows"):
        rm.recover_response(Bracket.from_frames(frames))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("response", "bit_depth", "limit"),
    [
        *((one, 8, 0.0022) for one in ("gamma", "linear", "sigmoid")),
        *((one, 12, 0.002) for one in ("gamma", "linear", "sigmoid")),
        ("gamma", 16, 0.002),
        *(pytest.param(one, 16, 0.002, marks=pytest.mark.long) for one in ("linear", "sigmoid")),
    ],
)
def test_response_comes_back(make_stack, inner_error, response, bit_depth, limit):
    """The scatter of ln H over 5–95 % stays under half of 0.0044, the best peer's at 8 bits."""
    curve = recover_response_auto(make_stack(response, bit_depth=bit_depth)).curve
    assert np.std(inner_error(curve, response)) < limit


@pytest.mark.slow
def test_parts_of_an_even_stack_agree(make_stack):
    """Where all quadrants and frames follow one curve, curves without one of them differ by less than 1 %."""
    for bit_depth in (8, 12):
        agreement = recover_response_auto(make_stack("gamma", bit_depth=bit_depth)).agreement
        assert 0.0 < agreement.quadrants_rms_log < 0.01
        assert 0.0 < agreement.frames_rms_log < 0.01


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


@pytest.mark.long
@pytest.mark.parametrize("bit_depth", [8, 12])
def test_errors_are_what_the_uncertainty_says(make_stack, inner_error, bit_depth):
    """Over five responses with bends at all levels the mean squared error in units of u is near 1: 0.4 to 2.5.

    The frames are whole stops apart, so that much of the error is what smoothness decides: some 10 free values each.
    """
    films = [f"film{k}" for k in range(bit_depth == 12, 10, 2)]
    assert 0.4 < _mean_square_in_u(make_stack, inner_error, bit_depth, films) < 2.5


@pytest.mark.long
@pytest.mark.parametrize("bit_depth", [8, 12])
def test_errors_of_smooth_responses_stay_within_the_uncertainty(make_stack, inner_error, bit_depth):
    """Where a response is smoother than u must allow for, errors are smaller than u, not larger."""
    smooth = [{8: "gamma", 12: "linear"}[bit_depth], *(f"tone{k}" for k in range(bit_depth == 12, 8, 2))]
    assert _mean_square_in_u(make_stack, inner_error, bit_depth, smooth) < 1.0


@pytest.mark.slow
def test_right_times_are_left_alone(make_stack):
    """Where the labels are right no time errors are fitted: the ratios are the given ones, without uncertainty."""
    estimate = recover_response_auto(make_stack("gamma"))
    assert estimate.details["time_spread"] == 0.0
    assert np.all(estimate.u_exposure_ratios == 0)


@pytest.mark.slow
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


@pytest.mark.slow
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
        for f in make_stack("linear").light
    ]
    curve = recover_response_auto(Bracket.from_frames(frames)).curve
    assert curve.valid_dn is not None
    assert curve.valid_dn[0] > 64
    g = np.exp(curve.log_exposure[[564, 1064, 2064]])
    assert g / g[0] == pytest.approx([1, 2, 4], rel=0.01)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("response", "bit_depth"),
    [("gamma", 8), ("linear", 8), ("gamma", 16), pytest.param("linear", 16, marks=pytest.mark.long)],
)
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


def _with_flare(stack, amount):
    """Return the stack with the left half's mean brightness spread over that half, as flare does, behind the curve."""
    from radiometer.data import Bracket, Frame

    frames = []
    for frame in stack.light:
        dn = frame.dn.astype(np.float64)
        left = dn[:, : dn.shape[1] // 2]
        left += amount * (left.mean() - left) * np.linspace(0.0, 1.0, left.shape[0])[:, None]
        stored = np.clip(np.round(dn), 0, frame.full_scale_dn).astype(frame.dn.dtype)
        frames.append(Frame(stored, frame.bit_depth, frame.settings, extra=frame.extra))
    return Bracket.from_frames(frames)


@pytest.mark.slow
def test_parts_that_disagree_widen_the_uncertainty_and_smooth_the_curve(make_stack, inner_error):
    """Flare in one half: groups no longer count as independent, u grows at least threefold, and it holds the error."""
    plain, flared = (recover_response_auto(s) for s in (make_stack("gamma"), _with_flare(make_stack("gamma"), 0.1)))
    assert plain.details["groups_that_count_as_one"] == pytest.approx(1.0, abs=0.5)
    assert flared.details["groups_that_count_as_one"] > 4.0
    low, high = (int(share * plain.curve.log_exposure.size) for share in (0.1, 0.9))
    u_plain, u_flared = (np.median(one.curve.u_log_exposure[low:high]) for one in (plain, flared))
    assert u_flared > 3.0 * u_plain
    assert any("quadrant" in note for note in flared.notes)
    assert not any("quadrant" in note for note in plain.notes)


@pytest.mark.slow
def test_outside_the_data_nothing_is_stated(make_stack):
    """u is infinite outside the supported values, finite inside; g goes on with no more than the power at the edge."""
    curve = recover_response_auto(make_stack("gamma", bit_depth=8)).curve
    low, high = curve.valid_dn
    assert np.all(np.isfinite(curve.u_log_exposure[low : high + 1]))
    assert np.all(np.isinf(curve.u_log_exposure[:low]))
    assert np.all(np.isinf(curve.u_log_exposure[high + 1 :]))
    steepest = np.max(np.diff(curve.log_exposure[low : low + 8]) / np.diff(np.log(np.arange(low, low + 8))))
    assert curve.log_exposure[low] - curve.log_exposure[0] <= steepest * np.log(low / 0.5)


@pytest.mark.slow
def test_frames_that_no_curve_joins_are_said_to_be_so(make_stack):
    """Of three frames the middle one's time is 1.5 times too long: the curve is not to be relied on, and says so."""
    bracket = make_stack("gamma", bit_depth=8)
    three = list(bracket.light[2:8:2])
    assert not any("no single curve" in note for note in recover_response_auto(Bracket.from_frames(three)).notes)
    wrong = replace(three[1].settings, exposure_s=1.5 * three[1].settings.exposure_s)
    three[1] = replace(three[1], settings=wrong)
    assert any("follow no single curve" in note for note in recover_response_auto(Bracket.from_frames(three)).notes)


@pytest.mark.slow
def test_a_date_stamped_into_every_frame_is_no_exposure(make_stack):
    """Pixels that stay at 160 DN through the ladder see no light: the curve is the one of the stack without them."""
    bracket = make_stack("gamma", bit_depth=8)
    stamped = []
    for frame in bracket.light:
        dn = frame.dn.copy()
        dn[: dn.shape[0] // 8, : dn.shape[1] // 4] = 160
        stamped.append(replace(frame, dn=dn))
    clean, found = (recover_response_auto(one).curve for one in (bracket, Bracket.from_frames(stamped)))
    inside = slice(13, 243)
    gap = (found.log_exposure - clean.log_exposure)[inside]
    u = np.hypot(found.u_log_exposure, clean.u_log_exposure)[inside]
    assert np.sqrt(np.mean((gap - gap.mean()) ** 2)) < 1.5 * np.sqrt(np.mean(u**2))
    assert np.sqrt(np.mean(u**2)) < 0.02


@pytest.mark.slow
@pytest.mark.parametrize(
    "scene",
    [
        {"kind": "uniform", "radiance_W_per_sr_m2": 1.0},
        {"kind": "step_chart", "steps": {"count": 6, "lowest": 0.01, "highest": 10.0}, "margin": 0.0},
    ],
    ids=["sphere", "chart"],
)
def test_an_even_source_is_one_light_and_no_disagreement(tmp_path: Path, scene: dict[str, Any]) -> None:
    """A sphere, a chart: noise decides which pixel of a light is brighter; no note blames movement or processing."""
    bench = {
        "format": "radiometer-bench/1",
        "camera": {"kind": "simulated", "preset": "BFS-U3-19S4M", "width": 160, "height": 120, "black_level_dn": 64},
        "lens": {"focal_length_mm": 16, "f_number": 4},
        "scene": scene,
    }
    write_yaml_atomic(tmp_path / "bench.yaml", bench)
    ladder = {"shortest_s": 5e-4, "longest_s": 0.256, "stops": 0.5, "repeat": 2}
    rm.bracket(tmp_path / "sphere", bench=tmp_path / "bench.yaml", **ladder)  # type: ignore[arg-type]
    (found,) = rm.recover_response(tmp_path / "sphere").estimates
    assert any("one light" in note for note in found.notes)
    assert not any("differ by more than their noise" in note for note in found.notes)
