"""What a client hears: every command asked and set over a fixed conversation, within its limits and beyond them."""

from __future__ import annotations

import asyncio
import io
import json
import re
from collections.abc import Coroutine
from dataclasses import replace
from pathlib import Path
from typing import Any

import aiohttp
import numpy as np
import pytest
from PIL import Image

from radiometer.daemon.http.picture import composite, render
from radiometer.daemon.http.server import HttpServer
from radiometer.daemon.instrument import Measurement
from radiometer.daemon.journal import Journal
from radiometer.daemon.scpi.command import Command
from radiometer.daemon.scpi.parameters import Boolean, Choice, Number, short_form
from radiometer.daemon.scpi.session import Session
from radiometer.daemon.scpi.table import command_table
from radiometer.daemon.station import Station
from radiometer.data import Frame, FrameSettings, Patch, Quantity, Reading
from testing.patience import within
from tests.unit.daemon.conftest import QUICK, FakeBox, FakeInstrument
from tests.unit.held.figures import digest, moved

TABLE = command_table()
UNITS = ("MS", "US", "S", "DB", "NM", "PCT", "KG")
# Replies that hold a time, a version or a path.
PASSING = re.compile(r"\d{4}-\d\d-\d\d|\d+\.\d+\.\d+|/dev/|/tmp/|uptime", re.IGNORECASE)
GUARDS = ("Content-Security-Policy", "X-Content-Type-Options", "Cache-Control", "Access-Control-Allow-Origin")
PASSING_KEYS = ("time", "_ms", "uptime_s", "since", "until", "counters", "temperature_C", "session")
LEFT_OUT = ("SYSTem:TIME", "SYSTem:DATE", "UPTime", "HELP", "MEMory", "LOG", "DIAGnostic")


def lines(command: Command, limits: Any) -> list[str]:
    """Return what is said of one command."""
    header = ":" + command.spellings()[0].replace("<n>", "1")
    said = []
    for place, parameter in enumerate(command.parameters):
        if place:
            break
        if isinstance(parameter, Number):
            bounds = parameter.limits(limits)
            middle = 0.5 * (bounds.low + bounds.high)
            words = [
                f"{bounds.high * (1 + 1e-3) + 1e-3:.12g}",
                f"{bounds.low - 1e-3:.12g}",
                f"{middle:.9g}",
                "MIN",
                "MAX",
                "DEF",
            ]
            words += [f"{bounds.default:.9g} {unit}" for unit in UNITS]
        elif isinstance(parameter, Choice):
            words = [form for word in parameter.words for form in (word, short_form(word).lower())]
        elif isinstance(parameter, Boolean):
            words = ["ON", "0", "OFF", "1", "MAYBE"]
        else:
            words = ["", "1", "'x'"]
        for word in words:
            said.append(f"{header} {word}".replace(":*", "*"))
            said.append(f"{header}?".replace(":*", "*"))
    if command.do and not command.parameters:
        said.append(header.replace(":*", "*"))
    if command.ask:
        said += [f"{header}? {word}".strip().replace(":*", "*") for word in ("", "MIN", "MAX", "DEF", "1,2,3")]
    said.append("SYST:ERR?")
    return said


async def answers(tmp_path: Path) -> dict[str, list[Any]]:
    """Return what every line is answered by, one station for each command."""
    told: dict[str, list[Any]] = {}
    for command in TABLE.commands:
        name = command.spellings()[0]
        if any(word in name for word in LEFT_OUT):
            continue
        station = Station(FakeInstrument(), Journal(tmp_path / f"{len(told)}.sqlite"), box=FakeBox(), times=QUICK)
        await station.start()
        while not station.instrument.is_open:
            await asyncio.sleep(0.001)
        session = Session(station, TABLE)
        heard: list[Any] = []
        for line in lines(command, station):
            outcome = session.execute(line)
            async with asyncio.timeout(within(20.0)):
                reply = await outcome if isinstance(outcome, Coroutine) else outcome
            heard.append([line, "passing" if reply and PASSING.search(reply) else reply])
            for _ in range(3):
                error = session.execute("SYST:ERR?")
                said = await error if isinstance(error, Coroutine) else error
                heard[-1].append(said)
                if str(said).startswith("0"):
                    break
        told[name] = heard
        await station.stop()
    return told


