"""A day of the daemon in simulated time, with clients and with losses of camera, box, broker and disk."""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import random
import re
import sys
import tempfile
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from dataclasses import dataclass, field
from itertools import count
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import aiohttp
import structlog

from benchmarks._sections import write_section
from benchmarks.daemon_soak import slope
from radiometer.daemon import mqtt
from radiometer.daemon.bench_instrument import BenchInstrument
from radiometer.daemon.http.server import HttpServer
from radiometer.daemon.instrument import DeviceReport, Measurement, MeasurementSettings
from radiometer.daemon.journal import Journal
from radiometer.daemon.keeper import KeeperTimes
from radiometer.daemon.resources import level_memory
from radiometer.daemon.scpi.server import ScpiServer
from radiometer.daemon.station import Station
from radiometer.data import Patch
from radiometer.errors import DeviceLost
from testing.daemon_process import machine_note
from testing.simulated_time import simulated_time
from testing.soak_world import PATCHES, Verdict, Witness, judge, write_benches

HOURS = 24.0
EVERY_S = 10.0
LOSS_EVERY_S = 300.0
_WARM_UP_S = 7200.0
_SAMPLE_S = 300.0


class _Camera(BenchInstrument):
    """The simulated camera of the bench, with a cable that can be pulled."""

    away = False

    def open(self) -> None:
        """Open it. Raises DeviceLost while it is away."""
        self._refuse()
        super().open()

    def check(self) -> DeviceReport:
        """Ask whether it is there."""
        self._refuse()
        return super().check()

    def measure(self, settings: MeasurementSettings) -> Measurement:
        """Measure; a cable pulled meanwhile fails it."""
        found = super().measure(settings)
        self._refuse()
        return found

    def _refuse(self) -> None:
        if self.away:
            raise DeviceLost("the camera is unplugged")


@dataclass
class _Box:
    """A light box that goes dark by itself 1 s after it was unplugged."""

    name: str = "light box"
    channels: tuple[str, ...] = ("fixation", "spot")
    late_at: float | None = None
    away_since: float | None = None
    lit: dict[str, float] = field(default_factory=dict)

    def truth(self, channel: str) -> float:
        """Return what a channel really does."""
        dark = self.away_since is not None and time.monotonic() - self.away_since >= 1.0
        return 0.0 if dark else self.lit.get(channel, 0.0)

    def plug(self) -> None:
        """Bring it back; it is dark if it was away for 1 s."""
        self.lit, self.away_since = {name: self.truth(name) for name in self.channels}, None

    def open(self) -> None:
        """Open it, dark."""
        self._refuse()
        self.lit = dict.fromkeys(self.channels, 0.0)

    def close(self) -> None:
        """Release it; without a host it is dark."""
        if self.away_since is None:
            self.lit = dict.fromkeys(self.channels, 0.0)

    def check(self) -> DeviceReport:
        """Say what each channel does."""
        self._refuse()
        return DeviceReport(30.0, {}, dict(self.lit))

    def set_level(self, channel: str, level: float) -> float:
        """Light a channel."""
        self._refuse()
        self.lit[channel] = level
        return level

    def _refuse(self) -> None:
        if self.away_since is not None:
            raise DeviceLost("the light box is unplugged")


class _FillingJournal(Journal):
    """A journal whose disk can be full: SQLite gets no page beyond those that it has."""

    full = False

    def _transaction(self) -> Any:
        transaction = super()._transaction()
        assert self._connection is not None
        (pages,) = self._connection.execute("PRAGMA page_count").fetchone()
        self._connection.execute(f"PRAGMA max_page_count = {pages if self.full else 2**30}")
        return transaction


