"""Brackets taken from a simulated camera: metered, planned, captured, judged."""

import math
from dataclasses import replace

import numpy as np
import pytest

from radiometer.acquire.bracketing import BracketRequest, plan_for_scene, take_dark_frames, take_plan
from radiometer.acquire.exposure_plan import ExposurePlan, ExposureWindow
from radiometer.acquire.metering import meter
from radiometer.acquire.reach import assess_reach
from radiometer.data import Frame, FrameSettings, LensDescription, Patch
from radiometer.devices import CameraCapabilities, CameraPreset, CameraSettings
from radiometer.errors import DeviceError, UsageError
from simulators.cameras.simulated_camera import SimulatedCamera
from simulators.chain.camera_model import CameraModel
from simulators.scenes import scene_from_mapping

LIMITS = CameraCapabilities((11e-6, 30.0), (0.0, 47.9), (0.0, 511.0), ("Mono12",), 100, 40, True, True)


def camera_before(scene, **limits):
    """Return an open simulated Blackfly of 100 × 40 pixels before a scene."""
    preset = CameraPreset.shipped("BFS-U3-19S4M").camera
    model = CameraModel.ideal(preset, LensDescription(focal_length_mm=16, f_number=4.0))
    camera = SimulatedCamera(model, scene_from_mapping(scene), seed=3, limits=replace(LIMITS, **limits))
    camera.open()
    camera.configure(CameraSettings(0.01, black_level_dn=64.0))
    return camera


CHART = {"kind": "step_chart", "steps": {"count": 10, "lowest": 1e-4, "highest": 10.0}}


def expected_rate(camera, radiance):
    """Return DN/s at a radiance by hand: π·L/(4N²) · pixel area / photon energy · QE / conversion gain."""
    about = camera.description
    photons = np.pi * radiance / (4 * 16.0) * (about.pixel_pitch_um * 1e-6) ** 2 / (6.62607015e-34 * 299792458 / 550e-9)
    return photons * about.quantum_efficiency / about.conversion_gain_e_per_dn


def test_metering_finds_the_brightness_of_every_patch():
    """Light over six decades, three steps to a decade: in some trial each pixel stands five times above its noise."""
    camera = camera_before({"kind": "step_chart", "steps": {"count": 18, "lowest": 1e-4, "highest": 100.0}})
    rates = meter(camera).rates_dn_per_s
    for patch in camera.scene.patches(100, 40):
        found, expected = rates[patch.patch.slices], expected_rate(camera, patch.radiance())
        assert found.mean() == pytest.approx(expected, rel=4 * 0.2 / np.sqrt(found.size))
        assert found.std() < 0.25 * found.mean()


def test_dim_light_at_high_gain_is_metered_though_its_noise_is_many_digital_numbers():
    """At 30 dB the read noise is some 40 DN: a signal of ten times that in the longest trial counts as light."""
    camera = camera_before({"kind": "uniform", "radiance_W_per_sr_m2": 1e-6})
    camera.configure(CameraSettings(0.01, gain_db=30.0, black_level_dn=64.0))
    radiance = 400.0 / (10 ** (30 / 20) * 1.0) / expected_rate(camera, 1.0)
    camera.set_scene(scene_from_mapping({"kind": "uniform", "radiance_W_per_sr_m2": radiance}))
    rates = meter(camera, longest_s=1.0).rates_dn_per_s
    assert np.mean(rates > 0) > 0.9
    assert rates.mean() == pytest.approx(expected_rate(camera, radiance), rel=0.1)


def test_the_dark_signal_of_a_warm_camera_is_not_metered_as_light():
    """Cap on at 70 °C, where the expected dark signal is many times its noise: nothing stands out."""
    warm = CameraPreset.shipped("BFS-U3-19S4M").camera.model_copy(update={"dark_current_e_per_s": 400.0})
    model = CameraModel.ideal(warm, LensDescription(focal_length_mm=16, f_number=4.0))
    scene = scene_from_mapping({"kind": "uniform", "radiance_W_per_sr_m2": 0.0})
    camera = SimulatedCamera(model, scene, seed=3, limits=LIMITS, temperature_c=warm.dark_current_reference_C)
    camera.open()
    camera.configure(CameraSettings(0.01, black_level_dn=64.0))
    assert np.mean(meter(camera, longest_s=1.0).rates_dn_per_s > 0) < 0.01


