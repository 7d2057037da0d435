"""The state of a running test, in a terminal and on the page that browsers see."""

import json
import re

import aiohttp
import numpy as np
import pytest

from radiometer.adaptation.live import LivePage, LiveState, LiveText, event_line, live_lines, replayed, running_fit
from radiometer.adaptation.outcome import RunJournal
from radiometer.adaptation.protocol import read_protocol
from radiometer.adaptation.request import Controls
from radiometer.adaptation.session import prompts_after, with_prompts
from radiometer.errors import DeviceInUse, DeviceTimeout
from radiometer.reporting.terminal_chart import TerminalChart
from testing.patience import within
from testing.scripted_adaptation import SubjectCurve


def _event(kind, time_s, **facts):
    return {"sequence": round(10 * time_s), "kind": kind, "time_s": time_s, **facts}


def _trial(time_s, threshold, *, false=False, catch=False):
    minutes = {} if catch else {"minutes": (time_s - 120) / 60}
    return _event("trial", time_s, catch=catch, false_press=false, threshold=threshold, **minutes)


@pytest.fixture
def state():
    """Return the state of a test that has just gone dark, after 120 s."""
    state = LiveState(read_protocol("classic"))
    for event in (_event("start", 0.0, subject="S1"), _event("bleach", 0.1), _event("dark", 120.0)):
        state.take(event)
    return state


def test_phases_follow_the_events(state):
    """Bleach, fixation, threshold, pause and the end; notes in between change nothing."""
    seen = [state.phase]
    for event in (
        _event("blink", 121.0, log10_level=0.5, presses_s=[]),
        _event("prompt", 121.0, say="threshold"),
        _trial(122.0, 0.5),
        _event("pause", 123.0, by="page", voids=None),
        _event("resume", 130.0, by="page"),
        _event("end", 140.0, verdict="stopped", explanation="enough"),
    ):
        state.take(event)
        seen.append(state.phase)
    assert seen == ["fixation", "threshold", "threshold", "fixation", "paused", "fixation", "over"]
    assert state.outcome == ("stopped", "enough")
    assert state.to_mapping()["subject"] == "S1"


def test_false_presses_are_caught_and_hasty_ones(state):
    """One pressed catch of two and one hasty press make two false presses; the hasty trial has no threshold."""
    for event in (
        _trial(130, None, catch=True),
        _trial(140, None, catch=True, false=True),
        _trial(150, None, false=True),
        _trial(160, -0.5),
        _trial(170, -0.1),
        _event("pause", 171, by="subject", voids=1700),  # a long press: its threshold is on no curve
    ):
        state.take(event)
    mapping = state.to_mapping()
    assert (mapping["catches"], mapping["false_presses"]) == (2, 2)
    assert mapping["points"] == [[round(40 / 60, 3), -0.5]]
    assert mapping["missed"] == [0.5]


def test_running_fit_finds_the_break_and_says_why_there_is_none():
    """Too few thresholds and a flat curve are stated so; with 0.05 log10 of noise the break is at 9 min."""
    rng = np.random.default_rng(3)
    whole = [(t, SubjectCurve().threshold(t) + rng.normal(0, 0.05)) for t in np.arange(0.5, 35, 0.5)]
    fit = running_fit(whole)
    assert float(fit.text.split("break ")[1].split()[0]) == pytest.approx(9.0, abs=1.2)  # 4 sigmas of 70 thresholds
    errors = [value - SubjectCurve().threshold(t) for t, value in fit.curve]
    assert np.sqrt(np.mean(np.square(errors))) < 0.1
    plateaus = [float(running_fit(whole, bias).text.split("plateau ")[1].split(",")[0]) for bias in (0.0, -0.1)]
    assert plateaus[1] - plateaus[0] == pytest.approx(0.1, abs=0.011)  # as `adapt fit` removes the method's bias
    assert running_fit(whole[:5]).text == "a fit needs 8 thresholds"
    assert "no fit yet" in running_fit([(t, -1.0) for t, _ in whole]).text