class _Broker:
    """Stands for broker and MQTT library in simulated time: queues while it is away, as the library does."""

    CallbackAPIVersion, MQTTv311, MQTT_ERR_QUEUE_SIZE = SimpleNamespace(VERSION2=2), 4, 15

    def __init__(self, witness: Witness) -> None:
        self.witness, self.up, self.client = witness, True, None  # type: Witness, bool, Any
        self._waiting: list[tuple[str, str, int]] = []
        self._numbers = count(1)

    def Client(self, *_: Any, **__: Any) -> Any:  # noqa: N802 (the library's name)
        """Return the client."""
        self.client = SimpleNamespace(
            max_queued_messages_set=lambda n: None, reconnect_delay_set=lambda **_: None,
            will_set=lambda *_, **__: None, connect_async=lambda *_, **__: None, loop_start=self.back,
            loop_stop=lambda: None, disconnect=lambda: None,
            is_connected=lambda: self.up, publish=self._publish, subscribe=lambda *_, **__: None,
        )  # fmt: skip
        return self.client

    def gone(self) -> None:
        """Take the broker away."""
        self.up = False
        self.client.on_disconnect(self.client, None, None, SimpleNamespace(is_failure=True), None)

    def back(self) -> None:
        """Bring it back; what waited arrives."""
        self.up = True
        self.client.on_connect(self.client, None, None, SimpleNamespace(is_failure=False), None)
        waiting, self._waiting = self._waiting, []
        for message in waiting:
            self._deliver(*message)

    def _publish(self, topic: str, line: str, **_: Any) -> Any:
        number = next(self._numbers)
        if self.up:
            self._deliver(topic, line, number)
        else:
            self._waiting.append((topic, line, number))
        return SimpleNamespace(wait_for_publish=lambda seconds: None, rc=0, mid=number)

    def _deliver(self, topic: str, line: str, number: int) -> None:
        if line and topic.endswith("/reading"):
            patch = "dim" if "/patch/dim/" in topic else "bright"
            self.witness.saw(f"MQTT {patch}", json.loads(line), patch)
        self.client.on_publish(self.client, None, number, SimpleNamespace(is_failure=False), None)


@dataclass(frozen=True, slots=True)
class DayResult:
    """What a day showed; memory in MB, slope in MB per simulated h."""

    hours: float
    real_s: float
    losses: dict[str, int]
    witness: Witness
    verdict: Verdict
    memory_mb: list[float]
    slope_mb_per_h: float
    u_slope_mb_per_h: float


@dataclass
class _World:
    station: Station
    camera: _Camera
    box: _Box
    journal: _FillingJournal
    broker: _Broker
    witness: Witness
    scpi_port: int
    url: str
    losses: dict[str, int] = field(default_factory=dict)