# Lines that no manual has: odd blocks, strings, numbers, headers, and several units in one.
ODD = """
SENS:EXP #15hello
SENS:EXP #0rest
SENS:EXP #19abc
SENS:EXP #x1
SENS:EXP #HFF
SENS:EXP #B102
SENS:EXP 1e400
SENS:EXP 1e-3;GAIN?
SENS:EXP 2 MS;:SENS:EXP?
:SENS:EXP?;*IDN?;*ESR?
SENSE:EXPOSURE? MAX;:SENS:GAIN? MIN
SENS:EXP 'text'
SENS:EXP "unfinished
SENS:PATC 1,2,3
SENS:PATC 1,2,3,4,5
SENS:PATC 60,0,10,10
SENS:PATC 1,2,30,4;PATC?
SENS:PATC CENT;PATC?
SENS::EXP?
SENS:EXPO?
SENS:EXP??
*XYZ
:*IDN?
;;
MEAS:RAD?;LUM?
INIT;FETC:RAD?
READ:RAD?
FETC?
SOUR:LED1:LEV 0.25;LEV?
SOUR:LED2:LEV 50 PCT;LEV?
SOUR:LED9:LEV 1
SOUR:LED1:LEV -0.1
SOUR:LED1:LEV MAX;LEV?
TRIG:TIM 0.5;TIM?
TRIG:TIM -1
CALC:LIM:UPP 5;UPP?;LOW 7
STAT:QUES?
STAT:QUES:ENAB 65536
SYST:ERR:COUN?
ABOR;*OPC?
*RST;:SENS:EXP?
"""


async def test_odd_lines_are_answered_as_they_were(tmp_path):
    """One session, one line after the other; each leaves its reply and its errors."""
    station = Station(FakeInstrument(), Journal(tmp_path / "journal.sqlite"), box=FakeBox(), times=QUICK)
    await station.start()
    while not station.instrument.is_open:
        await asyncio.sleep(0.001)
    session = Session(station, TABLE)
    told = []
    for line in ODD.split("\n")[1:-1]:
        heard: list[Any] = [line]
        for said in (line, *["SYST:ERR?"] * 4):
            outcome = session.execute(said)
            async with asyncio.timeout(within(20.0)):
                reply = await outcome if isinstance(outcome, Coroutine) else outcome
            heard.append("passing" if reply and PASSING.search(reply) else reply)
            if str(reply).startswith('0,"No'):
                break
        told.append(heard)
    await station.stop()
    assert not moved("odd_lines", {"lines": told})


async def test_the_conversation_is_as_it_was(tmp_path):
    """Every reply and every error that a line leaves."""
    assert not moved("conversation", await answers(tmp_path))


# Requests to the web server: method, path, body.
VISIT = """
GET /status
GET /response
GET /healthz
GET /events
GET /openapi.json
GET /nothing
GET /readings?limit=1
GET /readings?format=csv
GET /readings?after=1
GET /readings?flag=saturated
GET /readings?clean=true
GET /readings?limit=0
GET /readings?since=x
GET /trend
GET /trend?points=5
GET /trend?points=0
GET /trend?patch=a
GET /trend?nonsense=1
POST /measure {}
POST /measure {"patch": {"x": 3, "y": 4, "width": 5, "height": 6}}
POST /measure {"exposure_s": 1e9}
POST /measure {"gain_db": -1}
POST /measure {"spectrum": 3}
POST /settings {"exposure_s": 0.01}
POST /settings {"auto_exposure": true}
POST /settings {"every_s": null}
POST /settings {"every_s": -1}
POST /settings {"x": 1}
POST /light {"channel": "red", "level": 0.25}
POST /light {"channel": "red", "level": 1.5}
POST /light {"channel": "no", "level": 0.1}
POST /light {}
GET /status
POST /light/off {}
POST /patches {"name": "a", "x": 1, "y": 2, "width": 3, "height": 4}
POST /patches {"name": "b", "x": 99, "y": 0, "width": 3, "height": 4}
POST /patches {"name": ""}
POST /patches/delete {"name": "a"}
POST /patches/delete {"name": "z"}
POST /events {"message": "lamp changed"}
POST /events {"message": ""}
POST /events {}
GET /frame.png
GET /frame.png?width=32
GET /frame.png?width=0
GET /status
GET /readings?limit=2
POST /patches {"name": "main", "limits": {"low": 1.0, "high": 5.0}}
POST /patches {"name": "main", "limits": {"low": 5.0, "high": 1.0}}
POST /patches {"name": "main", "limits": {"low": 1.0, "high": 5.0, "hysteresis_rel": 0.7}}
POST /patches {"name": "nobody", "limits": {"low": 1.0}}
POST /measure {}
POST /measure {}
GET /status
POST /patches {"name": "lamp", "patch": {"x": 1, "y": 2, "width": 3, "height": 4}, "limits": {"high": 2.0}}
POST /patches {"name": "lamp", "patch": {"x": 2, "y": 2, "width": 3, "height": 4}}
POST /patches {"name": "out", "patch": {"x": 60, "y": 2, "width": 30, "height": 4}}
POST /patches {"name": "lamp"}
GET /trend?stream=patch%20lamp
GET /trend?points=9
GET /trend?points=5001
GET /events?limit=2
POST /patches/delete {"name": "lamp"}
GET /events
GET /metrics
"""


