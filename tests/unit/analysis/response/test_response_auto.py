"""The best estimate on stacks whose response and times are known, or whose times are labelled wrong."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import radiometer as rm
from radiometer.analysis.response.auto import Judged, judge_by_prediction, recover_response_auto
from radiometer.analysis.response.debevec1997 import curve_debevec1997
from radiometer.analysis.response.estimate import ResponseEstimate
from radiometer.analysis.response.labels import exposure_labels, refuse_equal_throughout, reject_inconsistent_exposures
from radiometer.analysis.response.planes import Plane
from radiometer.analysis.response.samples import gather_samples
from radiometer.analysis.response.settle import Choices, fit_with
from radiometer.analysis.response.wrong_labels import find_wrong_labels, freed_one_by_one, smallest_label_error
from radiometer.data import Bracket, Frame, FrameSettings
from radiometer.data.storage import write_yaml_atomic
from radiometer.errors import CaptureError, MeasurementError


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


@pytest.mark.parametrize("seed", [2442101, 2442102])
@pytest.mark.parametrize(("exponent", "stops"), [(1.0, (-3, 0, 3)), (0.8, (-4, -2, 0, 2, 4))])
def test_a_wave_that_wide_steps_do_not_show_is_left_out(exponent, stops, seed):
    """M ∝ H or H^1.25, frames two and three stops apart: noise draws a fit of ln H to a wave of 0.6; u holds the error.

    Of a camera of 20,000 e⁻ and 4 e⁻ of read noise, over three decades of light.
    """
    rng, frames = np.random.default_rng(seed), []
    light = 10.0 ** (-3.0 * np.arange(120) / 120.0) * (1.0 + 0.3 * np.sin(np.arange(80) / 5.0))[:, None]
    for exposure_s in 2.0 ** np.array(stops, dtype=np.float64):
        electrons = rng.poisson(np.minimum(light * exposure_s * 2e4, 1e7)) + rng.normal(0.0, 4.0, light.shape)
        dn = np.rint(255.0 * np.clip(electrons / 2e4, 0.0, 1.0) ** (1.0 / exponent)).astype(np.uint8)
        frames.append(Frame(dn, 8, FrameSettings(float(exposure_s))))
    curve = recover_response_auto(Bracket.from_frames(frames)).curve
    dn = np.arange(12, 245)
    error = curve.log_exposure[dn] - exponent * np.log(dn / 128.0)
    assert np.mean(np.abs(error) <= 2.0 * curve.u_log_exposure[dn]) > 0.95
    assert np.abs(error).max() < 0.1


@pytest.mark.slow
@pytest.mark.parametrize(
    ("response", "bit_depth", "limit"),
    [
        *((one, 8, 0.0022) for one in ("gamma", "sigmoid")),
        ("linear", 12, 0.002),
        ("gamma", 16, 0.002),
        *(pytest.param(one, 16, 0.002, marks=pytest.mark.long) for one in ("linear", "sigmoid")),
    ],
)
def test_response_comes_back(make_stack, inner_error, response, bit_depth, limit):
    """The scatter of ln H over 5–95 % stays under half of 0.0044, the best peer's at 8 bits."""
    curve = recover_response_auto(make_stack(response, bit_depth=bit_depth)).curve
    assert np.std(inner_error(curve, response)) < limit


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
def test_wrong_time_is_found_and_taken_out(make_stack, inner_error):
    """A frame 3 % longer than its label is found, to within 5 u + 0.1 %, and does not bend the curve."""
    estimate = recover_response_auto(make_stack("gamma", time_errors=((4, 1.03),)))
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
    frames = [
        Frame(
            np.minimum(f.dn.astype(np.uint32) + 64, 4095).astype(np.uint16),
            12,
            replace(f.settings, black_level_dn=64.0),
        )
        for f in make_stack("linear").light
    ]
    curve = recover_response_auto(Bracket.from_frames(frames)).curve
    assert curve.valid_dn[0] > 64
    g = np.exp(curve.log_exposure[[564, 1064, 2064]])
    assert g / g[0] == pytest.approx([1, 2, 4], rel=0.01)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("response", "bit_depth"), [("gamma", 8), ("gamma", 16), pytest.param("linear", 16, marks=pytest.mark.long)]
)
def test_noise_behind_the_curve_is_borne_as_well(true_log_exposure, response, bit_depth):
    """With 1 DN of noise added behind the curve, close to white too, ln H over 5–95 % scatters under 0.3 %."""
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
    assert 0.0 < max(plain.agreement.quadrants_rms_log, plain.agreement.frames_rms_log) < 0.01
    assert flared.details["groups_that_count_as_one"] > 4.0
    low, high = (int(share * plain.curve.log_exposure.size) for share in (0.1, 0.9))
    u_plain, u_flared = (np.median(one.curve.u_log_exposure[low:high]) for one in (plain, flared))
    assert u_flared > 3.0 * u_plain
    assert any("quadrant" in note for note in flared.notes)
    assert not any("quadrant" in note for note in plain.notes)


