"""The simulated camera, in simulated time, and the simulated Blackfly: features, pictures, packed pixels."""

import re
import time
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest

from radiometer.data import CaptureSet, FrameSettings, LensDescription
from radiometer.devices import CameraCapabilities, CameraPreset, CameraSettings, Roi
from radiometer.errors import ConfigurationError, DeviceError, SettingOutOfRange
from simulators.cameras.blackfly_awkward import CHUNK_IDS, awkward_features
from simulators.cameras.blackfly_features import WIRE_FORMATS, blackfly_features, genicam_xml, pack_pixels
from simulators.cameras.blackfly_gige import (
    ForwardModelSource,
    PictureRequest,
    PooledSource,
    gamma_corrected,
    sharpened,
    steered,
)
from simulators.cameras.simulated_camera import SimulatedCamera, default_limits
from simulators.chain.camera_model import CameraModel, VirtualSensor
from simulators.scenes import StepChartScene, Steps, UniformScene
from simulators.scenes.kinds import scene_from_mapping
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


def test_a_region_is_the_same_part_of_the_whole_frame(model, limits):
    """What the whole sensor would have shown there, pixel by pixel."""
    chart = StepChartScene(steps=Steps(count=6, lowest=0.01, highest=1.0))
    roi = Roi(10, 5, 20, 30)
    frames = []
    for region in (None, roi):
        with SimulatedCamera(model, chart, limits=limits, seed=4) as camera:
            camera.configure(replace(SETTINGS, roi=region))
            frames.append(camera.capture()[0].dn)
    assert np.array_equal(frames[1], frames[0][5:35, 10:30])
    whole = ForwardModelSource(sensor())(REQUEST)
    part = ForwardModelSource(sensor())(replace(REQUEST, x=8, y=4, width=16, height=10))
    np.testing.assert_array_equal(part, whole[4:14, 8:24])


def test_closed_shutters_and_binning_change_the_light(camera):
    """Dark frames say so; 2 × 2 collects four times the electrons."""
    with camera:
        camera.configure(SETTINGS)
        single = camera.capture()[0].dn
        camera.configure(replace(SETTINGS, binning=2))
        binned = camera.capture()[0].dn
    assert binned.shape == (24, 32)
    signal = 4 * (single.mean() - 64)
    sigma = np.sqrt(signal / 5.95 / binned.size) * np.sqrt(2)
    assert binned.mean() - 64 == pytest.approx(signal, abs=4 * max(sigma, 0.5))
    with camera:
        camera.configure(SETTINGS)
        camera.set_shutter(closed=True)
        frame = camera.capture()[0]
    assert frame.settings.is_dark
    assert frame.dn.mean() == pytest.approx(64.0, abs=4 * np.sqrt((5.4 / 5.95) ** 2 + 1 / 12) / np.sqrt(frame.dn.size))


def test_a_camera_refuses_what_it_does_not_have(model, limits, camera):
    """A shutter that is not there, an unknown pattern or level, with the way out."""
    camera = SimulatedCamera(model, UniformScene(), limits=replace(limits, has_shutter=False))
    with camera, pytest.raises(DeviceError, match="cover the lens"):
        camera.set_shutter(closed=True)
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


# The simulated Blackfly: features, pictures, packed pixels.


REQUEST = PictureRequest(
    exposure_s=0.01,
    gain_db=0.0,
    black_level_dn=64.0,
    bit_depth=12,
    temperature_c=40.0,
    source_level=1.0,
    is_shutter_closed=False,
    binning=1,
    x=0,
    y=0,
    width=64,
    height=48,
)


def sensor() -> VirtualSensor:
    model = CameraModel.ideal(CameraPreset.shipped("BFS-U3-19S4M").camera, LensDescription(f_number=4.0))
    return VirtualSensor(model, scene_from_mapping({"kind": "uniform", "radiance_W_per_sr_m2": 0.2}), 64, 48, seed=5)


def test_a_shutter_and_a_drive_change_the_light_alone():
    """Only black and dark signal remain; half the drive is half the signal within 5 sigma."""
    dark = ForwardModelSource(sensor())(replace(REQUEST, is_shutter_closed=True))
    sigma = np.hypot(5.4 / 5.95, 0.29) / np.sqrt(dark.size)
    assert dark.mean() == pytest.approx(64.0, abs=5 * sigma + 0.01)  # dark signal: 0.04 e⁻
    full = ForwardModelSource(sensor())(REQUEST).mean() - 64
    half = ForwardModelSource(sensor())(replace(REQUEST, source_level=0.5)).mean() - 64
    assert half / full == pytest.approx(0.5, abs=5 * 0.75 / np.sqrt(full * 5.95 * 64 * 48))


def test_a_pool_is_drawn_anew_when_settings_change():
    """A pool repeats its frames under one setting, and never shows a frame of another."""
    made = []

    def source(request: PictureRequest) -> np.ndarray:
        made.append(request)
        return np.full((2, 2), len(made), np.uint16)

    pooled = PooledSource(source, 2)
    assert [int(pooled(REQUEST)[0, 0]) for _ in range(5)] == [1, 2, 1, 2, 1]
    assert int(pooled(replace(REQUEST, exposure_s=0.02))[0, 0]) == 3