def run(hours: float, seed: int = 1) -> DayResult:
    """Run the daemon's parts for a time of simulated hours and judge what was seen."""
    witness, real = Witness(), time.monotonic
    begun = real()
    with tempfile.TemporaryDirectory() as name, simulated_time() as loop:
        losses, times_s, megabytes = loop.run_until_complete(_day(Path(name), hours * 3600, witness, seed))
        verdict = judge(Path(name) / "journal.sqlite", witness)
    late = [n for n, moment in enumerate(times_s) if moment >= min(_WARM_UP_S, hours * 1800)]
    rate, u_rate = slope([times_s[n] for n in late], [megabytes[n] for n in late])
    shown = megabytes[:: max(1, len(megabytes) // 12)]
    return DayResult(hours, real() - begun, losses, witness, verdict, shown, rate * 3600, u_rate * 3600)


async def _day(
    folder: Path, seconds: float, witness: Witness, seed: int
) -> tuple[dict[str, int], list[float], list[float]]:
    loop = asyncio.get_running_loop()
    async with _world(folder, witness) as world, aiohttp.ClientSession() as http:
        tasks = [loop.create_task(work) for work in (*_clients(world, http), *_faults(world, seed), level_memory())]
        begun, times_s, megabytes = loop.time(), list[float](), list[float]()
        while (elapsed_s := loop.time() - begun) < seconds:
            times_s.append(elapsed_s)
            megabytes.append(_resident_mb())
            await asyncio.sleep(min(_SAMPLE_S, seconds / 40))
            for task in tasks:
                if task.done():
                    raise RuntimeError("a client or a fault ended") from task.exception()
            if (failure := world.station.failed_task()) is not None:
                raise RuntimeError("a part of the daemon ended") from failure
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        _all_well(world)
        await asyncio.sleep(60.0)
        return world.losses, times_s, megabytes


@contextlib.asynccontextmanager
async def _world(folder: Path, witness: Witness) -> AsyncIterator[_World]:
    bench, _ = write_benches(folder)
    camera, box, journal = _Camera(bench), _Box(), _FillingJournal(folder / "journal.sqlite")
    broker = _Broker(witness)
    settings = MeasurementSettings(patch=Patch(**PATCHES["bright"][0]))
    station = Station(camera, journal, box=box, settings=settings, times=KeeperTimes(check_every_s=5.0))
    scpi, http = ScpiServer(station), HttpServer(station)
    sys.modules["paho.mqtt.client"] = broker  # type: ignore[assignment]
    await station.start()
    publisher = mqtt.MqttPublisher(station, mqtt.MqttTarget("127.0.0.1"))
    publisher.start()
    ports = await scpi.listen_tcp("127.0.0.1", 0), await http.listen("127.0.0.1", 0)
    station.patches.define("dim", Patch(**PATCHES["dim"][0]))
    station.set_every(EVERY_S)
    try:
        yield _World(station, camera, box, journal, broker, witness, ports[0], f"http://127.0.0.1:{ports[1]}")
    finally:
        await http.close()
        await scpi.close()
        await station.stop()
        await publisher.stop()
        del sys.modules["paho.mqtt.client"]


def _clients(world: _World, http: aiohttp.ClientSession) -> list[Awaitable[None]]:
    asks = {patch: ",".join(map(str, PATCHES[patch][0].values())) for patch in ("dim", "mid")}
    return [
        _listen(world), _scpi(world, 23.0, [("FETC?", "bright")]), _scpi(world, 31.0, [("FETC?", "bright")]),
        _scpi(world, 61.0, [(f"MEAS:RAD? {asks['dim']}", "dim"), ("FETC:RAD?", "dim")]),
        _scpi(world, 77.0, [(f"MEAS:RAD? {asks['mid']}", "mid"), ("FETC:RAD?", "mid")]),
        _over_http(world, http), _light(world),
    ]  # fmt: skip


async def _listen(world: _World) -> None:
    """Hear every reading as the streams do; a subscription that is cut off would be an error here."""
    subscription = world.station.hub.subscribe(1000)
    while (event := await subscription.next()) is not None:
        if event.kind == "status":
            continue
        reading = json.loads(event.line)
        world.witness.saw(f"hub {event.kind}", reading, "bright" if event.kind == "reading" else "dim")
        if event.kind == "reading":
            world.witness.main.add(reading["sequence"])


async def _scpi(world: _World, every_s: float, questions: list[tuple[str, str]]) -> None:
    reader, writer = await asyncio.open_connection("127.0.0.1", world.scpi_port)
    try:
        while True:
            await asyncio.sleep(every_s)
            for question, patch in questions:
                await _ask(world.witness, reader, writer, question, patch)
    finally:
        writer.transport.abort()


async def _ask(
    witness: Witness, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, question: str, patch: str
) -> None:
    writer.write(f"*CLS\n{question}\nSYST:ERR?\n".encode())
    reply = (await reader.readline()).decode()
    if not reply:
        raise ConnectionError("hung up")
    if re.match(r'[-+]?\d+,"', reply):
        witness.count(f"{question} refused")
        return
    await reader.readline()
    value, u = map(float, reply.split(","))
    witness.saw_value(question, value, u, patch)


async def _over_http(world: _World, http: aiohttp.ClientSession) -> None:
    while True:
        await asyncio.sleep(60.0)
        async with http.post(world.url + "/measure", json={"patch": PATCHES["mid"][0]}) as reply:
            if reply.status == 200:
                world.witness.saw("POST /measure", await reply.json(), "mid")
            else:
                world.witness.count(f"POST /measure refused {reply.status}")
        for path, patch in (("/readings?limit=5", "bright"), ("/readings?limit=5&stream=patch+dim", "dim")):
            async with http.get(world.url + path) as reply:
                for reading in await reply.json():
                    world.witness.saw(f"GET /readings of {patch}", reading, patch)
        async with http.get(world.url + "/metrics") as reply:
            text = await reply.text()
        for value in re.findall(r"^radiometer_radiance\{[^}]*\} (\S+)$", text, re.MULTILINE):
            world.witness.saw_value("/metrics", float(value), 0.0, "bright")


async def _light(world: _World) -> None:
    """Light and darken, and hold what is shown as confirmed against what the box does; it is asked every 5 s."""
    doubt_s = turn = 0.0
    while True:
        await asyncio.sleep(1.0)
        turn += 1
        if turn % 40 == 0:
            with contextlib.suppress(DeviceLost):
                await world.station.light.set_level("fixation", 0.02 * (turn % 80 == 0))
        status, truth = world.station.status(), world.box.truth("fixation")
        shown = status["light"].get("fixation")
        world.witness.count("light looked at")
        agrees = not status["light_confirmed"] or shown is None or abs(shown - truth) < 1e-6
        doubt_s = 0.0 if agrees else doubt_s + 1.0
        if doubt_s > 12.0:
            world.witness.blame(f"light: {shown} confirmed where the box does {truth}")


def _faults(world: _World, seed: int) -> list[Awaitable[None]]:
    def unplug_box() -> None:
        world.box.away_since = time.monotonic()

    faults: list[tuple[str, Callable[[], None], Callable[[], None]]] = [
        ("camera", lambda: setattr(world.camera, "away", True), lambda: setattr(world.camera, "away", False)),
        ("light box", unplug_box, world.box.plug),
        ("broker", world.broker.gone, world.broker.back),
        ("disk", lambda: setattr(world.journal, "full", True), lambda: setattr(world.journal, "full", False)),
    ]
    return [_lose(world, *fault, random.Random(seed + number)) for number, fault in enumerate(faults)]


async def _lose(
    world: _World, name: str, take: Callable[[], None], give: Callable[[], None], rng: random.Random
) -> None:
    while True:
        await asyncio.sleep(LOSS_EVERY_S * rng.uniform(0.5, 1.5))
        take()
        world.losses[name] = world.losses.get(name, 0) + 1
        await asyncio.sleep(rng.uniform(1.0, 60.0))
        give()


def _all_well(world: _World) -> None:
    world.camera.away = world.journal.full = False
    world.box.plug()
    world.broker.back()


def _resident_mb() -> float:
    return int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1]) * 4096 / 1e6


