"""Photographs give the same physics by the command line and in Python: radiances against those of the scene."""

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest
from PIL import Image

import radiometer as rm
from radiometer.cli.main import run
from radiometer.data import Flag, ResponseCurve
from radiometer.errors import CalibrationError, CaptureError, UsageError

pytestmark = pytest.mark.usefixtures("recovered_once")

# Whole stops: EXIF prints them exactly enough for the stop behind to be taken.
TIMES_S = tuple(2.0**-k for k in (9, 8, 7, 6, 5, 4))
SHAPE = (64, 96)


def scene(shape=SHAPE):
    """Return smooth radiances over a factor of some 60 with texture to align by, relative."""
    noise = np.random.default_rng(0).normal(size=shape)
    texture = sum(cv2.GaussianBlur(noise, (0, 0), sigma) * sigma for sigma in (3.0, 7.0))
    return np.exp(np.linspace(0.0, 1.5, shape[1])[None, :] + texture) / 30.0


def photographs(
    folder, light, *, times_s=TIMES_S, gamma=2.2, iso=100, late_s=0.0, colours=None, shifts=(), seed=1, tags=None
):
    """Write JPEG files as a camera with a response M = 255·H^(1/gamma) takes them, times and speed in EXIF."""
    folder.mkdir(parents=True)
    rng = np.random.default_rng(seed)
    for number, label in enumerate(times_s):
        seen = light
        if shifts:
            move = np.array([[1.0, 0.0, shifts[number]], [0.0, 1.0, 0.5 * shifts[number]]])
            seen = cv2.warpAffine(light, move, light.shape[::-1], flags=cv2.INTER_CUBIC)
        exposure = seen * (label + late_s) * 40.0 * (iso or 100) / 100.0
        planes = [exposure * part for part in colours] if colours else [exposure]
        dn = [255.0 * np.clip(one, 0.0, 1.0) ** (1.0 / gamma) + rng.normal(0.0, 0.6, one.shape) for one in planes]
        pixels = np.clip(np.rint(np.stack(dn, axis=-1)), 0, 255).astype(np.uint8)
        exif = Image.Exif()
        of_camera = {tag: value for tag, value in (tags or {}).items() if tag < 1000}
        exif.update(of_camera)
        exif.get_ifd(0x8769).update({33434: label, 33437: 8.0} | ({34855: iso} if iso else {}))
        exif.get_ifd(0x8769).update({tag: value for tag, value in (tags or {}).items() if tag not in of_camera})
        image = Image.fromarray(pixels if colours else pixels[..., 0])
        image.save(folder / f"p{number}.jpg", exif=exif, quality=98, subsampling=0)
    return folder


def exponent(found, light):
    """Return the slope of ln(value) over ln(true radiance) where the map is good."""
    good = (found.mask == 0) & (found.value > 0)
    assert good.mean() > 0.5
    return float(np.polyfit(np.log(light[good]), np.log(found.value[good].astype(float)), 1)[0])


def test_merged_photographs_are_proportional_to_the_scene(tmp_path):
    """JPEG of gamma 1/2.2: the exponent is 1, not 0.5, from the folder, from the stack, and by the command, alike."""
    light = scene()
    folder = photographs(tmp_path / "p", light)
    stack = rm.read_photographs(folder)
    found = rm.merge(stack)
    assert exponent(found, light) == pytest.approx(1.0, abs=0.03)
    assert "exposure times as stated by EXIF" in found.assumptions
    assert run(["merge", str(folder), "-o", str(tmp_path / "map.tiff")]) == 0
    by_path = rm.merge(folder)
    assert np.array_equal(by_path.value, found.value)
    assert np.array_equal(by_path.u, found.u)
    assert exponent(rm.merge(stack, linear=True), light) < 0.7  # only because it was asked for


@pytest.fixture(scope="module")
def curve():
    """Return the response M = 255·H^(1/2.2)."""
    g = 2.2 * np.log(np.maximum(np.arange(256.0), 0.25) / 128.0)
    return ResponseCurve(g, np.full(256, 5e-3), valid_dn=(4, 252))


