"""What is served under each path: readings, the state, settings, the light, patches with names, trends and events."""

from __future__ import annotations

import asyncio
import itertools
import socket
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Final, Literal

import numpy as np
import structlog
from aiohttp import web
from pydantic import Field

from radiometer.daemon.http.requests import (
    ASKER,
    BUDGET,
    LIGHTS_OFF,
    LIMITS,
    QUERIES,
    STATION,
    Asked,
    LightBody,
    LimitsBody,
    MeasureBody,
    PatchBody,
    Route,
    SettingsBody,
    Switch,
    json_reply,
    read_body,
    read_query,
)
from radiometer.daemon.journal import OWN_STREAM
from radiometer.daemon.journal_reader import JournalReader, ReadingFilter, TrendPoint, to_csv
from radiometer.daemon.limits import SMALL_REPLY_BYTES
from radiometer.daemon.metrics import CONTENT_TYPE
from radiometer.daemon.patches import PatchLimits
from radiometer.daemon.station import Event, Station, Subscription
from radiometer.daemon.timestamps import now_us, parse_moment
from radiometer.data import Patch
from radiometer.data.json_text import parsed_json
from radiometer.errors import InputError, UsageError

_log = structlog.get_logger(__name__)
DEFAULT_ROWS: Final = 1000  # some 1.6 MB of JSON
_QUERY_DEADLINE_S: Final = 10.0  # what takes longer hinders the writer
_HEARTBEAT_S: Final = 15.0  # proxies end a connection that is silent for 30 to 60 s
_WRITE_DEADLINE_S: Final = 10.0  # who takes nothing for so long is gone
_REPLAY_ROWS: Final = 1000  # some 1.6 MB held at a time
# Of a stream: hardly more than a listener takes at once. 20 that take nothing, each with 1000 rows, held 33 MB and kept
# other clients waiting for 50 ms.
_STREAMED_ROWS: Final = 64
_PIECE: Final = 262_144  # bytes
_UNSENT_BYTES: Final = 65_536  # some 40 readings; Linux would let it grow to 4 MB, which is an hour of readings
_FORMATS: Final = {"json": "application/json", "jsonl": "application/x-ndjson", "csv": "text/csv"}


class ListQuery(Asked):
    """Which readings, and in which form."""

    since: str | None = Field(None, description="Not before this time: ISO 8601, or an age such as 15min, 2h, 7d.")
    until: str | None = Field(None, description="Before this time.")
    after: int | None = Field(None, description="Sequence number above this; gives the oldest of these first.")
    flag: str | None = Field(None, description="Only readings with this flag.")
    clean: Switch = Field(False, description="Only readings without any flag.")
    limit: int | None = Field(
        None,
        ge=1,
        description=f"At most this many, the newest; {DEFAULT_ROWS} for json, all for jsonl and csv by default.",
    )
    stream: str = Field(
        "main",
        description="main (the patch measured for all; the default), patch NAME, own (what clients measured for"
        " themselves) or all.",
    )
    format: Literal["json", "jsonl", "csv"] | None = Field(
        None, description="json (an array), jsonl (a line each) or csv; else the Accept header decides."
    )


class StreamQuery(Asked):
    """Where a stream begins, and its form."""

    after: int | None = Field(None, description="First replay the readings above this number, as Last-Event-ID does.")
    format: Literal["sse", "jsonl"] | None = Field(
        None, description="sse (server-sent events) or jsonl; else the Accept header decides."
    )


async def list_readings(request: web.Request) -> web.StreamResponse:
    """Serve history, oldest first: the newest of an array, the whole range of lines and tables."""
    query = read_query(request, ListQuery)
    form = query.format or _form_accepted(request)
    row_filter = _filter(query, request.app[LIMITS].rows)
    reader = JournalReader(request.app[STATION].journal_path, deadline_s=_QUERY_DEADLINE_S)
    if row_filter.after is not None:
        row_filter = replace(row_filter, after=await asyncio.to_thread(reader.known, row_filter.after))
    if form != "json" and query.limit is None:
        return await _send_all(request, reader, replace(row_filter, limit=_REPLAY_ROWS, newest_first=False), form)
    async with request.app[QUERIES]:
        body = await asyncio.to_thread(_render, reader, row_filter, form)
    return await _send_body(request, body, form)


