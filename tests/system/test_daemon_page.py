"""The page in a real browser at four sizes: all of one glance, readable, by keyboard and by touch."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import json
from collections.abc import Iterator
from typing import Any

import pytest

from radiometer.daemon.journal import Journal
from radiometer.daemon.timestamps import iso_time, now_us
from radiometer.data import Patch, Quantity, Reading
from testing.chromium import Browser, headless
from testing.daemon_process import DaemonProcess
from testing.report_checks import low_contrasts

SIZES = ((1440, 900), (1920, 1080), (390, 844), (1280, 800))
# What holds more than it shows, and would have a scroll bar of its own. Twelve patches fit no low screen.
_SCROLLING = """
JSON.stringify([...document.querySelectorAll("main :not(#patch-list)")].filter((e) => {
  const { overflowX, overflowY } = getComputedStyle(e), scrolls = (how) => ["auto", "scroll"].includes(how);
  return (scrolls(overflowY) && e.scrollHeight > e.clientHeight)
    || (scrolls(overflowX) && e.scrollWidth > e.clientWidth);
}).map((e) => e.id || e.className))"""
_EVENTS = """
JSON.stringify([...document.querySelectorAll("#event-list li")].map((e) => e.getBoundingClientRect().bottom
  - document.getElementById("event-list").getBoundingClientRect().bottom))"""
_CONTRASTS = low_contrasts(":disabled, #stage, .uplot, .fresh .value", 3.0)
_UNNAMED = """
JSON.stringify([...document.querySelectorAll("button, input, a, [tabindex]")].filter((e) => !(e.textContent.trim()
  || e.getAttribute("aria-label") || e.getAttribute("aria-labelledby") || e.closest("label"))).map((e) => e.outerHTML))
"""


def _smaller_than(high: float, wide: float, link: float, part: str) -> str:
    """Return JavaScript that lists the controls whose part is smaller than so many pixels."""
    return f"""
