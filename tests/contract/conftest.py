"""The cameras that the contract suite runs over."""

import fcntl
import shutil
import socket
import subprocess
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import pytest

from drivers.cameras.aravis_camera import load_library, open_camera
from drivers.cameras.camera_opening import answers
from drivers.cameras.pi_link import PiLink
from drivers.cameras.plain_camera import PlainCamera
from drivers.cameras.tethered_link import TetheredLink
from drivers.cameras.v4l2_link import V4l2Link
from radiometer.data import LensDescription
from radiometer.devices import Camera, CameraIdentity, CameraPreset, Roi
from radiometer.errors import MissingLibrary
from simulators.cameras.blackfly_awkward import AwkwardBlackfly
from simulators.cameras.blackfly_gige import BlackflyGige, ForwardModelSource
from simulators.cameras.simulated_camera import SimulatedCamera, default_limits
from simulators.chain.camera_model import CameraModel
from simulators.scenes.kinds import scene_from_mapping
from testing.edge_devices import SimulatedPiCamera, SimulatedTether, SimulatedWebcam
from testing.patience import ENDS_WITH_US, within
from testing.wire import PORT_LOCK

LOOPBACK = "127.0.0.1"
_occupied = []  # by another program, as was found
SMALL_REGION = Roi(16, 8, 64, 48)


@dataclass(frozen=True)
class Subject:
    """A camera under test, what opens it again, a small region, a format of its own, and a time that it can take."""

    name: str
    make: Callable[[], Camera]
    second: Callable[[Camera], Camera]
    roi: Roi = SMALL_REGION
    native: str = "Mono8"
    exposure_s: float = 0.005


@pytest.fixture(scope="session")
def aravis_installed():
    """Skip where Aravis is not installed."""
    try:
        load_library()
    except MissingLibrary as error:
        pytest.skip(str(error))


@pytest.fixture
def gige_port():
    """Hold the one GigE Vision control port of the loopback interface against other test runs."""
    with PORT_LOCK.open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not port_comes_free():
            pytest.skip("another program serves a GigE Vision camera at 127.0.0.1")
        yield


def port_comes_free():
    """Tell whether a camera can be served on the loopback interface; one that stays is waited for once."""
    end = time.monotonic() + within(0.0 if _occupied else 60.0)
    while not (free := port_is_free()) and time.monotonic() < end:
        time.sleep(0.2)
    _occupied[:] = [] if free else [LOOPBACK]
    return free


def port_is_free():
    """Tell whether a camera could be served on the loopback interface."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as line:
        try:
            line.bind((LOOPBACK, 3956))
        except OSError:
            return False
    return True


@pytest.fixture
def fake_gige_process(aravis_installed, gige_port):
    """Return a function that starts Debian's fake GigE Vision camera in its own process and waits until it answers."""
    program = shutil.which("arv-fake-gv-camera-0.8")
    if program is None:
        pytest.skip("arv-fake-gv-camera-0.8 is not installed: apt install aravis-tools")
    running = []

    def start(*options):
        words = [*ENDS_WITH_US, program, "-i", LOOPBACK, "-s", "GV77", *options]
        process = subprocess.Popen(words, stderr=subprocess.DEVNULL)
        running.append(process)
        end = time.monotonic() + within(10.0)
        while not answers(LOOPBACK, attempts=1, timeout_s=0.2):
            assert time.monotonic() < end, "arv-fake-gv-camera did not come up"
        return process

    yield start
    for process in running:
        process.kill()
        process.wait()


def _simulated(radiance=1.0):
    preset = CameraPreset.shipped("BFS-U3-19S4M")
    model = CameraModel.ideal(preset.camera, LensDescription(focal_length_mm=16, f_number=4.0))
    scene = scene_from_mapping({"kind": "uniform", "radiance_W_per_sr_m2": radiance})
    limits = replace(default_limits(), width=160, height=120)
    return SimulatedCamera(model, scene, seed=3, limits=limits)


