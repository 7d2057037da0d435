"""Live view, and devices that are opened again."""

import asyncio
import base64
import io
import threading
from dataclasses import replace

import aiohttp
import pytest
import yaml
from PIL import Image

import radiometer as rm
from radiometer.bench.reopening import reopen
from radiometer.devices import CameraIdentity, CameraSettings
from radiometer.errors import ConfigurationError, DeviceLost, MissingLibrary

BENCH = """# our bench
camera: {kind: simulated, preset: BFS-U3-19S4M, width: 96, height: 64, black_level_dn: 64}
lens: {focal_length_mm: 16, f_number: 4}
patch:          # the lamp
  {x: 1, y: 2,
   width: 3, height: 4}
scene: {kind: uniform, radiance_W_per_sr_m2: 0.3}   # an even source
"""


def test_patch_drawn_on_the_page_is_printed_and_written_into_the_bench_file(tmp_path):
    """The page gets picture, histogram and clipping; a rectangle becomes the patch, comments of the file stay."""
    bench, printed = tmp_path / "lab.yaml", list[str]()
    bench.write_text("format: radiometer-bench/1\n" + BENCH, encoding="utf-8")
    address = []
    ready = threading.Event()

    def announce(url):
        address.append(url)
        ready.set()

    def run():
        found.append(rm.view(bench=bench, frames=40, every_s=0.05, announce=announce, notice=printed.append))

    found = []
    shown = threading.Thread(target=run)
    shown.start()
    assert ready.wait(60)
    first, reported = asyncio.run(_draw(address[0], [10, 20, 30, 16]))
    shown.join(120)
    assert Image.open(io.BytesIO(base64.b64decode(first["png"]))).size == (96, 64)
    assert sum(first["histogram"]) == 96 * 64
    assert (first["patch"], first["clips"], first["bench"]) == ([1, 2, 3, 4], False, "lab.yaml")
    assert found == [rm.Patch(10, 20, 30, 16)]
    assert printed[0] == "--patch 10,20,30,16"
    assert "written" in reported["text"]
    text = bench.read_text(encoding="utf-8")
    assert yaml.safe_load(text)["patch"] == {"x": 10, "y": 20, "width": 30, "height": 16}
    assert "# our bench" in text
    assert "# an even source" in text


async def _draw(url, patch):
    async with aiohttp.ClientSession() as session, session.ws_connect(url.replace("/?", "/socket?")) as socket:
        first = await socket.receive_json(timeout=60)
        await socket.send_json({"kind": "patch", "patch": [90, 0, 50, 50]})  # leaves the frame: refused
        await socket.send_json({"kind": "patch", "patch": patch})
        await socket.send_json({"kind": "save"})
        while (message := await socket.receive_json(timeout=60))["kind"] != "notice" or message["failed"]:
            pass
        return first, message


def test_file_that_is_no_bench_stays_as_it_is(tmp_path):
    """A patch is not written into what would not be a bench afterwards."""
    file = tmp_path / "x.yaml"
    file.write_text("colour: red\n", encoding="utf-8")
    with pytest.raises(ConfigurationError):
        rm.view(bench=file, frames=1)
    assert file.read_text(encoding="utf-8") == "colour: red\n"


class LostCamera:
    """A camera that can be set only while it is open, and that is away for some tries."""

    def __init__(self, away):
        self.away, self.is_open, self.settings = away, True, CameraSettings(exposure_s=0.01)
        self.identity = CameraIdentity("Fake", "F-1", "4711", "fake")

    def close(self):
        self.is_open = False

    def open(self):
        if self.away:
            self.away -= 1
            raise DeviceLost("unplugged")
        self.is_open = True

    def configure(self, settings):
        if not self.is_open:
            raise DeviceLost("not open")
        self.settings = settings


@pytest.mark.parametrize("away", [0, 2])
def test_a_camera_that_is_back_is_open_with_its_settings(away):
    """It is let go, opened again after as many pauses as it was away for, and only then set."""
    camera = LostCamera(away)
    pauses = []

    def pause(seconds):
        pauses.append(seconds)
        if len(pauses) > away:
            pytest.fail("a camera that is there is not opened")

    requested = CameraSettings(exposure_s=0.003)
    reopen(camera, requested, lambda _reason: None, pause)
    assert (camera.is_open, camera.settings, len(pauses)) == (True, requested, away)


def test_each_reason_is_reported_once_and_a_camera_that_does_not_open_is_let_go(monkeypatch):
    """Who waits hears of a new reason and not of the same one again; between two tries nothing is held open."""
    reasons = ["unplugged", "unplugged", "in use", "in use"]
    camera = LostCamera(0)
    plain_open, others = camera.open, ["4712", "4711"]

    def fail_first():
        if reasons:
            camera.is_open = True  # an opening that fails half way
            raise DeviceLost(reasons.pop(0))
        camera.identity = replace(camera.identity, serial=others.pop(0))
        plain_open()

    monkeypatch.setattr(camera, "open", fail_first)
    reported = []
    held = []
    reopen(camera, CameraSettings(exposure_s=0.003), reported.append, lambda _s: held.append(camera.is_open))
    another = reported.pop()
    assert "another device answers, camera Fake F-1 4712, in place of camera Fake F-1 4711" in another
    assert (reported, held, camera.is_open) == (["unplugged", "in use"], [False] * 5, True)


def test_a_camera_that_can_never_be_opened_is_not_waited_for(monkeypatch):
    """Without its library no pause helps: the error comes at the first try."""
    camera = LostCamera(0)

    def fail():
        raise MissingLibrary("aravis")

    monkeypatch.setattr(camera, "open", fail)
    with pytest.raises(MissingLibrary):
        reopen(camera, CameraSettings(exposure_s=0.003), pytest.fail, pytest.fail)
