"""A real browser shows the patches: every level is acknowledged and on its screen as asked."""

import queue
import time

import pytest

from radiometer.devices import DisplayPatch
from radiometer.screen.browser_page import BrowserDisplay
from testing.chromium import headless, shows


@pytest.fixture
async def shown(tmp_path):
    """Return a display that is shown by headless Chromium, and the browser."""
    addresses = queue.SimpleQueue[str]()
    display = BrowserDisplay(announce=addresses.put, page_timeout_s=60, show_timeout_s=20)
    async with headless(tmp_path / "profile", (640, 400)) as browser, shows(browser, display, addresses, start=False):
        yield display, browser


@pytest.mark.slow
async def test_levels_are_acknowledged_with_their_own_pixels(shown):
    """The canvas holds exactly the level asked for, else show() raises; each waits for a frame of 60 per second."""
    display, _ = shown
    codes = [(n, n, n) for n in range(0, 256, 5)] + [(255, 0, 0), (0, 128, 0), (0, 0, 1), (17, 200, 99)]
    display.show(DisplayPatch((0, 0, 0)))
    begun = time.monotonic()
    for code in codes:
        display.show(DisplayPatch(tuple(v / 255 for v in code)))
        assert display.acknowledged["rgb"] == list(code)
    assert time.monotonic() - begun > len(codes) / 60
    assert display.acknowledged["colourDepth"] >= 24


@pytest.mark.slow
async def test_screen_holds_patch_and_surround(shown):
    """On the composed screen the middle is the patch, the corner the surround, to the code."""
    display, browser = shown
    for level in (0, 1, 2, 63, 128, 254, 255):
        display.show(DisplayPatch((level / 255,) * 3, (40 / 255,) * 3, 0.5, 0.5))
        picture = await browser.picture()
        middle, corner = picture[picture.shape[0] // 2, picture.shape[1] // 2], picture[2, 2]
        assert middle.tolist() == [level] * 3
        assert corner.tolist() == [40] * 3