JSON.stringify([...document.querySelectorAll("button, a, input")].map((e) => {part}).filter((e) => {{
  const b = e.getBoundingClientRect();
  return b.width && (b.height < {high} || b.width < (e.tagName === "A" ? {link} : {wide}));
}}).map((e) => e.outerHTML.slice(0, 90)))"""


# What a finger meets is 44 pixels tall and wide (WCAG 2.1, 2.5.5); a switch by its label.
_UNTOUCHABLE, _SMALL = _smaller_than(43.5, 43.5, 30, 'e.closest(".switch") || e'), _smaller_than(24, 20, 20, "e")
# Where the tab key goes, by the number of stops: what has the focus, whether that is seen, and where it lies.
_FOCUS = """
(() => { const e = document.activeElement, b = e.getBoundingClientRect(), s = getComputedStyle(e);
  return JSON.stringify([e.tagName, e.id || e.name || e.textContent.trim().slice(0, 20), s.outlineStyle !== "none",
    [...document.querySelectorAll(".card, header")].indexOf(e.closest(".card, header")), b.top + scrollY]); })()"""
# Replies to what was sent come when the alarm that followed is shown, as on a busy machine.
_LATE_REPLIES = """
{ const plain = fetch;
  replied = 0;
  window.fetch = async (...asked) => {
    const reply = await plain(...asked);
    if (asked[1]?.method !== "POST") return reply;
    while (!document.querySelector(".patch-row.bad[data-patch=wall]")) await new Promise((go) => setTimeout(go, 50));
    setTimeout(() => { replied += 1; }, 500);
    return reply;
  };
}"""


@pytest.fixture(scope="module")
def lasting(tmp_path_factory: pytest.TempPathFactory) -> Iterator[DaemonProcess]:
    """Return a daemon with two days of history, 38 minutes of them missing, and a second patch with limits."""
    folder = tmp_path_factory.mktemp("page")
    now = now_us()
    times = [now - k * 60_000_000 for k in range(2 * 1440, 1, -1) if not 200 <= k < 238]
    with Journal(folder / "journal.sqlite") as journal:
        for name, patch, value in (("", Patch(20, 30, 20, 20), 0.918), ("dim lamp", Patch(100, 40, 30, 30), 0.2)):
            journal.append(
                [Reading(Quantity(value, value / 200, "W sr-1 m-2"), patch, "22500001", time=iso_time(at), name=name)
                 for at in times]
            )  # fmt: skip
        limits = {"low": None, "high": 0.1, "hysteresis_rel": 0.01}
        where = {"x": 100, "y": 40, "width": 30, "height": 30}
        for number in range(60):
            journal.note("remark", f"remark {number}: " + "the lamp was exchanged; " * (number % 9))
        journal.keep_patch("dim lamp", json.dumps({"patch": where, "limits": limits}))
    with DaemonProcess(folder, "--every", "0.3", "--box", "sim") as running:
        running.wait_for_reading()
        yield running


@pytest.fixture
def daemon(lasting: DaemonProcess) -> Iterator[DaemonProcess]:
    """Return that daemon; what a test changes of its patches and period is gone after the test, passed or failed."""
    before = lasting.get("/status")
    yield lasting
    lasting.post("/settings", {"every_s": before["every_s"]})
    for name in lasting.get("/status")["patches"].keys() - before["patches"].keys():
        lasting.post("/patches/delete", {"name": name})


async def _shown(browser: Browser, daemon: DaemonProcess, size: tuple[int, int]) -> None:
    await _shown_size(browser, daemon, size)
    await browser.wait_for(
        "document.getElementById('nothing')?.hidden && document.querySelectorAll('.panel canvas').length === 2"
        " && document.querySelectorAll('#lights input').length > 0 && !!document.querySelector('.patch-row.bad')"
    )


async def _shown_size(browser: Browser, daemon: DaemonProcess, size: tuple[int, int]) -> None:
    phone = size[0] < 700
    await browser.command(
        "Emulation.setDeviceMetricsOverride", width=size[0], height=size[1], deviceScaleFactor=1, mobile=phone
    )
    await browser.command("Emulation.setTouchEmulationEnabled", enabled=phone)
    await browser.command("Page.navigate", url=daemon.url + "/")


async def _json(browser: Browser, expression: str) -> Any:
    return json.loads(await browser.evaluate(expression))


async def test_the_page_fits_and_can_be_read_at_every_size(daemon, tmp_path):
    """Nothing next to or below the window, no panel scrolls, contrast AA in every theme, name and size of controls."""
    async with headless(tmp_path / "profile") as browser:
        for size in SIZES:
            await _shown(browser, daemon, size)
            wide = await _json(browser, "JSON.stringify([document.documentElement.scrollWidth, innerWidth])")
            assert wide[0] <= wide[1]
            assert await _json(browser, _SCROLLING) == []
            shown = await _json(browser, _EVENTS)
            assert len(shown) >= 2
            assert max(shown) <= 0.5
            listed = "document.querySelectorAll('#all-event-list li').length"
            await browser.evaluate("document.getElementById('events-all').click()")
            assert await browser.evaluate(listed) > 60
            await browser.evaluate("document.getElementById('all-events').close()")
            if size[0] > 1000:
                tall = await _json(browser, "JSON.stringify([document.documentElement.scrollHeight, innerHeight])")
                assert tall[0] <= tall[1]
                used = await browser.evaluate(
                    "document.querySelector('main').getBoundingClientRect().width / innerWidth"
                )
                assert used > 0.97
                panel = await browser.evaluate("document.querySelector('.panel .plot').getBoundingClientRect().height")
                assert panel > 90
            for theme in ("light", "dark", "red"):
                await browser.evaluate(f"document.querySelector('[data-theme={theme}]').click()")
                assert await _json(browser, _CONTRASTS) == []
            assert await _json(browser, _UNNAMED) == []
            assert await _json(browser, _SMALL if size[0] > 1000 else _UNTOUCHABLE) == []
        assert browser.errors == []
        assert [url for url in browser.requested if not url.startswith((daemon.url, "blob:", "data:", "about:"))] == []


async def test_the_page_shows_trends_alarms_and_gaps(daemon, tmp_path):
    """Each patch has its panel with its own course; a day has its gap; the alarm of the limit is at the top."""
    async with headless(tmp_path / "profile", SIZES[0]) as browser:
        await _shown(browser, daemon, SIZES[0])
        assert "dim lamp" in await browser.wait_for("document.querySelector('.alarm')?.textContent")
        await browser.evaluate("document.querySelector('[data-span=\"86400\"]').click()")
        for name, value in (("main", 0.918), ("dim lamp", 0.2)):
            text = f"document.querySelector('[data-patch=\"{name}\"] figcaption .quiet').textContent"
            await browser.wait_for(f"/n = 1[34]\\d\\d,/.test({text})")
            mean = float((await browser.evaluate(text)).split()[1])
            assert mean == pytest.approx(value, rel=0.01)
        export = await browser.evaluate("document.getElementById('export').getAttribute('href')")
        assert "stream=all&since=" in export
        daemon.post("/light", {"channel": "spot", "level": 0.001})
        await browser.wait_for("document.getElementById('lights-off').classList.contains('lit')")
        for typing in (True, False):  # the key is for the page, not for what is being typed
            await browser.evaluate(f"document.getElementById('remark').{'focus' if typing else 'blur'}()")
            await browser.key("keyDown", "KeyO", "o")
            await browser.key("keyUp", "KeyO", "o")
            if typing:
                await asyncio.sleep(0.3)
                assert daemon.get("/status")["light"]["spot"] > 0
        await browser.wait_for("!document.getElementById('lights-off').classList.contains('lit')")
        assert set(daemon.get("/status")["light"].values()) == {0.0}
        most = await browser.evaluate("+document.querySelector('#lights input[name=bleach]').max")
        assert most == pytest.approx(daemon.get("/status")["light_limits"]["bleach"])
        assert 0 < most < 1
        assert browser.errors == []


async def test_a_person_names_limits_and_remarks(daemon, tmp_path):
    """By touch on a phone: a place gets a name and a panel, limits alarm, a remark stands among the events."""
    async with headless(tmp_path / "profile", SIZES[2]) as browser:
        await _shown(browser, daemon, SIZES[2])

        async def tap(selector: str, until: str) -> None:
            """Touch until it had its effect: what is drawn anew in between moves the place."""
            for _ in range(8):
                place = await _json(
                    browser,
                    f"(() => {{ const e = document.querySelector('{selector}'); e.scrollIntoView({{block: 'center'}});"
                    " const b = e.getBoundingClientRect();"
                    " return JSON.stringify([b.x + b.width / 2, b.y + b.height / 2]); })()",
                )
                for kind, points in (("touchStart", [{"x": place[0], "y": place[1]}]), ("touchEnd", [])):
                    await browser.command("Input.dispatchTouchEvent", type=kind, touchPoints=points)
                with contextlib.suppress(TimeoutError):
                    await browser.wait_for(until, 5.0)
                    return
            raise AssertionError(f"{selector}: touched eight times without effect")

        row = "document.querySelector('.patch-row[data-patch=wall]')"
        await browser.evaluate("document.getElementById('patch-name').value = 'wall'")
        await tap("#name-patch button", "document.querySelectorAll('.panel canvas').length === 3")
        assert daemon.get("/status")["patches"]["wall"]["patch"] == {"x": 20, "y": 30, "width": 20, "height": 20}
        await tap('.patch-row[data-patch="wall"] button', "document.getElementById('limits').open")
        await browser.evaluate("document.getElementById('limit-high').value = 0.5")
        await browser.evaluate(_LATE_REPLIES)
        await tap('#limits button[value="save"]', f"{row}.querySelector('button').textContent.includes('0.5')")
        await browser.wait_for(f"{row}.matches('.bad')", 60.0)  # two readings later: a busy daemon takes its time
        await browser.wait_for("replied === 1")
        assert await browser.evaluate(f"{row}.matches('.bad')"), "a late reply hides what came after it"
        await browser.evaluate("document.getElementById('remark').value = 'lamp exchanged'")
        remarks = "[...document.querySelectorAll('.is-remark')].map((e) => e.parentElement.textContent).join()"
        await tap("#remark-form button", f"{remarks}.includes('lamp exchanged')")
        await tap('.patch-row[data-patch="wall"] button', "document.getElementById('limits').open")
        await tap("#limit-delete", "document.querySelectorAll('.panel').length === 2")
        assert "wall" not in daemon.get("/status")["patches"]
        assert browser.errors == []


async def test_the_tab_key_goes_through_the_page_as_it_is_seen(daemon, tmp_path):
    """Every control is reached, each with a visible focus; card by card on a screen, from top to bottom on a phone."""
    async with headless(tmp_path / "profile", SIZES[0]) as browser:
        for size in (SIZES[0], SIZES[2]):
            await _shown(browser, daemon, size)
            stops = []
            while len(stops) < 90:
                await browser.command(
                    "Input.dispatchKeyEvent", type="keyDown", code="Tab", key="Tab", windowsVirtualKeyCode=9
                )
                stop = await _json(browser, _FOCUS)
                if stop[0] == "BODY" or (stops and stop[:2] == stops[0][:2]):
                    break
                stops.append(stop)
            names = {stop[1] for stop in stops}
            assert {"lights-off", "measure", "patch-name", "spot", "export", "events-all", "patch", "gain"} <= names
            assert [stop for stop in stops if not stop[2]] == []
            cards = [stop[3] for stop in stops if stop[3] >= 0]
            visits = [card for card, before in zip(cards, [None, *cards], strict=False) if card != before]
            assert len(visits) == len(set(visits))
            if size[0] > 1000:
                assert visits == sorted(visits)
            else:
                first = {card: min(stop[4] for stop in stops if stop[3] == card) for card in visits}
                assert [first[card] for card in visits] == sorted(first.values())


async def test_seven_patches_are_one_glance(daemon, tmp_path):
    """At 1440 × 900 each of seven patches has its panel in the window, and an event under the pointer is reported."""
    names = [f"lamp {number}" for number in range(5)]
    for number, name in enumerate(names):
        daemon.post("/patches", {"name": name, "patch": {"x": 95 + 10 * number, "y": 80, "width": 8, "height": 8}})
    daemon.post("/events", {"message": "<b>the</b> shutter jams"})
    async with headless(tmp_path / "profile", SIZES[0]) as browser:
        await _shown_panels(browser, daemon, 7)
        inside = """JSON.stringify([...document.querySelectorAll('.panel')].map((e) => {
          const b = e.getBoundingClientRect(), p = document.getElementById('panels').getBoundingClientRect();
          return b.top >= p.top - 1 && b.bottom <= p.bottom + 1 && b.bottom <= innerHeight && b.height > 90; }))"""
        assert await _json(browser, inside) == [True] * 7
        place = await _json(
            browser,
            "(() => { const b = document.querySelector('.panel .u-over').getBoundingClientRect();"
            " return JSON.stringify([b.right - 2, b.top + 20]); })()",
        )
        sentence = "document.querySelector('.panel figcaption .quiet').textContent"
        async with asyncio.timeout(20):  # a panel drawn anew forgets the pointer until it moves
            for step in itertools.cycle((0, 1)):
                await browser.command("Input.dispatchMouseEvent", type="mouseMoved", x=place[0] - step, y=place[1])
                if await browser.evaluate(f"{sentence}.includes('remark: <b>the</b> shutter jams')"):
                    break
                await asyncio.sleep(0.2)
        assert browser.errors == []


async def _shown_panels(browser: Browser, daemon: DaemonProcess, count: int) -> None:
    await _shown_size(browser, daemon, SIZES[0])
    await browser.wait_for(f"document.querySelectorAll('.panel canvas').length === {count}")
    await browser.evaluate("document.querySelector('[data-span=\"86400\"]').click()")


# What every object of JavaScript inherits, and names that look like numbers: a person may give a patch any of them.
_INHERITED = ("constructor", "__proto__", "toString", "hasOwnProperty", "valueOf", "isPrototypeOf", "7", "0.5", "null")
_BARS = """
JSON.stringify([...document.querySelectorAll("#panels, #panels *, main, body")].filter((e) => e.clientWidth
  && /auto|scroll/.test(getComputedStyle(e).overflow)
  && (e.scrollWidth > e.clientWidth || e.scrollHeight > e.clientHeight)).map((e) => e.id || e.className))"""


async def test_patches_of_any_name_and_number_leave_the_page_whole(daemon, tmp_path):
    """Each has its row, its value and its panel; values go on changing, no panel has a scroll bar, nothing fails."""
    async with headless(tmp_path / "profile", SIZES[0]) as browser:
        for count, name in enumerate(_INHERITED, start=3):
            daemon.post("/patches", {"name": name, "patch": {"x": 95, "y": 80, "width": 8, "height": 8}})
            if count not in (3, 4, 7, 2 + len(_INHERITED)):
                continue
            for size in (SIZES[0], (1280, 800), SIZES[1]):
                await _shown_size(browser, daemon, size)
                await browser.wait_for(f"document.querySelectorAll('.panel canvas').length === {count}")
                assert await _json(browser, _BARS) == []
        read = "[...document.querySelectorAll('.patch-row > span')].every((e) => /±/.test(e.textContent))"
        await browser.wait_for(f"document.querySelectorAll('.patch-row').length === {count} && {read}")
        number = "+document.getElementById('freshness').textContent.match(/#(\\d+)/)?.[1]"
        before = await browser.wait_for(number)
        await browser.wait_for(f"{number} > {before}")
        assert not await browser.evaluate("document.getElementById('alarms').textContent.includes('This page')")
        assert browser.errors == []


async def test_the_list_of_patches_is_folded_and_shows_what_was_last_read(daemon, tmp_path):
    """Where nothing is measured any more, every row still has its value; what has no room is a click away."""
    names = [f"lamp {number}" for number in range(9)]
    for number, name in enumerate(names):
        daemon.post("/patches", {"name": name, "patch": {"x": 95 + 5 * number, "y": 80, "width": 8, "height": 8}})
    count = len(daemon.get("/status")["patches"])
    read = "document.querySelectorAll('.patch-row > span')"
    seen = "[...document.querySelectorAll('.patch-row')].filter((e) => e.checkVisibility())"
    inside = (
        f"{seen}.every((e) => e.getBoundingClientRect().bottom <= e.parentElement.getBoundingClientRect().bottom + 1)"
    )
    async with headless(tmp_path / "profile", SIZES[0]) as browser:
        await _shown_size(browser, daemon, (1280, 800))
        await browser.wait_for(f"{read}.length === {count} && [...{read}].every((e) => /±/.test(e.textContent))")
        daemon.post("/settings", {"every_s": None})
        await _shown_size(browser, daemon, (1280, 800))
        await browser.wait_for(f"{read}.length === {count} && [...{read}].every((e) => /±/.test(e.textContent))")
        await browser.wait_for(f"{seen}.length < {count} && {seen}.length > 0 && {inside}")
        assert await browser.evaluate("document.getElementById('patches-all').textContent") == f"all {count}"
        await browser.evaluate("document.getElementById('patches-all').click()")
        await browser.wait_for(f"{seen}.length === {count} && {inside}")
        assert await browser.evaluate("document.getElementById('patches-all').textContent") == "fewer"
        assert browser.errors == []


async def test_lights_off_works_whatever_else_of_the_page_does_not(daemon, tmp_path):
    """One part that cannot be loaded stops no other; the button is seen and darkens the box."""
    async with headless(tmp_path / "profile", SIZES[0]) as browser:
        for gone in ("/page.js", "/trends.js", "/response.js", "/uplot.js", "/page.css", "/status", "/events"):
            daemon.post("/light", {"channel": "spot", "level": 0.001})
            await browser.command("Network.setBlockedURLs", urls=[f"*{gone}*"])
            await browser.command("Network.clearBrowserCache")
            await _shown_size(browser, daemon, SIZES[0])
            await browser.wait_for("document.getElementById('lights-off')?.checkVisibility()")
            if gone in ("/trends.js", "/response.js", "/uplot.js", "/events"):
                await browser.wait_for("/±/.test(document.getElementById('expanded').textContent)")
                await browser.wait_for("!!document.querySelector('#lights output')")
            await asyncio.sleep(0.5)  # until the script is there, whose answer is looked for
            await browser.evaluate("document.getElementById('lights-off').click()")
            await browser.wait_for("document.getElementById('lights-status').textContent === 'all channels are off'")
            assert set(daemon.get("/status")["light"].values()) == {0.0}, gone


async def test_a_level_that_cannot_be_known_is_not_shown_as_dark(tmp_path):
    """While the daemon is gone, the level of each channel is unknown and the button is lit."""
    with DaemonProcess(tmp_path, "--every", "0.3", "--box", "sim") as running:
        running.post("/light", {"channel": "spot", "level": 0.001})
        async with headless(tmp_path / "profile", SIZES[0]) as browser:
            await _shown_size(browser, running, SIZES[0])
            spot = "document.querySelector('#lights [data-channel=spot] output')?.textContent"
            await browser.wait_for(f"{spot} === '0.1 %'")
            running.kill()
            await browser.wait_for(f"{spot} === 'unknown'")
            assert await browser.evaluate("document.getElementById('lights-off').classList.contains('lit')")