def test_chart_sets_dots_where_the_points_are():
    """The corners of the ranges are the corner dots; a point outside is not drawn."""
    chart = TerminalChart(4, 2, (0.0, 1.0), (0.0, 1.0))
    chart.dots([(0.0, 0.0), (1.0, 1.0), (0.5, 2.0)])
    top, bottom, *_ = chart.lines([0, 1], [0, 1], "min")
    assert top[6:] == "⠀⠀⠀⠈"
    assert bottom[6:] == "⡀⠀⠀⠀"
    assert (top[:6], bottom[:6]) == ("   1 ┤", "   0 ┤")


def test_terminal_shows_clock_curve_and_counts(state):
    """The axis by name, then 11 rows of chart between the clock and the counts, and the level that blinks."""
    for minute in range(1, 12):
        state.take(_trial(120.0 + 60 * minute, SubjectCurve().threshold(minute)))
    state.take(_event("blink", 781.0, log10_level=-1.5, presses_s=[0.4]))
    lines = live_lines(state, running_fit(state.points), 60, waited_s=2.0)
    assert lines[0].startswith("11:03 in the dark")
    assert lines[-1].startswith("11 thresholds   0 not seen")
    assert lines[-1].endswith("spot -1.50  pressed")
    assert sum("⠀" in line for line in lines) == 11
    assert lines[1] == "log₁₀ threshold, scotopic cd·m⁻²"
    assert max(map(len, lines)) < 80


def test_prompts_follow_the_phases():
    """Every phase and every threshold has its sound, catches and misses have none."""
    text = {kind: prompts_after(_event(kind, 1.0)) for kind in ("start", "bleach", "dark", "pause", "resume", "end")}
    assert text["dark"] == ("dark", "mark")
    assert all(text[kind] == (kind,) for kind in ("bleach", "pause", "resume", "end"))
    assert text["start"] == ()
    assert prompts_after(_trial(5, -1.0)) == ("threshold",)
    assert prompts_after(_trial(5, None)) == prompts_after(_trial(5, None, catch=True)) == ()


@pytest.mark.parametrize("given", [0, 1, 2])
def test_prompts_that_a_crash_left_out_are_given_once(tmp_path, given):
    """With none, one or both of two prompts in the journal, taking it up leaves both there, in order."""
    heard = []
    with RunJournal(tmp_path / "j") as journal:
        journal.write("dark", 120.0, steady=True)
        for say in ("dark", "mark")[:given]:
            journal.write("prompt", 120.0, say=say)
        with_prompts(journal, journal.events.append, heard.append)
        with_prompts(journal, journal.events.append, heard.append)
        assert [event["say"] for event in journal.of_kind("prompt")] == ["dark", "mark"]
    assert len(heard) == 2 - given


def test_lost_fixation_is_announced_until_a_light_in_the_blind_spot_is_missed(state):
    """Counts of looks away and lapses are shown; they are neither catches nor thresholds."""
    look = {"catch": True, "false_press": False, "threshold": None}
    for event in (
        _event("trial", 400.0, of="blind_spot", seen=True, **look),
        _event("trial", 410.0, of="bright", seen=False, **look),
        _event("trial", 420.0, of="blind_spot", seen=True, **look),
        _event("fixation", 420.0, lost=2, of=2),
    ):
        state.take(event)
    mapping = state.to_mapping()
    assert (mapping["fixation"], mapping["lapses"], mapping["fixation_lost"]) == ([2, 2], [1, 1], True)
    assert (mapping["catches"], mapping["points"], mapping["missed"]) == (0, [], [])
    assert "fixation lost 2/2   lapses 1/1   FIXATION LOST" in "\n".join(live_lines(state, running_fit([]), 60))
    state.take(_event("trial", 430.0, of="blind_spot", seen=False, **look))
    mapping = state.to_mapping()
    assert (mapping["fixation"], mapping["fixation_lost"]) == ([2, 3], False)


