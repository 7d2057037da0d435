"""The whole test on a screen: a simulated one with a simulated subject, and a real browser with a real key."""

import asyncio
import contextlib
import json
import math
import os
import queue
import subprocess
import sys

import numpy as np
import pytest

from radiometer.adaptation.outcome import RunJournal, Verdict
from radiometer.adaptation.protocol import read_protocol
from radiometer.adaptation.request import RunRequest
from radiometer.adaptation.run import run_test
from radiometer.adaptation.screen_setup import open_screen_stage
from radiometer.bench.screen import lights, open_screen_bench
from radiometer.errors import CalibrationError, ConfigurationError, DeviceLost, UsageError
from radiometer.screen.browser_page import BrowserStimulus
from radiometer.screen.calibration import ScreenCalibration
from radiometer.screen.calibration_run import Options, calibrate_screen
from radiometer.screen.stimulus import ScreenPicture, Viewing
from simulators.observers.eye_kinetics import Eye, eye_after_bleach, scotopic_lm_per_w
from simulators.observers.observer import PRIMARY_NM, Habits, Observer
from testing.chromium import headless, shows
from testing.patience import within

LEVELS = (0, 1, 2, 4, 8, 16, 32, 64, 128, 192, 255)


@pytest.fixture(scope="module")
def oled(tmp_path_factory):
    """Return the calibration of a simulated OLED by the simulated camera."""
    file = tmp_path_factory.mktemp("screen") / "oled.yaml"
    with open_screen_bench("oled", seed=2) as bench:
        calibrate_screen(bench, Options("oled", LEVELS, ("blue",)), lights(primaries="crt")).write(file)
    return file


def _run(file, journal, *, subject="steady", dies_after=None):
    """Return the outcome of a run; one that dies does so after a number of events."""

    def watch(event):
        if dies_after is not None and event["sequence"] >= dies_after:
            raise DeviceLost("the power failed")

    with (
        open_screen_stage(
            RunRequest(read_protocol("screen-only"), screen=file, display="oled", simulate=subject, seed=7)
        ) as opened,
        RunJournal(journal) as open_journal,
    ):
        stage, _ = opened  # the age of the calibration is left out: it is another in every run
        return run_test(stage.protocol, stage, open_journal, subject="S1", seed=7, watch=watch)


def _by_limits(rng):
    """Return the error of one ascent: from 0.4 below the threshold up by 0.1 until seen, once it was missed."""
    observer, missed, level = Observer(Eye(), Habits(), rng), False, -0.4 + float(rng.uniform(-0.05, 0.05))
    truth = Eye().threshold_log10(30.0, 450.0)
    while True:
        seen = observer.answer(truth + level, 1800.0, 450.0) is not None
        if seen and missed:
            return level
        missed, level = missed or not seen, level - 0.4 if seen else level + 0.1


def test_thresholds_are_the_simulated_eyes(oled, tmp_path):
    """Less the eye's own they are what ascending limits find, to 4·s/√n; the ratio of efficacies is taken out."""
    outcome = _run(oled, tmp_path / "j")
    calibration = ScreenCalibration.read(oled)
    efficacy = math.log10(calibration.channel("blue").scotopic_lm_per_w / scotopic_lm_per_w(PRIMARY_NM[2]))
    eye = eye_after_bleach(Eye(), 120.0, 300.0)
    fine = [(t, v) for t, v in zip(outcome.times_min, outcome.thresholds_log10, strict=True) if v > -2.0]
    errors = np.array([v - efficacy - eye.threshold_log10(t, PRIMARY_NM[2]) for t, v in fine])
    expected = np.array([_by_limits(np.random.default_rng(n)) for n in range(500)])
    assert outcome.verdict is Verdict.FLOOR_REACHED
    assert errors.size > 15
    assert errors.mean() == pytest.approx(expected.mean(), abs=4 * expected.std() / math.sqrt(errors.size) + 0.01)
    assert errors.std() < 1.8 * expected.std()


def test_filter_before_an_lcd_lets_the_curve_go_on(tmp_path):
    """Its darkest level is above the cones' plateau: the curve ends at once, and behind density 2 it goes on."""
    file = tmp_path / "lcd.yaml"
    with open_screen_bench("lcd", seed=2) as bench:
        calibrate_screen(bench, Options("lcd", LEVELS, ("blue",), repeats=2), lights(primaries="crt")).write(file)
    lowest, counts = [], []
    for density in (0.0, 2.0):
        protocol = read_protocol("screen-only")
        protocol = protocol.model_copy(update={"spot": protocol.spot.model_copy(update={"filter_density": density})})
        with (
            open_screen_stage(RunRequest(protocol, screen=file, display="lcd", simulate="steady", seed=7)) as (
                stage,
                _,
            ),
            RunJournal(tmp_path / f"j{density}") as journal,
        ):
            outcome = run_test(stage.protocol, stage, journal, subject="S1", seed=7)
        lowest.append(stage.protocol.spot.lowest_log10)
        counts.append(len(outcome.thresholds_log10))
    assert lowest[1] == pytest.approx(lowest[0] - 2.0)
    assert counts[1] > 3 * counts[0]


