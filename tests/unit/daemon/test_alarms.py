"""Every alarm that the daemon knows goes up by its cause, is seen everywhere, and goes down by its end."""

from __future__ import annotations

import asyncio
import json
import math
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pytest

from radiometer.daemon.alarms import KINDS
from radiometer.daemon.descriptors import Descriptors
from radiometer.daemon.instrument import DeviceReport
from radiometer.daemon.limits import Limits
from radiometer.daemon.patches import PatchLimits
from radiometer.daemon.station import Station
from radiometer.data import Patch, Quantity
from radiometer.errors import CalibrationError, MeasurementError

Eventually = Callable[..., Awaitable[None]]
ROOT = Path(__file__).resolve().parents[3]
LAMP = Patch(5, 6, 7, 8)


@dataclass
class World:
    """A station and what it stands on, to be broken and corrected."""

    station: Station
    instrument: Any
    box: Any

    def fail(self, patch: Patch | None) -> None:
        """Let one patch be saturated."""
        whole = self.instrument.measure

        def measure(settings: Any) -> Any:
            if settings.patch == patch:
                raise MeasurementError("every pixel is saturated")
            return whole(settings)

        self.instrument.measure = measure

    def heal(self) -> None:
        del self.instrument.measure

    def hide_journal(self, *, hidden: bool) -> None:
        path = self.station.journal_path
        names = [path, path.with_name("elsewhere.sqlite")]
        names[not hidden].rename(names[hidden])

    async def reload(self, error: Exception | None) -> None:
        def reload_calibration() -> str:
            if error is not None:
                raise error
            return "calibration.yaml"

        self.instrument.reload_calibration = reload_calibration
        try:
            await self.station.reload_calibration()
        except CalibrationError:
            return


def _do(obj: Any, name: str, value: Any) -> None:
    setattr(obj, name, value)


# By the name of an alarm: what breaks, and what mends. "mqtt" and "period" have modules of tests of their own.
CASES: dict[str, tuple[Callable[[World], Any], Callable[[World], Any]]] = {
    "camera": (lambda w: _do(w.instrument, "unplugged", True), lambda w: _do(w.instrument, "unplugged", False)),
    "light box": (lambda w: _do(w.box, "unplugged", True), lambda w: _do(w.box, "unplugged", False)),
    "light red": (
        lambda w: _do(w.box, "check", lambda: DeviceReport(30.0, {}, {"red": 0.25})),
        lambda w: (_do(w.box, "check", lambda: DeviceReport(30.0)), w.station.light.off())[1],
    ),
    "journal": (lambda w: w.hide_journal(hidden=True), lambda w: w.hide_journal(hidden=False)),
    "measurement": (lambda w: w.fail(None), World.heal),
    "measurement lamp": (lambda w: w.fail(LAMP), World.heal),
    "reading": (lambda w: w.fail(None), World.heal),
    "reading lamp": (lambda w: w.fail(LAMP), World.heal),
    "limit lamp": (
        lambda w: w.station.patches.set_limits("lamp", PatchLimits(high=1.0)),
        lambda w: w.station.patches.set_limits("lamp", PatchLimits(high=99.0)),
    ),
    "stopped": (
        lambda w: (w.station.patches.set_limits("lamp", PatchLimits(high=99.0)), w.station.set_every(None)),
        lambda w: w.station.set_every(0.05),
    ),
    "calibration": (lambda w: w.reload(CalibrationError("no calibration")), lambda w: w.reload(None)),
    "descriptors": (
        lambda w: Descriptors(w.station.alarms).take_error(
            asyncio.get_running_loop(), {"message": "socket.accept() out of system resource"}
        ),
        lambda w: Descriptors(w.station.alarms).look(),
    ),
}


def _kind(name: str) -> str:
    """Return the kind of an alarm as the table has it."""
    for word in ("lamp", "red"):
        name = name.replace(word, {"lamp": "PATCH", "red": "CHANNEL"}[word])
    return name


def test_every_alarm_is_tested_and_documented():
    """The table of docs/reference/daemon.md is that of the program, line by line."""
    assert {_kind(name) for name in CASES} | {"mqtt", "period"} == {kind.name for kind in KINDS}
    text = (ROOT / "docs" / "reference" / "daemon.md").read_text(encoding="utf-8")
    for kind in KINDS:
        assert f"| `{kind.name}` | {kind.cause} | {kind.end} |" in text


