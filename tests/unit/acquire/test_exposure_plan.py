"""Plans of exposures, of captures and of a characterisation."""

import math
from dataclasses import replace

import numpy as np
import pytest
import yaml
from hypothesis import example, given, settings
from hypothesis import strategies as st

from radiometer.acquire.capture_plan import CapturePlan, take_capture_plan
from radiometer.acquire.characterisation_ladder import LadderRequest, saturating_exposure_s, take_ladder
from radiometer.acquire.exposure_plan import ExposurePlan, ExposureWindow, exposure_ladder, plan_exposures, repeats_for
from radiometer.cli.main import run
from radiometer.data import CameraDescription, LensDescription, Patch
from radiometer.devices import CameraPreset, CameraSettings
from radiometer.errors import MeasurementError, UsageError
from simulators.cameras.simulated_camera import SimulatedCamera, default_limits
from simulators.chain.camera_model import CameraModel
from simulators.scenes import UniformScene
from simulators.scenes.kinds import scene_from_mapping

CAMERA = CameraDescription(bit_depth=12, conversion_gain_e_per_dn=2.6, read_noise_e=2.4, full_well_e=10500)

LIMITS_S = (11e-6, 30.0)

WINDOW = ExposureWindow.of(CAMERA, 0.0, 64.0)


def cover_of(rates, exposures, gain_db=0.0):
    """Count in how many exposures each rate, amplified by hand, lies inside the window of a gain."""
    window = ExposureWindow.of(CAMERA, gain_db, 64.0)
    signal = np.multiply.outer(np.asarray(exposures), rates * 10 ** (gain_db / 20))
    return ((signal >= window.lowest_dn) & (signal <= window.highest_dn * (1 + 1e-6))).sum(axis=0)


def test_the_window_begins_where_signal_over_noise_reaches_its_minimum():
    """From the least signal-to-noise ratio by the photon-transfer law to the earlier of full well and converter."""
    electrons = WINDOW.lowest_dn * 2.6
    noise_e = math.sqrt(electrons + 2.4**2 + 2.6**2 / 12)
    assert electrons / noise_e == pytest.approx(10.0, rel=1e-9)
    assert WINDOW.highest_dn == pytest.approx(0.88 * min(4095 - 64, WINDOW.clipping_dn))
    small = CAMERA.model_copy(update={"full_well_e": 2600.0})
    assert ExposureWindow.of(small, 0.0, 64.0).clipping_dn == pytest.approx(1000.0)
    assert ExposureWindow.of(CAMERA, 20.0, 64.0).clipping_dn == pytest.approx(4095 - 64)


@settings(deadline=None, max_examples=200)
@example([14.7421875, 14.74609375], 0.0)
@given(st.lists(st.floats(math.log(30.0), math.log(3e6)), min_size=1, max_size=40), st.sampled_from([0.0, 6.0, 20.0]))
def test_every_reachable_pixel_is_well_exposed_twice(log_rates, gain_db):
    """Whatever scene and gain, each pixel is between noise floor and clipping in at least two exposures."""
    rates = np.exp(np.array(log_rates))
    plan = plan_exposures(rates, ExposureWindow.of(CAMERA, gain_db, 64.0), gain_db, LIMITS_S)
    assert plan.too_bright == 0
    assert plan.too_dark == 0
    assert cover_of(rates, plan.exposures_s, gain_db).min() >= 2


def test_the_plan_holds_no_frame_that_could_be_left_out():
    """Taking away any one exposure leaves some pixel with less than two."""
    rates = np.geomspace(100.0, 1e7, 500)
    plan = plan_exposures(rates, WINDOW, 0.0, LIMITS_S)
    for left_out in range(len(plan.exposures_s)):
        rest = [t for k, t in enumerate(plan.exposures_s) if k != left_out]
        assert cover_of(rates, rest).min() < 2


