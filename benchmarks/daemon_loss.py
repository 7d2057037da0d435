"""Takes the camera away from the daemon again and again, and takes the time until clients know and until it is back."""

from __future__ import annotations

import asyncio
import contextlib
import json
import random
import socket
import statistics
import subprocess
import sys
import tempfile
import threading
import time
import urllib.error
import urllib.request
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from benchmarks._sections import write_section
from testing.box_station import box_station, seconds_until
from testing.daemon_process import ROOT, DaemonProcess, machine_note, write_small_bench
from testing.wire import only_camera

CYCLES = 20
SERIAL = "22500077"


@dataclass(frozen=True, slots=True)
class LossResult:
    """Times in s, one per cycle."""

    reported_s: list[float]
    recovered_s: list[float]


class WireCamera:
    """The simulated Blackfly behind GigE Vision, in a process of its own: killed, it is an unplugged camera.

    One at a time per computer, for all answer on the same port.
    """

    def __init__(self, folder: Path, *, bench: Path | None = None, serial: str = SERIAL) -> None:
        self._command = [
            sys.executable, "-m", "radiometer", "simulate", "camera", "--serial", serial, "--bench",
            str(bench or write_small_bench(folder)), "--frame-pool", "4",
        ]  # fmt: skip
        self._process: subprocess.Popen[bytes] | None = None

    def plug(self) -> None:
        """Start it; it answers a moment later."""
        self._process = subprocess.Popen(self._command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
        assert self._process.stdout is not None
        self._process.stdout.readline()

    def unplug(self) -> None:
        """Kill it."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            assert self._process.stdout is not None
            self._process.stdout.close()


def wire_bench(folder: Path) -> Path:
    """Write a bench file whose camera is the one on the wire."""
    path = folder / "wire.yaml"
    lines = write_small_bench(folder).read_text(encoding="utf-8").splitlines()
    kept = [line for line in lines if not line.startswith(("camera:", "calibration:"))]
    path.write_text("\n".join([*kept, f'camera: {{kind: genicam, id: "{SERIAL}"}}', ""]), encoding="utf-8")
    return path


def run(cycles: int, seed: int = 1) -> LossResult:
    """Unplug and replug the camera; every interface is watched."""
    rng = random.Random(seed)
    reported, recovered = list[float](), list[float]()
    with tempfile.TemporaryDirectory() as name, only_camera():
        folder = Path(name)
        camera = WireCamera(folder)
        camera.plug()
        try:
            with DaemonProcess(folder, "--every", "0.2", bench=wire_bench(folder)) as daemon:
                daemon.wait_for_reading()
                open_ends = contextlib.ExitStack()
                watchers = _watchers(daemon, open_ends)
                for _ in range(cycles):
                    time.sleep(rng.uniform(1.5, 3.0))
                    # On a busy machine a frame may just be late: clients know of that already.
                    _time_until(lambda: daemon.get("/status")["alarms"] == [], lambda: None, [])
                    reported.append(_time_until(lambda: all(w.sees_alarm for w in watchers), camera.unplug, watchers))
                    time.sleep(rng.uniform(2.0, 5.0))
                    before = daemon.get("/status")["latest_sequence"]
                    camera.plug()
                    recovered.append(_time_until(lambda before=before: _is_back(daemon, before), lambda: None, []))
                for watcher in watchers:
                    watcher.stop()
            for watcher in watchers:  # the daemon has ended, so none of them waits any longer
                watcher.join(10)
            open_ends.close()
        finally:
            camera.unplug()
    return LossResult(reported, recovered)


async def run_box(cycles: int) -> LossResult:
    """Unplug and replug the light box; the station in this process is watched."""
    reported, recovered = list[float](), list[float]()
    with tempfile.TemporaryDirectory() as name:
        async with box_station(Path(name)) as (station, server, _):
            for _ in range(cycles):
                await station.light.set_level("fixation", 0.1)
                server.unplug()
                reported.append(await seconds_until(lambda: bool(station.alarms.active)))
                server.plug()
                recovered.append(await seconds_until(lambda: not station.alarms.active))
    return LossResult(reported, recovered)


class _Watcher(threading.Thread):
    """Looks at one interface as a client does."""

    def __init__(self, look: Callable[[], bool]) -> None:
        super().__init__(daemon=True)
        self._look, self._ended, self.sees_alarm = look, threading.Event(), False

    def run(self) -> None:
        while not self._ended.is_set():
            try:
                self.sees_alarm = self._look() or self.sees_alarm
            except OSError:
                continue

    def stop(self) -> None:
        self._ended.set()


def _watchers(daemon: DaemonProcess, open_ends: contextlib.ExitStack) -> list[_Watcher]:
    line = open_ends.enter_context(socket.create_connection(("127.0.0.1", daemon.scpi_port), timeout=20))
    replies = open_ends.enter_context(line.makefile("rb"))
    stream = open_ends.enter_context(urllib.request.urlopen(daemon.url + "/readings/stream", timeout=60))

    def scpi() -> bool:
        time.sleep(0.05)
        line.sendall(b"SYST:ERR?\n")
        return b"-240" in replies.readline()

    def events() -> bool:
        text = stream.readline()
        return bool(text.startswith(b'data: {"time"') and b'"alarms": [{' in text and b'"camera"' in text)

    def health() -> bool:
        time.sleep(0.05)
        try:
            urllib.request.urlopen(daemon.url + "/healthz", timeout=20).close()
        except urllib.error.HTTPError as answer:
            with answer:
                return bool(json.load(answer)["alarms"])
        return False

    watchers = [_Watcher(scpi), _Watcher(events), _Watcher(health)]
    for watcher in watchers:
        watcher.start()
    return watchers


def _time_until(condition: Callable[[], bool], act: Callable[[], None], watchers: list[_Watcher]) -> float:
    for watcher in watchers:
        watcher.sees_alarm = False
    begun = time.monotonic()
    act()
    while not condition():
        if time.monotonic() - begun > 60:
            raise RuntimeError("it did not happen within 60 s")
        time.sleep(0.02)
    return time.monotonic() - begun


def _is_back(daemon: DaemonProcess, before: int) -> bool:
    status = daemon.get("/status")
    return status["alarms"] == [] and status["latest_sequence"] > before


def main() -> None:
    note = machine_note()
    result, box = run(CYCLES), asyncio.run(run_box(CYCLES))
    rows = [
        f"| {what} | {statistics.median(times):.2f} s | {max(times):.2f} s |\n"
        for what, times in (
            ("camera unplugged until SCPI, event stream and health all report it", result.reported_s),
            ("camera replugged until the next reading, alarms clear", result.recovered_s),
            ("light box unplugged until the alarm", box.reported_s),
            ("light box replugged until the alarm clears", box.recovered_s),
        )
    ]
    body = note + (
        f"The simulated Blackfly on the wire, killed and started {CYCLES} times while the daemon measures; the light"
        f" box's pseudo-terminal closed and opened {CYCLES} times.\n\n"
        "| from … to | median | longest |\n|---|---|---|\n" + "".join(rows)
    )
    print(body, result, box)
    write_section("daemon-loss", "Devices lost and found by the daemon", "python -m benchmarks daemon_loss", body)


if __name__ == "__main__":
    main()
