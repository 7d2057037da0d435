"""What HTTP makes of queries, bodies, events and pictures: each piece by itself, without a server."""

from __future__ import annotations

import asyncio
import io
import json
import math
from collections import deque
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from PIL import Image
from pydantic import ValidationError

from radiometer.daemon.http import readings
from radiometer.daemon.http.control import show_health, show_response
from radiometer.daemon.http.patches import show_trend
from radiometer.daemon.http.picture import (
    PictureCache,
    ServedPicture,
    _with_bar,
    beside_bar,
    coloured,
    composite,
    render,
)
from radiometer.daemon.http.requests import MeasureBody, SettingsBody, read_query
from radiometer.daemon.http.route import QUERIES, STATION, QueryParameter
from radiometer.daemon.hub import Event, Hub
from radiometer.daemon.instrument import Measurement
from radiometer.daemon.journal_reader import ReadingFilter
from radiometer.daemon.station import Station
from radiometer.data import Frame, FrameSettings, Patch, Quantity, Reading, ResponseCurve
from radiometer.errors import InputError, UsageError

KNOWN = (
    QueryParameter("limit", "integer", ""),
    QueryParameter("clean", "boolean", ""),
    QueryParameter("flag", "string", ""),
)


@pytest.mark.parametrize(
    ("body", "changes"),
    [
        ({}, {}),
        ({"exposure_s": 0.02}, {"exposure_s": 0.02, "auto_exposure": False}),
        ({"exposure_s": 0.02, "auto_exposure": True}, {"exposure_s": 0.02, "auto_exposure": True}),
        ({"gain_db": 6.0}, {"gain_db": 6.0}),
        ({"patch": None}, {"patch": None}),
        ({"patch": {"x": 1, "y": 2, "width": 3, "height": 4}}, {"patch": Patch(1, 2, 3, 4)}),
        ({"wavelength_nm": None}, {"wavelength_nm": None}),
    ],
)
def test_only_what_a_body_names_is_changed(body: dict[str, Any], changes: dict[str, Any]) -> None:
    """Defaults change nothing; a stated exposure switches the automatic one off, unless both are stated."""
    assert MeasureBody.model_validate(body).changes() == changes
    assert SettingsBody.model_validate({**body, "every_s": 0.5}).changes() == changes


@pytest.mark.parametrize(
    "body", [{"exposure": 1}, {"patch": {"x": 1}}, {"patch": {"x": 1.5, "y": 2, "width": 3, "height": 4}}]
)
def test_a_body_with_other_names_or_kinds_is_refused(body: dict[str, Any]) -> None:
    """A name that is not known, or half a pixel, is no body."""
    with pytest.raises(ValidationError):
        MeasureBody.model_validate(body)


def asked(**query: str) -> Any:
    return SimpleNamespace(query=query, headers={})


@pytest.mark.parametrize(
    ("text", "value"),
    [("1", True), ("on", True), ("True", True), ("", True), ("0", False), ("off", False), ("false", False)],
)
def test_booleans_of_a_query(text: str, value: bool) -> None:
    """On and off in every spelling; a name alone is on."""
    assert read_query(asked(clean=text), KNOWN) == {"clean": value}


@pytest.mark.parametrize(("name", "text"), [("clean", "maybe"), ("limit", "1.5"), ("limit", "all"), ("limits", "1")])
def test_what_a_query_does_not_know_is_refused(name: str, text: str) -> None:
    """Neither a word for a number nor an unknown name is passed over in silence."""
    with pytest.raises(UsageError, match=name):
        read_query(asked(**{name: text}), KNOWN)
    assert read_query(asked(limit="-7", flag="saturated"), KNOWN) == {"limit": -7, "flag": "saturated"}


def test_readings_after_a_number_come_oldest_first_and_else_newest() -> None:
    """So paging with after= misses none; without it the newest 1000 of the shared patch are meant."""
    plain, paged = readings._filter({}, 5000), readings._filter({"after": 7, "limit": 5000, "stream": "all"}, 5000)
    assert (plain.newest_first, plain.limit, plain.stream, plain.after) == (True, 1000, "", None)
    assert (paged.newest_first, paged.limit, paged.stream, paged.after) == (False, 5000, None, 7)
    clean = readings._filter({"clean": True, "flag": "flicker", "stream": "own"}, 5000)
    assert (clean.without_flags, clean.flag, clean.stream) == (True, "flicker", "own")