def test_two_separate_brightnesses_need_no_exposures_between():
    """Two brightnesses need no exposures between; those taken are far enough apart to teach the response."""
    plan = plan_exposures(np.array([100.0, 1e7]), WINDOW, 0.0, LIMITS_S)
    assert len(plan.exposures_s) == 4
    exposures = plan_exposures(np.geomspace(100.0, 1e7, 500), WINDOW, 0.0, LIMITS_S).exposures_s
    assert np.diff(np.log2(exposures)).min() >= 0.5 - 1e-9


def test_unreachable_pixels_are_counted_and_do_not_hold_up_the_rest():
    """Pixels beyond the limits are reported by number; a plan takes no longer than permitted, or says it was cut."""
    rates = np.array([1e12, 1e12, 1000.0, 1e-3, 0.0, np.inf])
    plan = plan_exposures(rates, WINDOW, 0.0, LIMITS_S)
    assert plan.too_bright == 3
    assert plan.too_dark == 2
    assert cover_of(np.array([1000.0]), plan.exposures_s)[0] == 2
    rates = np.geomspace(20.0, 1e6, 100)
    whole = plan_exposures(rates, WINDOW, 0.0, LIMITS_S)
    cut = plan_exposures(rates, WINDOW, 0.0, LIMITS_S, time_limit_s=whole.total_s / 3)
    assert whole.cut_short is False
    assert cut.cut_short is True
    assert cut.total_s <= whole.total_s / 3


def test_repeats_count_gain_and_pixels():
    """Information by hand from the photon-transfer law at 12 dB; exposures that clip tell nothing of a mean."""
    factor = 10 ** (12 / 20)
    rates = np.full(100, 1000.0)
    plan = plan_exposures(rates, ExposureWindow.of(CAMERA, 12.0, 64.0), 12.0, LIMITS_S)
    signal_e = 1000.0 * 2.6 * np.array(plan.exposures_s)
    noise_e2 = signal_e + 2.4**2 + (2.6 / factor) ** 2 / 12
    expected = math.ceil(1.0 / ((signal_e**2 / noise_e2).sum() * 100 * 1e-5**2))
    assert repeats_for(plan, rates, CAMERA, 12.0, 1e-5) == expected
    with pytest.raises(UsageError, match="more than a day"):
        repeats_for(plan, rates, CAMERA, 12.0, 1e-9)
    rates = np.full(10, 1e4)
    short, both = ExposurePlan((0.1,)), ExposurePlan((0.1, 100.0))
    assert repeats_for(short, rates, CAMERA, 0.0, 1e-3) > 1
    assert repeats_for(both, rates, CAMERA, 0.0, 1e-3) == repeats_for(short, rates, CAMERA, 0.0, 1e-3)
    above, both = CAMERA.model_copy(update={"black_level_dn": 2000.0}), ExposurePlan((0.1, 0.25))
    assert repeats_for(both, rates, above, 0.0, 1e-3) == repeats_for(short, rates, above, 0.0, 1e-3)  # 2500 above 2000
    assert repeats_for(both, rates, CAMERA, 0.0, 1e-3) < repeats_for(short, rates, CAMERA, 0.0, 1e-3)


@pytest.mark.parametrize(("end_ms", "steps_ms"), [(8.0, (1.0, 2.0, 4.0, 8.0)), (10.0, (1.0, 2.0, 4.0, 8.0, 10.0))])
def test_a_ladder_has_the_ends_and_the_steps_asked_for(end_ms, steps_ms):
    """Whole stops from 1 ms on; where they do not meet the end, the last step is the smaller one."""
    found = exposure_ladder(1e-3, 1e-3 * end_ms, 1.0, LIMITS_S).exposures_s
    assert found == pytest.approx([1e-3 * step for step in steps_ms])


@pytest.mark.parametrize(("low", "high", "stops"), [(0.1, 0.01, 1.0), (0.01, 0.1, 0.0), (0.01, 0.1, -1.0)])
def test_a_ladder_that_makes_no_sense_is_misuse(low, high, stops):
    """Ends the wrong way round or steps not above 0."""
    with pytest.raises(UsageError):
        exposure_ladder(low, high, stops, LIMITS_S)