def test_command_runs_it_and_journals_the_prompts(oled, tmp_path, project_root):
    """`adapt run screen-only` before a simulated screen ends well; prompts stand in the journal, bells on stderr."""
    words = ["adapt", "run", "screen-only", "--subject", "S1", "--screen", str(oled), "--display", "oled"]
    done = subprocess.run(
        [sys.executable, "-m", "radiometer", *words, "--simulate", "steady", "--audio", "--json", "--page"],
        cwd=tmp_path, capture_output=True, text=True, timeout=within(150), check=False,
        env={**os.environ, "PYTHONPATH": str(project_root)},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    (journal,) = tmp_path.glob("S1-screen-only-right-*.jsonl")
    events = [json.loads(line) for line in journal.read_text().splitlines()]
    printed = [event["say"] for event in events if event["kind"] == "prompt"]
    found = sum(event["kind"] == "trial" and event["threshold"] is not None for event in events)
    assert printed[:3] == ["bleach", "dark", "mark"]
    assert printed[-1] == "end"
    assert printed.count("threshold") == found > 15
    assert "http://127.0.0.1:" in done.stderr
    assert json.loads(done.stdout.splitlines()[-1])["verdict"] == "floor_reached"


def test_what_does_not_go_together_is_refused(oled, tmp_path):
    """No calibration, an old one, no subject, a subject before a real page, a criterion out of reach: all stated."""
    protocol = read_protocol("screen-only")
    old = tmp_path / "old.yaml"
    old.write_text(oled.read_text().replace(ScreenCalibration.read(oled).created, "2020-01-01T00:00:00Z"))
    for asked, error, text in (
        ({}, UsageError, "--screen FILE"),
        ({"screen": oled, "display": "oled"}, UsageError, "--simulate"),
        ({"screen": oled, "simulate": "never"}, UsageError, "simulated displays only"),
        ({"screen": old, "display": "oled"}, CalibrationError, "allows 30"),
    ):
        with pytest.raises(error, match=text), open_screen_stage(RunRequest(protocol, **asked)):
            pass
    bright = protocol.model_copy(update={"bleach": protocol.bleach.model_copy(update={"luminance_cd_m2": 900.0})})
    with (
        pytest.raises(ConfigurationError, match="beyond screen oled"),
        open_screen_stage(RunRequest(bright, screen=oled, display="oled", simulate="steady")),
    ):
        pass


@pytest.fixture
async def shown(tmp_path):
    """Return the test's page in headless Chromium, its Start pressed."""
    addresses: queue.SimpleQueue[str] = queue.SimpleQueue()
    screen = BrowserStimulus(announce=addresses.put, page_timeout_s=60, start_timeout_s=60)
    async with headless(tmp_path / "profile") as browser, shows(browser, screen, addresses, start=True):
        yield screen, browser


VIEWING = Viewing(300.0, 0.27)
MARK = VIEWING.ellipse(-4.0, 0.6, (60, 0, 0))


@pytest.mark.slow
async def test_browser_shows_exactly_the_codes_asked_for(shown):
    """Field, mark and spot stand on the composed screen to the code, the spot in its place and size to a pixel."""
    screen, browser = shown
    waiting = await browser.picture()
    assert waiting[..., 0].max() > 50
    assert waiting[..., 1:].max() == 0  # what is read before the test, in the dark room, is red alone
    await asyncio.to_thread(screen.show, ScreenPicture((187, 187, 187)))
    assert np.unique(await browser.picture()).tolist() == [187]
    for code in (1, 2, 37, 128, 255):
        spot = VIEWING.ellipse(4.0, 1.5, (0, 0, code))
        await asyncio.to_thread(screen.show, ScreenPicture(shapes=(MARK, spot)))
        picture = await browser.picture()
        height, width = picture.shape[:2]
        at = [picture[height // 2, round(width / 2 + shape.x)].tolist() for shape in (MARK, spot)]
        assert at == [[60, 0, 0], [0, 0, code]]
        assert picture[:5].max() == picture[-5:].max() == 0
        lit = np.flatnonzero(picture[..., 2].max(axis=0))
        assert (lit[0] + lit[-1] + 1) / 2 == pytest.approx(width / 2 + spot.x, abs=1.0)
        assert lit[-1] - lit[0] + 1 == pytest.approx(spot.width, abs=2.0)
    assert screen.size == (width, height)


async def _tapping(browser):
    """Press and release the space bar until cancelled."""
    while True:
        await browser.key("keyDown")
        await browser.key("keyUp")


@pytest.mark.slow
async def test_browser_blinks_and_records_the_key(shown):
    """Presses during a blink come back from its onset, none is invented; a key held down is reported as a hold."""
    screen, browser = shown
    lit, rest = ScreenPicture(shapes=(MARK, VIEWING.ellipse(4.0, 1.5, (0, 0, 90)))), ScreenPicture(shapes=(MARK,))
    await asyncio.to_thread(screen.show, rest)
    quiet = await asyncio.to_thread(screen.blink, lit, rest, 0.3, 0.6)
    assert quiet.presses_s == ()
    assert quiet.hold.lasted_s == 0
    assert (await browser.picture())[..., 2].max() == 0  # the spot is off again
    tapping = asyncio.create_task(_tapping(browser))
    tapped = await asyncio.to_thread(screen.blink, lit, rest, 0.5, 1.5)
    rested = await asyncio.to_thread(screen.rest, 1.0)
    tapping.cancel()
    with contextlib.suppress(asyncio.CancelledError):
        await tapping
    assert len(tapped.presses_s) >= 1
    assert rested.presses >= 1
    assert all(0 <= a <= b for a, b in zip(tapped.presses_s, tapped.presses_s[1:], strict=False))
    assert tapped.on_s > 0.4
    await browser.key("keyUp")
    await browser.key("keyDown")
    held = await asyncio.to_thread(screen.blink, lit, rest, 0.2, 0.6)
    await browser.key("keyUp")
    assert held.hold.lasted_s > 0.5
    assert held.hold.began_ago_s >= held.hold.lasted_s
