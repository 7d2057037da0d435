"""Exports of maps and of curves, as other programs read them."""

import getpass
import json
from dataclasses import replace

import cv2
import numpy as np
import OpenEXR
import pytest
import tifffile
from PIL import Image

from radiometer.analysis.exports.curves import read_curves, write_curves
from radiometer.analysis.exports.maps import WRITERS, MapPicture, in_luminance, rgbe, writer_for
from radiometer.analysis.photometry.photometry import spectrum
from radiometer.cli.main import run
from radiometer.data import CaptureSetWriter, PixelMask, RadianceMap, ResponseCurve
from radiometer.errors import InputError, MeasurementError, OutputError, UsageError
from testing.photograph_folder import eight_bits, write_photographs


@pytest.fixture
def grey():
    """Return a map over six decades with one clipped, one negative and one defective pixel."""
    radiance = np.geomspace(1e-3, 1e3, 48, dtype=np.float32).reshape(6, 8)
    radiance[0, 0] = -1e-3
    mask = np.zeros((6, 8), np.uint8)
    mask[0, 0], mask[5, 7], mask[2, 2] = PixelMask.BELOW_NOISE, PixelMask.SATURATED, PixelMask.DEFECTIVE
    return RadianceMap(radiance, np.abs(radiance) * 0.01, mask, "W sr-1 m-2", 0.02, (1e-3, 4e-3))


@pytest.fixture
def colour(grey):
    """Return three maps in the ratio 1 : 2 : 3."""
    return {
        name: RadianceMap(grey.radiance * k, grey.u_radiance * k, grey.mask, grey.unit)
        for k, name in enumerate(("red", "green", "blue"), start=1)
    }


def test_exr_and_tiff_carry_value_uncertainty_mask_and_unit(grey, tmp_path):
    """Read back by a program that knows the form."""
    reported = replace(grey, not_in_u=("no stray light", "no offset"))
    writer_for(tmp_path / "map.exr")(tmp_path / "map.exr", MapPicture({"mono": reported}))
    file = OpenEXR.File(str(tmp_path / "map.exr"), separate_channels=True)
    channels = {name: channel.pixels for name, channel in file.channels().items()}
    np.testing.assert_array_equal(channels["Y"], grey.radiance)
    np.testing.assert_array_equal(channels["Y.u"], grey.u_radiance)
    np.testing.assert_array_equal(channels["Y.mask"], grey.mask)
    assert file.header()["unit"] == "W sr-1 m-2"
    assert file.header()["not_in_u"] == "no stray light; no offset"
    writer_for(tmp_path / "map.tiff")(tmp_path / "map.tiff", MapPicture({"mono": grey}))
    with tifffile.TiffFile(tmp_path / "map.tiff") as tiff:
        value, u, mask = (page.asarray() for page in tiff.pages)
        facts = [json.loads(page.description) for page in tiff.pages]
    np.testing.assert_array_equal(value, grey.radiance)
    np.testing.assert_array_equal(u, grey.u_radiance)
    np.testing.assert_array_equal(mask, grey.mask)
    assert [entry["quantity"] for entry in facts] == ["value", "standard uncertainty", "mask"]
    assert facts[0]["unit"] == "W sr-1 m-2"


@pytest.mark.parametrize(("unit", "per_value"), [("W sr-1 m-2", 1.0), ("cd m-2", 179.0)])
def test_hdr_is_read_back_by_opencv_to_its_resolution(grey, tmp_path, unit, per_value):
    """Half a step of an 8-bit mantissa is 0.4 % at worst; what is negative becomes 0; luminance is 179 lm/W of it."""
    writer_for(tmp_path / "map.hdr")(tmp_path / "map.hdr", MapPicture({"mono": replace(grey, unit=unit)}))
    back = per_value * cv2.imread(str(tmp_path / "map.hdr"), cv2.IMREAD_UNCHANGED)
    assert back[0, 0].tolist() == [0.0, 0.0, 0.0]
    np.testing.assert_allclose(back[..., 1].ravel()[1:], grey.radiance.ravel()[1:], rtol=1 / 256)
    assert abs(np.mean(back[..., 1].ravel()[1:] / grey.radiance.ravel()[1:]) - 1) < 5e-4  # rounded, not cut


