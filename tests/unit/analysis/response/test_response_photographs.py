"""Responses from stacks that behave as photographs do: hand-held edges, a camera's tone curve, noise behind it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from radiometer.analysis.response.auto import Judged, judge_by_prediction, recover_response_auto
from radiometer.analysis.response.debevec1997 import curve_debevec1997
from radiometer.analysis.response.estimate import ResponseEstimate
from radiometer.analysis.response.planes import Plane
from radiometer.analysis.response.samples import gather_samples
from radiometer.analysis.response.settle import Choices, fit_with
from radiometer.analysis.response.wrong_labels import WrongLabel, find_wrong_labels
from radiometer.data import Bracket, Frame, FrameSettings

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


TIMES = tuple(0.25 * 1.7**k for k in range(7))


@pytest.fixture(scope="module")
def moved() -> ResponseEstimate:
    return recover_response_auto(photographs(TIMES, (0, 1, -1, 2, 0, -2, 1)))


@pytest.mark.slow
def test_edges_that_moved_do_not_bend_the_curve(moved: ResponseEstimate) -> None:
    """Frames shifted by a pixel or two give the curve of the even patches: within 1 % of the truth, as stated."""
    assert rms_of(moved) < 0.01
    assert any("edges" in note for note in moved.notes)


def test_a_still_stack_keeps_all_its_pixels() -> None:
    """Where equally bright pixels vary no more at edges than elsewhere, all of them count."""
    still = gather_samples(photographs(TIMES, (0,) * 7))
    assert still.edge_scatter == 0.0
    moved = gather_samples(photographs(TIMES, (0, 1, -1, 2, 0, -2, 1)))
    assert moved.edge_scatter > 1.5
    assert moved.pixel_count < 0.6 * still.pixel_count


def test_a_linear_camera_stays_linear_beyond_its_brightest_value() -> None:
    """Where no pixel is brighter than a third of full scale, ln H goes on as ln M does."""
    rng = np.random.default_rng(5)
    light = np.exp(scene() - 1.5)
    frames = []
    for seconds in TIMES:
        values = 12.0 * light * seconds + 0.4 * rng.standard_normal(light.shape)
        frames.append(Frame(np.round(np.maximum(values, 0.0)).astype(np.uint8), 8, FrameSettings(seconds)))
    estimate = recover_response_auto(Bracket.from_frames(frames))
    assert (estimate.curve.valid_dn or (0, 255))[1] < 90
    g = estimate.curve.log_exposure
    assert g[242] - g[40] == pytest.approx(np.log(242 / 40), abs=0.25)


def relabelled(bracket: Bracket, index: int, factor: float) -> Bracket:
    frames = list(bracket.light)
    settings = replace(frames[index].settings, exposure_s=factor * frames[index].settings.exposure_s)
    frames[index] = replace(frames[index], settings=settings)
    return Bracket.from_frames(frames)


@pytest.mark.slow  # a label of a bracket is found in the fast tests by what is held (held/test_held_response_parts.py)
@pytest.mark.parametrize(("index", "stops"), [(1, 1 / 3), (4, -1 / 3)])
def test_a_label_wrong_by_a_third_of_a_stop_is_found_in_moved_photographs(index: int, stops: float) -> None:
    """The frame is named with its real exposure within 2 u, and no other; with right labels none is."""
    bracket = photographs(TIMES, (0, 1, -1, 2, 0, -2, 1))
    found = _wrong(relabelled(bracket, index, 2.0**stops))
    assert [one.frame for one in found] == [index]
    assert found[0].ratio == pytest.approx(2.0**-stops, abs=2.0 * found[0].u_ratio)
    assert _wrong(bracket) == ()


def _wrong(bracket: Bracket) -> tuple[WrongLabel, ...]:
    samples = gather_samples(bracket)
    return find_wrong_labels([Plane(samples, curve_debevec1997(samples).log_exposure)])


@pytest.mark.slow
def test_what_predicts_as_well_is_in_the_uncertainty(moved: ResponseEstimate) -> None:
    """Rival fits widen u by the rms distance of all, the best among them, from the best; without rivals it stays."""
    samples = gather_samples(photographs(TIMES, (0,) * 7))
    start = curve_debevec1997(samples).log_exposure
    best = fit_with(samples, start, Choices(smoothing=1e3))
    rival = fit_with(samples, start, Choices(smoothing=1e9))
    assert np.all(Judged(best).u_among(()) == 0.0)
    apart = np.abs(rival.relative - best.relative)
    assert Judged(best).u_among((rival,)) == pytest.approx(apart / np.sqrt(2.0))
    assert Judged(best).u_among((rival, rival)) == pytest.approx(apart * np.sqrt(2.0 / 3.0))


def test_smoothness_that_hides_the_curve_is_not_taken() -> None:
    """From a λ so large that the shoulder is lost, prediction of what was left out goes to a smaller one."""
    samples = gather_samples(photographs(TIMES, (0,) * 7))
    start = curve_debevec1997(samples).log_exposure
    stiff = fit_with(samples, start, Choices(smoothing=1e8, inflation=50.0))
    judged = judge_by_prediction(samples, start, stiff)
    assert judged.best.choices.smoothing == pytest.approx(1e6)
    assert stiff not in judged.other_smoothness
