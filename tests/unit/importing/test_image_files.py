"""Pictures of other programs: TIFF, Micro-Manager, FITS."""

import json
from pathlib import Path

import numpy as np
import pytest
import tifffile

from radiometer.analysis.signal.lens import lens_in_use, relative_sensitivity
from radiometer.data import Calibration, CameraDescription, LensDescription, Patch, SensorNoise
from radiometer.data.statements import StatementMap
from radiometer.errors import CaptureError, UnsettledError
from radiometer.importing import ImportOptions, import_sources, imported_of, is_foreign, open_capture
from radiometer.importing.exif import FallOff, RowExposure, corners_of_plane, numbers, read_xmp

PICTURE = ((np.arange(40 * 60).reshape(40, 60) % 3000 + 300) * 16).astype(np.uint16)


def test_exif_becomes_settings(write_raw_tiff):
    """Exposure in s, ISO as dB above ISO 100, black level, padding of four bits, and the level of masked rows."""
    capture = open_capture(write_raw_tiff("a.tif", PICTURE, iso=200, exposure=(1, 500)))
    entry = capture.header.frames[0]
    assert (entry.exposure_s, entry.black_level_dn) == (0.002, 4800)
    assert entry.gain_db == pytest.approx(6.0206, abs=1e-4)
    assert capture.header.camera.code_step_dn == 16
    assert np.array_equal(capture.read_frame(0).dn, PICTURE)
    assert open_capture(write_raw_tiff("b.tif", PICTURE, dark=5100)).read_frame(0).masked_dn == 5100.0


def test_masked_rows_off_the_black_level_tag_are_named(write_raw_tiff):
    """Offset and gain slope with their size at each gain; rows that read what the tag says are no finding."""
    write_raw_tiff("s/a_1.tif", PICTURE, iso=100, dark=5000)
    folder = write_raw_tiff("s/b_1.tif", PICTURE, iso=200, dark=5200).parent
    doubts_found = " ".join(imported_of(open_capture(folder)).doubts)
    assert "+200 DN at 0 dB, +400 DN at 6.02 dB: black_level_offset and black_level_gain_slope" in doubts_found
    doubts_found = imported_of(open_capture(write_raw_tiff("a.tif", PICTURE, dark=4800))).doubts
    assert not any("masked" in line for line in doubts_found)


def test_bands_and_cameras_are_not_mixed(write_raw_tiff, write_fits):
    """A folder of two bands, or of two cameras, is refused as one set, each named; a pattern takes one."""
    write_raw_tiff("s/IMG_1.tif", PICTURE, band="Blue")
    folder = write_raw_tiff("s/IMG_2.tif", PICTURE, band="Red").parent
    with pytest.raises(CaptureError, match=r"Blue.*Red"):
        open_capture(folder)
    assert open_capture(folder / "IMG_2*").header.camera.band == "Red"
    for name in ("one", "two"):
        cameras = write_fits(f"c/{name}.fits", FITS_PICTURE, EXPTIME=1.0, INSTRUME=name).parent
    with pytest.raises(CaptureError, match=r"2 cameras.*one.*two"):
        open_capture(cameras)


def test_the_makers_models_in_figures():
    """Fall-off and row gain by hand; XMP is read as attributes and as sequences, a damaged packet gives none."""
    model = FallOff((30.0, 40.0), (-0.001, -1e-4))
    assert model.corners((81, 61))[0] == pytest.approx(1 - 0.05 - 0.25)
    assert model.relative_illumination(np.array([30.0]), np.array([40.0]))[0] == 1.0
    assert RowExposure(1e-7, 1e-5).gain_at(500, 1e-3) == pytest.approx(1 + 0.05 - 0.005)
    properties = {"VignettingPolynomial2DName": ("0,0,1,0,0,2",), "VignettingPolynomial2D": ("1,0.2,-0.4",)}
    middle = 1 + 0.1 - 0.1
    assert corners_of_plane(properties) == pytest.approx(np.array([1.0, 1.2, 0.6, 0.8]) / middle)
    packet = (
        b'<x:xmpmeta xmlns:x="adobe:ns:meta/"><r:RDF xmlns:r="http://www.w3.org/1999/02/22-rdf-syntax-ns#">'
        b'<r:Description xmlns:c="u" c:T="32.5"><c:S><r:Seq><r:li>1,2</r:li><r:li>3</r:li></r:Seq></c:S>'
        b"</r:Description></r:RDF></x:xmpmeta>"
    )
    found = read_xmp(packet)
    assert numbers(found, "T") == (32.5,)
    assert numbers(found, "S") == (1.0, 2.0, 3.0)
    assert read_xmp(packet[:-60]) == {}