def test_hdr_states_its_exposure_once_and_never_overflows(grey, tmp_path):
    """At the beginning of a line; mantissas stay below 256."""
    writer_for(tmp_path / "map.hdr")(tmp_path / "map.hdr", MapPicture({"mono": grey}))
    header = (tmp_path / "map.hdr").read_bytes().split(b"\n\n")[0].decode()
    lines = header.splitlines()
    assert lines[0] == "#?RADIANCE"
    assert [line for line in lines if "EXPOSURE" in line] == ["EXPOSURE=1"]
    below = np.nextafter(np.float32(2.0), np.float32(0.0))
    quadruple = rgbe(np.full((1, 1, 3), below, np.float32))[0, 0]
    assert quadruple.tolist() == [128, 128, 128, 130]


@pytest.mark.parametrize("ending", [".exr", ".tiff", ".hdr"])
def test_colours_keep_their_order(colour, tmp_path, ending):
    """Red, green and blue come back as 1 : 2 : 3."""
    path = tmp_path / f"map{ending}"
    writer_for(path)(path, MapPicture(colour))
    if ending == ".exr":
        channels = OpenEXR.File(str(path), separate_channels=True).channels()
        values = [float(channels[name].pixels[3, 3]) for name in "RGB"]
    elif ending == ".tiff":
        values = tifffile.imread(path, key=0)[3, 3].tolist()
    else:
        values = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)[3, 3][::-1].tolist()
    np.testing.assert_allclose(np.array(values) / values[0], [1, 2, 3], rtol=0.01)


@pytest.mark.parametrize("ending", list(WRITERS))
def test_files_hold_no_path_and_an_unwritable_place_is_an_error(grey, tmp_path, ending):
    """They are handed on; an output error is no traceback."""
    path = tmp_path / f"map{ending}"
    writer_for(path)(path, MapPicture({"mono": grey}))
    content = path.read_bytes()
    assert str(tmp_path).encode() not in content
    if len(getpass.getuser()) > 3:
        assert getpass.getuser().encode() not in content
    assert list(tmp_path.iterdir()) == [path]
    path = tmp_path / "nowhere" / f"map{ending}"
    with pytest.raises(OutputError, match="nowhere"):
        writer_for(path)(path, MapPicture({"mono": grey}))


@pytest.mark.slow
def test_false_colours_grow_with_radiance_and_mark_what_clips(grey, tmp_path):
    """Brightness of the colours rises with the value; the clipped pixel is magenta."""
    path = tmp_path / "map.png"
    writer_for(path)(path, MapPicture({"mono": grey}, (1e-3, 1e3)))
    image = np.asarray(Image.open(path).convert("RGB")).astype(int)
    magenta = np.all(np.abs(image - [255, 64, 255]) < 8, axis=-1)
    assert magenta.sum() > 100
    scale_bar = image[:, int(image.shape[1] * 0.84) : int(image.shape[1] * 0.98)]
    assert scale_bar.sum(axis=-1).std() > 50


def test_a_picture_that_would_show_nothing_is_refused(grey, tmp_path):
    """A scale that does not begin above 0, or ends below its begin; a map without light; an ending without a writer."""
    file = tmp_path / "a.png"
    for bounds in ((0.0, 1.0), (2.0, 1.0)):
        with pytest.raises(UsageError, match="0 < low < high"):
            writer_for(file)(file, MapPicture({"mono": grey}, bounds))
    dark = RadianceMap(-np.abs(grey.radiance), grey.u_radiance, grey.mask)
    with pytest.raises(MeasurementError, match="no pixel shows light"):
        writer_for(file)(file, MapPicture({"mono": dark}))
    with pytest.raises(UsageError, match=r"\.exr, \.hdr"):
        writer_for(tmp_path / "map.bmp")


def test_luminance_scales_value_and_uncertainty(grey):
    """683 lm/W at 555 nm, and the unit changes."""
    shown = in_luminance(grey, spectrum("line:555"))
    np.testing.assert_allclose(shown.radiance, grey.radiance * 683, rtol=1e-6)
    np.testing.assert_allclose(shown.u_radiance, grey.u_radiance * 683, rtol=1e-6)
    assert shown.unit == "cd m-2"