@pytest.mark.slow
def test_frames_that_no_curve_joins_are_said_to_be_so(make_stack):
    """A time 1.5 times too long; a date stamped into every frame is no exposure."""
    bracket = make_stack("gamma", bit_depth=8)
    three = list(bracket.light[2:8:2])
    assert not any("no single curve" in note for note in recover_response_auto(Bracket.from_frames(three)).notes)
    wrong = replace(three[1].settings, exposure_s=1.5 * three[1].settings.exposure_s)
    three[1] = replace(three[1], settings=wrong)
    assert any("follow no single curve" in note for note in recover_response_auto(Bracket.from_frames(three)).notes)
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
    ("changed", "ladder"),
    [
        ({"scene": {"kind": "uniform", "radiance_W_per_sr_m2": 1.0}}, (5e-4, 0.256, 0.5, 2)),
        (
            {"scene": {"kind": "step_chart", "steps": {"count": 6, "lowest": 0.01, "highest": 10.0}, "margin": 0.0}},
            (5e-4, 0.256, 0.5, 2),
        ),
        (
            {
                "scene": {"kind": "step_chart", "steps": {"count": 24, "lowest": 0.02, "highest": 1.2}},
                "source": {"kind": "screen", "wavelength_nm": 550},
            },
            (2e-4, 0.0512, 1.0, 1),
        ),
    ],
    ids=["sphere", "chart", "dark chart"],
)
def test_an_even_source_is_one_light_and_no_disagreement(
    tmp_path: Path, changed: dict[str, Any], ladder: tuple[float, ...]
) -> None:
    """A sphere or a chart: the note says that tones are few; none blames movement or processing."""
    bench = {
        "format": "radiometer-bench/1",
        "camera": {"kind": "simulated", "preset": "BFS-U3-19S4M", "width": 144, "height": 96, "black_level_dn": 64},
        "lens": {"focal_length_mm": 16, "f_number": 4},
    }
    write_yaml_atomic(tmp_path / "bench.yaml", bench | changed)
    asked = dict(zip(("shortest_s", "longest_s", "stops", "repeat"), ladder, strict=True))
    rm.bracket(tmp_path / "sphere", bench=tmp_path / "bench.yaml", **asked)  # type: ignore[arg-type]
    (found,) = rm.recover_response(tmp_path / "sphere").estimates
    assert any("few tones" in note for note in found.notes)
    assert not any("differ by more than their noise" in note for note in found.notes)


# Exposure times that are labelled wrong.


def _relabelled(bracket: Bracket, index: int, exposure_s: float) -> Bracket:
    frames = list(bracket.light)
    frames[index] = replace(frames[index], settings=replace(frames[index].settings, exposure_s=exposure_s))
    return Bracket.from_frames(frames)


@pytest.mark.parametrize("case", ["rising", "two black ones", "one exposure"])
def test_honest_labels_pass(make_stack, case):
    """Brightness that rises with time; frames without light, alike whatever they state; one exposure says nothing."""
    frames = list(make_stack("gamma", bit_depth=8).light)
    if case == "two black ones":
        dark = replace(frames[0], dn=frames[0].dn * 0)
        frames += [replace(dark, settings=replace(dark.settings, exposure_s=s)) for s in (1e-6, 2e-6)]
    elif case == "one exposure":
        frames = [replace(f, settings=replace(f.settings, exposure_s=0.1)) for f in reversed(frames)]
    reject_inconsistent_exposures(Bracket.from_frames(frames))


@pytest.mark.parametrize(("index", "exposure_s", "looks"), [(2, 0.1, "shorter"), (6, 0.0011, "longer")])
def test_wrong_label_is_named(make_stack, index, exposure_s, looks):
    """The frame whose stated time contradicts its brightness is named, and so is the direction."""
    with pytest.raises(CaptureError, match=rf"{index:04}\.png says .* looks like a {looks} exposure") as caught:
        reject_inconsistent_exposures(_relabelled(make_stack("gamma", bit_depth=8), index, exposure_s))
    assert str(caught.value).count(".png says") == 1


