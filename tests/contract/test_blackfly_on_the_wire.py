"""The simulated Blackfly over GigE Vision: real pictures, real traps, real faults."""

import itertools
import shutil
import subprocess
import sys
import threading
import time
from dataclasses import replace

import numpy as np
import pytest

from drivers.cameras.aravis_camera import AravisCamera, open_camera
from radiometer.data import LensDescription
from radiometer.data.mosaic import COLOURS, plane_of
from radiometer.devices import CameraIdentity, CameraPreset, CameraSettings, Roi
from radiometer.errors import DeviceInUse, DeviceLost, DeviceNotFound, DeviceTimeout
from simulators.cameras.blackfly_gige import BlackflyGige
from simulators.cameras.blackfly_pictures import ForwardModelSource
from simulators.cameras.colour_filters import ColourFilters
from simulators.cameras.simulated_camera import SimulatedCamera, default_limits
from simulators.chain.camera_model import CameraModel
from simulators.scenes import scene_from_mapping
from testing.patience import ENDS_WITH_US, within

LOOPBACK = "127.0.0.1"
SETTINGS = CameraSettings(exposure_s=0.004, black_level_dn=64, pixel_format="Mono12")


RADIANCE = 0.4  # W·sr⁻¹·m⁻² of the even field that the `blackfly` fixture looks at
K_E_PER_DN, READ_E, QE, PITCH_M, WAVELENGTH_M = 5.95, 5.4, 0.62, 4.5e-6, 550e-9  # its preset
PHOTON_J = 6.62607015e-34 * 299_792_458 / WAVELENGTH_M


def opened():
    return open_camera(LOOPBACK, lens=LensDescription(focal_length_mm=16, f_number=4.0))


def position_code(request):
    """Return a picture in which every pixel says where it is."""
    columns = np.arange(request.x, request.x + request.width)
    rows = np.arange(request.y, request.y + request.height)
    return (columns[None, :] + 20 * rows[:, None]).astype(np.uint16)


def assert_brightness(frame, in_force):
    """Hold the mean of a frame against E = πL/(4N²) of its own settings, within 5 sigma of that mean."""
    irradiance = np.pi * RADIANCE / (4 * 4.0**2)
    electrons = irradiance * PITCH_M**2 * in_force.exposure_s / PHOTON_J * QE
    gain = 10 ** (in_force.gain_db / 20) / K_E_PER_DN
    sigma = np.sqrt((gain**2 * (electrons + READ_E**2) + 1 / 12) / frame.dn.size)
    dark = 0.1 * gain  # 4.4 e⁻/s at 40 °C, over 10 ms at most
    assert frame.dn.mean() == pytest.approx(in_force.black_level_dn + gain * electrons, abs=5 * sigma + dark + 0.01)


def test_it_is_the_camera_of_its_preset(blackfly):
    """Vendor, model and serial number come over the wire, and the preset is found by the model."""
    with opened() as camera:
        assert (camera.identity.vendor, camera.identity.model) == ("FLIR", "BFS-U3-19S4M")
        assert camera.identity.serial == "22500077"
        assert camera.description.pixel_pitch_um == 4.5


def test_what_falsifies_as_shipped_is_switched_off(blackfly):
    """Automatic exposure, gamma and sharpening are on when it is shipped, and off once the driver has opened it."""
    with opened() as camera:
        switched = {f.feature.name for f in camera.session.hygiene if f.state == "switched_off"}
        assert {"ExposureAuto", "GainAuto", "GammaEnable", "SharpeningEnable"} <= switched
        assert not [f for f in camera.session.hygiene if f.state == "still_on"]


def test_gamma_left_on_bends_the_signal(blackfly):
    """With GammaEnable on, twice the exposure is not twice the signal: the feature is no dummy."""
    with opened() as camera:
        camera.configure(replace(SETTINGS, black_level_dn=0))
        camera.session.features.write("GammaEnable", True)
        camera.session.features.write("Gamma", 0.5)
        single = np.mean(camera.capture(1)[0].dn)
        camera.configure(replace(SETTINGS, black_level_dn=0, exposure_s=0.008))
        assert np.mean(camera.capture(1)[0].dn) / single == pytest.approx(2**0.5, rel=0.01)


def test_a_region_is_cut_from_the_same_place(aravis_installed, gige_port):
    """A region shows the pixels that the whole frame has there."""
    limits = replace(default_limits(), width=160, height=120, has_shutter=False)
    with BlackflyGige(position_code, limits, serial="22500077"), opened() as camera:
        camera.configure(SETTINGS)
        whole = camera.capture(1)[0].dn
        camera.configure(replace(SETTINGS, roi=Roi(40, 20, 32, 16)))
        part = camera.capture(1)[0].dn
    np.testing.assert_array_equal(part, whole[20:36, 40:72])


