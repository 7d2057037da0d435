"""A fake instrument and light box for a station, and clients that speak HTTP, and SCPI by lines."""

from __future__ import annotations

import asyncio
import json
import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partialmethod
from typing import Any
from weakref import WeakKeyDictionary

import aiohttp
import numpy as np

from radiometer.daemon.instrument import DeviceReport, Measurement, MeasurementSettings
from radiometer.daemon.keeper import KeeperTimes
from radiometer.daemon.scpi.server import ScpiServer
from radiometer.data import Contribution, Frame, FrameSettings, Patch, Quantity, Reading, ResponseCurve
from radiometer.devices import CameraCapabilities, CameraIdentity
from radiometer.errors import DeviceError, DeviceLost, MeasurementError
from testing.patience import within

PORTS: WeakKeyDictionary[ScpiServer, int] = WeakKeyDictionary()  # where each server of a test listens
QUICK = KeeperTimes(first_pause_s=0.01, longest_pause_s=0.05, check_every_s=0.05, overdue_s=1.0)


@dataclass
class FakeInstrument:
    """An instrument without optics: radiance 1 + patch.x; can be unplugged."""

    measure_s: float = 0.002
    unplugged: bool = False
    failing: bool = False
    openings: int = 0
    measured: list[MeasurementSettings] = field(default_factory=list)
    is_open: bool = False
    reloads: int = 0
    late_at: float | None = None
    shape: tuple[int, int] = (48, 64)
    let_go: threading.Event | None = None  # a measurement takes until it is set

    @property
    def identity(self) -> CameraIdentity:
        return CameraIdentity("Fake", "F-1", "4711", "fake")

    @property
    def limits(self) -> CameraCapabilities:
        if not self.openings:
            raise DeviceError("the camera was never open")
        return CameraCapabilities((1e-5, 30.0), (0.0, 48.0), (0.0, 255.0), ("Mono12",), 64, 48)

    def open(self) -> None:
        if self.unplugged:
            raise DeviceLost("fake camera: unplugged")
        self.openings += 1
        self.is_open = True

    def close(self) -> None:
        self.is_open = False

    def check(self) -> DeviceReport:
        if self.unplugged:
            raise DeviceLost("fake camera: unplugged")
        return DeviceReport(41.5, {"frames": len(self.measured), "missing_packets": 3})

    def measure(self, settings: MeasurementSettings) -> Measurement:
        self.measured.append(settings)
        time.sleep(self.measure_s)
        if self.let_go is not None:
            self.let_go.wait(within(20.0))
        if self.unplugged:
            raise DeviceLost("fake camera: unplugged")
        if self.failing:
            raise MeasurementError("every pixel is saturated; close the aperture")
        patch = settings.patch or Patch(16, 12, 32, 24)
        reading = Reading(
            Quantity(1.0 + patch.x, 0.01, "W sr-1 m-2"),
            patch,
            "4711",
            Quantity(100.0, 2.0, "cd m-2"),
            exposures_s=(settings.exposure_s,),
            budget=(Contribution("scale", 0.01),),
        )
        dn = (np.arange(np.prod(self.shape)) % 3072).astype(np.uint16).reshape(self.shape)
        return Measurement(reading, (Frame(dn, 12, FrameSettings(settings.exposure_s)),))

    def self_test(self) -> list[str]:
        return ["dark level is high"] if self.failing else []

    def reload_calibration(self) -> str:
        self.reloads += 1
        return "calibration.yaml, made 2026-11-20"

    @property
    def response(self) -> ResponseCurve | None:
        g = np.log((np.arange(256) + 0.5) / 128.5)
        return ResponseCurve(g, np.full(256, 0.01))

    @property
    def calibration_summary(self) -> dict[str, Any]:
        return {"source": "calibration.yaml", "created": "2026-11-20T12:00:00Z", "assumptions": ["equal energy"]}


@dataclass
class FakeBox:
    """A light box of two channels."""

    unplugged: bool = False
    levels: dict[str, float] = field(default_factory=dict)
    name: str = "fake box"
    channels: tuple[str, ...] = ("white", "red")
    late_at: float | None = None

    def open(self) -> None:
        if self.unplugged:
            raise DeviceLost("fake box: unplugged")
        self.levels = dict.fromkeys(self.channels, 0.0)

    def close(self) -> None:
        self.levels = dict.fromkeys(self.channels, 0.0)

    def check(self) -> DeviceReport:
        if self.unplugged:
            raise DeviceLost("fake box: unplugged")
        return DeviceReport(30.0)

    def set_level(self, channel: str, level: float) -> float:
        if self.unplugged:
            raise DeviceLost("fake box: unplugged")
        self.levels[channel] = level
        return level


@dataclass
class Answer:
    """What an HTTP server answered."""

    status: int
    content_type: str
    headers: Mapping[str, str]
    body: bytes

    @property
    def text(self) -> str:
        return self.body.decode()

    def json(self) -> Any:
        return json.loads(self.body)


class HttpClient:
    """A client of an HTTP server on a port of loopback."""

    def __init__(self, port: int) -> None:
        self.port = port
        self.session = aiohttp.ClientSession(f"http://127.0.0.1:{port}")

    async def ask(self, method: str, path: str, **options: Any) -> Answer:
        async with self.session.request(method, path, **options) as reply:
            return Answer(reply.status, reply.content_type, reply.headers, await reply.read())

    get = partialmethod(ask, "GET")
    post = partialmethod(ask, "POST")
    head = partialmethod(ask, "HEAD")
    delete = partialmethod(ask, "DELETE")


@dataclass
class LineClient:
    """A raw socket that sends and receives lines."""

    reader: asyncio.StreamReader
    writer: asyncio.StreamWriter

    async def send(self, message: str) -> None:
        self.writer.write(message.encode("latin-1") + b"\n")
        await self.writer.drain()

    async def ask(self, message: str) -> str:
        await self.send(message)
        async with asyncio.timeout(within(20.0)):
            reply = await self.reader.readline()
            if reply.startswith(b"#"):  # a block may hold line feeds
                length = 2 + int(reply[1:2]) + int(reply[2 : 2 + int(reply[1:2])]) + 1
                reply += await self.reader.readexactly(length - len(reply))
            return reply.decode("latin-1").rstrip("\n")