def test_the_frame_carries_corners_and_row_gain(write_raw_tiff):
    """The maker's models stand in the capture set as numbers a user can judge."""
    header = open_capture(write_raw_tiff("a.tif", PICTURE)).header
    expected = FallOff((30.0, 20.0), (-0.001, -1e-4)).corners((40, 60))
    assert header.lens.model_extra["maker_corner_illumination"] == pytest.approx(expected, abs=1e-4)
    assert header.frames[0].model_extra["maker_row_gain_last"] == pytest.approx(
        1 + 1e-7 * 39 / 0.002 + 5e-6 * 39, abs=1e-4
    )
    doubts = header.model_extra["imported"]["doubts"]
    assert any("0.83 to 0.85 of the middle" in line and "natural_vignetting" in line for line in doubts), doubts
    assert not any("row_dependent_exposure" in line for line in doubts)  # 0.2 % are too little to be reported


def test_rows_that_are_exposed_for_times_of_their_own_are_recognised_by_the_entrys_name(write_raw_tiff):
    """A row more has 0.02 and 0.04 % of the light more at two exposures: 0.8 and 1.6 % over 40 rows."""
    for name, exposure_s in (("a.tif", (1, 2000)), ("b.tif", (1, 4000))):
        path = write_raw_tiff(name, PICTURE, exposure=exposure_s)
    doubts = open_capture(path.parent).header.model_extra["imported"]["doubts"]
    (line,) = [line for line in doubts if "row_dependent_exposure" in line]
    assert "+0.8 to +1.6 % more light than the first" in line


def test_plain_photographs_are_not_taken_for_raw_frames(tmp_path, write_raw_tiff):
    """A TIFF without a camera's raw facts stays a photograph."""
    (tmp_path / "photos").mkdir()
    tifffile.imwrite(tmp_path / "photos" / "a.tif", PICTURE)
    assert not is_foreign(tmp_path / "photos")
    assert is_foreign(write_raw_tiff("raw/a.tif", PICTURE).parent)


RECORDED = Path(__file__).parent / "recorded"

STACK_PICTURE = (np.arange(12 * 16).reshape(12, 16) * 3 + 200).astype(np.uint16)


def _stack(path, planes, pictures=None, **common):
    """Write pages with Micro-Manager's tag, as its MMStack files have it."""
    with tifffile.TiffWriter(path) as writer:
        for number, plane in enumerate(planes):
            text = json.dumps(common | plane)
            picture = STACK_PICTURE if pictures is None else pictures[number]
            writer.write(picture, extratags=[(51123, "s", 0, text, True)], metadata=None, contiguous=False)
    return path


def test_stack_and_sequence_of_pymmcore_plus_are_read():
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
    assert is_foreign(RECORDED / "sequence")  # the JSON next to its pictures holds their exposures
    sequence = open_capture(RECORDED / "sequence")
    assert [entry.exposure_s for entry in sequence.header.frames] == [0.005, 0.01]
    assert "exposure_s from _frame_metadata.json (2 frames)" in imported_of(sequence).taken


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
    assert capture.header.camera.binning == "2"
    assert "exposure_s from tag MicroManagerMetadata (3 frames)" in imported_of(capture).taken
    own = {"Camera": "Cam", "ScopeData": {"Cam-Exposure": {"PropType": "STRING", "PropVal": "50.00"}}}  # of version 2
    assert open_capture(_stack(tmp_path / "b.tif", [{}], **own)).header.frames[0].exposure_s == 0.05


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
        tifffile.imwrite(tmp_path / f"img_{number:09d}_Default_000.tif", STACK_PICTURE, metadata=None)
    text = {
        f"FrameKey-{n}-0-0": {"FileName": f"img_{n:09d}_Default_000.tif", "Exposure-ms": 5.0 * (n + 1), "Camera": "C"}
        for n in range(2)
    }
    (tmp_path / "metadata.txt").write_text(json.dumps({"Summary": {"Frames": 2}} | text))
    capture = open_capture(tmp_path)
    assert [entry.exposure_s for entry in capture.header.frames] == [0.005, 0.01]
    (tmp_path / "metadata.txt").write_text('{"FrameKey-0-0-0": {')  # cut short it is as none
    with pytest.raises(CaptureError, match="exposure"):
        import_sources([tmp_path], ImportOptions())


