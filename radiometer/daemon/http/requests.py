"""Routes, and the permitted contents of query strings and bodies; the OpenAPI description is made from them."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from contextlib import suppress
from contextvars import ContextVar
from dataclasses import dataclass
from typing import Annotated, Any, Final, TypeVar

from aiohttp import web
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError

from radiometer.daemon.light import Asker
from radiometer.daemon.limits import Limits, ReplyBudget
from radiometer.daemon.patches import DEFAULT_HYSTERESIS_REL
from radiometer.daemon.station import Station
from radiometer.data import Patch
from radiometer.data.json_text import RepeatedKey, json_text, parsed_json
from radiometer.errors import UsageError

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


_BODY_DEADLINE_S: Final = 5.0  # 16 kB, the most that is taken, come in it at 26 kbit/s
Switch = Annotated[bool, BeforeValidator(lambda text: text or "true")]  # `?clean` alone switches it on


class Asked(BaseModel):
    """What a client may state, and nothing else."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)


_Model = TypeVar("_Model", bound=Asked)


class PatchBody(Asked):
    """A region of the picture in pixels."""

    model_config = ConfigDict(extra="forbid")
    x: int
    y: int
    width: int
    height: int


class LimitsBody(Asked):
    """Between which radiances a patch should stay."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)
    low: float | None = Field(None, description="Lowest radiance that is well; null for no bound.")
    high: float | None = Field(None, description="Highest; null for no bound.")
    hysteresis_rel: float = Field(
        DEFAULT_HYSTERESIS_REL, description="Part of a limit by which it must be back inside before the alarm goes."
    )


class MeasureBody(Asked):
    """Settings of one measurement; omitted settings stay unchanged."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)
    patch: PatchBody | None = Field(None, description="Where to read; null is the middle of the picture.")
    auto_exposure: bool = Field(True, description="Let exposures follow the scene.")
    exposure_s: float = Field(0.01, description="Exposure time in s; switches automatic exposure off.")
    gain_db: float = Field(0.0, description="Analogue gain in dB.")
    wavelength_nm: float | None = Field(None, description="Wavelength of a line source in nm; null for the spectrum.")

    def changes(self) -> dict[str, Any]:
        """Return the fields that were given, as changes of `MeasurementSettings`."""
        given = {name: getattr(self, name) for name in self.model_fields_set & set(MeasureBody.model_fields)}
        if given.get("patch") is not None:
            given["patch"] = Patch(**given["patch"].model_dump())
        if "exposure_s" in given and "auto_exposure" not in given:
            given["auto_exposure"] = False
        return given


class SettingsBody(MeasureBody):
    """Settings for all later measurements; omitted settings stay unchanged."""

    every_s: float | None = Field(
        None, description="Period of continuous measurement in s; 0 is as fast as it goes, null stops it."
    )


class LightBody(Asked):
    """Level of one light channel."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)
    channel: str
    level: float = Field(description="0 (off) to 1.")


async def read_whole(request: web.Request) -> None:
    """Wait for a request's body, which is kept. Raises HTTPRequestTimeout if it does not come in time."""
    if not request.can_read_body:
        return
    try:
        async with asyncio.timeout(_BODY_DEADLINE_S):
            await request.read()
    except TimeoutError as error:
        raise web.HTTPRequestTimeout(text="the body did not come in time") from error


async def read_body(request: web.Request, model: type[_Model]) -> _Model:
    """Return the validated JSON body; an empty one means {}.

    Raises:
        UsageError: If it is not what the model says.
        HTTPUnsupportedMediaType: If it is not JSON by its content type.
    """
    content = await request.read()
    if content.strip() and request.content_type != "application/json":
        raise web.HTTPUnsupportedMediaType(text="send JSON with Content-Type: application/json")
    with suppress(ValueError):  # what is no JSON is named by the model
        try:
            parsed_json(content)
        except RepeatedKey as error:
            raise UsageError(str(error)) from error
    try:
        return model.model_validate_json(content.strip() or b"{}", strict=True)  # "1" and true are no numbers
    except ValidationError as error:
        raise _refusal(error, model) from error


def read_query(request: web.Request, model: type[_Model]) -> _Model:
    """Return the validated query string. Raises UsageError for an unknown, malformed or repeated parameter."""
    if repeated := [name for name in request.query if len(request.query.getall(name)) > 1]:
        raise UsageError(f"{repeated[0]} is given twice; leave one of them out")
    try:
        return model.model_validate(dict(request.query))
    except ValidationError as error:
        raise _refusal(error, model) from error


def _refusal(error: ValidationError, model: type[Asked]) -> UsageError:
    """Return what is wrong with the first value that is, and what may be stated."""
    first = error.errors(include_url=False, include_input=False)[0]
    where = ".".join(str(part)[:40] for part in first["loc"]) or "the body"
    return UsageError(f"{where}: {first['msg']}; allowed are {', '.join(model.model_fields) or 'none'}")
