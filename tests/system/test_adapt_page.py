"""The page of a running test in a real browser: points grow, pause reaches the run, nothing is green or blue."""

import asyncio
import time
from typing import Any

import numpy as np
import pytest

from radiometer.adaptation.live import LivePage
from radiometer.adaptation.outcome import RunJournal, Verdict
from radiometer.adaptation.protocol import read_protocol
from radiometer.adaptation.request import Controls
from radiometer.adaptation.run import run_test
from radiometer.adaptation.session import simulated_stage
from testing.chromium import headless
from testing.scripted_adaptation import SubjectCurve

PHONE = (390, 844)


@pytest.fixture
async def browser(tmp_path):
    """Return a headless browser of a phone's size."""
    async with headless(tmp_path / "profile") as driver:
        await driver.be_a_phone(*PHONE)
        yield driver


@pytest.fixture
def served():
    """Return the open page of a test that has begun, and its controls."""
    controls = Controls()
    with LivePage(read_protocol("classic"), controls, audio=True, health=lambda: {"supply": "5.02 V"}) as page:
        for number, (kind, time_s, facts) in enumerate(
            (("start", 0.0, {"subject": "S07"}), ("bleach", 0.1, {}), ("dark", 120.1, {}))
        ):
            page.publish({"sequence": number, "kind": kind, "time_s": time_s, **facts})
        yield page, controls


def _tell_trials(page, first, count):
    """Tell trials every half minute: thresholds of a healthy curve, one catch that was pressed for every ten."""
    for number in range(first, first + count):
        minutes = 0.5 * (number + 1)
        event: dict[str, Any] = {"sequence": 10 + 2 * number, "time_s": 120.1 + 60 * minutes}
        page.publish({**event, "kind": "blink", "log10_level": -1.0, "presses_s": [0.4]})
        found = round(SubjectCurve().threshold(minutes) + 0.05 * (-1) ** number, 3)
        trial = {"catch": True, "false_press": True, "threshold": None}
        if number % 10 != 9:
            trial = {"catch": False, "false_press": False, "threshold": found, "minutes": minutes}
        page.publish({**event, "sequence": 11 + 2 * number, "kind": "trial", **trial})


async def _text(browser, name):
    return str(await browser.evaluate(f"document.getElementById('{name}').textContent"))


async def _wait_for_text(browser, name, text):
    await browser.wait_for(f"document.getElementById('{name}').textContent === {text!r}")


@pytest.mark.slow
async def test_page_shows_points_grow_and_survives_a_reload(served, browser):
    """Phase, counts, fit and devices appear; a reload has all of it again; nothing is loaded from elsewhere."""
    page, _ = served
    await browser.command("Page.navigate", url=page.url)
    await _wait_for_text(browser, "phase", "Look at the red mark")
    _tell_trials(page, 0, 5)
    await _wait_for_text(browser, "found", "5")
    few = int((await browser.picture())[..., 0].astype(int).sum())
    _tell_trials(page, 5, 45)
    await _wait_for_text(browser, "found", "45")
    await browser.wait_for("document.getElementById('fit').textContent.includes('break')")
    await browser.command("Page.reload")
    await _wait_for_text(browser, "found", "45")
    await browser.wait_for("document.getElementById('fit').textContent.includes('break')")
    assert await _text(browser, "catches") == await _text(browser, "false") == "5"
    assert "5.02 V" in await _text(browser, "devices")
    assert "S07" in await _text(browser, "who")
    assert int((await browser.picture())[..., 0].astype(int).sum()) > few
    page.publish({"sequence": 900, "kind": "prompt", "time_s": 2000.0, "say": "end"})
    await browser.wait_for("played.includes('end')")
    page.publish({"sequence": 901, "kind": "end", "time_s": 2000.0, "verdict": "complete", "explanation": "all of it"})
    await _wait_for_text(browser, "phase", "Over: complete")
    assert [url for url in browser.requested if not url.startswith((page.url.split("?")[0], "data:"))] == []
    assert browser.errors == []