def test_reach_is_judged_above_the_black_level():
    """About black plus the lowest and the clipping signal; an unknown black level is none; dark frames say nothing."""
    about = CameraPreset.shipped("BFS-U3-19S4M").camera
    window = ExposureWindow.of(about, 0.0, 400.0)
    edges = [400 + window.lowest_dn - 2, 400 + window.lowest_dn + 2, 400 + 0.99 * window.clipping_dn, 4095]
    settings = FrameSettings(exposure_s=0.01, black_level_dn=400.0)
    frame = Frame(np.array([edges], dtype=np.uint16), 12, settings)
    reach = assess_reach([frame], about)
    assert reach.cover.tolist() == [[0, 1, 1, 0]]
    assert reach.below_noise.tolist() == [[True, False, False, False]]
    assert reach.saturated.tolist() == [[False, False, False, True]]
    about = CameraPreset.shipped("BFS-U3-19S4M").camera
    first = math.ceil(ExposureWindow.of(about, 0.0, 0.0).lowest_dn)
    frame = Frame(np.array([[first - 1, first]], dtype=np.uint16), 12, FrameSettings(exposure_s=0.01))
    assert assess_reach([frame], about).cover.tolist() == [[0, 1]]
    dn = np.full((4, 6), 2000, np.uint16)
    about = camera_before(CHART).description
    lit = Frame(dn, 12, FrameSettings(0.01, black_level_dn=64.0))
    dark = Frame(np.full((4, 6), 64, np.uint16), 12, FrameSettings(0.01, black_level_dn=64.0, shutter="closed"))
    reach = assess_reach([lit, dark], about)
    assert (int(reach.cover.min()), bool(reach.below_noise.any()), bool(reach.saturated.any())) == (1, False, False)
    with pytest.raises(ValueError, match="shutter open"):
        assess_reach([dark], about)


def test_five_decades_are_well_exposed_twice():
    """The bracket that follows from the scene reaches every pixel of the chart; one patch takes two frames."""
    camera = camera_before(CHART)
    request = BracketRequest()
    frames = list(take_plan(camera, plan_for_scene(camera, request), request))
    reach = assess_reach(frames, camera.description)
    for patch in camera.scene.patches(100, 40):
        assert reach.cover[patch.patch.slices].min() >= 2
    camera = camera_before(CHART)
    patch = camera.scene.patches(100, 40)[4].patch
    plan = plan_for_scene(camera, BracketRequest(region=patch))
    assert len(plan.exposures_s) == 2


def test_what_is_too_bright_is_reported_with_its_place():
    """A patch that clips at the shortest exposure is named by number and region."""
    patch = {"name": "sun", "x": 10, "y": 5, "width": 20, "height": 10, "drive": 1.0}
    scene = {"kind": "screen", "peak_radiance_W_per_sr_m2": 1e5, "gamma": 2.2, "background": 0.001, "patches": [patch]}
    camera = camera_before(scene)
    request = BracketRequest()
    plan = plan_for_scene(camera, request)
    reach = assess_reach(take_plan(camera, plan, request), camera.description)
    assert plan.too_bright == 200
    assert reach.sentences()[0] == ("200 of 4000 pixels clip even in the shortest exposure (within x 10, y 5, 20 × 10)")


@pytest.mark.parametrize(("radiance", "rounded", "bound_us"), [(0.0, math.floor, 3333333), (1e9, math.ceil, 11)])
def test_metering_ends_at_a_bound_that_the_camera_rounds(monkeypatch, radiance, rounded, bound_us):
    """Whole µs, as cameras count them: 10/3 s and 10.4 µs are asked for once, in the dark and in too much light."""
    camera = camera_before({"kind": "uniform", "radiance_W_per_sr_m2": radiance}, exposure_s=(10.4e-6, 30.0))
    exact = camera.configure

    def configure(settings):
        return exact(replace(settings, exposure_s=rounded(settings.exposure_s * 1e6) / 1e6))

    monkeypatch.setattr(camera, "configure", configure)
    trials = meter(camera, longest_s=10.0 / 3.0).trials
    assert trials[-1].settings.exposure_s * 1e6 == pytest.approx(bound_us)
    assert len({frame.settings.exposure_s for frame in trials}) == len(trials)