@pytest.mark.parametrize("triggered", [False, True], ids=["free running", "software trigger"])
def test_a_change_of_settings_is_never_mixed_into_a_frame(blackfly, triggered):
    """Over random changes of exposure, gain and black level, every frame has the brightness of its own settings."""
    rng = np.random.default_rng(11)
    with opened() as camera:
        for _ in range(12):
            expected = replace(
                SETTINGS,
                exposure_s=float(np.exp(rng.uniform(np.log(1e-4), np.log(8e-3)))),
                gain_db=float(rng.uniform(0, 6)),
                black_level_dn=float(rng.integers(20, 200)),
                software_trigger=triggered,
            )
            in_force = camera.configure(expected)
            for frame in camera.capture(2):
                assert_brightness(frame, in_force)
                assert frame.settings.temperature_c == pytest.approx(40.0)


def test_lost_packets_are_retried_and_no_damaged_frame_is_passed_on(blackfly):
    """With packets lost, every frame that arrives is whole and the retries are counted."""
    blackfly.lose_packets(150)
    with opened() as camera:
        in_force = camera.configure(SETTINGS)
        for frame in camera.capture(10):
            assert_brightness(frame, in_force)
            assert int(frame.dn.min()) > 64
        assert camera.counts.retried > 0
        assert camera.counts.incomplete == camera.counts.retried


def test_a_stalled_camera_is_a_timeout_and_recovers(blackfly):
    """A camera that answers but sends nothing raises DeviceTimeout; when it sends again it works as before."""
    with AravisCamera(CameraIdentity("", "", "", LOOPBACK), frame_deadline_s=0.3) as camera:
        camera.configure(SETTINGS)
        blackfly.stall(stalled=True)
        with pytest.raises(DeviceTimeout, match=r"22500077.*though it answers"):
            camera.capture(1)
        blackfly.stall(stalled=False)
        assert camera.capture(1)


def test_a_slow_camera_is_waited_for(blackfly):
    """Frames and answers that are late within the deadline are no error."""
    with opened() as camera:
        camera.configure(SETTINGS)
        blackfly.answer_slowly(0.4)
        assert len(camera.capture(2)) == 2
        blackfly.answer_slowly(0.0)


def test_a_camera_that_disappears_is_named_and_can_be_opened_again(blackfly):
    """DeviceLost names the camera within the deadline; once it is back, the same object opens and captures."""
    camera = opened()
    with camera:
        camera.configure(SETTINGS)
        frames = camera.stream()
        next(frames)
        blackfly.disconnect()
        start = time.monotonic()
        with pytest.raises(DeviceLost, match="22500077"):
            list(frames)
        assert time.monotonic() - start < within(15.0)
    blackfly.close()
    blackfly.open()
    with camera:
        camera.configure(SETTINGS)
        assert len(camera.capture(1)) == 1


def test_an_address_without_a_camera_is_reported(gige_port, aravis_installed):
    """Opening where nothing answers says so, with the address."""
    with pytest.raises(DeviceNotFound, match=r"127\.0\.0\.1 does not answer"):
        open_camera(LOOPBACK).open()


def test_another_program_that_holds_the_camera_is_distinguished_from_its_absence(blackfly, project_root):
    """While another process controls the camera, opening it raises DeviceInUse."""
    with opened():
        script = (
            "from drivers.cameras.aravis_camera import open_camera\n"
            "from radiometer.errors import DeviceInUse\n"
            "try:\n    open_camera('127.0.0.1').open()\n"
            "except DeviceInUse as error:\n    print('in use:', error)\n"
        )
        done = subprocess.run(
            [sys.executable, "-c", script],
            cwd=project_root,
            capture_output=True,
            text=True,
            timeout=within(60),
            check=True,
        )
    assert "in use: camera FLIR BFS-U3-19S4M 22500077 is in use by another program" in done.stdout


def test_a_second_camera_at_one_address_is_refused(blackfly):
    """Two cameras cannot be served at one address; the second says so."""
    second = BlackflyGige(lambda request: np.zeros((2, 4), np.uint8), default_limits(), serial="2")
    with pytest.raises(DeviceInUse, match=r"no camera can be served at 127\.0\.0\.1"):
        second.open()


