"""The frames that a characterisation takes from a camera."""

from __future__ import annotations

from dataclasses import replace

import pytest

from radiometer.acquire.characterisation_ladder import LadderRequest, saturating_exposure_s, take_ladder
from radiometer.data import LensDescription, Patch
from radiometer.devices import CameraPreset, CameraSettings
from radiometer.errors import MeasurementError
from simulators.cameras.simulated_camera import SimulatedCamera
from simulators.chain.camera_model import CameraModel
from simulators.scenes import UniformScene

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
    """Bright pairs cross saturation; dark frames repeat the exposures and add the long ones; the shutter reopens."""
    camera = _camera(0.3)
    request = LadderRequest(REGION, steps=9, stack=4, dark_exposures_s=(1.0,))
    frames = list(take_ladder(camera, request))
    bright = [f for f in frames if not f.settings.is_dark]
    dark = [f for f in frames if f.settings.is_dark]
    assert len(frames) == request.frames()
    assert {f.settings.exposure_s for f in dark} == {f.settings.exposure_s for f in bright} | {1.0}
    assert max(f.dn[REGION.slices].min() for f in bright) == 4095
    assert not camera.capture()[0].settings.is_dark


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


def test_dark_frames_of_1_2_and_4_s_are_taken_besides() -> None:
    """Without a wish of one's own the dark current is determined by these, two each."""
    camera = _camera(0.3)
    frames = list(take_ladder(camera, LadderRequest(REGION, steps=6, stack=3)))
    long = [f.settings.exposure_s for f in frames if f.settings.exposure_s > 0.5]
    assert long == pytest.approx([1.0, 1.0, 2.0, 2.0, 4.0, 4.0], rel=1e-3)
    assert len(frames) == LadderRequest(REGION, steps=6, stack=3).frames()


def test_a_region_beyond_the_frame_is_refused() -> None:
    """One that ends with the frame is taken; a pixel further it does not lie on its 64 × 48 pixels."""
    camera = _camera(0.3)
    assert saturating_exposure_s(camera, Patch(56, 40, 8, 8)) > 0.0
    for region in (Patch(57, 40, 8, 8), Patch(56, 41, 8, 8)):
        with pytest.raises(MeasurementError, match="64 × 48 pixels"):
            saturating_exposure_s(camera, region)