async def _send_body(request: web.Request, body: bytes, form: str) -> web.StreamResponse:
    """Send a table within the memory that all replies may hold; who does not take it loses the connection."""
    if len(body) <= SMALL_REPLY_BYTES or request.method == "HEAD":
        return web.Response(body=body, content_type=_FORMATS[form], charset="utf-8")
    if not request.app[BUDGET].take(len(body)):
        raise web.HTTPServiceUnavailable(text="other clients have not taken their replies yet; ask again, or for less")
    response = web.StreamResponse(headers={"Content-Length": str(len(body)), "Cache-Control": "no-store"})
    response.content_type, response.charset = _FORMATS[form], "utf-8"
    try:
        await response.prepare(request)
        for start in range(0, len(body), _PIECE):
            await _write(response, body[start : start + _PIECE])
    except (TimeoutError, ConnectionError) as error:
        _break_off(request, error)
    finally:
        request.app[BUDGET].give_back(len(body))
    return response


def _break_off(request: web.Request, error: Exception) -> None:
    _log.warning("reply broken off", error=str(error) or type(error).__name__)
    if request.transport is not None:
        request.transport.abort()  # a client must not take half a table for all of it


async def _send_all(
    request: web.Request, reader: JournalReader, row_filter: ReadingFilter, form: str
) -> web.StreamResponse:
    """Serve a whole range piece by piece, so that neither memory nor writer of the journal feels its length."""
    lines = await _piece(request, reader, row_filter)  # errors of the query are reported before the reply begins
    response = web.StreamResponse(headers={"Cache-Control": "no-store"})
    response.content_type, response.charset = _FORMATS[form], "utf-8"
    if form == "csv":
        response.headers["Content-Disposition"] = 'attachment; filename="readings.csv"'
    await response.prepare(request)
    if request.method == "HEAD":
        return response
    header = form == "csv"
    try:
        while lines or header:
            text = to_csv(lines, header=header) if form == "csv" else "".join(line + "\n" for line in lines)
            header = False
            await _write(response, text.encode())
            row_filter = replace(row_filter, after=int(parsed_json(lines[-1])["sequence"])) if lines else row_filter
            lines = await _piece(request, reader, row_filter) if lines else []
    except (TimeoutError, ConnectionError, InputError) as error:
        _break_off(request, error)
    return response


async def _piece(request: web.Request, reader: JournalReader, row_filter: ReadingFilter) -> list[str]:
    async with request.app[QUERIES]:
        return await asyncio.to_thread(reader.lines, row_filter)


async def stream_readings(request: web.Request) -> web.StreamResponse:
    """Serve readings as they are committed, as server-sent events or JSON lines.

    Raises:
        UsageError: If a parameter is wrong.
        HTTPServiceUnavailable: If there are too many listeners.
    """
    query = read_query(request, StreamQuery)
    form = query.format or ("jsonl" if "ndjson" in request.headers.get("Accept", "") else "sse")
    station = request.app[STATION]
    limits = request.app[LIMITS]
    if len(station.hub) >= limits.listeners and not station.hub.end_one(limits.listening_s):
        raise web.HTTPServiceUnavailable(text="too many listeners")
    response = web.StreamResponse(headers={"Cache-Control": "no-store", "X-Accel-Buffering": "no"})
    response.content_type = "text/event-stream" if form == "sse" else "application/x-ndjson"
    response.charset = "utf-8"
    # A client that reconnects to an address with `after` states both: the header is the newer.
    last = _last_event_id(request)
    after = query.after if last is None else last
    subscription = station.hub.subscribe()
    try:
        await response.prepare(request)
        if request.method == "HEAD":
            return response
        _keep_little_unsent(request)
        sent = await _replay(request, response, after, form) if after is not None else 0
        await _follow(response, subscription, form, sent)
    except (TimeoutError, ConnectionError):
        station.metrics.refused.labels(
            "http", "dropped"
        ).inc()  # gone, or too slow: a reconnect replays what is missing
        if request.transport is not None:
            request.transport.abort()
    finally:
        station.hub.unsubscribe(subscription)
    return response