@pytest.fixture
def capture(rig, tmp_path):
    """Return a capture set of an even scene with its radiance, and the calibration file that fits it."""
    radiance = 0.4 * rig.radiance_of_full_scale(1e-3)
    rng = np.random.default_rng(3)
    with CaptureSetWriter(tmp_path / "capture", rig.description, rig.lens) as writer:
        for exposure_s in (2.5e-4, 1e-3, 4e-3):
            writer.add(rig.frame(np.full((30, 40), radiance), exposure_s, rng))
        writer.add(rig.frame(np.zeros((30, 40)), 1e-3, rng, shutter="closed"))
    rig.calibration().write(tmp_path / "cal.yaml")
    return tmp_path / "capture", radiance


def test_the_command_merges_a_capture_set(capture, tmp_path, capsys):
    """Radiance comes out at its truth; several files are written from one merge."""
    folder, radiance = capture
    words = ["merge", str(folder), "--calibration", str(tmp_path / "cal.yaml"), "--json"]
    assert run([*words, "-o", str(tmp_path / "a.tiff"), "-o", str(tmp_path / "a.hdr")]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["unit"] == "W sr-1 m-2"
    assert report["values"]["median"] == pytest.approx(radiance, rel=0.01)
    assert report["pixels"]["good"] == 1200
    value = tifffile.imread(tmp_path / "a.tiff", key=0)
    assert value.mean() == pytest.approx(radiance, rel=0.002)
    assert (tmp_path / "a.hdr").exists()


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        (["{capture}", "-o", "{dir}/a.bmp"], 2, ".bmp"),
        (["{capture}", "-o", "{dir}/a.exr", "--luminance"], 2, "calibration"),
        (["{capture}", "-o", "{dir}/a.png", "--scale", "5"], 2, "LOW,HIGH"),
        (["{capture}", "-o", "{dir}/a.exr", "--pattern", "stripes"], 1, "stripes"),
        (["{dir}", "-o", "{dir}/a.exr"], 1, "nor photographs"),
        (["{capture}", "-o", "{dir}/a.exr", "--response", "{curve}"], 1, "8 bits"),
    ],
)
def test_misuse_of_the_command_is_one_line(words, code, message, capture, tmp_path, capsys):
    """And nothing is written."""
    curve = tmp_path / "curve.yaml"
    ResponseCurve(np.linspace(-5, 1, 256), np.zeros(256)).write(curve)
    places = {"capture": capture[0], "dir": tmp_path, "curve": curve}
    assert run(["merge", *(word.format(**places) for word in words)]) == code
    printed = capsys.readouterr().err.rpartition("\n\nError: ")[2]  # after the usage, where that is what is wrong
    assert message in printed
    assert len(printed.strip().splitlines()) == 1
    assert not list(tmp_path.glob("a.*"))


@pytest.mark.slow
def test_colour_photographs_are_merged_by_channel(tmp_path, capsys):
    """Three curves by channel, one command, an .exr with R, G and B in their proportion."""
    truth = np.geomspace(0.05, 4.0, 64)[None, :].repeat(16, 0)
    rng = np.random.default_rng(7)
    planes = (
        [
            eight_bits(255 * (truth * tint * 2.0**-k) ** (1 / 2.2) + rng.normal(0, 0.3, truth.shape))
            for tint in (0.25, 0.5, 1.0)
        ]
        for k in range(6)
    )
    folder = write_photographs(tmp_path / "photographs", map(np.dstack, planes), [2.0**-k for k in range(6)])
    curves = []
    with np.errstate(divide="ignore"):
        g = 2.2 * np.log(np.arange(256.0) / 128)
    for name in ("red", "green", "blue"):
        ResponseCurve(g, np.full(256, 1e-3), valid_dn=(3, 254), channel=name).write(tmp_path / f"{name}.yaml")
        curves += ["--response", str(tmp_path / f"{name}.yaml")]
    assert run(["merge", str(folder), "--channel", "each", *curves, "-o", str(tmp_path / "a.exr")]) == 0
    channels = OpenEXR.File(str(tmp_path / "a.exr"), separate_channels=True).channels()
    red, green, blue = (channels[name].pixels[:, 20:60].mean() for name in "RGB")
    assert red / green == pytest.approx(2.0, rel=0.01)
    assert green / blue == pytest.approx(2.0, rel=0.01)