@pytest.fixture
def calibrated(tmp_path, curve):
    """Return a calibration at ISO 100 by photographs of an even source of 0.5 W·sr⁻¹·m⁻²."""
    known = photographs(tmp_path / "known", np.full((40, 60), 0.5), times_s=TIMES_S[1:4], seed=7)
    found = rm.calibrate(
        known, response=curve, patch=(4, 4, 50, 30), radiance=0.5, u_rel=0.01, out=tmp_path / "cal.yaml"
    )
    assert found.to_mapping()["scale"]["iso"] == 100
    return found.calibration


CAMERA_TAGS: dict[int, str | int | float] = {
    271: "Maker", 272: "Model", 42033: "1", 37386: 50.0, 41987: 1, 41992: 0, 41993: 0, 41985: 0, 41990: 0,
}  # fmt: skip


@pytest.mark.parametrize(
    ("other", "said"),
    [
        ({272: "Another"}, "model"), ({42033: "2"}, "serial"), ({37386: 85.0}, "a lens of 50 mm"),
        ({41987: 0}, "white balance"), ({37384: 3}, "white balance"), ({41992: 2}, "mode Contrast 0"),
        ({41993: 1}, "Saturation"), ({41985: 1}, "CustomRendered"),
    ],
)  # fmt: skip
def test_photographs_of_another_camera_or_development_are_not_read_by_a_calibration(tmp_path, curve, other, said):
    """What EXIF states of camera, lens and development is kept by a calibration, and refused where it differs."""
    even = np.full((40, 60), 0.5)
    known = photographs(tmp_path / "known", even, times_s=TIMES_S[1:4], seed=7, tags=CAMERA_TAGS)
    asked = {"response": curve, "patch": (4, 4, 50, 30), "radiance": 0.5, "u_rel": 0.01}
    calibration = rm.calibrate(known, out=tmp_path / "cal.yaml", **asked).calibration
    same = photographs(tmp_path / "same", even, times_s=TIMES_S[1:4], seed=8, tags=CAMERA_TAGS)
    read = rm.measure_photographs(same, (4, 4, 50, 30), calibration=calibration)
    assert read.radiance.value == pytest.approx(0.5, rel=0.03)
    changed = photographs(tmp_path / "changed", even, times_s=TIMES_S[1:4], seed=8, tags=CAMERA_TAGS | other)
    for ask in (lambda: rm.measure_photographs(changed, (4, 4, 50, 30), calibration=calibration),
                lambda: rm.merge(changed, calibration=calibration)):  # fmt: skip
        with pytest.raises(CalibrationError, match=said):
            ask()


def test_a_response_holds_for_the_camera_that_it_was_recovered_from(tmp_path, curve):
    """Its file keeps camera and development; others are refused everywhere. Of a curve without them a doubt is left."""
    own = photographs(tmp_path / "own", scene(), tags=CAMERA_TAGS)
    rm.recover_response(own, "linear_spline", output=tmp_path / "curve.yaml")
    asked = {"patch": (4, 4, 8, 8), "radiance": 0.5, "u_rel": 0.01}
    others = ({272: "Another"}, "its model"), ({42033: "2"}, "its serial"), ({41992: 2}, "mode Contrast 0")
    for number, (tags, said) in enumerate(others):
        changed = photographs(tmp_path / str(number), scene(), times_s=TIMES_S[:2], seed=8, tags=CAMERA_TAGS | tags)
        with pytest.raises(CalibrationError, match=said):
            rm.merge(changed, tmp_path / "curve.yaml")
        with pytest.raises(CalibrationError, match=said):
            rm.calibrate(changed, response=tmp_path / "curve.yaml", **asked)
        with pytest.raises(CalibrationError, match=said):
            rm.recover_response([own, changed], "linear_spline")
    doubt = "the response curve does not state its camera: it counts as that of this one"
    found = [rm.merge(own, one).assumptions for one in (tmp_path / "curve.yaml", curve)]
    assert [doubt in one for one in found] == [False, True]