def _ome(path, *images, order="XYCTZ", bits=12, names=("", "")):
    """Write four pages whose OME-XML has images of such content, their size in channels and times first."""
    inner = "".join(
        f'<Image ID="Image:{n}"{name}><Pixels ID="Pixels:{n}" DimensionOrder="{order}" Type="uint16" SizeX="16" '
        f'SizeY="12" SizeZ="1" SizeC="{channels}" SizeT="2" SignificantBits="{bits}">{body}</Pixels></Image>'
        for n, (name, (channels, body)) in enumerate(zip(names, images, strict=False))
    )
    xml = f'<OME xmlns="http://www.openmicroscopy.org/Schemas/OME/2016-06">{inner}</OME>'
    tifffile.imwrite(path, np.stack([STACK_PICTURE] * 4), description=xml, metadata=None, photometric="minisblack")
    return path


def _plane(c, t, ms):
    return f'<Plane TheZ="0" TheT="{t}" TheC="{c}" ExposureTime="{ms}" ExposureTimeUnit="ms"/>'


def test_planes_are_distinguished_by_their_place(tmp_path):
    """Planes of OME-XML may stand in any order; the dimension order says which page is whose, and units are kept."""
    planes = "".join(_plane(c, t, 10 * t + c + 1) for c in (1, 0) for t in (1, 0))
    capture = open_capture(_ome(tmp_path / "p.ome.tif", (2, planes), order="XYTCZ"))
    found = {entry.file: entry.exposure_s for entry in capture.header.frames}
    assert [found[f"p.ome.tif#{n}"] for n in range(4)] == pytest.approx([0.001, 0.011, 0.002, 0.012])
    assert capture.header.camera.bit_depth == 12


@pytest.mark.parametrize("second", ["670", "461", None])
def test_channels_of_other_wavelengths_are_never_one_bracket(tmp_path, second):
    """Each light is a set named as its channel; channels of one wavelength are exposures of one scene."""
    wavelength = "" if second is None else f'EmissionWavelength="{second}"'
    channels = f'<Channel ID="C:0" Name="DAPI" EmissionWavelength="461"/><Channel ID="C:1" Name="Cy5" {wavelength}/>'
    planes = "".join(_plane(c, t, 4**c * 2**t) for t in (0, 1) for c in (0, 1))
    sets = import_sources([_ome(tmp_path / "p.ome.tif", (2, channels + planes))], ImportOptions())
    assert sorted(len(one.header.frames) for one in sets) == ([4] if second == "461" else [2, 2])


@pytest.mark.parametrize("names", [(' Name="Pos0 sample A"', ' Name="Pos1 sample B"'), (' Name="a"',) * 2, ("", "")])
@pytest.mark.parametrize("stated", [True, False])
def test_images_of_one_file_are_never_one_bracket(tmp_path, names, stated):
    """Each image (a position, a series) is a set by itself, whether its planes are described or not."""
    bodies = (
        f'<TiffData IFD="{2 * n}" PlaneCount="2"/>' + "".join(_plane(0, t, 10**n * (t + 1)) for t in (0, 1) if stated)
        for n in (0, 1)
    )
    path = _ome(tmp_path / "p.ome.tif", *((1, body) for body in bodies), names=names)
    mapped = StatementMap() if stated else StatementMap.parse(["exposure=10:ms"])
    sets = import_sources([path], ImportOptions(mapped=mapped))
    assert [[entry.file for entry in one.header.frames] for one in sets] == [
        ["p.ome.tif#0", "p.ome.tif#1"], ["p.ome.tif#2", "p.ome.tif#3"],
    ]  # fmt: skip


def test_a_mask_is_no_frame(tmp_path):
    """A transparency mask (TIFF 6.0) behind each picture is left out and reported."""
    for number, time_s in enumerate((0.01, 0.02)):
        with tifffile.TiffWriter(tmp_path / f"{time_s}s-{number}.tif") as writer:
            writer.write(STACK_PICTURE, photometric="minisblack", metadata=None)
            writer.write(np.ones(STACK_PICTURE.shape, bool), photometric="minisblack", subfiletype=4, metadata=None)
    (found,) = import_sources([tmp_path], ImportOptions())
    assert len(found.header.frames) == 2
    assert all("mask" in line for frame in found.frames.values() for line in frame.not_used)