def gamma_curve(power=2.2, size=256):
    """Return M/M_max to a power, nothing at 0."""
    with np.errstate(divide="ignore"):
        return ResponseCurve(power * np.log(np.arange(size) / (size // 2)), np.zeros(size))


def test_curves_are_read_back_by_pfstools_and_hdrgen(tmp_path):
    """Three matrices; a polynomial within 0.2 % of the curve."""
    write_curves(tmp_path / "c.m", {"mono": gamma_curve()})
    text = (tmp_path / "c.m").read_text()
    assert [line.split()[-1] for line in text.splitlines() if line.startswith("# name")] == ["IR", "IG", "IB"]
    rows = np.array([[float(v) for v in line.split()] for line in text.splitlines() if line and line[0] != "#"])
    first = rows[:256]
    assert rows.shape == (768, 3)
    np.testing.assert_array_equal(first[:, 1], np.arange(256))
    np.testing.assert_allclose(first[200, 2] / first[100, 2], 2**2.2, rtol=1e-6)
    np.testing.assert_allclose(10 ** first[50:, 0], first[50:, 2], rtol=1e-6)
    assert first[0, 0] == -6.0
    write_curves(tmp_path / "c.rsp", {"mono": gamma_curve()})
    lines = (tmp_path / "c.rsp").read_text().splitlines()
    assert len(lines) == 3
    order, *coefficients = (float(v) for v in lines[0].split())
    assert order == len(coefficients) - 1
    x = np.linspace(0, 1, 256)
    found = np.polyval(coefficients, x)
    assert found[-1] == pytest.approx(1.0, abs=1e-9)
    assert np.all(np.diff(found) >= 0)
    np.testing.assert_allclose(found, x**2.2, atol=3e-3)


def test_curves_of_other_programs_have_one_or_three_channels(tmp_path):
    """Two are refused; `curve-red.csv` is red's, any other name of no colour."""
    with pytest.raises(UsageError, match="blue"):
        write_curves(tmp_path / "c.m", {"red": gamma_curve(), "green": gamma_curve()})
    gamma_curve().write(tmp_path / "curve-red.csv")
    gamma_curve().write(tmp_path / "plain.csv")
    assert list(read_curves(tmp_path / "curve-red.csv")) == ["red"]
    assert list(read_curves(tmp_path / "plain.csv")) == ["mono"]


@pytest.mark.parametrize("ending", [".m", ".rsp"])
def test_what_we_write_for_others_we_read_back(tmp_path, ending):
    """Three channels come back within the polynomial's error over the middle, with an assumed u that is stated."""
    curves = {name: gamma_curve(power) for name, power in (("red", 1.8), ("green", 2.0), ("blue", 2.2))}
    write_curves(tmp_path / f"c{ending}", curves)
    found = read_curves(tmp_path / f"c{ending}")
    assert list(found) == ["red", "green", "blue"]
    for name, curve in found.items():
        expected = curves[name].log_exposure
        assert np.max(np.abs(curve.log_exposure[60:250] - expected[60:250])) < 0.02
        assert curve.log_exposure[128] == 0.0
        assert np.median(curve.u_log_exposure[10:250]) == pytest.approx(0.03)
        assert "states none" in curve.provenance.assumptions[0]


@pytest.mark.parametrize(
    ("name", "text"), [("a.m", "1 2\n3 4\n"), ("a.rsp", "3 1 0\n"), ("b.m", "x y z\n"), ("inf.rsp", "inf 1 0\n")]
)
def test_what_is_no_curve_is_refused(tmp_path, name, text):
    """With the file named, and no traceback."""
    (tmp_path / name).write_text(text)
    with pytest.raises(InputError, match=name):
        read_curves(tmp_path / name)
