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
from radiometer.devices import CameraIdentity, CameraPreset, CameraSettings
from radiometer.errors import DeviceInUse, DeviceLost, DeviceNotFound, DeviceTimeout
from simulators.cameras.blackfly_gige import BlackflyGige, ForwardModelSource
from simulators.cameras.simulated_camera import ColourFilters, SimulatedCamera, default_limits
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


def assert_brightness(frame, in_force):
    """Hold the mean of a frame against E = πL/(4N²) of its own settings, within 5 sigma of that mean."""
    irradiance = np.pi * RADIANCE / (4 * 4.0**2)
    electrons = irradiance * PITCH_M**2 * in_force.exposure_s / PHOTON_J * QE
    gain = 10 ** (in_force.gain_db / 20) / K_E_PER_DN
    sigma = np.sqrt((gain**2 * (electrons + READ_E**2) + 1 / 12) / frame.dn.size)
    dark = 0.1 * gain  # 4.4 e⁻/s at 40 °C, over 10 ms at most
    assert frame.dn.mean() == pytest.approx(in_force.black_level_dn + gain * electrons, abs=5 * sigma + dark + 0.01)


def test_it_is_the_camera_of_its_preset(blackfly):
    """Vendor, model, number and preset come over the wire; what falsifies as shipped is off once it is opened."""
    with opened() as camera:
        assert (camera.identity.vendor, camera.identity.model) == ("FLIR", "BFS-U3-19S4M")
        assert camera.identity.serial == "22500077"
        assert camera.description.pixel_pitch_um == 4.5
        switched = {f.feature.name for f in camera.session.hygiene if f.state == "switched_off"}
        assert {"ExposureAuto", "GainAuto", "GammaEnable", "SharpeningEnable"} <= switched
        assert not [f for f in camera.session.hygiene if f.state == "still_on"]


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


# A Blackfly as awkward as the real one: what a plain simulated one never asked of the driver.


PACKED = CameraSettings(exposure_s=0.004, black_level_dn=64, pixel_format="Mono12p")
# Electrons of the even field in 4 ms, from E = πL/(4N²) with the preset's pitch, efficiency and gain.
ELECTRONS = np.pi * 0.4 / (4 * 4.0**2) * 4.5e-6**2 * 0.004 / PHOTON_J * 0.62
SIGNAL_DN = ELECTRONS / 5.95
U_REL = 5 / np.sqrt(ELECTRONS * 160 * 120) + 0.02 / SIGNAL_DN  # five sigma of a mean, and the dark signal


def test_it_is_taken_for_a_real_blackfly(awkward):
    """The family's quirks, the twin's preset, a hexadecimal number; formats that it does not have are not its own."""
    with opened() as camera:
        assert camera.session.quirks.load_default_user_set
        assert camera.session.quirks.mono16_left_aligned_bits == 12
        assert camera.description.pixel_pitch_um == 4.5
        assert camera.identity.serial == "0138C343"
    with opened() as camera:
        assert camera.capabilities.pixel_formats == ("Mono8", "Mono10p", "Mono12Packed", "Mono12p", "Mono16")
        assert camera.settings.pixel_format in camera.capabilities.pixel_formats


@pytest.mark.parametrize("name", ["Mono8", "Mono10p", "Mono12p", "Mono12Packed", "Mono16"])
def test_every_format_carries_the_light_of_the_scene(awkward, name):
    """Mono16 holds twelve bits at its top: right-aligned, it has the same digital numbers as Mono12p."""
    with opened() as camera:
        camera.configure(replace(PACKED, pixel_format=name, black_level_dn=0))
        frames = camera.capture(2)
    scale = 4095 / frames[0].full_scale_dn
    found = np.mean([frame.dn for frame in frames]) * scale
    assert frames[0].bit_depth == {"Mono8": 8, "Mono10p": 10}.get(name, 12)
    assert found == pytest.approx(SIGNAL_DN, rel=U_REL, abs=0.5 * scale if scale > 1 else 0)


def test_chunks_tell_the_two_frames_that_are_still_of_the_settings_before(awkward):
    """From 4 ms to 30 s, two frames of 4 ms are thrown away and the first of 30 s is taken: one exposure, not three."""
    with opened() as camera:
        camera.configure(replace(PACKED, software_trigger=True))
        camera.capture(3)
        before, discarded = len(awkward.exposed_s), camera.counts.extra["stale_discarded"]
        camera.configure(replace(PACKED, software_trigger=True, exposure_s=30.0))
        assert camera.capture(1)[0].settings.exposure_s == 30.0
        assert awkward.exposed_s[before:] == [0.004, 0.004, 30.0]
        assert camera.counts.extra["stale_discarded"] - discarded == 2


def test_no_frame_mixes_two_settings(awkward):
    """After a change of exposure, gain or black level alone, a frame has the brightness of its own settings."""
    required, changes = (
        PACKED,
        {"exposure_s": (0.008, 0.002), "gain_db": (6.0205999, 0.0), "black_level_dn": (200.0, 20.0)},
    )
    with opened() as camera:
        for step in (0, 1):
            for name, values in changes.items():
                required = replace(required, **{name: values[step]})
                in_force = camera.configure(required)
                assert_brightness(camera.capture(1)[0], in_force)


def test_the_shortest_exposure_is_not_taken_for_another_one(awkward):
    """At 11 µs a step of the exposure time is 9 %: the frame of the setting comes, in whole µs as it was read back."""
    with opened() as camera:
        assert camera.configure(replace(PACKED, exposure_s=11.4e-6)).exposure_s == pytest.approx(11e-6)
        assert camera.capture(1)[0].settings.exposure_s == pytest.approx(11e-6)
        camera.configure(replace(PACKED, exposure_s=12e-6))
        assert camera.capture(1)[0].settings.exposure_s == pytest.approx(12e-6)


def test_nothing_is_dropped_on_a_link_that_carries_little_less_than_it_should(awkward):
    """At its nominal speed, as shipped, the link loses a packet of every frame; the link itself says what it lost."""
    with opened() as camera:
        assert camera.session.throughput.limit_bytes_s == 112_500_000
        camera.configure(PACKED)
        camera.capture(10)
        assert awkward.frames_sent >= 10
        assert awkward.frames_cut == 0


def test_a_slow_link_slows_the_camera_down(serve_awkward):
    """Where no frame comes whole at the link's nominal speed, the camera is slowed down until they do."""
    served = serve_awkward(link_bytes_s=70_000_000)
    with AravisCamera(CameraIdentity("", "", "", LOOPBACK), frame_deadline_s=0.5) as camera:
        camera.configure(PACKED)
        assert camera.capture(2)
        limit = camera.session.throughput.limit_bytes_s
        assert 0.5 * 70_000_000 < limit <= 70_000_000
        whole = camera.counts.incomplete
        camera.capture(3)
        assert camera.counts.incomplete == whole
    assert 40 < served.frames_cut < served.frames_sent