def test_reciprocal_times_are_recognised(make_stack):
    """Times that are wrong throughout are reported to be so instead of accusing every frame."""
    bracket = make_stack("linear")
    frames = [replace(f, settings=replace(f.settings, exposure_s=1 / f.settings.exposure_s)) for f in bracket.light]
    with pytest.raises(CaptureError, match="1/t instead of t"):
        reject_inconsistent_exposures(Bracket.from_frames(frames))


def test_equal_frames_are_refused_unless_one_can_tell_which_label_is_wrong(make_stack):
    """Four copies of one frame stated to be 0.5 to 4 s long are named."""
    frame = make_stack("gamma", bit_depth=8).light[4]
    frames = [
        replace(frame, settings=replace(frame.settings, exposure_s=0.5 * 2.0**k), extra={"file": f"{k}.jpg"})
        for k in range(4)
    ]
    with pytest.raises(CaptureError, match=r"0\.jpg \(0\.5 s\) and 1\.jpg \(1 s\).*2\.jpg \(2 s\) and 3\.jpg \(4 s\)"):
        reject_inconsistent_exposures(Bracket.from_frames(frames))
    with pytest.raises(CaptureError, match=r"0\.jpg \(0\.5 s\) and 1\.jpg \(1 s\)"):
        refuse_equal_throughout(Bracket.from_frames(frames))
    first, brighter = make_stack("gamma", bit_depth=8).light[4:6]
    times = [replace(first.settings, exposure_s=one) for one in (0.5, 1.0, 2.0)]
    alike = [replace(first, settings=one) for one in times]
    refuse_equal_throughout(
        Bracket.from_frames([*alike, replace(brighter, settings=replace(times[0], exposure_s=4.0))])
    )
    refuse_equal_throughout(Bracket.from_frames([alike[0], alike[0]]))


def _two_frames(seconds, of_middle=(60, 3000), part=0.5, rise=0.0):
    """Return frames of 16 bits, some pixels at a part of full scale, the second by a rise above, the rest black."""
    count, pixels = of_middle
    shown = np.zeros((2, pixels))
    shown[0, :count], shown[1, :count] = part, part + rise
    dn = np.rint(65535.0 * shown).astype(np.uint16).reshape(2, 10, -1)
    return Bracket.from_frames(Frame(one, 16, FrameSettings(t)) for one, t in zip(dn, seconds, strict=True))


EQUAL, DARKER = "equally bright though their stated exposures differ", "get darker"


@pytest.mark.parametrize(
    ("changes", "refused"),
    [
        ({}, EQUAL), ({"of_middle": (59, 3000)}, None), ({"of_middle": (50, 1000)}, EQUAL),
        ({"of_middle": (49, 1000)}, None), ({"part": 0.09}, None), ({"part": 0.11}, EQUAL), ({"part": 0.89}, EQUAL),
        ({"part": 0.91}, None), ({"rise": 0.0038}, EQUAL), ({"rise": 0.0042}, None),
        ({"seconds": (1.0, 1.26)}, EQUAL), ({"seconds": (1.0, 1.24)}, None),
        ({"seconds": (1.0, 1.1), "rise": -0.0038}, None), ({"seconds": (1.0, 1.1), "rise": -0.0042}, DARKER),
        ({"seconds": (1.0, 1.1), "rise": -0.0042, "of_middle": (49, 3000)}, None),
    ],
)  # fmt: skip
def test_frames_that_contradict_their_labels_need_enough_middle_tones_to_do_so(changes, refused):
    """50 pixels and 2 % between a tenth and nine tenths of full scale, alike to 0.4 % of it, labels a quarter apart.

    A longer exposure may be darker by 0.4 %; of fewer such pixels the whole picture is asked instead.
    """
    bracket = _two_frames(**({"seconds": (1.0, 2.0)} | changes))
    with pytest.raises(CaptureError, match=refused) if refused else nullcontext():
        reject_inconsistent_exposures(bracket)


def test_an_exposure_is_called_as_it_is_stated(make_stack):
    """A label that is found wrong is reported with file, time and speed, not by the product of time and gain."""
    frames = make_stack("gamma", bit_depth=8).light[:3]
    stated = [{"gain_db": 0.0, "iso": 100.0}, {"gain_db": 6.0206, "iso": 200.0}, {"gain_db": 6.0206, "iso": None}]
    bracket = Bracket.from_frames(
        replace(f, settings=replace(f.settings, exposure_s=2.0 ** (k - 6), **gain), extra={"file": f"p{k}.jpg"})
        for k, (f, gain) in enumerate(zip(frames, stated, strict=True))
    )
    labels = ["0.01562 s at ISO 100 (p0.jpg)", "0.03125 s at ISO 200 (p1.jpg)", "0.0625 s at 6.02 dB (p2.jpg)"]
    assert exposure_labels(bracket) == labels
    assert exposure_labels(replace(bracket, light=bracket.light[:1])) == ["0.01562 s (p0.jpg)"]