def lasting(value: Any) -> Any:
    """Return an answer without what is another at every run."""
    if isinstance(value, dict):
        return {key: lasting(one) for key, one in value.items() if not key.endswith(PASSING_KEYS)}
    if isinstance(value, list):
        return [lasting(one) for one in value]
    return "passing" if isinstance(value, str) and PASSING.search(value) else value


def figures_of(text: str) -> list[str]:
    """Return the lines of Prometheus's text that tell our figures, without what counts time, frames or requests."""
    ours = [line for line in text.splitlines() if line.startswith("radiometer_")]
    return [line for line in ours if not re.search("seconds|_created|frames|requests|missing|queue", line)]


async def settled(station: Station) -> None:
    """Return once the journal holds every event and patch: what is asked next is answered from the file."""
    async with asyncio.timeout(within(20.0)):
        while station.writer._events or station.writer._kept_patches:
            await asyncio.sleep(0.001)


async def test_the_web_server_answers_as_it_did(tmp_path):
    """Status, kind and body of every request of a fixed visit; numbers that count seconds or bytes left out."""
    station = Station(FakeInstrument(), Journal(tmp_path / "journal.sqlite"), box=FakeBox(), times=QUICK)
    await station.start()
    while not station.instrument.is_open:
        await asyncio.sleep(0.001)
    server = HttpServer(station)
    base = f"http://127.0.0.1:{await server.listen('127.0.0.1', 0)}"
    told = {}
    async with aiohttp.ClientSession() as client:
        for number, line in enumerate(VISIT.split("\n")[1:-1]):
            method, path, *body = line.split(" ", 2)
            await settled(station)
            async with client.request(method, base + path, json=json.loads(body[0]) if body else None) as reply:
                content = await reply.read()
                kind = reply.content_type
                answer: Any = len(content) > 0
                if kind == "application/json":
                    answer = lasting(json.loads(content))
                elif kind == "text/csv":
                    answer = len(content.splitlines())
                elif path == "/metrics":
                    answer = sorted(figures_of(content.decode()))
                guards = sum(key in reply.headers for key in GUARDS)
                told[f"{number} {line}"] = [reply.status, kind, guards, answer]
    await server.close()
    await station.stop()
    assert not moved("web", told)


@pytest.mark.parametrize("colours", ["inferno", "grey", "red"])
def test_pictures_are_as_they_were(colours):
    """Of two exposures, one clipped: by a curve and without, on either scale; the bar is held but for its letters."""
    rows, columns = np.indices((48, 64))
    light = 10.0 ** (3.5 * columns / 64.0) * (1.0 + 0.1 * (rows > 20))
    frames = tuple(
        Frame(np.clip(np.rint(light * t + 16.0), 0, 255).astype(np.uint8), 8, FrameSettings(t, black_level_dn=black))
        for t, black in ((0.1, 16.0), (1.0, 16.0))
    )
    darker = tuple(replace(frame, dn=(frame.dn // 3 + 20).astype(np.uint8)) for frame in frames[:1])
    curve = FakeInstrument().response
    told: dict[str, Any] = {}
    for name, taken, response in (("plain", frames, None), ("by a curve", frames, curve), ("narrow", darker, None)):
        reading = Reading(Quantity(3.0, 0.01, "W sr-1 m-2"), Patch(20, 10, 8, 8), "4711")
        picture = composite(Measurement(reading, taken), response, 7)
        told[name] = {"radiance": digest(picture.radiance), "clipped": digest(picture.clipped), "unit": picture.unit}
        for scale, width in (("auto", 64), ("log", 90), ("linear", 128)):
            content, headers = render(picture, width=width, scale=scale, colours=colours, bar=scale != "log")
            shown = np.asarray(Image.open(io.BytesIO(content)))
            kept = shown[:, : width + (30 if scale != "log" else 0)]
            told[name][scale] = {"size": list(shown.shape), "pixels": digest(kept[34:]), **headers}
    assert not moved(f"pictures/{colours}", told, rel=1e-4)