def _keep_little_unsent(request: web.Request) -> None:
    """Bound what the system holds of a stream: a listener that does not read is then noticed by its full buffer."""
    raw_socket: Any = request.transport.get_extra_info("socket") if request.transport is not None else None
    if raw_socket is not None:
        raw_socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _UNSENT_BYTES)


async def _follow(response: web.StreamResponse, subscription: Subscription, form: str, last: int) -> None:
    while True:
        try:
            async with asyncio.timeout(_HEARTBEAT_S):
                event = await subscription.next()
        except TimeoutError:
            await _write(response, b": still here\n\n" if form == "sse" else b"\n")
            continue
        if event is None:
            return
        if event.kind == "patch" and form == "jsonl":
            continue  # plain lines are those of one patch
        if event.sequence is None or event.sequence > last:
            await _write(response, _encoded(event, form).encode())


async def _replay(request: web.Request, response: web.StreamResponse, after: int, form: str) -> int:
    """Send what the journal holds above a number and return the last number sent."""
    reader = JournalReader(request.app[STATION].journal_path, deadline_s=_QUERY_DEADLINE_S)
    last = await asyncio.to_thread(reader.known, after)
    while lines := await _piece(request, reader, ReadingFilter(after=last, limit=_STREAMED_ROWS, stream="")):
        events = [Event("reading", line, int(parsed_json(line)["sequence"])) for line in lines]
        await _write(response, "".join(_encoded(event, form) for event in events).encode())
        last = events[-1].sequence or last
    return last


async def _write(response: web.StreamResponse, content: bytes) -> None:
    async with asyncio.timeout(_WRITE_DEADLINE_S):
        await response.write(content)


def _encoded(event: Event, form: str) -> str:
    if form == "jsonl":
        return event.line + "\n" if event.kind == "reading" else ""
    if event.kind == "reading":
        return f"id: {event.sequence}\ndata: {event.line}\n\n"
    identity = f"id: {event.sequence}\n" if event.sequence is not None else ""
    return f"{identity}event: {event.kind}\ndata: {event.line}\n\n"


def _last_event_id(request: web.Request) -> int | None:
    text = request.headers.get("Last-Event-ID", "")
    return int(text) if text.isascii() and text.isdigit() and len(text) < 19 else None


def _form_accepted(request: web.Request) -> str:
    accept = request.headers.get("Accept", "")
    return next((form for form, kind in _FORMATS.items() if form != "json" and kind in accept), "json")


def _filter(query: ListQuery, most: int) -> ReadingFilter:
    if query.limit is not None and query.limit > most:
        raise UsageError(f"limit must be 1 to {most}, not {query.limit}; ask for more in steps with after=…")
    return ReadingFilter(
        since_us=None if query.since is None else parse_moment(query.since),
        until_us=None if query.until is None else parse_moment(query.until),
        after=query.after,
        flag=query.flag,
        without_flags=query.clean,
        limit=query.limit or DEFAULT_ROWS,
        newest_first=query.after is None,
        stream=stream_asked(query.stream),
    )


def stream_asked(asked: str) -> str | None:
    """Return the stream of the journal that a client names; None for all. Raises UsageError."""
    if asked in ("main", "all"):
        return "" if asked == "main" else None
    if asked != OWN_STREAM and not asked.startswith("patch "):
        raise UsageError(f"stream must be main, own, all, or patch NAME, not {asked[:40]!r}")
    return asked