@pytest.mark.parametrize(
    "query", [{"limit": 0}, {"limit": 5001}, {"after": 2**62}, {"after": -(2**62)}, {"stream": "lamp"}]
)
def test_bounds_of_what_is_asked_for(query: dict[str, Any]) -> None:
    """1 to the limit of rows; numbers that SQLite holds; streams that there can be."""
    with pytest.raises(UsageError):
        readings._filter(query, 5000)
    assert readings.stream_asked("patch lamp") == "patch lamp"


@pytest.mark.parametrize(
    ("event", "sse", "lines"),
    [
        (Event("reading", '{"a":1}', 7), 'id: 7\ndata: {"a":1}\n\n', '{"a":1}\n'),
        (Event("patch", "{}", 8), "id: 8\nevent: patch\ndata: {}\n\n", ""),
        (Event("status", "{}"), "event: status\ndata: {}\n\n", ""),
    ],
)
def test_an_event_on_the_wire(event: Event, sse: str, lines: str) -> None:
    """A reading's number is its id, so that a client that reconnects misses nothing; lines hold readings alone."""
    assert (readings._encoded(event, "sse"), readings._encoded(event, "jsonl")) == (sse, lines)


@pytest.mark.parametrize(
    ("text", "number"), [("12", 12), ("", None), ("-1", None), ("1e3", None), ("9" * 19, None), ("٣", None)]
)
def test_the_last_event_of_a_client(text: str, number: int | None) -> None:
    """A whole number of ASCII digits, or nothing."""
    assert readings._last_event_id(SimpleNamespace(headers={"Last-Event-ID": text})) == number  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("accept", "form", "said"),
    [
        ("", None, "json"),
        ("text/csv", None, "csv"),
        ("application/x-ndjson", None, "jsonl"),
        ("text/csv", "json", "json"),
    ],
)
def test_the_form_of_a_history(accept: str, form: str | None, said: str) -> None:
    """What the query asks for, else the Accept header, else JSON."""
    request: Any = SimpleNamespace(headers={"Accept": accept})
    assert readings._form(request, form) == said
    with pytest.raises(UsageError, match="csv"):
        readings._form(request, "xml")


async def test_a_listener_that_is_too_slow_is_ended_and_not_starved() -> None:
    """Two events wait for one who has room for two; the third ends it. Others get all, in order; closing ends them."""
    hub = Hub()
    slow, quick = hub.subscribe(2), hub.subscribe(10)
    events = [Event("reading", str(n), n) for n in range(3)]
    for event in events:
        hub.publish(event)
    assert (slow.closed, quick.closed, len(hub)) == (True, False, 1)
    assert await slow.next() is None
    assert [await quick.next() for _ in range(3)] == events
    hub.close()
    assert (await quick.next(), len(hub)) == (None, 0)
    gone = hub.subscribe(1)
    hub.unsubscribe(gone)
    hub.publish(events[0])
    assert (len(hub), gone._queue.empty()) == (0, True)


async def test_health_is_503_while_an_alarm_is_up(station: Station) -> None:
    """What a watchdog looks at: 200 and ok, or 503 and the names."""
    request: Any = SimpleNamespace(app={STATION: station})
    well = await show_health(request)
    station.alarms.put_up("camera", "lost")
    ill = await show_health(request)
    assert (well.status, json.loads(well.text or "")) == (200, {"status": "ok", "alarms": []})
    assert (ill.status, json.loads(ill.text or "")) == (503, {"status": "alarm", "alarms": ["camera"]})


async def test_the_curve_of_the_page_is_that_in_use_or_a_straight_line() -> None:
    """A line is ln M up to a constant that makes half of full scale 0; of a curve its own numbers are shown."""
    g = np.log((np.arange(256) + 0.5) / 128.5)
    g[:3] = np.nan
    shown = {}
    for name, curve in (("line", None), ("curve", ResponseCurve(g, np.full(256, 0.01)))):
        station = SimpleNamespace(instrument=SimpleNamespace(response=curve))
        request: Any = SimpleNamespace(app={STATION: station})
        shown[name] = json.loads((await show_response(request)).text or "")
    line, curve = shown["line"], shown["curve"]
    assert (line["linear"], curve["linear"]) == (True, False)
    assert (line["absolute"], curve["absolute"]) == (False, False)
    assert line["log_exposure"] == pytest.approx([math.log(m / 2048) for m in line["dn"]])
    assert (line["dn"][0], line["dn"][-1], set(line["u_log_exposure"])) == (8, 4095, {0.0})
    assert curve["dn"] == list(range(3, 256))
    assert curve["log_exposure"] == pytest.approx(g[3:].tolist())
    assert set(curve["u_log_exposure"]) == {0.01}


