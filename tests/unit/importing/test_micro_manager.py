"""Stacks of Micro-Manager and pymmcore-plus: files of the real writer, and Micro-Manager's tags written by tifffile."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import tifffile
import yaml

import radiometer as rm
from radiometer.cli.main import run
from radiometer.errors import CaptureError
from radiometer.importing import ImportOptions, import_sources, imported_of, is_foreign, open_capture

RECORDED = Path(__file__).parent / "recorded"
PICTURE = (np.arange(12 * 16).reshape(12, 16) * 3 + 200).astype(np.uint16)


def _stack(path, planes, pictures=None, **common):
    """Write pages with Micro-Manager's tag, as its MMStack files have it."""
    with tifffile.TiffWriter(path) as writer:
        for number, plane in enumerate(planes):
            text = json.dumps(common | plane)
            picture = PICTURE if pictures is None else pictures[number]
            writer.write(picture, extratags=[(51123, "s", 0, text, True)], metadata=None, contiguous=False)
    return path


def test_ome_stack_of_pymmcore_plus_is_read():
    """Exposures and times of each plane, and the gain of the camera in its own unit, which is doubted."""
    path = RECORDED / "stack.ome.tiff"
    assert is_foreign(path)
    capture = open_capture(path)
    assert [entry.exposure_s for entry in capture.header.frames] == [0.005, 0.01, 0.02]
    stamps = [entry.timestamp_s for entry in capture.header.frames]
    assert stamps[0] == 0.0
    assert stamps[1] == pytest.approx(0.026067, abs=1e-5)
    assert capture.header.created.startswith("2026-11-22T17:17")
    assert capture.header.camera.model == "Camera"
    text = imported_of(capture)
    assert any("gain is 6.0 in a unit of the camera's own" in line for line in text.doubts)
    assert "exposure_s from OME-XML (3 frames)" in text.taken
    assert capture.header.frames[0].model_extra["device_gain"] == "6.0"
    # The camera that wrote it gives 100 DN + 20 DN per ms.
    means = [float(capture.read_frame(n).dn.mean()) for n in range(3)]
    assert means == pytest.approx([200.0, 300.0, 500.0], abs=2.0)


def test_radiance_of_a_stack_follows_its_exposures(tmp_path, capsys):
    """Imported and merged, the stack's light per exposure is one: 20 DN per ms above black."""
    assert run(["import", str(RECORDED / "stack.ome.tiff"), "-o", str(tmp_path / "set")]) == 0
    assert "exposure_s from OME-XML" in capsys.readouterr().err
    stack = rm.read(tmp_path / "set")
    assert [frame.settings.exposure_s for frame in stack.bracket.light] == [0.005, 0.01, 0.02]
    header = tmp_path / "set" / "capture.yaml"
    text = yaml.safe_load(header.read_text())
    text["camera"]["black_level_dn"] = 100
    header.write_text(yaml.safe_dump(text))
    bright, whole = (rm.merge(rm.read(folder)).value for folder in (tmp_path / "set", RECORDED / "stack.ome.tiff"))
    assert float(np.median(bright)) == pytest.approx((500.0 - 100.0) / 0.02, rel=0.02)
    assert whole.shape == bright.shape


def test_image_sequence_of_pymmcore_plus_is_read():
    """The JSON next to the pictures holds their exposures."""
    assert is_foreign(RECORDED / "sequence")
    capture = open_capture(RECORDED / "sequence")
    assert [entry.exposure_s for entry in capture.header.frames] == [0.005, 0.01]
    assert "exposure_s from _frame_metadata.json (2 frames)" in imported_of(capture).taken


