"""Patches with names, their limits and trends; events and remarks."""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import Sequence
from typing import Any, Final

from aiohttp import web
from pydantic import Field

from radiometer.daemon.http.readings import stream_asked
from radiometer.daemon.http.requests import (
    QUERIES,
    STATION,
    Asked,
    LimitsBody,
    PatchBody,
    Route,
    json_reply,
    read_body,
    read_query,
)
from radiometer.daemon.journal_reader import JournalReader, TrendPoint
from radiometer.daemon.patches import PatchLimits
from radiometer.daemon.timestamps import now_us, parse_moment
from radiometer.data import Patch
from radiometer.errors import UsageError

_QUERY_DEADLINE_S: Final = 10.0  # what takes longer hinders the writer
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


ROUTES: Final = (
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