def measured(*frames: tuple[float, float, float], dn: np.ndarray[Any, Any] | None = None) -> Measurement:
    """Return a measurement of frames of (number, exposure in s, gain in dB), its patch read as 2."""
    pictures = tuple(
        Frame(
            (np.full((8, 8), number) if dn is None else dn).astype(np.uint16),
            12,
            FrameSettings(exposure_s, gain_db, black_level_dn=64.0),
        )
        for number, exposure_s, gain_db in frames
    )
    return Measurement(Reading(Quantity(2.0, 0.1, "1"), Patch(0, 0, 4, 4), "1"), pictures)


def test_a_picture_is_in_the_unit_of_the_reading() -> None:
    """The patch shows the reading's value; half the light above black shows half; gain is no light."""
    dn = np.full((8, 8), 64 + 1000)
    dn[6, 6] = 64 + 500
    picture = composite(measured((0, 0.01, 0.0), dn=dn), None, 3)
    assert (picture.radiance[0, 0], picture.radiance[6, 6]) == (pytest.approx(2.0), pytest.approx(1.0))
    frames = measured((64 + 400, 0.01, 0.0), (64 + 1600, 0.02, 20 * math.log10(2.0)))
    assert composite(frames, None, 3).radiance[7, 7] == pytest.approx(2.0)
    clipping = measured((64 + 400, 0.01, 0.0), (4095, 0.02, 0.0))
    assert composite(clipping, None, 3).radiance[0, 0] == pytest.approx(2.0)
    assert composite(measured((4095, 0.01, 0.0)), None, 3).clipped.all()


def test_a_picture_goes_through_the_curve_in_use() -> None:
    """Of a square law, half the number is a quarter of the light."""
    with np.errstate(divide="ignore"):
        curve = ResponseCurve(2.0 * np.log(np.arange(4096) / 2048.0), np.zeros(4096))
    dn = np.full((8, 8), 2000)
    dn[6, 6] = 1000
    picture = composite(measured((0, 0.01, 0.0), dn=dn), curve, 3)
    assert picture.radiance[6, 6] / picture.radiance[0, 0] == pytest.approx(0.25, rel=1e-5)


@pytest.mark.parametrize(("scale", "said"), [("auto", "log"), ("linear", "linear"), ("log", "log")])
def test_the_scale_of_a_picture_is_told(scale: str, said: str) -> None:
    """From the half-per-cent dimmest to the 0.2 % brightest; a factor of 100 is drawn in logarithms by itself."""
    radiance = np.geomspace(1.0, 100.0, 64 * 64).reshape(64, 64).astype(np.float32)
    picture = ServedPicture(radiance, np.zeros((64, 64), bool), "W", 5)
    image, headers = render(picture, width=64, scale=scale, colours="grey", bar=False)
    kind, low, high = headers["Radiometer-Scale"].split(",")
    assert kind == said
    assert [float(low), float(high)] == pytest.approx([100.0**0.005, 100.0**0.998], rel=0.01)
    grey = np.asarray(Image.open(io.BytesIO(image)))[..., 0]
    middle = 0.5 if said == "log" else (10.0 - float(low)) / (float(high) - float(low))
    assert grey[31, 63] / 255 == pytest.approx(middle, abs=0.01)
    assert (headers["Radiometer-Unit"], headers["Radiometer-Sequence"]) == ("W", "5")


def test_clipped_pixels_stand_out_in_every_map() -> None:
    """In a colour that no map has; in the red map, for a dark room, as a hatching of red and black."""
    clipped = np.zeros((64, 64), bool)
    clipped[:32] = True
    picture = ServedPicture(np.full((64, 64), 5.0, np.float32), clipped, "W", 5)
    for colours, expected in (
        ("grey", {(64, 224, 255)}),
        ("inferno", {(64, 224, 255)}),
        ("red", {(0, 0, 0), (255, 0, 0)}),
    ):
        image, _ = render(picture, width=64, scale="linear", colours=colours, bar=False)
        pixels = np.asarray(Image.open(io.BytesIO(image)))
        assert set(map(tuple, pixels[:30].reshape(-1, 3).tolist())) == expected
        assert set(map(tuple, pixels[34:].reshape(-1, 3).tolist())).isdisjoint({(64, 224, 255)})
    assert coloured(np.array([[-1.0, 0.5, 2.0]]), "grey")[0, :, 0].tolist() == [0, 127, 255]


def test_a_picture_is_made_once_for_a_measurement() -> None:
    """Asked again it is the same; of the next measurement another."""
    cache, one, other = PictureCache(), measured((500, 0.01, 0.0)), measured((600, 0.01, 0.0))
    first = cache.get(one, None, 1)
    assert cache.get(one, None, 1) is first
    assert cache.get(other, None, 2).sequence == 2


