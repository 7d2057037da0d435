"""The simulated camera: a Camera like any other, in simulated time."""

from __future__ import annotations

import itertools
import time
from dataclasses import replace

import numpy as np
import pytest

from radiometer.data import CaptureSet, FrameSettings, LensDescription
from radiometer.devices import Camera, CameraCapabilities, CameraPreset, CameraSettings, Roi
from radiometer.errors import ConfigurationError, DeviceError, DeviceInUse, SettingOutOfRange
from simulators.cameras.simulated_camera import SimulatedCamera
from simulators.chain.camera_model import CameraModel
from simulators.scenes import StepChartScene, Steps, UniformScene
from testing.patience import within
from testing.simulated_capture import simulate_capture

LENS = LensDescription(focal_length_mm=16, f_number=4.0)
SETTINGS = CameraSettings(exposure_s=0.004, black_level_dn=64.0)


@pytest.fixture
def limits() -> CameraCapabilities:
    limits = CameraPreset.shipped("BFS-U3-19S4M").require_limits("test").capabilities(has_shutter=True)
    return replace(limits, width=64, height=48)


@pytest.fixture
def model() -> CameraModel:
    return CameraModel.ideal(CameraPreset.shipped("BFS-U3-19S4M").camera, LENS)


@pytest.fixture
def camera(model: CameraModel, limits: CameraCapabilities) -> SimulatedCamera:
    return SimulatedCamera(model, UniformScene(radiance_W_per_sr_m2=0.1), limits=limits, seed=1)


def test_it_is_a_camera(camera):
    """It offers everything that the protocol asks for."""
    with camera:
        assert isinstance(camera, Camera)


def test_same_seed_gives_the_same_frames(model, limits):
    """Two cameras of one seed agree frame by frame; another seed differs; two frames of one camera differ."""

    def frames(seed: int) -> list[np.ndarray]:
        with SimulatedCamera(model, UniformScene(radiance_W_per_sr_m2=0.1), limits=limits, seed=seed) as camera:
            camera.configure(SETTINGS)
            return [frame.dn for frame in camera.capture(2)]

    first, again, other = frames(1), frames(1), frames(2)
    assert all(np.array_equal(a, b) for a, b in zip(first, again, strict=True))
    assert not np.array_equal(first[0], other[0])
    assert not np.array_equal(first[0], first[1])


def test_frames_carry_settings_temperature_and_simulated_time(camera):
    """Each frame says what it was taken with; 60 s of exposure pass without waiting."""
    started = time.monotonic()
    with camera:
        camera.configure(replace(SETTINGS, exposure_s=30.0, gain_db=6.0))
        camera.set_source(level=0.25)
        frames = camera.capture(2)
    assert time.monotonic() - started < within(10.0)
    settings = frames[1].settings
    assert (settings.exposure_s, settings.gain_db, settings.black_level_dn) == (30.0, 6.0, 64.0)
    assert (settings.temperature_c, settings.f_number, settings.source_level) == (40.0, 4.0, 0.25)
    assert settings.timestamp_s == pytest.approx(30.0)
    assert camera.clock.now_s() == pytest.approx(60.0)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"exposure_s": 31.0}, r"exposure time 31 s is out of range; allowed is 1\.1e-05 to 30 s"),
        ({"exposure_s": 1e-6}, r"exposure time 1e-06 s is out of range"),
        ({"gain_db": 48.0}, r"gain 48 dB is out of range; allowed is 0 to 47\.9943 dB"),
        ({"black_level_dn": 512.0}, r"black level 512 DN is out of range; allowed is 0 to 511 DN"),
        ({"pixel_format": "Mono8", "black_level_dn": 64.0}, r"black level 64 DN is out of range; allowed is 0 to 31"),
        ({"binning": 5}, r"binning 5 px is out of range; allowed is 1 to 4 px"),
        ({"roi": Roi(60, 0, 8, 8)}, r"ROI width 8 pixels is out of range; allowed is 1 to 4 pixels"),
        ({"roi": Roi(0, 99, 8, 8)}, r"ROI top 99 pixels is out of range; allowed is 0 to 47 pixels"),
    ],
)
def test_what_is_out_of_range_is_refused_and_nothing_changes(camera, change, message):
    """The message gives value, limits and unit; the settings in force stay."""
    with camera:
        before = camera.configure(SETTINGS)
        with pytest.raises(SettingOutOfRange, match=message):
            camera.configure(replace(SETTINGS, **change))  # type: ignore[arg-type]
        assert camera.settings == before


def test_unknown_pixel_format_is_refused_with_those_that_there_are(camera):
    """The message lists the formats."""
    with camera, pytest.raises(DeviceError, match=r"no pixel format 'BayerRG8'; it has Mono12, Mono8"):
        camera.configure(replace(SETTINGS, pixel_format="BayerRG8"))