@settings(max_examples=30, deadline=None)
@given(
    bits=st.integers(8, 16),
    gain_e=st.floats(0.05, 20.0),
    read_e=st.floats(0.5, 60.0),
    well_e=st.floats(50.0, 1e5),
    gain_db=st.floats(0.0, 24.0),
)
@example(bits=8, gain_e=0.5, read_e=30.0, well_e=100.0, gain_db=0.0)
def test_every_camera_has_an_octave_to_expose_in(bits, gain_e, read_e, well_e, gain_db):
    """However noisy and shallow: the brightest well exposed pixel is at least twice as bright as the darkest."""
    camera = CameraDescription(bit_depth=bits, conversion_gain_e_per_dn=gain_e, read_noise_e=read_e, full_well_e=well_e)
    window = ExposureWindow.of(camera, gain_db, 8.0)
    assert 0.0 < 2.0 * window.lowest_dn <= window.highest_dn * (1 + 1e-12)
    assert window.highest_dn < window.clipping_dn


PLAN = {
    "format": "radiometer-plan/1",
    "reasons": ["separates exposure_time_offset from parasitic_light_sensitivity"],
    "frames": [
        {"exposure_s": 0.01, "gain_db": 6.0, "repeat": 2},
        {"exposure_s": 0.02, "shutter": "closed", "repeat": 1},
        {"exposure_s": 0.04, "source_level": 0.5, "f_number": 8.0},
    ],
}


@pytest.fixture
def plan_file(tmp_path):
    """Return a function that writes a plan."""

    def write(**changes):
        path = tmp_path / "plan.yaml"
        path.write_text(yaml.safe_dump({**PLAN, **changes}))
        return path

    return write


def small_camera():
    preset = CameraPreset.shipped("BFS-U3-19S4M").camera
    model = CameraModel.ideal(preset, LensDescription(focal_length_mm=16, f_number=4.0))
    limits = replace(default_limits(), width=40, height=30)
    return SimulatedCamera(model, scene_from_mapping({"kind": "uniform", "radiance_W_per_sr_m2": 0.1}), limits=limits)


def test_every_frame_is_staged_and_set_as_planned():
    """Each entry is staged once before its frames, which have its exposure, gain, level, shutter and number."""
    planned, staged = CapturePlan.model_validate(PLAN), []
    with small_camera() as camera:
        frames = [frame.settings for frame in take_capture_plan(camera, planned, staged.append)]
    assert [one.exposure_s for one in staged] == [0.01, 0.02, 0.04]
    assert (planned.total, [s.exposure_s for s in frames]) == (4, pytest.approx([0.01, 0.01, 0.02, 0.04], rel=1e-3))
    assert [s.gain_db for s in frames] == pytest.approx([6.0, 6.0, 0.0, 0.0])
    assert [s.shutter for s in frames] == ["open", "open", "closed", "open"]
    assert [s.source_level for s in frames] == [1.0, 1.0, 1.0, 0.5]
    assert frames[3].f_number == 8.0, "of a lens set by hand, which the camera does not know"


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"frames": []}, "frames"),
        ({"frames": [{"exposure_s": -1}]}, "exposure_s = -1"),
        ({"format": "radiometer-plan/7"}, "radiometer-plan/7"),
    ],
)
def test_a_wrong_plan_is_misuse(plan_file, tmp_path, capsys, changes, message):
    """Key and value are named; nothing is written."""
    assert run(["bracket", str(tmp_path / "out"), "--plan", str(plan_file(**changes))]) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


REGION = Patch(8, 8, 32, 24)


def _camera(radiance: float) -> SimulatedCamera:
    preset = CameraPreset.shipped("BFS-U3-19S4M")
    limits = replace(preset.require_limits("test").capabilities(has_shutter=True), width=64, height=48)
    model = CameraModel.ideal(preset.camera, LensDescription(f_number=4.0))
    camera = SimulatedCamera(model, UniformScene(radiance_W_per_sr_m2=radiance), limits=limits)
    camera.open()
    camera.configure(CameraSettings(exposure_s=0.01, black_level_dn=64.0))
    return camera


