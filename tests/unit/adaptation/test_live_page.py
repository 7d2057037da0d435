"""The page's server: whole state on connecting, buttons to the run, strangers and lost browsers."""

from __future__ import annotations

import json
import urllib.error
import urllib.request
from collections.abc import Iterator

import aiohttp
import pytest

from radiometer.adaptation.controls import Controls
from radiometer.adaptation.live_page import LivePage, replayed
from radiometer.adaptation.protocol import read_protocol
from radiometer.errors import DeviceInUse, DeviceTimeout
from testing.patience import within

BEGIN = [
    {"sequence": 0, "kind": "start", "time_s": 0.0, "subject": "S1"},
    {"sequence": 1, "kind": "bleach", "time_s": 0.1},
    {"sequence": 2, "kind": "prompt", "time_s": 0.1, "say": "bleach"},
    {"sequence": 3, "kind": "dark", "time_s": 120.0},
]


def _trial(number: int) -> dict[str, object]:
    facts = {"catch": False, "false_press": False, "threshold": 1.0 - 0.1 * number, "minutes": 0.2 * number}
    return {"sequence": number, "kind": "trial", "time_s": 120.0 + 12 * number, **facts}


@pytest.fixture
def page() -> Iterator[LivePage]:
    """Return the open page of a test whose bleach is over."""
    with LivePage(read_protocol("classic"), Controls()) as page:
        replayed(page, BEGIN)
        yield page


async def _until(socket: aiohttp.ClientWebSocketResponse, key: str, expected: object) -> dict[str, object]:
    """Return the first message in which a key has a value."""
    while True:
        message = json.loads((await socket.receive(timeout=within(20))).data)
        if message.get(key) == expected:
            return dict(message)


async def test_every_browser_gets_the_whole_state_and_what_follows(page: LivePage) -> None:
    """Two browsers, one of them late, see the same; one that goes away is missed by no one."""
    address = page.url.replace("/?", "/socket?")
    async with aiohttp.ClientSession() as session, session.ws_connect(address) as first:
        await _until(first, "phase", "fixation")
        for number in range(10, 13):
            page.tell(_trial(number))
        async with session.ws_connect(address) as late:
            await _until(late, "points", [[2.0, 0.0], [2.2, -0.1], [2.4, -0.2]])
        page.tell({"sequence": 20, "kind": "pause", "time_s": 300.0, "by": "page", "voids": None})
        assert (await _until(first, "phase", "paused"))["subject"] == "S1"
        for number in range(21, 40):
            page.tell(_trial(number))
        fitted = await _until(first, "phase", "fixation")
        while len(fitted["points"]) != fitted["fit"]["count"]:  # type: ignore[arg-type, index]
            fitted = await _until(first, "kind", "state")
        assert len(fitted["points"]) == 22  # type: ignore[arg-type]


async def test_prompts_are_reported_as_they_come_and_not_again(page: LivePage) -> None:
    """A browser that comes later does not get the old ones."""
    async with aiohttp.ClientSession() as session, session.ws_connect(page.url.replace("/?", "/socket?")) as socket:
        await _until(socket, "phase", "fixation")
        page.tell({"sequence": 9, "kind": "prompt", "time_s": 121.0, "say": "threshold"})
        assert (await _until(socket, "kind", "prompt"))["say"] == "threshold"


async def test_nonsense_from_a_browser_is_passed_over() -> None:
    """Neither broken JSON nor unknown words stop the server or reach the run."""
    controls = Controls()
    with LivePage(read_protocol("classic"), controls) as page:
        async with aiohttp.ClientSession() as session, session.ws_connect(page.url.replace("/?", "/socket?")) as socket:
            for text in ("{", "[]", '{"kind": "explode"}', '{"kind": ["stop"]}'):
                await socket.send_str(text)
            await socket.send_json({"kind": "pause"})
            assert (await _until(socket, "pause_asked", "page"))["stop_asked"] is None
    assert controls.stopped_by is None


async def test_devices_that_do_not_answer_are_shown_so() -> None:
    """The run is not disturbed by a box that does not tell how it is."""

    def silent() -> dict[str, str]:
        raise DeviceTimeout("the box does not answer")

    with LivePage(read_protocol("classic"), Controls(), health=silent) as page:
        async with aiohttp.ClientSession() as session, session.ws_connect(page.url.replace("/?", "/socket?")) as socket:
            assert (await _until(socket, "phase", "starting"))["devices"] == {"devices": "the box does not answer"}


def test_strangers_and_a_taken_port(page: LivePage) -> None:
    """Without the key there is no page; a second server on the port is refused with the port's number."""
    with pytest.raises(urllib.error.HTTPError) as refused:
        urllib.request.urlopen(page.url.split("?")[0], timeout=within(10))
    assert refused.value.code == 403
    refused.value.close()
    port = int(page.url.split(":")[2].split("/")[0])
    with pytest.raises(DeviceInUse, match=str(port)), LivePage(read_protocol("classic"), Controls(), port):
        pass


def test_page_holds_no_colour_but_red_and_nothing_from_elsewhere(page: LivePage) -> None:
    """Every rgb() of the page has no green and no blue, and no address stands in it."""
    with urllib.request.urlopen(page.url, timeout=within(10)) as answer:
        text = answer.read().decode()
    parts = text.split("rgb(")[1:]
    assert len(parts) > 5
    assert all(part.split(")")[0].split()[1:] == ["0", "0"] or part.startswith("${") for part in parts)
    assert "http" not in text.replace("ws://", "")


async def test_lights_off_darkens_the_box_and_ends_the_test() -> None:
    """The box is darkened at once, whoever holds it; the run is asked to end, or its next blink would light it."""
    controls, asked = Controls(), []

    def darken() -> str:
        asked.append(controls.stopped_by)
        return "dark: light box AAAA0001"

    with LivePage(read_protocol("classic"), controls, darken=darken) as page:
        async with aiohttp.ClientSession() as session, session.ws_connect(page.url.replace("/?", "/socket?")) as socket:
            await socket.send_json({"kind": "lights_off"})
            assert (await _until(socket, "kind", "outcome"))["text"] == "dark: light box AAAA0001"
    assert asked == ["lights off"]


async def test_a_box_that_cannot_be_darkened_is_reported_to_be_lit() -> None:
    """The page shows why and how else; the server goes on."""

    def stuck() -> str:
        raise DeviceInUse("process 7 holds light box AAAA0001 and does not darken it; hold its button for 3 s")

    with LivePage(read_protocol("classic"), Controls(), darken=stuck) as page:
        async with aiohttp.ClientSession() as session, session.ws_connect(page.url.replace("/?", "/socket?")) as socket:
            await socket.send_json({"kind": "lights_off"})
            reported = await _until(socket, "kind", "outcome")
            assert str(reported["text"]).startswith("not dark: process 7 holds")
