"""Asks the daemon over many SCPI connections at once while it measures."""

from __future__ import annotations

import asyncio
import json
import subprocess
import sys
import tempfile
import time
from dataclasses import asdict, dataclass
from pathlib import Path

from benchmarks._sections import write_section
from testing.daemon_process import ROOT, DaemonProcess, machine_note

FULL = ROOT / "configs" / "bench-simulated.yaml"
CLIENTS, PER_CLIENT_PER_S, SECONDS = 200, 20.0, 60.0
# Small camera: 160 × 120 pixels, so that measuring is quick; full camera: the shipped bench, 1616 × 1240 pixels.
# As fast as it goes, the simulated camera wants both cores to paint its pictures: what the clients take, it lacks.
CASES = (("small", 0.1), ("full", 2.0), ("small", 0.0))


@dataclass(frozen=True, slots=True)
class Replies:
    """What the clients saw, and how many cores they and the network below them kept busy."""

    asked: int
    errors: int
    p50_ms: float
    p99_ms: float
    slowest_ms: float
    per_s: float
    cores: float


@dataclass(frozen=True, slots=True)
class LoadResult:
    """What the clients saw, and the rate of measuring without and under load."""

    replies: Replies
    idle_per_s: float
    loaded_per_s: float

    @property
    def fall(self) -> float:
        return 1.0 - self.loaded_per_s / self.idle_per_s


class _Client(asyncio.Protocol):
    """Sends FETC? at fixed times, spread evenly over the clients, and takes the time to each reply."""

    def __init__(self, delay_s: float, period_s: float, count: int) -> None:
        self._delay_s, self._period_s, self._left = delay_s, period_s, count
        self._sent: list[float] = []
        self.times_s: list[float] = []
        self.errors = 0
        self._rest = b""
        self.done: asyncio.Future[None] = asyncio.get_running_loop().create_future()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        self._transport = transport
        self._loop = asyncio.get_running_loop()
        self._due = self._loop.time() + self._delay_s
        self._loop.call_at(self._due, self._send)

    def _send(self) -> None:
        self._sent.append(self._loop.time())
        self._transport.write(b"FETC?\n")
        self._left -= 1
        if self._left:
            self._due += self._period_s
            self._loop.call_at(self._due, self._send)

    def data_received(self, data: bytes) -> None:
        *lines, self._rest = (self._rest + data).split(b"\n")
        now = self._loop.time()
        for line in lines:
            self.times_s.append(now - self._sent[len(self.times_s)])
            self.errors += not _is_reply(line)
        if not self._left and len(self.times_s) == len(self._sent) and not self.done.done():
            self.done.set_result(None)

    def connection_lost(self, exc: Exception | None) -> None:
        if not self.done.done():
            self.errors += 1
            self.done.set_result(None)


def _is_reply(line: bytes) -> bool:
    """Tell whether a line is a value and its uncertainty, as the scenes here can give them."""
    try:
        value, u = map(float, line.split(b","))
    except ValueError:
        return False
    return 0.1 < value < 2.0 and 0.0 < u < 0.05


async def ask_many(port: int, clients: int, per_s: float, seconds: float) -> Replies:
    """Ask FETC? over many connections and return the times."""
    loop, period_s = asyncio.get_running_loop(), 1.0 / per_s
    everyone = []
    for number in range(clients):
        delay_s = 1.0 + period_s * number / clients
        _, client = await loop.create_connection(
            lambda delay_s=delay_s: _Client(delay_s, period_s, round(per_s * seconds)), "127.0.0.1", port
        )
        everyone.append(client)
    begun, worked_s = time.monotonic(), time.process_time()
    async with asyncio.timeout(seconds + 30):
        await asyncio.gather(*(client.done for client in everyone))
    elapsed_s, worked_s = time.monotonic() - begun - 1.0, time.process_time() - worked_s
    times_ms = sorted(1e3 * value for client in everyone for value in client.times_s)
    for client in everyone:
        client._transport.close()
    return Replies(
        len(times_ms), sum(client.errors for client in everyone), times_ms[len(times_ms) // 2],
        times_ms[int(len(times_ms) * 0.99)], times_ms[-1], len(times_ms) / elapsed_s,
        worked_s / elapsed_s,
    )  # fmt: skip


def run(camera: str, every_s: float, clients: int, per_s: float, seconds: float) -> LoadResult:
    """Measure the rate of acquisition without load, then with load, in one run."""
    with (
        tempfile.TemporaryDirectory() as folder,
        DaemonProcess(Path(folder), "--every", str(every_s), bench=FULL if camera == "full" else None) as daemon,
    ):
        daemon.wait_for_reading()
        time.sleep(1.0)
        idle = _rate(daemon, min(seconds, 30.0))
        before, begun = daemon.get("/status")["latest_sequence"], time.monotonic()
        arguments = [str(daemon.scpi_port), str(clients), str(per_s), str(seconds)]
        client = [sys.executable, "-m", "benchmarks.daemon_load", *arguments]
        replies = Replies(**json.loads(subprocess.run(client, capture_output=True, check=True, text=True).stdout))
        after, elapsed_s = daemon.get("/status")["latest_sequence"], time.monotonic() - begun
    return LoadResult(replies, idle, (after - before) / elapsed_s)


def _rate(daemon: DaemonProcess, seconds: float) -> float:
    before, begun = daemon.get("/status")["latest_sequence"], time.monotonic()
    time.sleep(seconds)
    return float((daemon.get("/status")["latest_sequence"] - before) / (time.monotonic() - begun))


def main() -> None:
    note = machine_note()
    rows = []
    for camera, every_s in CASES:
        result = run(camera, every_s, CLIENTS, PER_CLIENT_PER_S, SECONDS)
        replies = result.replies
        pace = f"every {every_s:g} s" if every_s else "as fast as it goes"
        rows.append(
            f"| {camera} | {pace} | {replies.asked} | {replies.per_s:.0f}/s | {replies.errors} |"
            f" {replies.cores:.2f} | {replies.p50_ms:.2f} ms | {replies.p99_ms:.2f} ms | {replies.slowest_ms:.0f} ms |"
            f" {result.idle_per_s:.1f}/s | {result.loaded_per_s:.1f}/s | {100 * result.fall:.1f} % |\n"
        )
        print(rows[-1], flush=True)
    body = note + (
        f"{CLIENTS} SCPI connections, each asking `FETC?` {PER_CLIENT_PER_S:g} times a second for {SECONDS:g} s, while"
        " the simulated camera measures. At full speed the simulated camera uses both cores, so it loses what the"
        " clients take. Cameras are small (160 × 120 pixels) and full (1616 × 1240). Median, p99 (99th percentile) and"
        " slowest are times until a reply, fall is the loss of readings under load.\n\n"
        "| camera | measuring | asked | rate | errors | cores of the clients | median | p99 | slowest |"
        " readings without load | under load | fall |\n"
        "|---|---|---|---|---|---|---|---|---|---|---|---|\n" + "".join(rows)
    )
    write_section("daemon-load", "Daemon under load", "python -m benchmarks daemon_load", body)


if __name__ == "__main__":
    if len(sys.argv) == 5:
        port, count, pace, length = sys.argv[1:]
        answer = asyncio.run(ask_many(int(port), int(count), float(pace), float(length)))
        print(json.dumps(asdict(answer)))
    else:
        main()
