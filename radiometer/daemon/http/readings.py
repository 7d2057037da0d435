"""GET /readings and GET /readings/stream."""

from __future__ import annotations

import asyncio
import socket
from dataclasses import replace
from typing import Any, Final, Literal

import structlog
from aiohttp import web
from pydantic import Field

from radiometer.daemon.http.requests import BUDGET, LIMITS, QUERIES, STATION, Asked, Route, Switch, read_query
from radiometer.daemon.hub import Event, Subscription
from radiometer.daemon.journal import OWN_STREAM
from radiometer.daemon.journal_reader import JournalReader, ReadingFilter, to_csv
from radiometer.daemon.limits import SMALL_REPLY_BYTES
from radiometer.daemon.timestamps import parse_moment
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


ROUTES: Final = (
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