def test_an_automatic_white_balance_is_an_assumption_of_every_value(tmp_path):
    """The camera weighs the colours by what it sees; photographs of one bracket must agree in what they state of it."""
    folder = photographs(tmp_path / "p", scene(), tags=CAMERA_TAGS | {41987: 0})
    assert any("white balance is automatic" in one for one in rm.merge(folder).assumptions)
    photographs(tmp_path / "q", scene(), times_s=TIMES_S[:1], tags=CAMERA_TAGS)
    (tmp_path / "q" / "p0.jpg").rename(folder / "q0.jpg")
    with pytest.raises(CaptureError, match=r"q0\.jpg manual|white balance automatic, q0"):
        rm.read_photographs(folder)


@pytest.mark.parametrize("iso", [100, 400])
def test_photographs_of_another_iso_read_right(tmp_path, calibrated, iso):
    """Numbers of ISO 400 are four times as large: map and reading are of the light that was there all the same."""
    folder = photographs(tmp_path / "other", np.full((40, 60), 0.2), iso=iso, times_s=TIMES_S[1:4], seed=8)
    stack = rm.read_photographs(folder)
    reading = rm.measure_photographs(stack, (4, 4, 50, 30), calibration=calibrated, spectrum="equal_energy")
    assert reading.radiance.value == pytest.approx(0.2, rel=0.03)
    assert np.median(rm.merge(stack, calibration=calibrated).value) == pytest.approx(0.2, rel=0.03)
    assert any(line.name == "gain step" and line.u_rel > 0 for line in reading.budget) == (iso == 400)


def test_a_speed_that_one_side_does_not_state_is_assumed_or_refused(tmp_path, calibrated):
    """Photographs without a speed are treated as the calibration's, in words; a scale without one is refused."""
    silent = photographs(tmp_path / "silent", np.full((40, 60), 0.2), iso=None, times_s=TIMES_S[1:4])
    assert any("treated as taken at ISO 100" in one for one in rm.merge(silent, calibration=calibrated).assumptions)
    stated = rm.measure_photographs(silent, (4, 4, 50, 30), calibration=calibrated, iso=100, spectrum="equal_energy")
    assert stated.radiance.value == pytest.approx(0.2, rel=0.03)
    unknown = replace(calibrated, scale=calibrated.scale.model_copy(update={"iso": None}))
    reported = photographs(tmp_path / "stated", np.full((40, 60), 0.2), times_s=TIMES_S[1:4])
    with pytest.raises(CalibrationError, match="does not say at which ISO speed"):
        rm.measure_photographs(reported, (4, 4, 50, 30), calibration=unknown)


def test_a_calibration_of_one_colour_reads_no_other(tmp_path, curve):
    """Green's scale is refused for red and for luminance, by commands and functions, and takes green."""
    colours = (0.6, 1.0, 0.8)
    known = photographs(tmp_path / "known", np.full((40, 60), 0.5), times_s=TIMES_S[1:4], colours=colours)
    patch, green = (4, 4, 50, 30), replace(curve, channel="green")
    found = rm.calibrate(known, response=green, channel="green", patch=patch, radiance=0.5, u_rel=0.01)
    stack = rm.read_photographs(known)
    for channel in ("red", "blue"):
        with pytest.raises(UsageError, match="calibration is of green"):
            rm.merge(stack[channel], calibration=found.calibration)
    with pytest.raises(UsageError, match="calibration is of green"):
        rm.measure_photographs(known, patch, calibration=found.calibration)
    assert np.median(rm.merge(stack["green"], calibration=found.calibration).value) == pytest.approx(0.5, rel=0.02)


def test_exposures_that_nothing_confirms_are_assumed_and_count_in_u(tmp_path, curve):
    """A shutter 0.1 ms late at 1/500 s: the assumption is named, and u of the brightest pixels holds the error."""
    light = np.full((40, 60), 8.0)  # clips in all but the shortest
    late = photographs(tmp_path / "p", light, times_s=(2.0**-9, 2.0**-8, 2.0**-7, 2.0**-6), late_s=1e-4)
    found = rm.merge(late, curve, align="off")
    assert "exposure times as stated by EXIF" in found.assumptions
    error = 1e-4 / 2.0**-9
    assert np.median(found.u / found.value) > 0.4 * error


def test_photographs_are_reconciled_in_python(tmp_path):
    """Labels that agree with the pictures: the stack gives the verdict of the command."""
    folder = photographs(tmp_path / "p", scene())
    found = rm.reconcile(rm.read_photographs(folder))
    assert found.verdict == rm.reconcile(folder).verdict == "agrees"


