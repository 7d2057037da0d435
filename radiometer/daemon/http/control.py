"""POST /measure, /settings, /light; GET /status, /response, /healthz, /metrics."""

from __future__ import annotations

import itertools
from dataclasses import replace
from typing import Any, Final

import numpy as np
from aiohttp import web

from radiometer.daemon.http.requests import (
    ASKER,
    LIGHTS_OFF,
    STATION,
    LightBody,
    MeasureBody,
    Route,
    SettingsBody,
    json_reply,
    read_body,
)
from radiometer.daemon.metrics import CONTENT_TYPE
from radiometer.daemon.station import Station
from radiometer.errors import UsageError

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


ROUTES: Final = (
    Route("POST", "/measure", measure, "Measure once and reply the reading, which is in the journal then.",
          body=MeasureBody, schema="Reading"),
    Route("POST", "/settings", change_settings, "Change settings for all later measurements.", body=SettingsBody,
          schema="Status"),
    Route("POST", "/light", set_light, "Set the level of a light channel.", body=LightBody, schema="Light"),
    Route("POST", LIGHTS_OFF, switch_off, "Switch every light channel off.", schema="Light"),
    Route("GET", "/status", show_status, "State of devices, settings, calibration and alarms.", schema="Status"),
    Route("GET", "/response", show_response, "Response curve in use, at most 512 points; `linear` is true where "
    "none is.",
          schema="Response"),
    Route("GET", "/healthz", show_health, "200 while nothing is wrong, 503 while an alarm is up.", schema="Health",
          public=True),
    Route("GET", "/metrics", show_metrics, "Figures in Prometheus's text form.", reply="text/plain"),
)  # fmt: skip
