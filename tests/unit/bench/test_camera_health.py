"""Health of a camera and the frames that an instrument takes."""

import re
from dataclasses import replace

import numpy as np
import pytest

from radiometer.bench.assembly import require_absolute
from radiometer.bench.doctor import check_camera, check_dark_level, check_linearity, check_temperature
from radiometer.bench.instrument import Instrument
from radiometer.data import BlackLevel, Calibration, Flag, LensDescription, Patch, Scale, SensorNoise
from radiometer.devices import CameraCapabilities, CameraPreset, CameraSettings, Health
from radiometer.errors import CalibrationError
from simulators.cameras.simulated_camera import SimulatedCamera, default_limits
from simulators.chain.camera_model import CameraModel
from simulators.scenes import scene_from_mapping
from testing.relative_scale import relative_calibration


class UnevenCamera(SimulatedCamera):
    """A camera whose pixels have offsets of 0 to 30 DN of their own, the same in all frames."""

    def capture(self, count=1):
        return [
            replace(f, dn=f.dn + np.arange(f.dn.size, dtype=np.uint16).reshape(f.dn.shape) % 31)
            for f in super().capture(count)
        ]


class BentCamera(SimulatedCamera):
    """A camera whose digital numbers are bent by a gamma of 0.9."""

    def capture(self, count=1):
        frames = super().capture(count)
        return [replace(f, dn=np.rint(4095 * (f.dn / 4095) ** 0.9).astype(np.uint16)) for f in frames]


def camera(kind=SimulatedCamera, radiance=0.3, temperature_c=40.0):
    model = CameraModel.ideal(CameraPreset.shipped("BFS-U3-19S4M").camera, LensDescription(f_number=4.0))
    scene = scene_from_mapping({"kind": "uniform", "radiance_W_per_sr_m2": radiance})
    limits = replace(default_limits(), width=80, height=60)
    return kind(model, scene, limits=limits, temperature_c=temperature_c)


@pytest.mark.parametrize("radiance", [0.03, 0.3, 3.0])
def test_a_sound_camera_has_no_warning(radiance):
    """An ideal camera passes every check, also where its exposure is too short or clips to begin with."""
    with camera(radiance=radiance) as sound:
        sound.configure(CameraSettings(0.01, black_level_dn=64))
        assert {finding.health for finding in check_camera(sound)} == {Health.OK}


@pytest.mark.parametrize(
    ("made", "black_dn", "check", "health", "words"),
    [
        ({"kind": BentCamera}, 0, lambda c: check_linearity(c, 0.0), Health.WARNING, "gives 0.535"),  # 0.5**0.9
        ({"radiance": 1e-9}, 64, lambda c: check_linearity(c, 64.0), Health.NOTE, "light"),
        ({}, 0, lambda c: check_dark_level(c)[0], Health.WARNING, "raise the black level"),
        ({}, 64, check_temperature, Health.OK, ""),
        ({"temperature_c": 75.0}, 64, check_temperature, Health.WARNING, ""),
    ],
    ids=["gamma", "too dark to judge", "noise cut off at zero", "warm", "above 65 °C"],
)
def test_what_ails_a_camera_is_found(made, black_dn, check, health, words):
    """Half the exposure gives not half the signal, light shows nothing, dark noise is cut off, heat: with the cure."""
    with camera(**made) as examined:
        examined.configure(CameraSettings(0.01, black_level_dn=black_dn))
        finding = check(examined)
    assert finding.health is health
    assert words in f"{finding.message} {finding.cure}"
    assert finding.cure or health is not Health.NOTE


def test_the_dark_level_is_measured_with_the_shutter_closed():
    """The dark level is that of closed frames, to the noise of their mean; offsets of pixels (15 DN) are no noise."""
    with camera(UnevenCamera, radiance=10.0) as lit:
        lit.configure(CameraSettings(0.01, black_level_dn=64))
        found, level_dn = check_dark_level(lit)
    noise_dn = np.sqrt(SensorNoise.of(lit.description).variance_dn2(0.0, 0.0))
    assert level_dn == pytest.approx(79.0, abs=5 * noise_dn / np.sqrt(2 * 80 * 60) + 0.01)
    told = re.search(r"noise ([\d.]+) DN", found.message)
    assert told is not None
    assert float(told[1]) == pytest.approx(noise_dn, rel=5 / np.sqrt(2 * 80 * 60))


