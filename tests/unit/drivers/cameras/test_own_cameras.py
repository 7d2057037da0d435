"""Webcams, the Raspberry Pi's camera and tethered cameras, each on a simulated device at its library's edge."""

import subprocess
import sys
import textwrap
from pathlib import Path

import numpy as np
import pytest
import yaml

from drivers.cameras import own_cameras
from drivers.cameras.pi_link import PiLink, green_of
from drivers.cameras.plain_camera import PlainCamera
from drivers.cameras.tethered_link import TetheredLink, seconds_of
from drivers.cameras.v4l2_link import Control, V4l2Link, plain_numbers
from radiometer.bench.cameras import open_camera
from radiometer.bench.config import read_bench
from radiometer.cli.main import run
from radiometer.data import CaptureSet, LensDescription
from radiometer.devices import CameraIdentity, CameraSettings, Health, Roi
from radiometer.errors import DeviceError, DeviceInUse, DeviceLost, DeviceTimeout, MissingLibrary
from testing.edge_devices import SimulatedPiCamera, SimulatedTether, SimulatedWebcam, dng_bytes, mosaic_of
from testing.patience import within

DN_PER_S = 20_000.0  # of the even field, above black, at gain 0 dB and in the numbers of each camera


def even(request) -> np.ndarray:
    """Return an even picture without noise: black level and signal, clipped at full scale."""
    signal = DN_PER_S * request.exposure_s * 10 ** (request.gain_db / 20)
    level = round(min(request.black_level_dn + signal, (1 << request.bit_depth) - 1))
    return np.full((request.height, request.width), level, np.uint16)


@pytest.fixture
def webcam():
    """Return a simulated webcam and the camera in front of it."""
    device = SimulatedWebcam(even, 32, 24)
    return device, PlainCamera(V4l2Link(CameraIdentity("", "C920", "", "v4l2:/dev/video0"), device.open))


@pytest.fixture
def pi():
    """Return a simulated Raspberry Pi camera and the camera in front of it."""
    device = SimulatedPiCamera(even, 32, 24)
    return device, PlainCamera(PiLink(CameraIdentity("Raspberry Pi", "imx477", "", "picamera:0"), device.open))


@pytest.fixture
def body():
    """Return a simulated tethered camera and the camera in front of it."""
    pytest.importorskip("rawpy")
    device = SimulatedTether(even, 32, 24)
    return device, PlainCamera(TetheredLink(CameraIdentity("", "EOS 5D", "", "gphoto2:usb:001,004"), device.open))


def test_a_webcam_is_set_in_units_of_100_microseconds(webcam):
    """5 ms are 50 units, read back in s; three frames of the old exposure are thrown away after a change."""
    device, camera = webcam
    with camera:
        assert camera.capabilities.exposure_s == pytest.approx((1e-4, 2.0))
        assert camera.configure(CameraSettings(0.00503, pixel_format="Mono8")).exposure_s == pytest.approx(0.005)
        assert device.values["exposure_time_absolute"].value == 50
        assert set(camera.capture(1)[0].dn.ravel()) == {100}
    _, camera = webcam
    with camera:
        camera.configure(CameraSettings(0.005, pixel_format="Mono8"))
        camera.capture(1)
        camera.configure(CameraSettings(0.01, pixel_format="Mono8"))
        assert [int(frame.dn[0, 0]) for frame in camera.capture(2)] == [200, 200]


def test_what_a_webcam_does_by_itself_is_switched_off(webcam):
    """Exposure, white balance, gain, gamma and the rest stand at what falsifies least, each reported."""
    device, camera = webcam
    with camera:
        values = {name: control.value for name, control in device.values.items()}
        checks = {finding.check: finding for finding in camera.findings()}
    assert {name: values[name] for name in ("auto_exposure", "white_balance_automatic", "gamma", "gain")} == {
        "auto_exposure": 1, "white_balance_automatic": 0, "gamma": 100, "gain": 0,
    }  # fmt: skip
    assert (values["brightness"], values["sharpness"], values["backlight_compensation"]) == (0, 0, 0)
    assert checks["control gamma"].health is Health.NOTE
    assert "tone curve" in checks
    assert "recover it with `radiometer response`" in checks["tone curve"].cure


@pytest.mark.parametrize(
    ("change", "reason"),
    [({"locked": frozenset({"gamma"})}, "is inactive"), ({"gamma": Control(160, 300, 1, 220, 220)}, "from 160")],
    ids=["locked", "no 1.0"],
)
def test_a_gamma_that_stays_is_warned_of(webcam, change, reason):
    """A webcam whose gamma cannot be made 1 is used all the same, with a warning that says what to do."""
    device, camera = webcam
    device.locked = change.get("locked", frozenset())
    device.values |= {name: value for name, value in change.items() if name == "gamma"}
    with camera:
        (found,) = [f for f in camera.findings() if f.check == "control gamma"]
    assert found.health is Health.WARNING
    assert reason in found.message