@pytest.mark.parametrize(
    ("event", "line"),
    [
        (_event("check", 0, what="limits"), "checked: the box's limits"),
        (
            _event("check", 0, what="exposure", blue_light=0.012, thermal=0.0034),
            "checked: 1.2 % of the blue-light limit, 0.34 % of the thermal one",
        ),
        (
            _event("check", 0, what="calibration", of="box", age_days=400.2, accepted_stale=True),
            "checked: calibration of box, 400 days old, older than the protocol allows: accepted",
        ),
        (_event("check", 0, what="calibration", of="screen"), "checked: calibration of screen"),
        (_event("room", 0, luminance_cd_m2=0.0021, u_cd_m2=0.0003), "dark room: 0.00210 ± 0.00060 cd·m⁻² (k = 2)"),
        (_event("room", 0, luminance_cd_m2=None, u_cd_m2=None), ""),
        (_event("refused", 0), "refused: nothing was shown"),
        (_event("bleach", 0), "bleach: look at the bright field"),
        (_event("dark", 0), "dark: look at the red mark and press whenever the spot is seen"),
        (_event("pause", 0, by="page"), "pause by page"),
        (_event("resume", 0), "resume by operator"),
        (_event("fixation", 0, lost=3, of=4), "FIXATION LOST (3 of the last 4 checks): look at the red mark"),
        (_event("stage", 0, no_fixation_check="no second spot"), "fixation is not checked: no second spot"),
        (_event("stage", 0), ""),
        (_event("trial", 0, of="blind_spot", seen=False), "blind spot: rightly not seen"),
        (_event("trial", 0, of="blind_spot", seen=True), "blind spot: seen"),
        (_event("trial", 0, of="bright", seen=False), "bright spot: missed"),
        (_event("trial", 0, of="bright", seen=True), "bright spot: seen"),
        (_trial(130, None, catch=True, false=True), "catch: pressed"),
        (_trial(130, None, catch=True), "catch: rightly not pressed"),
        (_trial(180, None), "1.00 min not seen"),
        (_trial(180, None, false=True), "1.00 min pressed too early"),
        (_trial(180, -5.1), f"1.00 min -5.10 log₁₀ scotopic cd·m⁻² {'▪' * 2}"),
        (_trial(180, -6.0), "1.00 min -6.00 log₁₀ scotopic cd·m⁻²"),
    ],
)
def test_without_a_terminal_each_event_is_a_line(event, line):
    """What a pipe or a log gets: checks with figures, phases, trials with minutes and threshold; else nothing."""
    assert " ".join((event_line(event) or "").split()) == line


def test_the_terminal_shows_the_running_curve():
    """In a terminal what the journal held counts too: phase, time in the dark, and the counts of points."""
    known = [_event("start", 0.0, subject="S1"), _event("bleach", 0.1), _event("dark", 120.0)]
    screen = LiveText(read_protocol("classic"), known)
    for event in (_trial(150, -1.0), _trial(180, -1.5), _trial(200, None)):
        screen.take(event)
    shown = "\n".join(screen.lines(60))
    assert re.search(r"^1:\d\d in the dark   look at the red mark\n", shown)
    assert "2 thresholds   1 not seen   0 catches   0 false presses" in shown


def test_bleach_is_counted_down(state):
    """After 50 s of the bleach the clock shows what is left of the protocol's time."""
    lasts_s = int(state.protocol.bleach.duration_s)
    state = LiveState(state.protocol)
    for event in (_event("start", 0.0, subject="S1"), _event("bleach", 0.0)):
        state.take(event)
    left_s = lasts_s - 50
    first = live_lines(state, running_fit([]), 60, waited_s=50.0)[0]
    assert first.startswith(f"{left_s // 60}:{left_s % 60:02d} left of {lasts_s // 60}:{lasts_s % 60:02d}")


BEGIN = [
    {"sequence": 0, "kind": "start", "time_s": 0.0, "subject": "S1"},
    {"sequence": 1, "kind": "bleach", "time_s": 0.1},
    {"sequence": 2, "kind": "prompt", "time_s": 0.1, "say": "bleach"},
    {"sequence": 3, "kind": "dark", "time_s": 120.0},
]


def _page_trial(number):
    facts = {"catch": False, "false_press": False, "threshold": 1.0 - 0.1 * number, "minutes": 0.2 * number}
    return {"sequence": number, "kind": "trial", "time_s": 120.0 + 12 * number, **facts}


@pytest.fixture
def page():
    """Return the open page of a test whose bleach is over."""
    with LivePage(read_protocol("classic"), Controls()) as page:
        replayed(page, BEGIN)
        yield page