FITS_PICTURE = (np.arange(48 * 64).reshape(48, 64) + 1000).astype(np.uint16)


def test_a_header_becomes_settings(write_fits):
    """Exposure in s, temperature in °C, shutter, conversion gain and values above 32767 come out as they were."""
    path = write_fits(
        "a.fits.gz", FITS_PICTURE + np.uint16(40_000), EXPTIME=2.5, CCD_TEMP=-5.25, SET_TEMP=-5.0, EGAIN=2.06,
        IMAGETYP="Flat Field", DATE_OBS="2017-09-08T20:48:41.5", INSTRUME="STL", XPIXSZ=24.0,
    )  # fmt: skip
    capture = open_capture(path)
    entry, camera = capture.header.frames[0], capture.header.camera
    assert (entry.exposure_s, entry.temperature_C, entry.shutter) == (2.5, -5.25, "open")
    assert (camera.bit_depth, camera.conversion_gain_e_per_dn, camera.pixel_pitch_um) == (16, 2.06, 24.0)
    assert capture.header.created.startswith("2017-09-08T20:48:41.5")
    assert np.array_equal(capture.read_frame(0).dn, FITS_PICTURE + np.uint16(40_000))


@pytest.mark.parametrize("message", ["Bias Frame", "DARK", "zero", "Dark Frame          "])
def test_darkness_is_recognised_by_imagetyp(write_fits, message):
    """Bias and dark frames have a closed shutter, a bias frame an exposure of 0 s."""
    entry = open_capture(write_fits("a.fit", FITS_PICTURE, EXPTIME=0.0, IMAGETYP=message)).header.frames[0]
    assert (entry.shutter, entry.exposure_s) == ("closed", 0.0)


def test_a_temperature_in_kelvins(write_fits):
    """268.15 is −5 °C where the user states K; without a unit it stops the import, for no sensor has so many °C."""
    path = write_fits("a.fit", FITS_PICTURE, EXPTIME=1.0, IMAGETYP="dark", DET_TEMP=268.15)
    with pytest.raises(UnsettledError, match="--map temperature=DET-TEMP:UNIT"):
        open_capture(path)
    (found,) = import_sources([path], ImportOptions(mapped=StatementMap.parse(["temperature=DET-TEMP:K"])))
    assert found.header.frames[0].temperature_C == pytest.approx(-5.0)


@pytest.mark.parametrize("name", ["dark_0c_1m30s.fits", "dark-expos90s-x.fits", "dark_90000ms.fits", "d_1p5min.fits"])
def test_a_name_that_contradicts_its_header_is_doubted(write_fits, name):
    """A file called expos1 that holds 60 s is taken as 60 s and named; minutes, seconds and ms that agree are not."""
    assert imported_of(open_capture(write_fits(name, FITS_PICTURE, EXPTIME=90.0, IMAGETYP="dark"))).doubts == ()
    capture = open_capture(write_fits("s/darks-expos1-x.0001.fits", FITS_PICTURE, EXPTIME=60.0, IMAGETYP="dark"))
    assert capture.header.frames[0].exposure_s == 60.0
    assert any("darks-expos1-x" in line and "60 s" in line for line in imported_of(capture).doubts)


def test_processing_and_an_unsettled_cooler_are_doubted(write_fits):
    """A HISTORY that speaks of dark subtraction, a combined frame, a sensor 3 K off its temperature; 0.2 K is fine."""
    for name, history, cards, expected in (
        ("a", ("Dark Subtract with m.fits",), {"NCOMBINE": 5}, ("dark subtract", "5 frames")),
        ("b", (), {"CCD_TEMP": -7.0, "SET_TEMP": -10.0}, ("-7.0",)),
        ("c", (), {"CCD_TEMP": -9.8, "SET_TEMP": -10.0}, ()),
    ):
        doubts = imported_of(
            open_capture(write_fits(f"{name}.fits", FITS_PICTURE, history, EXPTIME=1.0, IMAGETYP="dark", **cards))
        ).doubts
        assert all(one in " ".join(doubts) for one in expected)
        assert bool(doubts) == bool(expected)