def _render(reader: JournalReader, row_filter: ReadingFilter, form: str) -> bytes:
    lines = reader.lines(row_filter)
    if row_filter.newest_first:
        lines.reverse()
    if form == "csv":
        return to_csv(lines).encode()
    if form == "jsonl":
        return "".join(line + "\n" for line in lines).encode()
    return ("[" + ",\n".join(lines) + "]\n").encode()


READING_ROUTES: Final = (
    Route("GET", "/readings", list_readings, "History of readings, oldest first.", query=ListQuery, schema="Readings"),
    Route(
        "GET",
        "/readings/stream",
        stream_readings,
        "Readings as they come, each once it is in the journal. `id` is the sequence number, so a client that"
        " reconnects misses nothing of the same journal. An event named `status` reports a change of state.",
        reply="text/event-stream",
        query=StreamQuery,
    ),
)


_MOST_POINTS: Final = 5000  # more than a screen has columns
_MOST_EVENTS: Final = 5000  # more than a page can show
_COVERAGE_FACTOR: Final = 2.0  # 95 %


class TrendQuery(Asked):
    """Which course."""

    stream: str = Field("main", description="main (the default) or patch NAME.")
    since: str = Field("1h", description="From this time on: ISO 8601, or an age such as 1h, 7d; 1h by default.")
    until: str | None = Field(None, description="Before this time; now by default.")
    points: int = Field(1000, ge=10, le=_MOST_POINTS, description="About so many points at most; 1000 by default.")


class EventQuery(Asked):
    """Which events."""

    since: str | None = Field(None, description="From this time on: ISO 8601, or an age such as 1h, 7d.")
    until: str | None = Field(None, description="Before this time.")
    limit: int = Field(200, ge=1, le=_MOST_EVENTS, description="At most this many, the newest; 200 by default.")


class NamedPatchBody(Asked):
    """A patch with a name; "main" is the one measured for all, of which only limits can be set here."""

    name: str
    patch: PatchBody | None = Field(None, description="Where it is; left out, it stays.")
    limits: LimitsBody | None = Field(None, description="Its limits; left out, they stay.")


class NameBody(Asked):
    """The name of a patch."""

    name: str


class RemarkBody(Asked):
    """A remark of a person, kept among the events."""

    message: str


async def change_patch(request: web.Request) -> web.Response:
    """Define or move a patch with a name, or set its limits, and reply the state."""
    station = request.app[STATION]
    body = await read_body(request, NamedPatchBody)
    limits = PatchLimits(**body.limits.model_dump()) if body.limits else None
    if body.patch is not None:
        station.patches.define(body.name, Patch(**body.patch.model_dump()))
    if limits is not None:
        station.patches.set_limits(body.name, limits)
    return json_reply(station.status())


async def delete_patch(request: web.Request) -> web.Response:
    """Measure a patch no longer and reply the state."""
    station = request.app[STATION]
    station.patches.delete((await read_body(request, NameBody)).name)
    return json_reply(station.status())


async def show_trend(request: web.Request) -> web.Response:
    """Reply the course of one patch in columns; a time without readings is a point of nulls. Raises UsageError."""
    query = read_query(request, TrendQuery)
    until_us = now_us() if query.until is None else parse_moment(query.until)
    since_us = parse_moment(query.since)
    if since_us >= until_us:
        raise UsageError("since must be a time before until")
    stream = stream_asked(query.stream)
    if stream is None:
        raise UsageError("a trend is of one patch: stream must be main or patch NAME")
    station = request.app[STATION]
    reader = JournalReader(station.journal_path, deadline_s=_QUERY_DEADLINE_S)
    async with request.app[QUERIES]:
        found = await asyncio.to_thread(reader.trend, stream, since_us, until_us, query.points)
    return json_reply({"since": since_us / 1e6, "until": until_us / 1e6, "coverage_factor": _COVERAGE_FACTOR,
                  **trend_columns(found, station.acquisition.every_s)})  # fmt: skip