def test_no_exposure_takes_more_than_a_third_of_the_time():
    """Of six seconds a third at most, and none is misuse; where nothing is seen the longest is not taken twice."""
    camera = camera_before({"kind": "uniform", "radiance_W_per_sr_m2": 0.2})
    camera.set_scene(
        scene_from_mapping({"kind": "uniform", "radiance_W_per_sr_m2": 300.0 / 10.0 / expected_rate(camera, 1.0)})
    )
    plan = plan_for_scene(camera, BracketRequest(time_limit_s=6.0))
    assert max(plan.exposures_s) == pytest.approx(2.0)
    assert plan.total_s <= 6.0
    with pytest.raises(UsageError, match="leaves no time"):
        plan_for_scene(camera, BracketRequest(region=Patch(0, 0, 4, 4), time_limit_s=0.0))
    camera = camera_before({"kind": "uniform", "radiance_W_per_sr_m2": 0.0})
    plan = plan_for_scene(camera, BracketRequest(time_limit_s=30.0))
    assert plan.too_dark == 4000
    assert len(plan.exposures_s) == 1


def test_dark_frames_follow_with_the_shutter_closed():
    """Each distinct exposure has its dark frames, without light, and the shutter reopens; the whole is counted."""
    camera = camera_before(CHART)
    request = BracketRequest(dark_frames=2)
    frames = list(take_plan(camera, ExposurePlan((0.01, 0.01, 0.1)), request))
    darks = [frame for frame in frames if frame.settings.is_dark]
    assert [frame.settings.exposure_s for frame in darks] == [0.01, 0.01, 0.1, 0.1]
    # Mean dark signal at 40 °C is under an electron; noise of 4,000 pixels averages to 0.02 DN.
    assert darks[0].dn.mean() == pytest.approx(64.0, abs=0.15)
    assert not camera.capture()[0].settings.is_dark
    seen = []
    request = BracketRequest(dark_frames=2)
    plan = ExposurePlan((0.01, 0.01, 0.02))
    list(take_plan(camera_before(CHART), plan, request, progress=lambda done, total, frame: seen.append((done, total))))
    assert seen[:3] == [(1, 7), (2, 7), (3, 7)]
    assert seen[3:] == [(1, 4), (2, 4), (3, 4), (4, 4)]


def test_a_lens_covered_by_hand_makes_dark_frames():
    """They are marked as dark though the camera knows of no cap; it comes off, also where they end early."""
    asked, plan, request = [], ExposurePlan((0.01, 0.02)), BracketRequest(dark_frames=1)
    camera = camera_before(CHART, has_shutter=False)
    frames = list(take_plan(camera, plan, request, close_shutter=asked.append))
    assert [frame.settings.is_dark for frame in frames] == [False, False, True, True]
    darks = take_dark_frames(camera, [0.01, 0.02], 1, asked.append)
    next(darks)
    darks.close()
    assert asked == [True, False] * 2
    with pytest.raises(DeviceError, match="no shutter; cover the lens"):
        list(take_plan(camera, plan, request))


@pytest.mark.parametrize(("at_s", "taken"), [((0.0, 8.9), 2), ((0.0, 9.1), 1), ((0.0, 5.0), 2)])
def test_an_exposure_must_end_before_the_deadline(at_s, taken):
    """Of 10 s: one of 1 s is begun at 8.9 s and not at 9.1 s; the first is taken however late it is."""
    now = iter(at_s)
    plan, camera = ExposurePlan((1.0, 1.0)), camera_before(CHART)
    frames = take_plan(camera, plan, BracketRequest(), deadline_s=10.0, clock=lambda: next(now))
    assert len(list(frames)) == taken
    alone = take_plan(camera, ExposurePlan((1.0,)), BracketRequest(), deadline_s=0.1, clock=lambda: 0.0)
    assert len(list(alone)) == 1


@pytest.mark.parametrize(
    ("limit_s", "third_s", "taken"), [(10.0, 23.9, 3), (10.0, 24.1, 2), (0.1, 9.14, 3), (0.1, 9.16, 2)]
)
def test_the_deadline_leaves_ten_seconds_and_half_the_time(limit_s, third_s, taken):
    """Of 10 s: 25 s; of 0.1 s: 10.15 s. A third frame of a second has to begin a second before."""
    now = iter((0.0, 1.0, third_s))
    plan = ExposurePlan((1.0, 1.0, 1.0))
    frames = take_plan(camera_before(CHART), plan, BracketRequest(time_limit_s=limit_s), clock=lambda: next(now))
    assert len(list(frames)) == taken


@pytest.mark.parametrize("target", [1e-3, 1e-6])
def test_repeats_stay_within_the_time(target):
    """However sure the mean is to be, whole passes end within the limit, and it is stated where more were requested."""
    camera = camera_before({"kind": "uniform", "radiance_W_per_sr_m2": 0.3})
    plan = plan_for_scene(camera, BracketRequest(target_u_rel=target, time_limit_s=0.4))
    assert plan.total_s <= 0.4
    assert plan.cut_short is (target == 1e-6)