async def _until(socket, key, expected):
    """Return the first message in which a key has a value."""
    while True:
        message = json.loads((await socket.receive(timeout=within(20))).data)
        if message.get(key) == expected:
            return dict(message)


async def test_every_browser_gets_the_whole_state_and_what_follows(page):
    """Two browsers, one of them late, see the same; one that goes away is missed by no one."""
    address = page.url.replace("/?", "/socket?")
    async with aiohttp.ClientSession() as session, session.ws_connect(address) as first:
        await _until(first, "phase", "fixation")
        for number in range(10, 13):
            page.publish(_page_trial(number))
        async with session.ws_connect(address) as late:
            await _until(late, "points", [[2.0, 0.0], [2.2, -0.1], [2.4, -0.2]])
        page.publish({"sequence": 20, "kind": "pause", "time_s": 300.0, "by": "page", "voids": None})
        assert (await _until(first, "phase", "paused"))["subject"] == "S1"
        for number in range(21, 40):
            page.publish(_page_trial(number))
        fitted = await _until(first, "phase", "fixation")
        while len(fitted["points"]) != fitted["fit"]["count"]:
            fitted = await _until(first, "kind", "state")
        assert len(fitted["points"]) == 22


async def test_prompts_are_reported_as_they_come_and_not_again(page):
    """A browser that comes later does not get the old ones."""
    async with aiohttp.ClientSession() as session, session.ws_connect(page.url.replace("/?", "/socket?")) as socket:
        await _until(socket, "phase", "fixation")
        page.publish({"sequence": 9, "kind": "prompt", "time_s": 121.0, "say": "threshold"})
        assert (await _until(socket, "kind", "prompt"))["say"] == "threshold"


async def test_nonsense_from_a_browser_is_passed_over():
    """Neither broken JSON nor unknown words stop the server or reach the run."""
    controls = Controls()
    with LivePage(read_protocol("classic"), controls) as page:
        async with aiohttp.ClientSession() as session, session.ws_connect(page.url.replace("/?", "/socket?")) as socket:
            for text in ("{", "[" * 5000, "[]", '{"kind": "explode"}', '{"kind": ["stop"]}'):
                await socket.send_str(text)
            await socket.send_json({"kind": "pause"})
            assert (await _until(socket, "pause_asked", "page"))["stop_asked"] is None
    assert controls.stopped_by is None


async def test_devices_that_do_not_answer_are_shown_so():
    """The run is not disturbed by a box that does not report its state."""

    def silent():
        raise DeviceTimeout("the box does not answer")

    with LivePage(read_protocol("classic"), Controls(), health=silent) as page:
        async with aiohttp.ClientSession() as session, session.ws_connect(page.url.replace("/?", "/socket?")) as socket:
            assert (await _until(socket, "phase", "starting"))["devices"] == {"devices": "the box does not answer"}


async def test_lights_off_darkens_the_box_and_ends_the_test():
    """The box is darkened at once, whoever holds it; the run is asked to end, or its next blink would light it."""
    controls, asked = Controls(), []

    def darken():
        asked.append(controls.stopped_by)
        return "dark: light box AAAA0001"

    with LivePage(read_protocol("classic"), controls, darken=darken) as page:
        async with aiohttp.ClientSession() as session, session.ws_connect(page.url.replace("/?", "/socket?")) as socket:
            await socket.send_json({"kind": "lights_off"})
            assert (await _until(socket, "kind", "outcome"))["text"] == "dark: light box AAAA0001"
    assert asked == ["lights off"]


async def test_a_box_that_cannot_be_darkened_is_reported_to_be_lit():
    """The page shows why and how else; the server goes on."""

    def stuck():
        raise DeviceInUse("process 7 holds light box AAAA0001 and does not darken it; hold its button for 3 s")

    with LivePage(read_protocol("classic"), Controls(), darken=stuck) as page:
        async with aiohttp.ClientSession() as session, session.ws_connect(page.url.replace("/?", "/socket?")) as socket:
            await socket.send_json({"kind": "lights_off"})
            reported = await _until(socket, "kind", "outcome")
            assert str(reported["text"]).startswith("not dark: process 7 holds")