TIMES = 0.002 * 2.0 ** np.arange(10)


def church(wrong: int | None, ratio: float, seed: int = 5) -> Plane:
    """Return photographs of a dim room with a window in one quadrant, which alone is seen in the shortest of them.

    Args:
        wrong: Frame whose real exposure is `ratio` times its label.
        ratio: Real over stated exposure.
        seed: Of the noise.
    """
    rng = np.random.default_rng(seed)
    radiance = np.exp(rng.uniform(-7.0, -3.0, (96, 128)))
    radiance[8:40, 70:118] = np.exp(rng.uniform(2.0, 5.0, (32, 48)))
    frames = []
    for number, label in enumerate(TIMES):
        light = radiance * label * (ratio if number == wrong else 1.0)
        values = 255.0 * (light / (0.3 + light)) ** 0.6 + 0.8 * rng.standard_normal(radiance.shape)
        frames.append(Frame(np.clip(np.round(values), 0, 255).astype(np.uint8), 8, FrameSettings(float(label))))
    samples = gather_samples(Bracket.from_frames(frames))
    return Plane(samples, curve_debevec1997(samples).log_exposure)


@pytest.mark.slow
@pytest.mark.parametrize(("wrong", "ratio"), [(1, 1.6), (5, 1.35)])
def test_the_label_of_a_frame_that_shows_one_corner_is_reported(wrong: int, ratio: float) -> None:
    """By its own rows and by its size, however little it adds to the error of all frames; and it alone."""
    plane = church(wrong, ratio)
    shown = [int((part.frame == 1).sum()) for part in plane.samples.quadrants]
    assert shown[1] > 50
    assert max(shown[0], shown[2], shown[3]) < 10
    (label,) = find_wrong_labels([plane])
    assert label.frame == wrong
    assert label.ratio == pytest.approx(ratio, abs=3.0 * label.u_ratio)
    assert label.u_ratio < 0.1 * ratio
    assert label.rivals == ()


@pytest.mark.slow
def test_each_label_is_what_the_other_frames_say_of_it() -> None:
    """With its u, next to a wrong one too; right labels of one corner are left alone."""
    plane = church(5, 1.35)
    dark = replace(plane, samples=plane.samples.changed(lambda one: one.kept(one.frame != 0)))
    reported = freed_one_by_one([dark], (5,))
    assert reported[0] == (0.0, math.inf)
    value, u = np.array(reported[1:]).T
    true = np.where(np.arange(1, TIMES.size) == 5, math.log(1.35), 0.0)
    assert np.all(np.abs(value - true) < 3.5 * u + 0.003)
    assert max(u) < 0.1
    assert freed_one_by_one([replace(plane, samples=replace(plane.samples, shares=()))]) == [(0.0, math.inf)] * 10
    assert [find_wrong_labels([church(None, 1.0, seed)]) for seed in (6, 7)] == [(), ()]


@pytest.mark.slow
@pytest.mark.parametrize("wrong", [1, 8])
def test_a_label_is_named_from_five_of_its_u_on(wrong: int) -> None:
    """Beyond what counts as wrong at all; either way."""
    value, u = freed_one_by_one([church(None, 1.0)])[wrong]
    least = smallest_label_error(float(TIMES[wrong])) + 5.0 * u
    for ratio in (math.exp(least - value), math.exp(-least - value)):
        assert [one.frame for one in find_wrong_labels([church(wrong, ratio)])] == [wrong]


# Responses from stacks that behave as photographs do: hand-held edges, a camera's tone curve, noise behind it.


Array = NDArray[np.float64]
PATCH_PX, ROWS, COLUMNS = 16, 10, 14


def scene() -> Array:
    """Return patches of ln radiance over seven e-foldings in random order, sloping a little within each."""
    rng = np.random.default_rng(11)
    tones = rng.permutation(np.linspace(-5.5, 1.5, ROWS * COLUMNS)).reshape(ROWS, COLUMNS)
    slope = np.linspace(-0.1, 0.1, PATCH_PX)
    return np.asarray(np.kron(tones, np.ones((PATCH_PX, PATCH_PX))) + np.tile(slope, COLUMNS)[None, :])