@pytest.mark.slow
async def test_nothing_on_the_page_is_green_or_blue(served, browser):
    """At its brightest and with every part shown not one pixel has green or blue; as opened the red stays below 100."""
    page, _ = served
    _tell_trials(page, 0, 40)
    await browser.command("Page.navigate", url=page.url)
    await _wait_for_text(browser, "found", "36")
    picture = await browser.picture()
    assert picture.shape[:2] == (2 * PHONE[1], 2 * PHONE[0])
    assert picture[..., 1:].max() == 0
    assert 30 < picture[..., 0].max() < 100
    assert picture[..., 0].mean() < 10
    await browser.evaluate("for (let n = 0; n < 9; n++) document.getElementById('brighter').click()")
    await browser.evaluate("document.getElementById('stop').focus(); document.getElementById('stop').click()")
    await browser.evaluate("getSelection().selectAllChildren(document.body)")
    brightest = await browser.picture()
    assert brightest[..., 1:].max() == 0
    assert brightest[..., 0].max() > picture[..., 0].max()
    assert await browser.evaluate("document.documentElement.scrollWidth <= innerWidth")


@pytest.mark.slow
async def test_every_prompt_has_tones_of_its_own(served, browser):
    """Each prompt sounds, below half of full scale, and differs; 0.12 s of 392 Hz cross zero upwards 47 times."""
    page, _ = served
    await browser.command("Page.navigate", url=page.url)
    await browser.wait_for("now !== null")
    crossings = {}
    for name in ("bleach", "dark", "mark", "threshold", "pause", "resume", "end"):
        script = (
            "(async () => { const context = new OfflineAudioContext(1, 48000, 48000); "
            f"play(context, {name!r}); return Array.from((await context.startRendering()).getChannelData(0)); }})()"
        )
        wave = np.array(await browser.evaluate(script))
        assert 0.1 < np.abs(wave).max() < 0.5
        crossings[name] = int(np.sum((wave[:-1] <= 0) & (wave[1:] > 0)))
    assert crossings["threshold"] == pytest.approx(392 * 0.12, abs=2)
    assert len(set(crossings.values())) == len(crossings)


@pytest.mark.slow
async def test_pause_and_stop_on_the_page_stand_in_the_journal(tmp_path, browser):
    """A run pauses where the page asked for it before it began, goes on, and ends: each by the page, in this order."""
    classic = read_protocol("classic")
    protocol = classic.model_copy(update={"end": classic.end.model_copy(update={"duration_min": 120.0})})
    controls = Controls(linger_s=0.1)
    stage = simulated_stage(protocol, "steady", seed=3)
    with LivePage(protocol, controls) as page:

        def watch(event):
            page.publish(event)
            time.sleep(0.1 if event["kind"] == "trial" else 0.0)

        def run():
            with RunJournal(tmp_path / "j") as journal:
                return run_test(protocol, stage, journal, subject="S1", watch=watch, controls=controls)

        await browser.command("Page.navigate", url=page.url)
        await browser.wait_for("!document.getElementById('pause').disabled")
        await browser.evaluate("document.getElementById('pause').click()")
        await _wait_for_text(browser, "pause", "Resume")
        running = asyncio.create_task(asyncio.to_thread(run))
        await _wait_for_text(browser, "phase", "Paused")
        await browser.evaluate("document.getElementById('pause').click()")
        await browser.wait_for("Number(document.getElementById('found').textContent) > 2")
        await browser.evaluate("document.getElementById('stop').click(); document.getElementById('stop').click()")
        outcome = await running
        await _wait_for_text(browser, "phase", "Over: stopped")
    assert outcome.verdict is Verdict.STOPPED
    with RunJournal(tmp_path / "j") as journal:
        asked = [
            (event["kind"], event["by"]) for event in journal.events if event["kind"] in ("pause", "resume", "stop")
        ]
    assert asked == [("pause", "page"), ("resume", "page"), ("stop", "page")]