@pytest.mark.parametrize("name", CASES)
async def test_an_alarm_is_up_as_long_as_its_cause(name, station, instrument, box, serve, eventually):
    """Health, state and every listener have it; then it goes, and the journal has both."""
    station.lateness.missing_s = 0.3
    world, http = World(station, instrument, box), await serve(limits=Limits(http_requests_per_s=1e4))

    async def health():
        reply = await http.get("/healthz")
        return reply.status, reply.json()["alarms"]

    async def until(*, up):
        async with asyncio.timeout(60):
            while (name in (await health())[1]) is not up:
                await asyncio.sleep(0.01)

    station.patches.define("lamp", LAMP)
    station.set_every(0.01)
    await eventually(lambda: station.shown.latest and station.patches.latest_of("lamp"))
    assert await health() == (200, [])
    listener = station.hub.subscribe(10_000)
    for step, up in zip(CASES[name], (True, False), strict=True):
        done = step(world)
        if asyncio.iscoroutine(done):
            await done
        await until(up=up)
        status, alarms = await health()
        assert status == (503 if alarms else 200)
    async with asyncio.timeout(60):
        while await health() != (200, []):
            await asyncio.sleep(0.01)
    reported = set()
    while name not in reported and (event := await listener.next()) is not None:
        reported |= {alarm["name"] for alarm in json.loads(event.line)["alarms"]} if event.kind == "status" else set()
    assert name in reported


async def test_no_number_of_the_camera_makes_anything_but_json(station, instrument, serve, eventually, monkeypatch):
    """NaN and infinity in a reading, in a temperature, in counters and in the calibration: null on every interface."""

    def refuse(constant: str) -> None:
        raise AssertionError(f"{constant} is no JSON")

    whole = instrument.measure

    def measure(settings: Any) -> Any:
        made = whole(settings)
        odd = Quantity(math.nan, math.inf, "W sr-1 m-2")
        return replace(made, reading=replace(made.reading, radiance=odd, luminance=odd, exposures_s=(math.nan,)))

    instrument.measure = measure
    instrument.check = lambda: DeviceReport(math.nan, {"frames": math.inf})
    monkeypatch.setattr(type(instrument), "calibration_summary", property(lambda self: {"created": math.nan}))
    http, listener = await serve(limits=Limits(http_requests_per_s=1e4)), station.hub.subscribe(10_000)
    station.patches.define("lamp", LAMP)
    station.set_every(0.01)
    await eventually(lambda: station.patches.latest_of("lamp"))
    station.set_every(None)
    await eventually(lambda: math.isnan(station.camera.report.temperature_c or 0.0))
    for path in ("status", "readings?stream=all", "readings?format=jsonl", "trend", "events", "response", "healthz"):
        reply = await http.get(f"/{path}")
        assert reply.status in (200, 503)
        for line in reply.text.splitlines() if "jsonl" in path else [reply.text]:
            json.loads(line, parse_constant=refuse)
    odd_settings = {"auto_exposure": True, "exposure_s": math.nan}
    assert (await http.post("/settings", json=odd_settings)).status == 400
    assert (await http.get("/metrics")).status == 200
    for _ in range(4):  # as many come at least: of the patch, of its two readings, of the end of measuring
        event = await listener.next()
        assert event is not None
        json.loads(event.line, parse_constant=refuse)


@pytest.mark.parametrize(
    "request_bytes",
    [
        b"SYST:HELP:HEAD?\n" * 2000,
        b"GET /readings/stream HTTP/1.1\r\nHost: localhost\r\n\r\n",
        b"GET /readings/stream?format=jsonl HTTP/1.1\r\nHost: localhost\r\n\r\n",
        b"GET /readings?format=csv&stream=all HTTP/1.1\r\nHost: localhost\r\n\r\n" * 20,
        b"GET /frame.png?width=2048 HTTP/1.1\r\nHost: localhost\r\n\r\n" * 20,
        b"POST /measure HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\nContent-Length: 90\r\n\r\n{",
    ],
    ids=["replies", "events", "lines", "table", "pictures", "half a body"],
)
async def test_clients_that_do_not_read_delay_no_reading(station, scpi, serve, instrument, eventually, request_bytes):
    """Ten of each kind ask and never read, nor finish what they send; the shared patch is measured on and on."""
    http = await serve(limits=Limits(http_requests_per_s=1e4))
    ports = {True: http.port, False: await scpi.listen_tcp("127.0.0.1", 0)}
    instrument.measure_s = 0.0
    station.set_every(0.0)
    deaf = []
    for _ in range(10):
        _, writer = await asyncio.open_connection("127.0.0.1", ports[b"HTTP" in request_bytes], limit=1024)
        writer.transport.pause_reading()  # type: ignore[attr-defined]
        writer.write(request_bytes)
        deaf.append(writer)
    begun = station.shown.latest.sequence if station.shown.latest else 0
    await eventually(lambda: station.shown.latest and station.shown.latest.sequence > begun + 300)
    assert station.troubles() == []
    for writer in deaf:
        writer.transport.abort()