@pytest.mark.parametrize(("name", "bits"), [("Mono8", 8), ("Mono10p", 10), ("Mono12p", 12), ("Mono16", 16)])
def test_each_pixel_format_shows_the_same_light_in_its_own_numbers(camera, name, bits):
    """Mean DN over gain and black level, as the description states them, give the same electrons in every format."""
    with camera:
        camera.configure(replace(SETTINGS, pixel_format=name, black_level_dn=64.0 * 2.0 ** (bits - 12)))
        frame = camera.capture()[0]
        described = camera.description
        native = camera.configure(SETTINGS)
        reference = camera.capture()[0]
    assert (frame.bit_depth, described.bit_depth) == (bits, bits)
    assert native.pixel_format == "Mono12"
    electrons = (frame.dn.mean() - (frame.settings.black_level_dn or 0)) * (described.conversion_gain_e_per_dn or 0)
    expected = (reference.dn.mean() - 64.0) * 5.95
    # Shot noise of 3072 pixels in both frames, and 1/12 DN² of rounding in the coarser one.
    step_e = described.conversion_gain_e_per_dn or 0.0
    sigma = np.sqrt(2 * (expected + 5.4**2 + step_e**2 / 12) / frame.dn.size)
    # Rounding is not blurred away where the noise is a fraction of a code: bias up to exp(−2π²σ²)/π codes.
    rounding_e = step_e * np.exp(-2 * np.pi**2 * (expected + 5.4**2) / step_e**2) / np.pi
    assert electrons == pytest.approx(expected, abs=4 * sigma + rounding_e)


def test_region_of_interest_is_the_same_part_of_the_whole_frame(model, limits):
    """A region shows what the whole sensor would have shown there."""
    chart = StepChartScene(steps=Steps(count=6, lowest=0.01, highest=1.0))
    roi = Roi(10, 5, 20, 30)
    frames = []
    for region in (None, roi):
        with SimulatedCamera(model, chart, limits=limits, seed=4) as camera:
            camera.configure(replace(SETTINGS, roi=region))
            frames.append(camera.capture()[0].dn)
    assert np.array_equal(frames[1], frames[0][5:35, 10:30])


def test_binning_sums_pixels(camera):
    """2 × 2 binning halves the size and collects four times the electrons."""
    with camera:
        camera.configure(SETTINGS)
        single = camera.capture()[0].dn
        camera.configure(replace(SETTINGS, binning=2))
        binned = camera.capture()[0].dn
    assert binned.shape == (24, 32)
    signal = 4 * (single.mean() - 64)
    sigma = np.sqrt(signal / 5.95 / binned.size) * np.sqrt(2)
    assert binned.mean() - 64 == pytest.approx(signal, abs=4 * max(sigma, 0.5))


def test_closed_shutter_gives_dark_frames(camera):
    """With the shutter closed the frame is dark and says so."""
    with camera:
        camera.configure(SETTINGS)
        camera.set_shutter(closed=True)
        frame = camera.capture()[0]
    assert frame.settings.is_dark
    assert frame.dn.mean() == pytest.approx(64.0, abs=4 * np.sqrt((5.4 / 5.95) ** 2 + 1 / 12) / np.sqrt(frame.dn.size))


def test_camera_without_shutter_says_what_to_do(model, limits):
    """Where there is no shutter the way out is named."""
    camera = SimulatedCamera(model, UniformScene(), limits=replace(limits, has_shutter=False))
    with camera, pytest.raises(DeviceError, match="cover the lens"):
        camera.set_shutter(closed=True)


def test_closed_camera_refuses_to_work(camera):
    """Without open() each call is refused; opening twice is, too; closing twice is not."""
    with pytest.raises(DeviceError, match="is not open"):
        camera.capture()
    with camera, pytest.raises(DeviceInUse, match="open already"):
        camera.open()
    camera.close()


def test_stream_yields_frames_until_closed(camera):
    """Frames come one after the other with rising numbers."""
    with camera:
        frames = list(itertools.islice(camera.stream(), 3))
    assert [frame.frame_id for frame in frames] == [0, 1, 2]


def test_unknown_pattern_and_level_are_refused(camera):
    """What the bench's source cannot do is stated at once."""
    with pytest.raises(ConfigurationError, match="no pattern 'x'; it shows default"):
        camera.set_source(pattern="x")
    with pytest.raises(SettingOutOfRange, match="source level 2"):
        camera.set_source(level=2.0)


def test_capture_set_of_a_plan_is_read_back_as_believed(model, tmp_path):
    """Settings, order, patches and the believed camera are in the header; frames hold the simulated numbers."""
    chart = StepChartScene(steps=Steps(count=6, lowest=0.01, highest=1.0), inverted=True)
    plan = [
        FrameSettings(exposure_s=0.001),
        FrameSettings(exposure_s=0.004, gain_db=6.0, pattern="inverted", source_level=0.5),
        FrameSettings(exposure_s=0.1, shutter="closed", temperature_c=25.0),
    ]
    written = simulate_capture(model, plan, chart, tmp_path / "set", frames_per_setting=2, seed=9)
    capture = CaptureSet.read(tmp_path / "set")
    assert capture.header == written.header
    assert [f.exposure_s for f in capture.header.frames] == [0.001, 0.001, 0.004, 0.004, 0.1, 0.1]
    assert capture.header.patterns == ("default", "inverted")
    assert capture.header.camera.conversion_gain_e_per_dn == 5.95
    assert [f.timestamp_s for f in capture.header.frames] == sorted(f.timestamp_s or 0 for f in capture.header.frames)
    bright = capture.read_frame(0).dn[capture.header.patches[5].patch.slices]
    assert bright.mean() > capture.read_frame(0).dn[capture.header.patches[0].patch.slices].mean() + 20