def test_several_patterns_are_asked_for_by_command_and_function(tmp_path, capsys):
    """Neither takes the first of two without a word; both take the chosen one."""
    capture = two_patterns(tmp_path / "set")
    with pytest.raises(UsageError, match="holds 2 patterns"):
        rm.merge(rm.read(capture))
    words = ["merge", str(capture), "-o", str(tmp_path / "map.exr")]
    assert run(words) == 2
    assert "--pattern" in capsys.readouterr().err
    assert run([*words, "--pattern", "inverted", "--json"]) == 0
    median = json.loads(capsys.readouterr().out)["values"]["median"]
    assert median == float(np.median(rm.merge(rm.read(capture), pattern="inverted").value))


def two_patterns(folder, **camera):
    """Write a capture set of two displayed patterns, 1000 and 2000 DN above a black level of 64 that frames state."""
    from radiometer.data import CameraDescription, CaptureSetWriter, Frame, FrameSettings, LensDescription

    with CaptureSetWriter(folder, CameraDescription(bit_depth=12, **camera), LensDescription()) as writer:
        for pattern, level in (("chart", 1000.0), ("inverted", 2000.0)):
            for time_s in (0.5, 1.0):
                dn = np.full((12, 16), 64.0 + level * time_s).astype(np.uint16)
                writer.add(Frame(dn, 12, FrameSettings(time_s, black_level_dn=64.0, pattern=pattern)))
    return folder


def test_the_frames_own_black_level_comes_before_the_cameras(tmp_path):
    """Frames say 64 DN, the camera 0: with a response the values go as the light, 2 to 1 between two exposures."""
    capture = two_patterns(tmp_path / "set", black_level_dn=0.0)
    dn = np.arange(4096.0)
    line = ResponseCurve(np.log(np.maximum(dn - 64.0, 0.25) / 1984.0), np.full(4096, 1e-3), valid_dn=(70, 4090))
    values = [np.median(rm.merge(capture, line, pattern=name).value) for name in ("chart", "inverted")]
    assert values[1] / values[0] == pytest.approx(2.0, rel=1e-3)


def test_a_stack_and_its_brackets_print_no_pixels(tmp_path):
    """One line each, however many frames."""
    stack = rm.read_photographs(photographs(tmp_path / "p", scene(), times_s=TIMES_S[:3]))
    for shown in (repr(stack), str(stack), repr(stack.bracket), repr(rm.merge(stack, linear=True, align="off"))):
        assert len(shown) < 250
        assert "\n" not in shown
        assert "array" not in shown


def test_a_light_meter_s_scale_counts_the_ratio_of_speeds(tmp_path, curve):
    """K at ISO 100, 200 and 400, photographs at ISO 100: speed and gain go together, the reading is the same."""
    folder = photographs(tmp_path / "p", np.full((40, 60), 0.5), times_s=TIMES_S[1:4])
    values = []
    for iso in (100, 200, 400):
        scale = rm.calibrate(response=curve, luminance_meter_k=12.5, f_number=8.0, exposure_s=1 / 128, iso=iso)
        reading = rm.measure_photographs(folder, (4, 4, 50, 30), calibration=scale.calibration)
        values.append(reading.radiance.value)
    # H_ref = L·π/(4N²)·t with L = N²K/(tS) is half at twice the speed, and the gain of ISO 100 is half of ISO 200's.
    assert values == pytest.approx([values[0]] * 3, rel=1e-4)


def test_flags_of_a_relative_reading_of_photographs(tmp_path):
    """Two patches of a gamma curve, recovered: their ratio is that of the light; values are relative."""
    light = scene()
    folder = photographs(tmp_path / "p", light)
    one, other = (
        rm.measure_photographs(folder, patch, uncalibrated=True) for patch in ((12, 40, 6, 6), (80, 40, 6, 6))
    )
    truth = light[40:46, 80:86].mean() / light[40:46, 12:18].mean()
    assert other.radiance.value / one.radiance.value == pytest.approx(truth, rel=0.06)
    assert Flag.UNCALIBRATED in one.flags