@pytest.mark.parametrize(
    ("codes", "message"), [(("MJPG", "H264"), r"no plain numbers \(only H264, MJPG\)"), (None, "no exposure control")]
)
def test_a_webcam_that_cannot_measure_is_refused(webcam, codes, message):
    """Compressed formats alone, or no exposure control: it says so, and is not left open."""
    device, camera = webcam
    if codes:
        device.codes = codes
    else:
        del device.values["exposure_time_absolute"]
    with pytest.raises(DeviceError, match=message):
        camera.open()
    assert not device.is_open


@pytest.mark.parametrize(
    ("fourcc", "payload", "expected"),
    [
        ("GREY", bytes([1, 2, 3, 4]), [[1, 2], [3, 4]]),
        ("YUYV", bytes([1, 128, 2, 128, 3, 128, 4, 128]), [[1, 2], [3, 4]]),
        ("Y16 ", bytes([1, 0, 0, 1, 2, 0, 255, 255]), [[1, 256], [2, 65535]]),
        ("Y10 ", bytes([255, 3, 0, 2, 0, 0, 1, 0]), [[1023, 512], [0, 1]]),
    ],
)
def test_bytes_of_a_video_frame_become_numbers(fourcc, payload, expected):
    """Words are little-endian; of YUYV every other byte is the luma."""
    assert plain_numbers(payload, fourcc, 2, 2).tolist() == expected
    with pytest.raises(DeviceError, match="but only"):
        plain_numbers(payload[:-1], fourcc, 2, 2)


def test_the_deepest_format_of_the_video_subsystem_is_taken(webcam):
    """Where there are 16-bit words they come first; grey and luma are one format, and both stay on offer once."""
    device, camera = webcam
    device.codes = ("YUYV", "Y16 ", "GREY", "MJPG")
    with camera:
        assert camera.capabilities.pixel_formats == ("Mono16", "Mono8")
        assert camera.settings.pixel_format == "Mono16"


@pytest.mark.parametrize("which", ["webcam", "pi", "body"])
def test_a_camera_that_is_unplugged_is_lost_and_can_be_opened_again(which, request):
    """Its loss is reported, everything after it too, and once it is back the same object opens."""
    device, camera = request.getfixturevalue(which)
    with camera:
        camera.capture(1)
        device.is_unplugged = True
        with pytest.raises(DeviceLost):
            camera.capture(1)
        device.is_unplugged = False
        with pytest.raises(DeviceLost, match="open it again"):
            camera.capture(1)
    with camera:
        assert len(camera.capture(1)) == 1


def test_an_opening_that_fails_leaves_the_camera_to_be_tried_again(webcam):
    """A device held elsewhere is in use; once it is free the same object opens."""
    device, camera = webcam
    device.is_open = True
    with pytest.raises(DeviceInUse):
        camera.open()
    device.is_open = False
    with camera:
        assert camera.counts.frames == 0


@pytest.mark.parametrize(("which", "link"), [("webcam", V4l2Link), ("pi", PiLink), ("body", TetheredLink)])
def test_a_program_opens_a_camera_once(which, link, request):
    """Also where the library would let it be opened twice: the second is refused until the first is closed."""
    device, camera = request.getfixturevalue(which)
    again = PlainCamera(link(camera.identity, device.open))
    with camera, pytest.raises(DeviceInUse, match="by this program already"):
        again.open()
    with again:
        assert len(again.capture(1)) == 1


def test_a_pis_frame_says_what_it_was_taken_with(pi):
    """µs and a factor become s and dB, black 12 bits; frames of the settings before are known by their metadata."""
    _, camera = pi
    with camera:
        assert camera.capabilities.exposure_s == pytest.approx((31e-6, 200.0))
        assert camera.capabilities.gain_db == pytest.approx((0.0, 24.0824), abs=1e-4)
        assert camera.capabilities.black_level_dn == (256.0, 256.0)
        camera.configure(CameraSettings(0.01, gain_db=6.0206, black_level_dn=256, pixel_format="Mono12"))
        frame = camera.capture(1)[0]
    assert frame.settings.exposure_s == pytest.approx(0.01)
    assert frame.settings.gain_db == pytest.approx(6.0206, abs=1e-6)
    assert (frame.bit_depth, frame.settings.temperature_c) == (12, 40.0)
    assert int(frame.dn[0, 0]) == 256 + 400
    device, camera = pi
    device.stale = 7
    with camera:
        camera.configure(CameraSettings(0.02, black_level_dn=256, pixel_format="Mono12"))
        assert int(camera.capture(1)[0].dn[0, 0]) == 256 + 400
        device.stale = 40
        camera.configure(CameraSettings(0.04, black_level_dn=256, pixel_format="Mono12"))
        with pytest.raises(DeviceTimeout, match="frames of other settings"):
            camera.capture(1)