@pytest.mark.parametrize(("form", "ids"), [("sse", [7, 8, 9]), ("jsonl", [7, 9])])
async def test_a_page_is_told_of_every_patch_and_plain_lines_of_one(form: str, ids: list[int]) -> None:
    """Events of a patch with a name go to server-sent events alone; what was replayed already is not sent again."""
    sent: list[str] = []
    events = [Event("reading", f'{{"n":{n}}}', n) for n in (6, 7)]
    waiting = deque([*events, Event("patch", '{"n":8}', 8), Event("reading", '{"n":9}', 9), None])

    async def take(text: bytes) -> None:
        sent.append(text.decode())

    async def next_() -> Event | None:
        return waiting.popleft()

    await readings._follow(SimpleNamespace(write=take), SimpleNamespace(next=next_), form, 6)  # type: ignore[arg-type]
    assert [json.loads(text[text.index("{") :])["n"] for text in sent] == ids


async def test_a_client_that_takes_nothing_is_given_up_after_ten_seconds(monkeypatch: pytest.MonkeyPatch) -> None:
    """Not after nine, but after eleven, by the loop's own clock."""
    loop = asyncio.get_running_loop()
    true_time_s = loop.time
    writing = asyncio.ensure_future(readings._write(SimpleNamespace(write=lambda _: loop.create_future()), "{}"))  # type: ignore[arg-type]
    over = []
    for later_s in (0.0, 9.0, 11.0):
        monkeypatch.setattr(loop, "time", lambda later_s=later_s: true_time_s() + later_s)
        for _ in range(5):
            await asyncio.sleep(0)
        over.append(writing.done())
    writing.cancel()
    assert over == [False, False, True]
    assert isinstance(writing.exception(), TimeoutError)


async def test_a_trend_is_in_seconds_and_with_twice_the_standard_uncertainty(station: Station) -> None:
    """An hour of 20 November 2026, and one reading of 1 ± 0.01 there: U is 0.02."""
    at = 1_795_132_800  # 2026-11-20T00:00:00Z
    known = {"time": "2026-11-20T00:10:00.000000Z", "radiance": Quantity(1.0, 0.01, "W sr-1 m-2")}
    await station.writer.submit(replace(Reading(Quantity(1.0, 0.01, "1"), Patch(0, 0, 4, 4), "4711"), **known))
    query = {"since": "2026-11-20T00:00:00Z", "until": "2026-11-20T01:00:00Z"}
    request: Any = SimpleNamespace(query=query, app={STATION: station, QUERIES: asyncio.Semaphore(1)})
    shown = json.loads((await show_trend(request)).text or "")
    assert (shown["since"], shown["until"]) == (at, at + 3600)
    assert (shown["value"], shown["U"]) == ([1.0], [0.02])
    assert shown["time"] == [pytest.approx(at + 600, abs=1.8)]  # the middle of a thousandth of the hour, 3.6 s


@pytest.mark.parametrize(("clipped", "shown"), [(0, 0.04), (4, 0.04), (5, 0.02), (4096, 0.02)])
def test_the_frame_shown_is_the_longest_in_which_less_than_a_thousandth_clips(clipped: int, shown: float) -> None:
    """Of 4096 pixels four may clip; where all frames clip, the shortest is shown."""
    dn = np.full(4096, 900)
    dn[:clipped] = 4095
    pictures = [
        Frame(dn.reshape(64, 64).astype(np.uint16), 12, FrameSettings(0.04)),
        Frame(np.full((64, 64), 450, np.uint16), 12, FrameSettings(0.02)),
        Frame(np.full((64, 64), 225, np.uint16), 12, FrameSettings(0.01)),
    ]
    reading = Reading(Quantity(2.0, 0.1, "1"), Patch(0, 0, 4, 4), "1")
    frame = Measurement(reading, tuple(pictures)).frame
    assert frame is not None
    assert frame.settings.exposure_s == shown
    white = [replace(one, dn=np.full((64, 64), 4095, np.uint16)) for one in pictures]
    last = Measurement(reading, tuple(white)).frame
    assert last is not None
    assert last.settings.exposure_s == 0.01
    assert Measurement(reading).frame is None