def trend_columns(points: list[TrendPoint], every_s: float | None) -> dict[str, Any]:
    """Return points in columns, in s since 1970, of the newest unit.

    Where readings are missing, and between those of two places, stands a row of nulls.

    Args:
        every_s: Period of continuous measurement in s; None where there is none.
    """
    unit = points[-1].unit if points else ""
    columns: dict[str, list[float | int | str | None]] = {
        name: [] for name in ("time", "value", "U", "low", "high", "count", "flagged", "bound")
    }
    shown = [point for point in points if point.unit == unit]
    longest_us = _longest_pause_us(shown, every_s)
    before: TrendPoint | None = None
    for point in shown:
        pause_us = point.time_us - before.time_us if before else 0
        if before is not None and (pause_us > longest_us or point.place != before.place):
            for name, column in columns.items():
                column.append((before.time_us + point.time_us) / 2e6 if name == "time" else None)
        before = point
        row: Sequence[float | str] = (point.time_us / 1e6, point.value, _COVERAGE_FACTOR * point.u, point.low,
               point.high, point.count, point.flagged, point.bound)  # fmt: skip
        for column, value in zip(columns.values(), row, strict=True):
            column.append(value)
    return {"unit": unit, **columns}


def _longest_pause_us(points: list[TrendPoint], every_s: float | None) -> float:
    """Return the pause between two points that is no gap yet: thrice the usual one, or the period asked for."""
    pauses = sorted(later.time_us - earlier.time_us for earlier, later in itertools.pairwise(points))
    usual = pauses[len(pauses) // 2] if pauses else 0
    return max(3.0 * usual, 3e6 * (every_s or 0.0), 3e6)


async def show_events(request: web.Request) -> web.Response:
    """Reply the newest events of a time, oldest first. Raises UsageError."""
    query = read_query(request, EventQuery)
    since_us, until_us = (None if text is None else parse_moment(text) for text in (query.since, query.until))
    reader = JournalReader(request.app[STATION].journal_path, deadline_s=5.0)
    return json_reply(await asyncio.to_thread(reader.events, since_us, query.limit, until_us))


async def add_remark(request: web.Request) -> web.Response:
    """Keep a remark of a person among the events."""
    body = await read_body(request, RemarkBody)
    request.app[STATION].annotate(body.message)
    return json_reply({"kind": "remark", "message": " ".join(body.message.split())})


PATCH_ROUTES: Final = (
    Route("POST", "/patches", change_patch, "Define or move a patch with a name, or set its limits.",
          body=NamedPatchBody, schema="Status"),
    Route("POST", "/patches/delete", delete_patch, "Measure a patch no longer; its readings stay.", body=NameBody,
          schema="Status"),
    Route("GET", "/trend", show_trend, "Course of one patch in columns: mean, expanded uncertainty (k=2), lowest and"
          " highest radiance of each short time; nulls where there are no readings.",
          query=TrendQuery, schema="Trend"),
    Route("GET", "/events", show_events, "Alarms, recoveries, changes and remarks, oldest first.", query=EventQuery,
          schema="Events"),
    Route("POST", "/events", add_remark, "Keep a remark among the events.", body=RemarkBody, schema="Event"),
)  # fmt: skip


_MEASURING_DEADLINE_S: Final = 120.0  # twice the time limit of a bracket
_NUMBERS: Final = itertools.count(1)
_CURVE_POINTS: Final = 512  # about the pixels of the page's plot
_FULL_SCALE_DN: Final = 4095  # 12 bits; the line is the same at any depth


async def measure(request: web.Request) -> web.Response:
    """Measure once and reply the reading."""
    station = request.app[STATION]
    changes = (await read_body(request, MeasureBody)).changes()
    settings = replace(station.settings, **changes)
    if changes:
        station.acquisition.check_settings(settings)
    reading = await station.acquisition.measure(settings, _MEASURING_DEADLINE_S, f"http-{next(_NUMBERS)}")
    return web.Response(text=reading.to_json() + "\n", content_type="application/json")


async def change_settings(request: web.Request) -> web.Response:
    """Change the shared settings and reply the new state."""
    station = request.app[STATION]
    body = await read_body(request, SettingsBody)
    if changes := body.changes():
        station.configure(**changes)
    if "every_s" in body.model_fields_set:
        station.set_every(body.every_s)
    return json_reply(station.status())


async def set_light(request: web.Request) -> web.Response:
    """Set a channel of the light box. Raises UsageError for a channel that there is not."""
    station = request.app[STATION]
    body = await read_body(request, LightBody)
    if station.light.box is not None and body.channel not in station.light.box.channels:
        channels = ", ".join(station.light.box.channels)
        raise UsageError(f"there is no channel {body.channel[:40]!r}; there are: {channels}")
    level = await station.light.set_level(body.channel, body.level, ASKER.get())
    return json_reply({"channel": body.channel, "level": level})


async def switch_off(request: web.Request) -> web.Response:
    """Darken every channel of the light box and reply the levels."""
    station = request.app[STATION]
    await station.light.off()
    return json_reply({"light": dict(station.light.levels)})


async def show_status(request: web.Request) -> web.Response:
    """Reply the state of everything."""
    return json_reply(request.app[STATION].status())


async def show_response(request: web.Request) -> web.Response:
    """Reply the response curve, thinned out to what a plot can show."""
    curve = request.app[STATION].instrument.response
    if curve is None:
        return json_reply(_linear_curve())
    numbers = np.unique(np.linspace(0, curve.log_exposure.size - 1, _CURVE_POINTS).astype(int))
    finite = numbers[np.isfinite(curve.log_exposure[numbers])]
    return json_reply(
        {
            "dn": finite.tolist(),
            "log_exposure": curve.log_exposure[finite].tolist(),
            "u_log_exposure": np.nan_to_num(curve.u_log_exposure[finite], posinf=0.0).tolist(),
            "absolute": curve.absolute,
            "linear": False,
        }
    )


def _linear_curve() -> dict[str, Any]:
    """Return what is used where no curve is: digital numbers above black in proportion to the exposure."""
    numbers = np.unique(np.geomspace(8, _FULL_SCALE_DN, 120).astype(int))
    log_exposure = np.log(numbers / ((_FULL_SCALE_DN + 1) / 2))
    zeros = [0.0] * numbers.size
    return {"dn": numbers.tolist(), "log_exposure": log_exposure.tolist(), "u_log_exposure": zeros,
            "absolute": False, "linear": True}  # fmt: skip


async def show_health(request: web.Request) -> web.Response:
    """Reply 200 while nothing is wrong at this moment, 503 with names where something is."""
    alarms = request.app[STATION].troubles()
    return json_reply({"status": "alarm" if alarms else "ok", "alarms": alarms}, status=503 if alarms else 200)


async def show_metrics(request: web.Request) -> web.Response:
    """Reply the figures for Prometheus."""
    station: Station = request.app[STATION]
    station.refresh_metrics()
    return web.Response(body=station.metrics.render(), headers={"Content-Type": CONTENT_TYPE})


CONTROL_ROUTES: Final = (
    Route("POST", "/measure", measure, "Measure once and reply the reading, which is in the journal then.",
          body=MeasureBody, schema="Reading"),
    Route("POST", "/settings", change_settings, "Change settings for all later measurements.", body=SettingsBody,
          schema="Status"),
    Route("POST", "/light", set_light, "Set the level of a light channel.", body=LightBody, schema="Light"),
    Route("POST", LIGHTS_OFF, switch_off, "Switch every light channel off.", schema="Light"),
    Route("GET", "/status", show_status, "State of devices, settings, calibration and alarms.", schema="Status"),
    Route("GET", "/response", show_response,
          "Response curve in use, at most 512 points; `linear` is true where none is.", schema="Response"),
    Route("GET", "/healthz", show_health, "200 while nothing is wrong, 503 while an alarm is up.", schema="Health",
          public=True),
    Route("GET", "/metrics", show_metrics, "Figures in Prometheus's text form.", reply="text/plain"),
)  # fmt: skip