@pytest.mark.parametrize(("mosaic", "first"), [("RGGB", 2), ("GRBG", 1), ("GBRG", 1), ("BGGR", 2)])
def test_green_pixels_are_taken_from_any_mosaic(mosaic, first):
    """The first green of each 2 × 2 comes out at half size; a grey sensor's frame stays as it is."""
    numbers = np.array([[1, 2, 1, 2], [3, 4, 3, 4]], np.uint16)
    assert green_of(numbers, mosaic).tolist() == [[first, first]]
    assert green_of(numbers, "") is numbers


@pytest.mark.parametrize(
    ("text", "seconds"),
    [
        ("1/250", 2.0**-8), ("1/60", 2.0**-6), ("1/10", 2.0 ** (-10 / 3)), ("30", 32.0), ("0.5", 0.5),
        ("0.4", 2.0 ** (-4 / 3)), ("0.0037s", 0.0037), ("bulb", None), ("Auto", None), ("1/0", None), ("-1", None),
    ],
)  # fmt: skip
def test_a_shutters_entry_means_the_stop_behind_it(text, seconds):
    """Printed times are third stops; any other time is itself; bulb is none."""
    found = seconds_of(text)
    assert found is None if seconds is None else found == pytest.approx(seconds, rel=1e-9)


def test_a_tethered_camera_gives_the_green_pixels_of_its_raw_file(body):
    """Green pixels, bits and black of the raw file, the stop behind the dial; a frame of a region has no file."""
    device, camera = body
    with camera:
        in_force = camera.configure(CameraSettings(0.0041, gain_db=6.0, black_level_dn=512, pixel_format="Mono14"))
        frame = camera.capture(1)[0]
        assert (camera.identity.vendor, camera.identity.serial) == ("Canon Inc.", "042031001234")
    assert (in_force.exposure_s, in_force.gain_db) == (2.0**-8, pytest.approx(6.0206))
    assert (device.read("shutterspeed"), device.read("iso"), device.read("imageformat")) == ("1/250", "200", "RAW")
    assert device.read("autoexposuremode") == "Manual"
    assert frame.shape == (24, 32)
    assert frame.bit_depth == 14
    assert int(frame.dn[0, 0]) == round(512 + DN_PER_S * 2.0**-8 * 2)
    assert frame.settings.f_number == pytest.approx(4.0)
    assert frame.settings.black_level_dn == 512
    with body[1] as camera:
        camera.configure(CameraSettings(0.004, 0.0, 512, "Mono14", roi=Roi(2, 2, 8, 8)))
        assert camera.capture(1)[0].file is None
        camera.configure(CameraSettings(0.004, 0.0, 512, "Mono14"))
        assert camera.capture(1)[0].file is not None


def test_a_mode_dial_that_cannot_be_turned_by_wire_is_a_fault(body):
    """A camera that chooses the exposure itself is a fault, with the cure; one that sends JPEG is refused."""
    device, camera = body
    device.settings["autoexposuremode"] = ("AV", [])
    with camera:
        (found,) = [f for f in camera.findings() if f.check == "setting autoexposuremode"]
    assert found.health is Health.FAULT
    assert "chooses the exposure itself" in found.message
    device, camera = body
    device.settings["imageformat"] = ("Large Fine JPEG", ["Large Fine JPEG", "Small JPEG"])
    with pytest.raises(DeviceError, match=r"sends JPEG .* set its quality to raw"):
        camera.open()
    assert not device.is_open


