"""Fifty clients ask the daemon twenty times a second while others do it all the harm that the loopback address allows.

`python -m benchmarks --soak daemon_hostile_soak` takes half an hour; `python -m benchmarks.daemon_hostile_soak
--seconds 120` takes less.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import random
import subprocess
import sys
import tempfile
import time
import urllib.error
import urllib.request
from collections.abc import Awaitable, Callable
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import datetime
from itertools import pairwise
from pathlib import Path
from typing import Any

from benchmarks._sections import write_section
from benchmarks.daemon_load import Replies
from radiometer.daemon.journal_reader import JournalReader, ReadingFilter
from testing.daemon_process import ROOT, DaemonProcess, machine_note

CLIENTS, PER_CLIENT_PER_S, SECONDS, EVERY_S = 50, 20.0, 1800.0, 1.0
_LOOK_S = 0.5
_HEAD = "{} HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\n"


@dataclass
class Looks:
    """What somebody saw who asked for health and state all the time."""

    count: int = 0
    untrue: int = 0
    alarmed: dict[str, int] = field(default_factory=dict)
    unanswered: int = 0
    memory_mb: list[float] = field(default_factory=list)


async def _measure_own(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    x = random.randrange(100)
    while True:
        writer.write(f"MEAS:RAD? {x},{x},8,8\n".encode())
        await reader.readline()


async def _never_read(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    writer.transport.pause_reading()  # type: ignore[attr-defined]
    while not writer.transport.is_closing():
        writer.write(b"SYST:HELP:HEAD?\n" * 20)
        await writer.drain()
        await asyncio.sleep(0.1)


async def _listen_deaf(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    writer.transport.pause_reading()  # type: ignore[attr-defined]
    writer.write((_HEAD.format("GET /readings/stream?after=0") + "\r\n").encode())
    await asyncio.sleep(60)


async def _drip(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    writer.write((_HEAD.format("POST /settings") + "Content-Length: 500\r\n\r\n").encode())
    while not writer.transport.is_closing():
        writer.write(b" ")
        await asyncio.sleep(1)


async def _garbage(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    writer.transport.pause_reading()  # type: ignore[attr-defined]
    while not writer.transport.is_closing():
        writer.write(random.randbytes(300) + b"\n")
        await asyncio.sleep(0.05)


async def _knock(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    await asyncio.sleep(0.05)


# How many of each, whether to SCPI, and what they do.
_HOSTILE: tuple[tuple[int, bool, Callable[[Any, Any], Awaitable[None]]], ...] = (
    (3, True, _measure_own),
    (20, True, _never_read),
    (20, False, _listen_deaf),
    (20, False, _drip),
    (5, True, _garbage),
    (5, False, _garbage),
    (3, True, _knock),
    (3, False, _knock),
)


async def _attack(scpi_port: int, http_port: int, seconds: float) -> None:
    async def one(port: int, what: Callable[[Any, Any], Awaitable[None]]) -> None:
        while True:
            with suppress(OSError, asyncio.IncompleteReadError):
                reader, writer = await asyncio.open_connection("127.0.0.1", port)
                try:
                    await what(reader, writer)
                finally:
                    writer.transport.abort()
            await asyncio.sleep(0.2)

    tasks = [
        asyncio.create_task(one(scpi_port if scpi else http_port, what))
        for count, scpi, what in _HOSTILE
        for _ in range(count)
    ]
    await asyncio.sleep(seconds)
    for task in tasks:
        task.cancel()


def _watch(daemon: DaemonProcess, seconds: float) -> Looks:
    """Ask for health and, before and after it, for the state: where these two agree, health has to say the same."""
    looks, end = Looks(), time.monotonic() + seconds
    while time.monotonic() < end:
        try:
            before, health, after = daemon.get("/status"), _health(daemon), daemon.get("/status")
        except (OSError, urllib.error.URLError):
            looks.unanswered += 1
            continue
        wrong = [{a["name"] for a in s["alarms"]} | _not_ready(s) for s in (before, after)]
        looks.count += 1
        looks.untrue += wrong[0] == wrong[1] and health[0] != (503 if wrong[0] else 200)
        for name in health[1]:
            looks.alarmed[name] = looks.alarmed.get(name, 0) + 1
        looks.memory_mb.append(daemon.resident_bytes() / 1e6)
        time.sleep(_LOOK_S)
    return looks


def _not_ready(status: dict[str, Any]) -> set[str]:
    return {name for name, device in status["devices"].items() if device["state"] != "ready"}


def _health(daemon: DaemonProcess) -> tuple[int, list[str]]:
    try:
        with urllib.request.urlopen(daemon.url + "/healthz", timeout=20) as reply:
            return 200, json.load(reply)["alarms"]
    except urllib.error.HTTPError as error:
        return error.code, json.load(error)["alarms"]


def _gaps_s(journal: Path, begun: float) -> list[float]:
    """Return the pauses between the readings of the shared patch from a time on, in s."""
    lines = JournalReader(journal, deadline_s=60.0).lines(ReadingFilter(stream=""))
    times = [datetime.fromisoformat(json.loads(line)["time"]).timestamp() for line in lines]
    return [later - earlier for earlier, later in pairwise(t for t in times if t >= begun)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=SECONDS)
    seconds, note = parser.parse_args().seconds, machine_note()
    with (
        tempfile.TemporaryDirectory() as folder,
        DaemonProcess(Path(folder), "--every", str(EVERY_S)) as daemon,
    ):
        daemon.wait_for_reading()
        time.sleep(2.0)
        begun, ports = time.time(), [str(daemon.scpi_port), str(daemon.http_port)]
        polite = [sys.executable, "-m", "benchmarks.daemon_load", ports[0], str(CLIENTS), str(PER_CLIENT_PER_S)]
        hostile = [sys.executable, "-m", "benchmarks.daemon_hostile_soak", *ports, str(seconds)]
        attack = subprocess.Popen(hostile, cwd=ROOT, stderr=subprocess.DEVNULL)
        asking = subprocess.Popen([*polite, str(seconds)], cwd=ROOT, stdout=subprocess.PIPE, text=True)
        looks = _watch(daemon, seconds)
        replies = Replies(**json.loads(asking.communicate()[0]))
        attack.wait()
        gaps = sorted(_gaps_s(daemon.journal, begun))
    early = looks.memory_mb[len(looks.memory_mb) // 10]
    alarmed = ", ".join(f"{name} {count}×" for name, count in looks.alarmed.items()) or "none"
    body = note + (
        f"For {seconds:g} s, {CLIENTS} SCPI connections ask `FETC?` {PER_CLIENT_PER_S:g} times a second each. At the"
        f" same time {sum(count for count, _, _ in _HOSTILE)} hostile clients measure further patches without end,"
        " never read replies or streams, drip bodies, send noise, connect and disconnect. The simulated camera"
        f" (160 × 120 pixels) measures every {EVERY_S:g} s.\n\n| what | figure |\n|---|---|\n"
        f"| replies, errors | {replies.asked}, {replies.errors} |\n"
        f"| median, p99, slowest | {replies.p50_ms:.1f} ms, {replies.p99_ms:.1f} ms, {replies.slowest_ms:.0f} ms |\n"
        f"| readings of the shared patch, median and longest pause | {len(gaps) + 1}, {gaps[len(gaps) // 2]:.2f} s,"
        f" {gaps[-1]:.2f} s |\n"
        f"| looks at `healthz`, untrue ones, unanswered | {looks.count}, {looks.untrue}, {looks.unanswered} |\n"
        f"| looks with an alarm | {alarmed} |\n"
        f"| memory after a tenth of the time, at the end, highest | {early:.0f} MB, {looks.memory_mb[-1]:.0f} MB,"
        f" {max(looks.memory_mb):.0f} MB |\n"
    )
    print(body, flush=True)
    command = f"python -m benchmarks.daemon_hostile_soak --seconds {seconds:g}"
    write_section("daemon-hostile", "Daemon among hostile clients", command, body)


if __name__ == "__main__":
    if len(sys.argv) == 4:  # as started by main()
        asyncio.run(_attack(int(sys.argv[1]), int(sys.argv[2]), float(sys.argv[3])))
    else:
        main()