@pytest.mark.parametrize("radiance", [1e-3, 0.3, 50.0])
def test_saturating_exposure_is_found_over_decades(radiance: float) -> None:
    """4031 DN above black are reached at 4031·5.95 e- over the photocurrent, within the noise of the region."""
    camera = _camera(radiance)
    per_s = 0.62 * 3.141592653589793 * radiance / 64 * (4.5e-6) ** 2 / (6.62607015e-34 * 299_792_458.0 / 550e-9)
    assert saturating_exposure_s(camera, REGION) == pytest.approx(4031 * 5.95 / (per_s + 4.42), rel=2e-3)


@pytest.mark.parametrize(("radiance", "word"), [(1e-7, "dim"), (1e6, "bright")])
def test_light_that_cannot_saturate_is_refused(radiance: float, word: str) -> None:
    """The message says which way the light is wrong."""
    with pytest.raises(MeasurementError, match=f"too {word}"):
        saturating_exposure_s(_camera(radiance), REGION)


def test_ladder_takes_pairs_a_stack_and_the_same_darks() -> None:
    """Pairs cross saturation, darks repeat the exposures and add 1, 2 and 4 s unless others are asked for."""
    camera = _camera(0.3)
    request = LadderRequest(REGION, steps=9, stack=4, dark_exposures_s=(1.0,))
    frames = list(take_ladder(camera, request))
    bright = [f for f in frames if not f.settings.is_dark]
    dark = [f for f in frames if f.settings.is_dark]
    assert len(frames) == request.frames()
    assert {f.settings.exposure_s for f in dark} == {f.settings.exposure_s for f in bright} | {1.0}
    assert max(f.dn[REGION.slices].min() for f in bright) == 4095
    assert not camera.capture()[0].settings.is_dark
    camera = _camera(0.3)
    frames = list(take_ladder(camera, LadderRequest(REGION, steps=6, stack=3)))
    long = [f.settings.exposure_s for f in frames if f.settings.exposure_s > 0.5]
    assert long == pytest.approx([1.0, 1.0, 2.0, 2.0, 4.0, 4.0], rel=1e-3)
    assert len(frames) == LadderRequest(REGION, steps=6, stack=3).frames()


def test_shutter_by_hand_is_asked_for_and_given_back() -> None:
    """Where a callback closes the shutter it is asked to open it again, even when taking stops midway."""
    camera, asked = _camera(0.3), list[bool]()

    def ask(closed: bool) -> None:
        asked.append(closed)
        camera.set_shutter(closed=closed)

    frames = take_ladder(camera, LadderRequest(REGION, steps=6, stack=3), ask)
    for frame in frames:
        if frame.settings.is_dark:
            break
    frames.close()  # type: ignore[attr-defined]
    assert asked == [True, False]


def test_two_thirds_of_the_ladder_rise_evenly_and_a_third_passes_through_saturation() -> None:
    """Of nine steps six run from 2 to 88 % of the saturating exposure and three from 90 to 108 %; the stack at 50 %."""
    camera = _camera(0.3)
    saturating_s = saturating_exposure_s(camera, REGION)
    request = LadderRequest(REGION, steps=9, stack=4)
    bright = [f.settings.exposure_s for f in take_ladder(camera, request) if not f.settings.is_dark]
    ladder, stack = bright[:-4], bright[-4:]
    shares = [0.02, 0.192, 0.364, 0.536, 0.708, 0.88, 0.90, 0.99, 1.08]
    twice = [share * saturating_s for share in shares for _ in range(2)]
    assert ladder == pytest.approx(twice, rel=0.01)
    assert stack == pytest.approx([0.5 * saturating_s] * 4, rel=0.01)


def test_a_region_beyond_the_frame_is_refused() -> None:
    """One that ends with the frame is taken; a pixel further it does not lie on its 64 × 48 pixels."""
    camera = _camera(0.3)
    assert saturating_exposure_s(camera, Patch(56, 40, 8, 8)) > 0.0
    for region in (Patch(57, 40, 8, 8), Patch(56, 41, 8, 8)):
        with pytest.raises(MeasurementError, match="64 × 48 pixels"):
            saturating_exposure_s(camera, region)