def test_a_cube_is_one_frame_per_plane(write_fits):
    """Planes of a cube keep their order; files stand by their times, which count from the first."""
    path = write_fits(
        "c.fits", np.stack([FITS_PICTURE, FITS_PICTURE + 1, FITS_PICTURE + 2]).astype(np.uint16), EXPTIME=1.0
    )
    capture = open_capture(path)
    assert [int(frame.dn[0, 0]) for frame in capture.frames()] == [1000, 1001, 1002]
    write_fits("s/b.fits", FITS_PICTURE, EXPTIME=1.0, IMAGETYP="dark", DATE_OBS="2020-01-01T00:00:10")
    folder = write_fits("s/a.fits", FITS_PICTURE, EXPTIME=1.0, IMAGETYP="dark", DATE_OBS="2020-01-01T00:01:10").parent
    entries = open_capture(folder).header.frames
    assert [(e.file, e.timestamp_s) for e in entries] == [("b.fits", 0.0), ("a.fits", 60.0)]


def test_crop_and_sampling(write_fits):
    """A crop keeps its region, sampling every n-th row and column of it."""
    path = write_fits("a.fits", FITS_PICTURE, EXPTIME=1.0, XPIXSZ=5.0)
    capture = open_capture(path, ImportOptions(crop=Patch(8, 4, 20, 10), sample=2))
    assert np.array_equal(capture.read_frame(0).dn, FITS_PICTURE[4:14:2, 8:28:2])
    assert capture.header.camera.pixel_spacing_um == 10.0
    assert capture.header.lens.principal_point_px == ((31.5 - 8) / 2, (23.5 - 4) / 2)


@pytest.mark.parametrize("options", [ImportOptions(crop=Patch(30, 20, 30, 20)), ImportOptions(sample=2)])
def test_the_fall_off_of_a_part_is_that_of_its_place(options, write_fits):
    """cos⁴ of the calibration's wide lens is about the middle of the whole picture, whatever part was taken of it."""
    path = write_fits("a.fits", FITS_PICTURE, EXPTIME=1.0, XPIXSZ=5.0)
    camera, lens = CameraDescription(bit_depth=16), LensDescription(focal_length_mm=0.2, vignetting="cos4")
    known = Calibration(camera, lens, None, None, SensorNoise.of(camera))
    y, x = np.mgrid[:48, :64]
    falloff = []
    for capture in (open_capture(path), open_capture(path, options)):
        shape = capture.read_frame(0).dn.shape
        used = lens_in_use(known, capture.header.lens)
        rows, columns = y[: shape[0], : shape[1]], x[: shape[0], : shape[1]]
        falloff.append(relative_sensitivity(capture.header.camera, used, None, shape, columns, rows))
    whole, part = falloff
    assert whole.min() < 0.5
    np.testing.assert_allclose(part, options.cut(whole, "whole"), rtol=1e-12)


def test_floating_point_needs_a_full_scale(write_fits):
    """Refused with the option that takes each; whole numbers up to 65535 are kept, a full scale above scales them."""
    path = write_fits("f.fits", np.linspace(0, 2, 48 * 64).reshape(48, 64).astype(np.float32), EXPTIME=1.0)
    with pytest.raises(CaptureError, match="--full-scale"):
        open_capture(path)
    dn = open_capture(path, ImportOptions(full_scale=4.0)).read_frame(0).dn
    assert (int(dn[0, 0]), int(dn[-1, -1])) == (0, round(65535 * 2 / 4))
    path = write_fits("i.fits", FITS_PICTURE.astype(np.int32) * 10, EXPTIME=1.0)
    assert np.array_equal(open_capture(path, ImportOptions(full_scale=65535)).read_frame(0).dn, FITS_PICTURE * 10)
    scaled = open_capture(path, ImportOptions(full_scale=131070)).read_frame(0).dn
    assert int(scaled[0, 0]) == 5000
    with pytest.raises(CaptureError, match="above the full scale"):
        open_capture(path, ImportOptions(full_scale=20_000))
    path = write_fits("n.fits", FITS_PICTURE.astype(np.int16) - 1040, EXPTIME=1.0)
    with pytest.raises(CaptureError, match="--pedestal 40"):
        open_capture(path)
    assert int(open_capture(path, ImportOptions(pedestal=40)).read_frame(0).dn[0, 0]) == 0