def test_processing_bends_sharpens_and_exposes():
    """Gamma keeps black and white; an edge overshoots; automatic exposure moves by two at most."""
    bent = gamma_corrected(np.array([0, 1024, 4095], np.uint16), 0.5, 4095)
    assert bent.tolist() == [0, round(4095 * (1024 / 4095) ** 0.5), 4095]
    edge = np.repeat(np.array([[100] * 4 + [200] * 4], np.uint16), 6, axis=0)
    crisp = sharpened(edge, 4095)
    assert crisp[3, 3] < 100
    assert crisp[3, 4] > 200
    assert crisp[3, 0] == 100
    assert steered(0.01, 1000, 4095, 1e-5, 30) == pytest.approx(0.02)
    assert steered(0.01, 4000, 4095, 1e-5, 30) == pytest.approx(0.01 * 0.5 * 4095 / 4000)
    assert steered(20.0, 10, 4095, 1e-5, 30) == 30


NAMESPACE = "{http://www.genicam.org/GenApi/Version_1_0}"


@pytest.fixture
def features():
    """Return the features of a simulated Blackfly with the limits of its preset."""
    return blackfly_features(default_limits(), 12, 40.0)


def test_the_register_map_is_sound(features):
    """No two registers overlap, every node referred to exists, limits are the preset's."""
    taken: dict[int, str] = {}
    for feature in features:
        if feature.kind in ("formula", "string") or feature.name in {"BinningVertical", "AcquisitionStop"}:
            continue
        for byte in range(feature.address, feature.address + (8 if feature.kind == "float" else 4)):
            assert byte not in taken, f"{feature.name} overlaps {taken[byte]}"
            assert byte < 0x10000
            taken[byte] = feature.name
    root = ElementTree.fromstring(genicam_xml(features, "FLIR", "BFS-U3-19S4M"))
    names = {node.get("Name") for node in root}
    for node in root.iter():
        if node.tag.removeprefix(NAMESPACE) in ("pValue", "pMin", "pMax", "pFeature", "pVariable", "pPort"):
            assert node.text in names
    by_name = {feature.name: feature for feature in features}
    assert by_name["ExposureTime"].minimum == pytest.approx(11.0)
    assert by_name["ExposureTime"].maximum == pytest.approx(30e6)
    assert by_name["Gain"].maximum == 47.9943
    assert by_name["BlackLevel"].maximum == pytest.approx(511 / 4095 * 100)


@pytest.mark.parametrize("make", [blackfly_features, awkward_features], ids=["plain", "awkward"])
def test_names_units_and_kinds_are_those_of_the_real_camera(make, shared_data):
    """Each feature that is not the simulator's own is named and typed as in FLIR's description of the twin."""
    features = make(default_limits(), 12, 40.0)
    text = (shared_data / "genicam" / "FLIR_BFS_PGE_19S4M.xml").read_text(encoding="utf-8", errors="replace")
    tags = {"float": "Float", "integer": "Integer", "boolean": "Boolean", "enumeration": "Enumeration"}
    absent = []
    for feature in features:
        if feature.category in ("", "SimulatorControl") or feature.kind not in tags:
            continue
        node = re.search(rf'<{tags[feature.kind]} Name="{feature.name}".*?</{tags[feature.kind]}>', text, re.DOTALL)
        if node is None:
            absent.append(feature.name)
        elif feature.unit:
            assert f"<Unit>{feature.unit}</Unit>" in node.group(0), feature.name
    assert absent == []


def test_chunks_and_formats_are_those_of_the_standards(shared_data):
    """FLIR's identifiers and order; low bytes first; nibbles in the middle byte."""
    text = (shared_data / "genicam" / "FLIR_BFS_PGE_19S4M.xml").read_text(encoding="utf-8", errors="replace")
    features = {feature.name: feature for feature in awkward_features(default_limits(), 12, 40.0)}
    for name, number in CHUNK_IDS.items():
        port = re.search(rf'<Port Name="{name}Port".*?<ChunkID>(\w+)</ChunkID>', text, re.DOTALL)
        assert int(port.group(1), 16) == number
        assert f"<Formula>{features[f'Chunk{name}'].formula}</Formula>" in text
    assert re.search(r'<IntReg Name="ChunkExposureTime_Val">.*?<Endianess>LittleEndian</Endianess>', text, re.DOTALL)
    assert pack_pixels(np.array([[0x0102]], np.uint16), "Mono16") == b"\x02\x01"
    assert pack_pixels(np.array([0xABC, 0x123], np.uint16), "Mono12Packed") == bytes([0xAB, 0x3C, 0x12])
    for number, name, message in ((4096, "Mono12p", "4096 DN do not fit Mono12p"), (0, "RGB8Packed", "Mono12p")):
        with pytest.raises(ConfigurationError, match=message):
            pack_pixels(np.array([number], np.uint16), name)


@pytest.mark.parametrize("name", ["Mono10p", "Mono12p"])
@pytest.mark.parametrize("count", [8, 7])
def test_a_bit_stream_holds_the_pixels_lowest_bit_first(name, count):
    """Read as one whole number, the payload has pixel n at bit n × depth (PFNC 2.1)."""
    bits = WIRE_FORMATS[name].bit_depth
    values = np.random.default_rng(1).integers(0, 1 << bits, count).astype(np.uint16)
    payload = pack_pixels(values, name)
    stream = int.from_bytes(payload, "little")
    assert [stream >> bits * n & (1 << bits) - 1 for n in range(count)] == values.tolist()
    assert len(payload) == -(-count * bits // 8)