def tone_curve(light: Array) -> Array:
    """Return digital numbers of a tone curve with shoulder and a linear toe, before rounding."""
    share = 1.0 - np.exp(-light)
    return np.asarray(255.0 * np.where(share < 0.01, 12.33 * share, share**0.4545))


def true_log_exposure(dn: Array) -> Array:
    share = dn / 255.0
    return np.asarray(np.log(-np.log1p(-np.where(share < 0.1233, share / 12.33, share**2.2))))


def photographs(times: Sequence[float], shifts: Sequence[int], seed: int = 3) -> Bracket:
    """Return frames of the scene, each moved sideways by whole pixels, with noise behind the curve."""
    rng = np.random.default_rng(seed)
    frames = []
    for number, (seconds, shift) in enumerate(zip(times, shifts, strict=True)):
        light = np.exp(np.roll(scene(), shift, axis=1)) * seconds
        values = tone_curve(light) + 0.7 * rng.standard_normal(light.shape)
        dn = np.clip(np.round(values), 0, 255).astype(np.uint8)
        frames.append(Frame(dn, 8, FrameSettings(seconds), extra={"file": f"{number}.jpg"}))
    return Bracket.from_frames(frames, origin="photographs")


def rms_of(estimate: ResponseEstimate) -> float:
    dn = np.arange(13, 243)
    return float(np.std(estimate.curve.log_exposure[dn] - true_log_exposure(dn.astype(np.float64))))


HAND_HELD_S = tuple(0.25 * 1.7**k for k in range(7))


@pytest.fixture(scope="module")
def moved() -> ResponseEstimate:
    return recover_response_auto(photographs(HAND_HELD_S, (0, 1, -1, 2, 0, -2, 1)))


@pytest.mark.slow
def test_edges_that_moved_do_not_bend_the_curve(moved: ResponseEstimate) -> None:
    """The curve of the even patches within 1 %; rival fits widen u by their rms distance."""
    assert rms_of(moved) < 0.01
    assert any("edges" in note for note in moved.notes)
    samples = gather_samples(photographs(HAND_HELD_S, (0,) * 7))
    start = curve_debevec1997(samples).log_exposure
    best = fit_with(samples, start, Choices(smoothing=1e3))
    rival = fit_with(samples, start, Choices(smoothing=1e9))
    assert np.all(Judged(best).u_among(()) == 0.0)
    apart = np.abs(rival.relative - best.relative)
    assert Judged(best).u_among((rival,)) == pytest.approx(apart / np.sqrt(2.0))
    assert Judged(best).u_among((rival, rival)) == pytest.approx(apart * np.sqrt(2.0 / 3.0))


def test_a_still_stack_keeps_all_its_pixels() -> None:
    """Where equally bright pixels vary no more at edges than elsewhere, all of them count."""
    still = gather_samples(photographs(HAND_HELD_S, (0,) * 7))
    assert still.edge_scatter == 0.0
    moved = gather_samples(photographs(HAND_HELD_S, (0, 1, -1, 2, 0, -2, 1)))
    assert moved.edge_scatter > 1.5
    assert moved.pixel_count < 0.6 * still.pixel_count


def test_a_linear_camera_stays_linear_beyond_its_brightest_value() -> None:
    """Where no pixel is brighter than a third of full scale, ln H goes on as ln M does."""
    rng = np.random.default_rng(5)
    light = np.exp(scene() - 1.5)
    frames = []
    for seconds in HAND_HELD_S:
        values = 12.0 * light * seconds + 0.4 * rng.standard_normal(light.shape)
        frames.append(Frame(np.round(np.maximum(values, 0.0)).astype(np.uint8), 8, FrameSettings(seconds)))
    estimate = recover_response_auto(Bracket.from_frames(frames))
    assert (estimate.curve.valid_dn or (0, 255))[1] < 90
    g = estimate.curve.log_exposure
    assert g[242] - g[40] == pytest.approx(np.log(242 / 40), abs=0.25)


def test_smoothness_that_hides_the_curve_is_not_taken() -> None:
    """From a λ so large that the shoulder is lost, prediction of what was left out goes to a smaller one."""
    samples = gather_samples(photographs(HAND_HELD_S, (0,) * 7))
    start = curve_debevec1997(samples).log_exposure
    stiff = fit_with(samples, start, Choices(smoothing=1e8, inflation=50.0))
    judged = judge_by_prediction(samples, start, stiff)
    assert judged.best.choices.smoothing == pytest.approx(1e6)
    assert stiff not in judged.other_smoothness