def main() -> None:
    note = machine_note()
    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(logging.CRITICAL))
    result = run(float(sys.argv[1]) if len(sys.argv) > 1 else HOURS)
    verdict, counts = result.verdict, result.witness.counts
    answered = sum(n for what, n in counts.items() if what != "false" and "refused" not in what)
    refused = sum(n for what, n in counts.items() if "refused" in what)
    memory_mb = ", ".join(f"{value:.0f}" for value in result.memory_mb)
    losses = ", ".join(f"{name} {times}" for name, times in sorted(result.losses.items()))
    body = note + (
        f"{result.hours:g} h of simulated time in {result.real_s / 60:.0f} min, with SCPI, HTTP and MQTT in one"
        " process whose clock jumps to the next timer. Every answer is compared with the radiance of its patch."
        " Camera, box, broker and disk go away every 5 min for up to a minute.\n\n"
        "| losses | readings in the journal | seen by clients | seen but missing | holes | not heard by the stream |"
        " answers compared with the scene | refused meanwhile | false values |\n|---|---|---|---|---|---|---|---|---|\n"
        f"| {losses} | {verdict.readings} | {verdict.seen} | {verdict.missing} | {verdict.holes} | {verdict.unheard} |"
        f" {answered} | {refused} | {counts['false'] + verdict.false_rows} |\n\n"
        f"Memory of the whole process at even steps in MB: {memory_mb}; slope {result.slope_mb_per_h:+.2f} ±"
        f" {result.u_slope_mb_per_h:.2f} MB per simulated hour (k=1) after the first two.\n"
    )
    print(body, result.witness.false, counts, verdict.alarms, sep="\n")
    write_section("daemon-day-soak", "A day of the daemon in simulated time", "make soak", body)


if __name__ == "__main__":
    main()