@pytest.mark.parametrize("height", [60, 200])
def test_the_bar_runs_from_its_brightest_at_the_top_to_its_end(height: int) -> None:
    """34 pixels, or a quarter, from the top, and 14, or half, from the bottom; beyond it there is background."""
    picture = ServedPicture(np.linspace(1.0, 2.0, height * 100, dtype=np.float32).reshape(height, 100),
                      np.zeros((height, 100), bool), "W sr-1 m-2", 3)  # fmt: skip
    page, _ = render(picture, width=100, scale="linear", colours="grey", bar=True)
    pixels = np.asarray(Image.open(io.BytesIO(page)).convert("L")).astype(int)
    assert pixels.shape[0] == height
    bar = pixels[:, 100 + 20]
    top, bottom = min(34, height // 4), max(height - 14, height // 2)
    assert bar[top] == bar.max() > 200
    assert np.all(np.diff(bar[top:bottom]) <= 0)
    assert bar[bottom - 1] < 20
    assert len(set(bar[bottom:].tolist())) == 1


def test_the_numbers_beside_the_bar_are_those_of_its_scale() -> None:
    """Half way up stands the geometric mean of a logarithmic bar's ends, of a linear one's the arithmetic mean."""
    places = np.array([0.0, 0.5, 1.0])
    assert beside_bar(1.0, 100.0, places, logarithmic=True) == pytest.approx([1.0, 10.0, 100.0])
    assert beside_bar(1.0, 100.0, places, logarithmic=False) == pytest.approx([1.0, 50.5, 100.0])


def test_what_lies_at_black_is_dim_and_not_a_thousand() -> None:
    """Numbers at or below black are a thousandth of a DN, the patch is what was read, and a patch in the dark is 1."""
    dn = np.full((8, 8), 64 + 1000)
    dn[6, 6] = 40
    assert composite(measured((0, 0.01, 0.0), dn=dn), None, 3).radiance[6, 6] == pytest.approx(2e-6)
    dark = replace(measured((64, 0.01, 0.0)), reading=Reading(Quantity(0.0, 0.1, "1"), Patch(0, 0, 4, 4), "1"))
    assert composite(dark, None, 3).radiance[0, 0] == pytest.approx(1e-3 / 0.01)


async def test_an_export_that_breaks_off_is_no_whole_table(monkeypatch: pytest.MonkeyPatch) -> None:
    """A client that has half of it sees the connection end: nothing that was cut may pass for all there is."""
    for error in (TimeoutError(), ConnectionError(), InputError("the journal is gone")):
        aborted, sent = list[int](), list[bytes]()
        transport = SimpleNamespace(abort=lambda aborted=aborted: aborted.append(1))
        request = SimpleNamespace(method="GET", transport=transport)
        pieces: list[Any] = [['{"sequence": 1}'], error]

        async def piece(*_: Any, pieces: list[Any] = pieces) -> list[str]:
            found = pieces.pop(0)
            if isinstance(found, Exception):
                raise found
            return found

        async def write(response: Any, text: bytes, sent: list[bytes] = sent) -> None:
            sent.append(text)

        async def prepare(self: Any, request: Any) -> None:
            return None

        monkeypatch.setattr(readings, "_piece", piece)
        monkeypatch.setattr(readings, "_write", write)
        monkeypatch.setattr("aiohttp.web.StreamResponse.prepare", prepare)
        wanted = ReadingFilter(limit=1, stream="")
        await readings._send_all(request, None, wanted, "jsonl")  # type: ignore[arg-type]
        assert sent == [b'{"sequence": 1}\n']
        assert aborted == [1]
        request.transport = None
        pieces[:] = [[], error]
        await readings._send_all(request, None, wanted, "jsonl")  # type: ignore[arg-type]


@pytest.mark.parametrize(("height", "ticks"), [(100, 3), (240, 6)])
@pytest.mark.parametrize("colours", ["inferno", "red"])
def test_every_tick_of_the_bar_has_its_number(height: int, ticks: int, colours: str) -> None:
    """A stroke beside the ramp and ink right of it at each value; between two ticks there is none, the unit above."""
    canvas = Image.new("RGB", (60, height))
    bar = np.asarray(_with_bar(canvas, 1.0, 100.0, logarithmic=True, unit="DN", colours=colours), np.int64)[:, 60:]
    ink = bar[..., 0] > 60
    top, bottom = min(34, height // 4), height - 14
    places = np.linspace(bottom, top, ticks)
    for y in places:
        assert ink[round(y) - 1 : round(y) + 2, 33:37].any()
        assert ink[round(y) - 6 : round(y) + 7, 42:].any()
    between = np.rint((places[1:] + places[:-1]) / 2).astype(int)
    assert not ink[between, 33:].any()
    assert ink[8:22, 14:32].any()
