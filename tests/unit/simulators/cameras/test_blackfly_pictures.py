"""The simulated Blackfly: features, pictures, packed pixels."""

from __future__ import annotations

import re
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest

from radiometer.data import LensDescription
from radiometer.devices import CameraPreset
from radiometer.errors import ConfigurationError
from simulators.cameras.blackfly_awkward import CHUNK_IDS, awkward_features
from simulators.cameras.blackfly_features import blackfly_features
from simulators.cameras.blackfly_pictures import ForwardModelSource, PictureRequest, PooledSource
from simulators.cameras.blackfly_registers import gamma_corrected, sharpened, steered
from simulators.cameras.genicam_document import genicam_xml
from simulators.cameras.pixel_packing import WIRE_FORMATS, pack_pixels
from simulators.cameras.simulated_camera import default_limits
from simulators.chain.camera_model import CameraModel
from simulators.chain.virtual_sensor import VirtualSensor
from simulators.scenes.factory import scene_from_mapping

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


def test_a_region_is_the_whole_picture_cut():
    """A region of a frame holds the very pixels that the whole frame has there."""
    whole = ForwardModelSource(sensor())(REQUEST)
    part = ForwardModelSource(sensor())(replace(REQUEST, x=8, y=4, width=16, height=10))
    np.testing.assert_array_equal(part, whole[4:14, 8:24])


def test_a_closed_shutter_leaves_the_black_level():
    """With the shutter closed only black level and dark signal remain."""
    dark = ForwardModelSource(sensor())(replace(REQUEST, is_shutter_closed=True))
    sigma = np.hypot(5.4 / 5.95, 0.29) / np.sqrt(dark.size)
    assert dark.mean() == pytest.approx(64.0, abs=5 * sigma + 0.01)  # dark signal: 0.04 e⁻


def test_the_source_level_scales_the_light():
    """Half the drive gives half the signal, within 5 sigma of the means."""
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


def test_gamma_keeps_black_and_full_scale():
    """Gamma bends what lies between and leaves the ends."""
    bent = gamma_corrected(np.array([0, 1024, 4095], np.uint16), 0.5, 4095)
    assert bent.tolist() == [0, round(4095 * (1024 / 4095) ** 0.5), 4095]


def test_sharpening_steepens_an_edge_and_leaves_a_plane():
    """An edge overshoots; an even field stays."""
    edge = np.repeat(np.array([[100] * 4 + [200] * 4], np.uint16), 6, axis=0)
    crisp = sharpened(edge, 4095)
    assert crisp[3, 3] < 100
    assert crisp[3, 4] > 200
    assert crisp[3, 0] == 100


def test_automatic_exposure_moves_towards_half_of_full_scale():
    """Too dark lengthens, too bright shortens, by a factor of two at most and within the limits."""
    assert steered(0.01, 1000, 4095, 1e-5, 30) == pytest.approx(0.02)
    assert steered(0.01, 4000, 4095, 1e-5, 30) == pytest.approx(0.01 * 0.5 * 4095 / 4000)
    assert steered(20.0, 10, 4095, 1e-5, 30) == 30


NAMESPACE = "{http://www.genicam.org/GenApi/Version_1_0}"


@pytest.fixture
def features():
    """Return the features of a simulated Blackfly with the limits of its preset."""
    return blackfly_features(default_limits(), 12, 40.0)


def test_no_two_registers_overlap(features):
    """Every feature that is not an alias has bytes of its own, inside the device's memory."""
    taken: dict[int, str] = {}
    for feature in features:
        if feature.kind in ("formula", "string") or feature.name in {"BinningVertical", "AcquisitionStop"}:
            continue
        for byte in range(feature.address, feature.address + (8 if feature.kind == "float" else 4)):
            assert byte not in taken, f"{feature.name} overlaps {taken[byte]}"
            assert byte < 0x10000
            taken[byte] = feature.name


def test_every_node_that_is_referred_to_exists(features):
    """No pValue, pMax, pFeature or variable points to a node that is not there."""
    root = ElementTree.fromstring(genicam_xml(features, "FLIR", "BFS-U3-19S4M"))
    names = {node.get("Name") for node in root}
    for node in root.iter():
        if node.tag.removeprefix(NAMESPACE) in ("pValue", "pMin", "pMax", "pFeature", "pVariable", "pPort"):
            assert node.text in names


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


def test_chunks_are_laid_out_as_the_real_camera_s(shared_data):
    """Identifier, formula and byte order of each chunk are those of FLIR's description."""
    text = (shared_data / "genicam" / "FLIR_BFS_PGE_19S4M.xml").read_text(encoding="utf-8", errors="replace")
    features = {feature.name: feature for feature in awkward_features(default_limits(), 12, 40.0)}
    for name, number in CHUNK_IDS.items():
        port = re.search(rf'<Port Name="{name}Port".*?<ChunkID>(\w+)</ChunkID>', text, re.DOTALL)
        assert int(port.group(1), 16) == number
        assert f"<Formula>{features[f'Chunk{name}'].formula}</Formula>" in text
    assert re.search(r'<IntReg Name="ChunkExposureTime_Val">.*?<Endianess>LittleEndian</Endianess>', text, re.DOTALL)


def test_the_limits_are_those_of_the_preset(features):
    """Exposure in µs, gain in dB and black level in % of full scale have the preset's bounds."""
    by_name = {feature.name: feature for feature in features}
    assert by_name["ExposureTime"].minimum == pytest.approx(11.0)
    assert by_name["ExposureTime"].maximum == pytest.approx(30e6)
    assert by_name["Gain"].maximum == 47.9943
    assert by_name["BlackLevel"].maximum == pytest.approx(511 / 4095 * 100)


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


def test_packed_pairs_share_the_middle_byte():
    """Mono12Packed: high bytes outside, low nibbles in the middle (GigE Vision 1.2)."""
    assert pack_pixels(np.array([0xABC, 0x123], np.uint16), "Mono12Packed") == bytes([0xAB, 0x3C, 0x12])


def test_words_are_little_endian():
    """16-bit formats send the low byte first."""
    assert pack_pixels(np.array([[0x0102]], np.uint16), "Mono16") == b"\x02\x01"


def test_numbers_above_full_scale_are_refused():
    """A number that the format cannot hold is an error, not a wrap-around."""
    with pytest.raises(ConfigurationError, match="4096 DN do not fit Mono12p"):
        pack_pixels(np.array([4096], np.uint16), "Mono12p")


def test_an_unknown_format_is_refused():
    """The message lists the formats."""
    with pytest.raises(ConfigurationError, match="Mono12p"):
        pack_pixels(np.zeros(4, np.uint16), "RGB8Packed")
