from __future__ import annotations

import re
from xml.etree import ElementTree

import pytest

from simulators.cameras.awkward_features import CHUNK_IDS, awkward_features
from simulators.cameras.blackfly_features import blackfly_features
from simulators.cameras.genicam_document import genicam_xml
from simulators.cameras.simulated_camera import default_limits

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