LENS = LensDescription(focal_length_mm=16, f_number=4.0, transmittance=0.95, vignetting="cos4")


def instrument(scene, *, shutter, **more):
    """Return an instrument with a small simulated camera; its calibration is of 1 J/m² per unit."""
    limits = CameraCapabilities((11e-6, 30.0), (0.0, 47.9), (0.0, 511.0), ("Mono12",), 48, 40, True, shutter)
    model = CameraModel.ideal(CameraPreset.shipped("BFS-U3-19S4M").camera, LENS)
    camera = SimulatedCamera(model, scene_from_mapping(scene), seed=3, limits=limits)
    camera.open()
    camera.configure(CameraSettings(0.01, black_level_dn=64.0))
    scale = Scale(value=1.0, u_rel=0.0, method="known_radiance", f_number=4.0)
    noise = SensorNoise.of(camera.description)
    calibration = Calibration(camera.description, LENS, scale, None, noise, BlackLevel(dn=64.0))
    return Instrument(camera, Patch(18, 14, 12, 12), calibration, clock=camera.clock.now_s, **more)


DIM = {"kind": "uniform", "radiance_W_per_sr_m2": 2e-4}

BRIGHT = {"kind": "uniform", "radiance_W_per_sr_m2": 1.0}


@pytest.mark.parametrize(("scene", "shutter", "dark"), [(DIM, True, True), (DIM, False, False), (BRIGHT, True, False)])
def test_dark_frames_are_taken_where_they_matter_and_can_be_had(scene, shutter, dark):
    """A dim patch with a shutter: two at each exposure; a bright one, or without a shutter, none."""
    taken = instrument(scene, shutter=shutter, time_limit_s=6.0).take_bracket()
    exposures = {frame.settings.exposure_s for frame in taken.light}
    assert sorted(f.settings.exposure_s for f in taken.dark) == (sorted([*exposures] * 2) if dark else [])


def test_dark_frames_take_the_data_sheet_s_doubt_away():
    """Read with dark frames, the dim patch is no longer flagged for its dark level."""
    without, shuttered = (instrument(DIM, shutter=shutter, time_limit_s=6.0).measure() for shutter in (False, True))
    assert Flag.DARK_ASSUMED in without.flags
    assert Flag.DARK_ASSUMED not in shuttered.flags


def test_a_cap_is_asked_for_and_taken_off_again():
    """By hand, whatever the light: covered once, uncovered once, dark frames in the bracket."""
    asked = []
    taken = replace(instrument(BRIGHT, shutter=False), cover=asked.append).take_bracket()
    assert asked == [True, False]
    assert taken.dark


def test_a_surround_that_clips_is_looked_at_in_shorter_frames():
    """The patch is 100 times dimmer than what is around it: the reading knows by how much, and says so."""
    scene = {
        "kind": "screen",
        "peak_radiance_W_per_sr_m2": 1.0,
        "gamma": 1.0,
        "background": 1.0,
        "patches": [{"name": "dim", "x": 12, "y": 8, "width": 24, "height": 24, "drive": 0.01}],
    }
    found = instrument(scene, shutter=False).measure()
    assert Flag.STRAY_LIGHT in found.flags
    stray = next(line for line in found.budget if line.name == "stray light")
    assert stray.u_rel == pytest.approx(7.5e-3 * (0.7 * 100 + 0.3 - 1), rel=0.05)


def test_a_radiance_needs_an_absolute_scale():
    """Neither none nor a relative one is taken."""
    described = CameraPreset.shipped("BFS-U3-19S4M").camera
    for known in (None, relative_calibration(described, SensorNoise.of(described))):
        with pytest.raises(CalibrationError, match="no absolute calibration"):
            require_absolute(known)