def test_tags_of_micro_manager_are_read(tmp_path):
    """Exposure in ms, elapsed time, bit depth, binning, temperature and a gain that says dB."""
    planes = [{"Exposure-ms": 4.0 * 2**n, "ElapsedTime-ms": 1000.0 * n} for n in range(3)]
    own = {"Camera": "Zyla", "Zyla-Gain (dB)": "12", "Zyla-CCDTemperature": "-5.5", "Binning": "2", "BitDepth": 12}
    capture = open_capture(_stack(tmp_path / "a_MMStack.ome.tif", planes, **own))
    assert [entry.exposure_s for entry in capture.header.frames] == [0.004, 0.008, 0.016]
    assert [entry.timestamp_s for entry in capture.header.frames] == [0.0, 1.0, 2.0]
    assert {entry.gain_db for entry in capture.header.frames} == {12.0}
    assert {entry.temperature_C for entry in capture.header.frames} == {-5.5}
    assert capture.header.camera.bit_depth == 12
    assert capture.header.camera.model_extra["binning"] == "2"
    assert "exposure_s from tag MicroManagerMetadata (3 frames)" in imported_of(capture).taken


def test_wrapped_values_of_micro_manager_2_are_read(tmp_path):
    """Version 2 keeps device properties in a mapping of their own, each value wrapped."""
    own = {"Camera": "Cam", "ScopeData": {"Cam-Exposure": {"PropType": "STRING", "PropVal": "50.00"}}}
    capture = open_capture(_stack(tmp_path / "b.tif", [{}], **own))
    assert capture.header.frames[0].exposure_s == 0.05


def test_gains_of_unknown_unit_are_sets_of_their_own(tmp_path):
    """Frames of two gains in the device's unit are never mixed as if they were one."""
    planes = [{"Exposure-ms": 10, "Cam-Gain": gain} for gain in ("1", "1", "4")]
    path = _stack(tmp_path / "g.tif", planes, Camera="Cam")
    assert sorted(len(one.frames) for one in import_sources([path], ImportOptions())) == [1, 2]
    with pytest.raises(CaptureError, match="2 cameras"):
        open_capture(path)


def test_metadata_text_next_to_single_pictures_is_read(tmp_path):
    """`metadata.txt` names each picture's file."""
    for number in range(2):
        tifffile.imwrite(tmp_path / f"img_{number:09d}_Default_000.tif", PICTURE, metadata=None)
    text = {
        f"FrameKey-{n}-0-0": {"FileName": f"img_{n:09d}_Default_000.tif", "Exposure-ms": 5.0 * (n + 1), "Camera": "C"}
        for n in range(2)
    }
    (tmp_path / "metadata.txt").write_text(json.dumps({"Summary": {"Frames": 2}} | text))
    capture = open_capture(tmp_path)
    assert [entry.exposure_s for entry in capture.header.frames] == [0.005, 0.01]


def test_damaged_metadata_is_as_none(tmp_path):
    """A JSON file that is cut short leaves the pictures without exposure, which is stated in one line."""
    shutil.copytree(RECORDED / "sequence", tmp_path / "s")
    (tmp_path / "s" / "_frame_metadata.json").write_text('{"00000_.tif": {')
    with pytest.raises(CaptureError, match="exposure"):
        import_sources([tmp_path / "s"], ImportOptions())


def test_planes_are_distinguished_by_their_place(tmp_path):
    """Planes of OME-XML may stand in any order; the dimension order says which page is whose, and units are kept."""
    xml = (
        '<OME xmlns="http://www.openmicroscopy.org/Schemas/OME/2016-06"><Image ID="Image:0"><Pixels ID="Pixels:0" '
        'DimensionOrder="XYTCZ" Type="uint16" SizeX="16" SizeY="12" SizeZ="1" SizeC="2" SizeT="2" SignificantBits="12">'
        + "".join(
            f'<Plane TheZ="0" TheT="{t}" TheC="{c}" ExposureTime="{10 * t + c + 1}" ExposureTimeUnit="ms"/>'
            for c in (1, 0)
            for t in (1, 0)
        )
        + "</Pixels></Image></OME>"
    )
    path = tmp_path / "p.ome.tif"
    tifffile.imwrite(path, np.stack([PICTURE] * 4), description=xml, metadata=None, photometric="minisblack")
    capture = open_capture(path)
    found = {entry.file: entry.exposure_s for entry in capture.header.frames}
    assert [found[f"p.ome.tif#{n}"] for n in range(4)] == pytest.approx([0.001, 0.011, 0.002, 0.012])
    assert capture.header.camera.bit_depth == 12