@pytest.fixture
def blackfly(aravis_installed, gige_port):
    """Serve a simulated Blackfly of 160 × 120 pixels that looks at an even field, in this process."""
    camera = _simulated(radiance=0.4)
    limits = replace(default_limits(), width=160, height=120, has_shutter=False)
    with BlackflyGige(ForwardModelSource(camera.sensor), limits, serial="22500077") as served:
        yield served
    assert served.failure is None


@pytest.fixture
def serve_awkward(aravis_installed, gige_port):
    """Return a function that serves the Blackfly that is as awkward as the real one, before the same even field."""
    running = []

    def serve(**options):
        limits = replace(default_limits(), width=160, height=120, has_shutter=False)
        running.append(AwkwardBlackfly(ForwardModelSource(_simulated(radiance=0.4).sensor), limits, **options))
        running[-1].open()
        return running[-1]

    yield serve
    for served in running:
        served.close()
        assert served.failure is None


@pytest.fixture
def awkward(serve_awkward):
    """Serve the awkward Blackfly."""
    return serve_awkward()


def _picture_source():
    """Return pictures of the even field, 160 × 120 pixels."""
    return ForwardModelSource(_simulated(radiance=0.4).sensor)


def _at_the_edge(kind):
    """Return a camera that people own, its library replaced by a simulated device at the library's edge."""
    if kind == "v4l2":
        webcam = SimulatedWebcam(_picture_source(), 160, 120)
        who = CameraIdentity("Logitech", "HD Pro Webcam C920", "A1B2C3", "v4l2:/dev/video0", "V4L2 /dev/video0")
        webcam_camera = lambda: PlainCamera(V4l2Link(who, webcam.open))  # noqa: E731
        return Subject(kind, webcam_camera, lambda _: webcam_camera())
    if kind == "picamera":
        sensor = SimulatedPiCamera(_picture_source(), 160, 120)
        who = CameraIdentity("Raspberry Pi", "imx477", "10000000abcd", "picamera:0", "libcamera")
        made = lambda: PlainCamera(PiLink(who, sensor.open))  # noqa: E731
        return Subject(kind, made, lambda _: made(), native="Mono12")
    pytest.importorskip("rawpy")
    body = SimulatedTether(_picture_source(), 160, 120)
    who = CameraIdentity("", "Canon EOS 5D Mark II", "", "gphoto2:usb:001,004", "libgphoto2 usb:001,004")
    tethered = lambda: PlainCamera(TetheredLink(who, body.open))  # noqa: E731
    return Subject(kind, tethered, lambda _: tethered(), native="Mono14", exposure_s=2.0**-8)


@pytest.fixture(params=["simulated", "fake_1", "fake_gige", "blackfly", "awkward", "v4l2", "picamera", "gphoto2"])
def subject(request):
    """Return each camera in turn."""
    if request.param == "simulated":
        return Subject("simulated", _simulated, lambda camera: camera)
    if request.param in ("v4l2", "picamera", "gphoto2"):
        return _at_the_edge(request.param)
    request.getfixturevalue("aravis_installed")
    if request.param == "fake_1":
        return Subject("Fake_1", lambda: open_camera("Fake_1"), lambda _: open_camera("Fake_1"))
    if request.param in ("blackfly", "awkward"):
        request.getfixturevalue(request.param)
    else:
        request.getfixturevalue("fake_gige_process")()
    return Subject(request.param, lambda: open_camera(LOOPBACK), lambda _: open_camera(LOOPBACK))


@pytest.fixture
def room_for_frames(subject):
    """Skip where a full frame of a GigE camera that bursts cannot be held: no packet socket, small socket buffers."""
    status = Path("/proc/self/status").read_text(encoding="utf-8")
    capabilities = int(next(line for line in status.splitlines() if line.startswith("CapEff")).split()[1], 16)
    buffer_bytes = int(Path("/proc/sys/net/core/rmem_max").read_text(encoding="utf-8"))
    if subject.name == "fake_gige" and not capabilities >> 13 & 1 and buffer_bytes < 4_194_304:
        pytest.skip("full frames need CAP_NET_RAW or net.core.rmem_max of 4 MB: see `radiometer doctor`")


@pytest.fixture
def camera(subject):
    """Return the camera, opened."""
    made = subject.make()
    with made:
        yield made