def test_fewer_bits_are_told_by_where_pixels_pile_up(write_fits):
    """Pixels that pile up at 4095 tell a 12-bit converter in a 16-bit file; else the highest stated top does."""
    capture = open_capture(write_fits("t.fits", np.minimum(FITS_PICTURE + 2000, 4095).astype(np.uint16), EXPTIME=1.0))
    assert capture.header.camera.bit_depth == 12
    write_fits("s/a.fits", FITS_PICTURE, EXPTIME=1.0, DATAMAX=4095)
    stated = open_capture(write_fits("s/b.fits", FITS_PICTURE, EXPTIME=2.0, DATAMAX=16383).parent)
    assert stated.header.camera.bit_depth == 14


@pytest.mark.parametrize(
    ("keys", "first", "second"),
    [
        (("FILTER1", "FILTER2"), ("clear", "R"), ("clear", "V")), (("FILTNAM",), ("R",), ("V",)),
        (("FILTER", "FILTER2"), ("R", "ND0"), ("R", "ND2")), (("INSFILTE",), ("R",), ("V",)),
        (("FILTER",), ("R",), ("V",)),
    ],
)  # fmt: skip
def test_filters_of_every_wheel_part_the_frames(write_fits, keys, first, second):
    """Two frames that differ in a filter are two patterns, whatever its keyword; a dark frame belongs to neither."""
    write_fits("s/a.fits", FITS_PICTURE, EXPTIME=1.0, IMAGETYP="flat", **dict(zip(keys, first, strict=True)))
    write_fits("s/b.fits", FITS_PICTURE, EXPTIME=2.0, IMAGETYP="flat", **dict(zip(keys, second, strict=True)))
    folder = write_fits("s/c.fits", FITS_PICTURE, EXPTIME=1.0, IMAGETYP="dark", **dict(zip(keys, first, strict=True)))
    patterns = {entry.file: entry.pattern for entry in open_capture(folder.parent).header.frames}
    assert (len(set(patterns.values())), patterns["c.fits"]) == (3, "default")


@pytest.mark.parametrize(
    "binned",
    [
        {"XBINNING": 2}, {"CCDSUM": "2 2"}, {"BINNING": "2x2"}, {"CCDXBIN": 2}, {"CCDBIN1": 2, "CCDBIN2": 2},
        {"XBINNING": 2.0, "YBINNING": 2.0}, {"XBIN": 2, "YBIN": 2}, {"BIN": 2}, {"BINMODE": "2x2"},
        {"HIERARCH ESO DET WIN1 BINX": 2, "HIERARCH ESO DET WIN1 BINY": 2},
    ],
)  # fmt: skip
def test_binned_frames_are_another_set(write_fits, binned):
    """Four pixels in one have another gain, though a window of the sensor has the same size."""
    write_fits("s/a.fits", FITS_PICTURE, EXPTIME=1.0)
    write_fits("s/b.fits", FITS_PICTURE, EXPTIME=1.0, **binned)
    folder = write_fits("s/c.fits", FITS_PICTURE, EXPTIME=2.0, XBINNING=1.0, YBINNING=1.0).parent
    found = import_sources([folder], ImportOptions())
    assert len(found) == 2
    assert "2" in {one.header.camera.binning for one in found}


@pytest.mark.parametrize(
    ("cards", "white_dn"),
    [
        ({"SATURATE": 50_000}, 50_000), ({"SATLEVEL": 50_000.0}, 50_000), ({"DATAMAX": 9_000}, None),
        ({"SATURATE": (50_000, "saturation level [e-]")}, None), ({"SATURATE": 200_000}, None),
    ],
)  # fmt: skip
def test_a_stated_saturation_is_the_white_level(tmp_path, write_fits, cards, white_dn):
    """SATURATE in DN; DATAMAX is the largest value of one frame, and electrons or numbers beyond 16 bits are none."""
    dn = np.full((20, 30), 9_000, np.uint16)
    for k, seconds in enumerate((1.0, 2.0)):
        write_fits(f"f/{k}.fits", dn + np.uint16(k), EXPTIME=seconds, IMAGETYP="Light", **cards)
    camera = open_capture(tmp_path / "f").header.camera
    assert camera.white_level_dn == white_dn
    assert camera.saturated_dn == (white_dn or 65_535)
