"""A real browser shows the patches: every level is acknowledged and on its screen as asked."""

import base64
import io
import json
import shutil
import subprocess
import time
import urllib.request

import aiohttp
import numpy as np
import pytest
from PIL import Image

from radiometer.devices import DisplayPatch
from radiometer.screen.browser_page import BrowserDisplay
from testing.patience import within

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
FLAGS = (
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-background-networking", "--disable-component-update",
    "--disable-sync", "--no-first-run", "--disable-quic", "--force-color-profile=srgb", "--hide-scrollbars",
    "--remote-debugging-port=0", "--window-size=640,400",
)  # fmt: skip

pytestmark = [pytest.mark.slow, pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this machine")]


@pytest.fixture
def browser(tmp_path):
    """Return a display that is shown by headless Chromium, and the browser's profile folder."""
    profile = tmp_path / "profile"
    started: list[subprocess.Popen[bytes]] = []

    def launch(url):
        command = [str(CHROMIUM), *FLAGS, f"--user-data-dir={profile}", url]
        started.append(subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL))

    try:
        with BrowserDisplay(announce=launch, page_timeout_s=60, show_timeout_s=20) as display:
            yield display, profile
    finally:
        for process in started:
            process.terminate()
            process.wait(within(20.0))


def test_every_level_is_acknowledged_with_its_own_pixels(browser):
    """All 256 greys and some colours are painted; the canvas holds exactly the level asked for, else show() raises."""
    display, _ = browser
    patches = [DisplayPatch((n / 255,) * 3) for n in range(256)]
    patches += [
        DisplayPatch(tuple(v / 255 for v in rgb)) for rgb in ((255, 0, 0), (0, 128, 0), (0, 0, 1), (17, 200, 99))
    ]
    for patch in patches:
        display.show(patch)
        assert display.acknowledged["rgb"] == [round(255 * v) for v in patch.rgb]
    assert display.acknowledged["colourDepth"] >= 24


async def _screenshot(profile):
    """Return what the browser composes for its screen, by its own debugging protocol."""
    port = (profile / "DevToolsActivePort").read_text().split()[0]
    with urllib.request.urlopen(f"http://127.0.0.1:{port}/json", timeout=within(10)) as answer:
        page = next(t for t in json.load(answer) if t["type"] == "page")
    async with (
        aiohttp.ClientSession() as session,
        session.ws_connect(page["webSocketDebuggerUrl"], max_msg_size=0) as ws,
    ):
        await ws.send_json({"id": 1, "method": "Page.captureScreenshot", "params": {"format": "png"}})
        async for message in ws:
            reply = json.loads(message.data)
            if reply.get("id") == 1:
                return np.asarray(Image.open(io.BytesIO(base64.b64decode(reply["result"]["data"]))).convert("RGB"))
    raise AssertionError("the browser did not answer")


async def test_screen_holds_patch_and_surround(browser):
    """On the composed screen the middle is the patch, the corner the surround, to the code."""
    display, profile = browser
    for level in (0, 1, 2, 63, 128, 254, 255):
        display.show(DisplayPatch((level / 255,) * 3, (40 / 255,) * 3, 0.5, 0.5))
        picture = await _screenshot(profile)
        middle, corner = picture[picture.shape[0] // 2, picture.shape[1] // 2], picture[2, 2]
        assert middle.tolist() == [level] * 3
        assert corner.tolist() == [40] * 3


def test_a_patch_takes_two_frames_at_least(browser):
    """The acknowledgement waits for the paint: 30 patches take no less than 30 frames of 60 per second."""
    display, _ = browser
    display.show(DisplayPatch((0, 0, 0)))
    begun = time.monotonic()
    for n in range(30):
        display.show(DisplayPatch((n % 2,) * 3))
    assert time.monotonic() - begun > 30 / 60