def test_a_bracket_of_a_tethered_camera_is_a_capture_set_of_its_raw_files(body, monkeypatch, tmp_path):
    """`bracket --camera gphoto2:…` keeps the files that the camera gave, byte for byte, exact times next to them."""
    device, camera = body
    given: list[bytes] = []
    taken = type(device).capture

    def capture(self: SimulatedTether, deadline_s: float) -> tuple[str, bytes]:
        name, content = taken(self, deadline_s)
        given.append(content)
        return name, content

    monkeypatch.setattr(SimulatedTether, "capture", capture)
    monkeypatch.setattr(own_cameras, "open_own", lambda _name, _lens, _preset: camera)
    folder = tmp_path / "set"
    words = ["bracket", str(folder), "--camera", "gphoto2:usb:001,004", "--from", "1ms", "--to", "16ms"]
    assert run(words) == 0
    written = yaml.safe_load((folder / "capture.yaml").read_text(encoding="utf-8"))
    assert written["camera"]["bit_depth"] == 14
    assert written["camera"]["model"] == "EOS 5D"
    assert [frame["exposure_s"] for frame in written["frames"]] == [2.0**-10, 2.0**-9, 2.0**-8, 2.0**-7, 2.0**-6]
    assert {(frame["f_number"], frame["black_level_dn"]) for frame in written["frames"]} == {(4.0, 512.0)}
    files = [folder / frame["file"] for frame in written["frames"]]
    assert {file.suffix for file in files} == {".dng"}
    assert [file.read_bytes() for file in files] == given[-5:]
    # Read again, every frame is the green pixels of its file: black level and signal of its own time.
    levels = [int(frame.dn[5, 7]) for frame in CaptureSet.read(folder).frames()]
    assert levels == [round(512 + DN_PER_S * 2.0**exponent) for exponent in (-10, -9, -8, -7, -6)]


def test_a_bench_file_names_such_a_camera(webcam, monkeypatch, tmp_path):
    """`kind: v4l2` with a path opens it, in the nearest format that it has, its lens being the bench's."""
    asked = []

    def open_own(name: str, lens: LensDescription, _preset: object) -> PlainCamera:
        asked.append((name, lens.f_number))
        return webcam[1]

    monkeypatch.setattr(own_cameras, "open_own", open_own)
    file = tmp_path / "bench.yaml"
    file.write_text("camera: {kind: v4l2, id: /dev/video2}\nlens: {focal_length_mm: 4, f_number: 2}\n", "utf-8")
    camera = open_camera(*read_bench(file))
    assert asked == [("v4l2:/dev/video2", 2.0)]
    assert camera.settings.pixel_format == "Mono8"
    camera.close()


@pytest.mark.parametrize("library", ["linuxpy", "picamera2", "gphoto2"])
def test_without_its_library_the_message_says_what_to_install(library, monkeypatch):
    """A library that is not there is reported by name, and the doctor notes it."""
    monkeypatch.setitem(sys.modules, library, None)
    monkeypatch.setitem(sys.modules, f"{library}.video.device", None)
    kind = {"linuxpy": "v4l2", "picamera2": "picamera", "gphoto2": "gphoto2"}[library]
    with pytest.raises(MissingLibrary, match=r"(pip|apt) install"):
        own_cameras.open_own(f"{kind}:")
    (finding,) = [f for f in own_cameras.check_libraries() if f.check == f"library {kind}"]
    assert finding.health is Health.NOTE


VIRTUAL = """
    import os, sys, time
    from pathlib import Path
    import gphoto2
    libraries = Path(gphoto2.__file__).parent / "libgphoto2"
    os.environ["IOLIBS"], os.environ["VCAMERADIR"] = str(libraries / "vusb"), sys.argv[1]
    from drivers.cameras.own_cameras import listed, open_own
    from radiometer.devices import CameraSettings
    print([one.device_id for one in listed()[0]])
    with open_own("gphoto2:") as camera:
        print(camera.identity.vendor, camera.identity.model)
        for exposure_s in (0.001, 0.1):
            settings = camera.configure(CameraSettings(exposure_s, 0.0, 64.0, "Mono12"))
            frame = camera.capture(1)[0]
            print(round(settings.exposure_s, 5), frame.bit_depth, frame.dn[0, 0], frame.settings.f_number)
"""


@pytest.mark.slow
def test_the_real_libgphoto2_takes_a_bracket_with_its_virtual_camera(tmp_path, project_root):
    """libgphoto2's own virtual camera: its dial is set and read back, and a raw file comes through the library."""
    gphoto2 = pytest.importorskip("gphoto2")
    if not (Path(gphoto2.__file__).parent / "libgphoto2" / "vusb").is_dir():
        pytest.skip("this libgphoto2 has no virtual camera")
    folder = tmp_path / "DCIM" / "100NIKON"
    folder.mkdir(parents=True)
    green = np.full((24, 32), 1000, np.uint16)
    # The virtual camera hands out copies of its first .jpg: here a raw file under that name.
    (folder / "DSC_0001.jpg").write_bytes(dng_bytes(mosaic_of(green, 64), 64, 4095))
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(VIRTUAL), str(tmp_path)],
        cwd=project_root, capture_output=True, text=True, timeout=within(120), check=False,
    )  # fmt: skip
    assert done.stdout.splitlines() == [
        "['gphoto2:usb:001,001']",
        "GP Nikon DSC D750",
        "0.0012 12 1000 2.8284271247461903",
        "0.09921 12 1000 2.8284271247461903",
    ], done.stderr