def test_other_genicam_programs_see_it(blackfly):
    """Aravis's own command line tool reads its features and takes a setting."""
    tool = shutil.which("arv-tool-0.8")
    if tool is None:
        pytest.skip("arv-tool-0.8 is not installed: apt install aravis-tools-cli")
    done = subprocess.run(
        [tool, "-a", LOOPBACK, "control", "ExposureTime=2500", "DeviceSerialNumber", "BlackLevel"],
        capture_output=True,
        text=True,
        timeout=within(60),
        check=True,
    )
    assert "ExposureTime = 2500 us" in done.stdout
    assert "DeviceSerialNumber = 22500077" in done.stdout


def test_automatic_exposure_steers_while_it_is_left_on(blackfly):
    """With ExposureAuto on, the exposure time moves towards half of full scale by itself: the feature is no dummy."""
    with opened() as camera:
        camera.configure(SETTINGS)
        camera.session.features.write("ExposureAuto", "Continuous")
        first, *_, last = (camera.capture(1)[0] for _ in range(8))
        assert last.dn.mean() > 2 * first.dn.mean()
        assert camera.session.access.read().exposure_s > 2 * SETTINGS.exposure_s


def test_requests_are_answered_while_a_picture_is_made(aravis_installed, gige_port):
    """A camera answers while the sensor is at a picture that takes until all answers are there."""
    asked, answered, pictures = threading.Event(), threading.Event(), itertools.count()

    def slow(request):
        if next(pictures):
            asked.set()
            answered.wait(within(20.0))
        return np.zeros((request.height, request.width), np.uint16)

    limits = replace(default_limits(), width=160, height=120, has_shutter=False)
    with BlackflyGige(slow, limits, serial="22500077"), opened() as camera:
        camera.configure(SETTINGS)
        stream = camera.stream()
        next(stream)
        assert asked.wait(within(20.0))
        reported = [camera.session.features.read("Gain", float) for _ in range(10)]
        answered.set()
        stream.close()
    assert reported == [0.0] * 10


LOSES_ITS_CAMERA = """
import sys, threading, time
from drivers.cameras.aravis_camera import open_camera
camera, opened = open_camera("127.0.0.1"), threading.Event()
def tell(*_):
    opened.set()
    time.sleep(1)
camera.open()
camera.session.camera.get_device().connect("control-lost", tell)
print("open", flush=True)
assert opened.wait(float(sys.argv[1]))
camera.close()
del camera
time.sleep(3)
print("lived", flush=True)
"""


def test_a_camera_closed_while_the_library_reports_its_loss_ends_no_program(blackfly, project_root):
    """The device, held by the heartbeat's own thread just then, ends later: there it would wait for itself."""
    words = [*ENDS_WITH_US, sys.executable, "-c", LOSES_ITS_CAMERA, str(within(40))]
    with subprocess.Popen(words, cwd=project_root, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as child:
        assert child.stdout.readline() == "open\n"
        blackfly.close()
        printed, complaint = child.communicate(timeout=within(60))
    assert (printed, child.returncode) == ("lived\n", 0), complaint


# A camera with colour filters: its frames are the mosaic that it sees, and it says so.


@pytest.mark.parametrize("pixel_format", ["BayerRG12", "BayerRG8"])
def test_a_mosaic_comes_through_the_driver(aravis_installed, gige_port, pixel_format):
    """Of monochromatic light each plane is as bright as its filter lets through."""
    preset = CameraPreset.shipped("BFS-U3-19S4C")
    limits = replace(preset.require_limits("").capabilities(has_shutter=False), width=160, height=120)
    lens = LensDescription(focal_length_mm=16, f_number=4.0)
    scene = scene_from_mapping({"kind": "uniform", "radiance_W_per_sr_m2": 0.3, "wavelength_nm": 530.0})
    filters = ColourFilters()
    camera = SimulatedCamera(CameraModel.ideal(preset.camera, lens), scene, limits=limits, filters=filters)
    served = BlackflyGige(ForwardModelSource(camera.sensor), limits, serial="22500078")
    with served, open_camera("22500078", lens=lens) as opened:
        opened.configure(replace(opened.settings, pixel_format=pixel_format, exposure_s=0.008, black_level_dn=0.0))
        frame = opened.capture()[0]
        assert opened.description.mosaic == "RGGB"
    seen = np.array([np.median(plane_of(frame.dn, "RGGB", colour)) for colour in COLOURS])
    passed = np.array([float(filters.responsivity(colour, np.array([530.0]))[0]) for colour in COLOURS])
    assert frame.bit_depth == int(pixel_format.removeprefix("BayerRG"))
    assert seen / seen[1] == pytest.approx(passed / passed[1], abs=0.02)
