"""One line of the route table; the server and its OpenAPI description are both made from it."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from contextvars import ContextVar
from dataclasses import dataclass
from typing import Any, Final

from aiohttp import web
from pydantic import BaseModel

from radiometer.daemon.light import Asker
from radiometer.daemon.limits import Limits, ReplyBudget
from radiometer.daemon.station import Station
from radiometer.data.json_text import json_text

Handler = Callable[[web.Request], Awaitable[web.StreamResponse]]
STATION: Final = web.AppKey("station", Station)
LIMITS: Final = web.AppKey("limits", Limits)
LIGHTS_OFF: Final = "/light/off"
ASKER: Final[ContextVar[Asker]] = ContextVar("asker")  # who asks for light, of the request that is served
QUERIES: Final = web.AppKey("queries", asyncio.Semaphore)
BUDGET: Final = web.AppKey("budget", ReplyBudget)


@dataclass(frozen=True, slots=True)
class Route:
    """One line of the route table."""

    method: str  # "GET" or "POST"
    path: str  # path, fixed
    handler: Handler  # what serves it
    summary: str  # what it does
    reply: str = "application/json"  # content type of the reply
    query: type[BaseModel] | None = None  # model of the query string; None where nothing is read from it
    body: type[BaseModel] | None = None  # model of the JSON body; None where there is none
    schema: str = ""  # name of the reply's schema in the OpenAPI description; "" where it is not JSON
    public: bool = False  # whether it is served without the token; such a route gives away no measurement


def json_reply(content: Any, status: int = 200) -> web.Response:
    """Return content as a reply of one line of JSON."""
    return web.Response(text=json_text(content) + "\n", content_type="application/json", status=status)
