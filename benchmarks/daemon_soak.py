"""Runs the daemon under steady use and watches its memory and file descriptors."""

from __future__ import annotations

import os
import statistics
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from benchmarks._sections import write_section
from testing.daemon_process import DaemonProcess

SECONDS = float(os.environ.get("RADIOMETER_SOAK_S", "3600"))


@dataclass(frozen=True, slots=True)
class SoakResult:
    seconds: float
    readings: int
    warm_mb: float
    end_mb: float
    slope_mb_per_h: float
    u_slope_mb_per_h: float
    descriptors_first: int
    descriptors_last: int
    errors: int


def run(seconds: float, *, warm_up_s: float, sample_s: float = 1.0) -> SoakResult:
    """Use the daemon as clients do for a time and fit the slope of its memory after warm-up."""
    with (
        tempfile.TemporaryDirectory() as folder,
        DaemonProcess(Path(folder), "--every", "0.05") as daemon,
    ):
        daemon.wait_for_reading()
        time.sleep(1.0)
        users = [_User(daemon, work) for work in (_ask_scpi, _ask_http, _watch_stream)]
        for user in users:
            user.start()
        sample(daemon, warm_up_s, sample_s)
        times_s, megabytes, descriptors = sample(daemon, seconds, sample_s)
        for user in users:
            user.stop()
        readings = daemon.get("/status")["latest_sequence"]
    rate, u_rate = slope(times_s, megabytes)
    tenth = max(1, len(descriptors) // 10)
    return SoakResult(
        seconds, readings, megabytes[0], megabytes[-1], rate * 3600, u_rate * 3600,
        round(statistics.median(descriptors[:tenth])), round(statistics.median(descriptors[-tenth:])),
        sum(user.errors for user in users),
    )  # fmt: skip


class _User(threading.Thread):
    """Does one thing again and again until stopped."""

    def __init__(self, daemon: DaemonProcess, work: Callable[[DaemonProcess], object]) -> None:
        super().__init__(daemon=True)
        self._daemon, self._work, self._stop_it, self.errors = daemon, work, threading.Event(), 0

    def run(self) -> None:
        while not self._stop_it.wait(0.2):
            try:
                self._work(self._daemon)
            except (OSError, ValueError) as error:
                self.errors += 1
                print(f"{getattr(self._work, '__name__', '')}: {error!r}", file=sys.stderr, flush=True)

    def stop(self) -> None:
        self._stop_it.set()
        self.join(30)


def _ask_scpi(daemon: DaemonProcess) -> None:
    value, _ = daemon.ask("READ?").split(",")
    if not 0.5 < float(value) < 1.5:
        raise ValueError(value)
    if not daemon.ask("*CLS\nNONSENSE\nSYST:ERR?").startswith("-113"):
        raise ValueError("the error queue")


def _ask_http(daemon: DaemonProcess) -> None:
    import urllib.request

    if len(daemon.get("/readings?limit=5")) != 5:
        raise ValueError("history")
    daemon.post("/settings", {"gain_db": 0})
    for path in ("/frame.png?width=160", "/metrics", "/readings?format=csv&limit=200"):
        with urllib.request.urlopen(daemon.url + path, timeout=20) as reply:
            reply.read()


def _watch_stream(daemon: DaemonProcess) -> None:
    import urllib.request

    with urllib.request.urlopen(daemon.url + "/readings/stream", timeout=20) as reply:
        for _ in range(20):
            reply.readline()


def sample(daemon: DaemonProcess, seconds: float, sample_s: float) -> tuple[list[float], list[float], list[int]]:
    """Return times in s, memory in MB and open descriptors over a time."""
    times_s, megabytes, descriptors = list[float](), list[float](), list[int]()
    begun = time.monotonic()
    while (elapsed_s := time.monotonic() - begun) < seconds:
        times_s.append(elapsed_s)
        megabytes.append(daemon.resident_bytes() / 1e6)
        descriptors.append(daemon.descriptors())
        time.sleep(sample_s)
    return times_s, megabytes, descriptors


def slope(times_s: list[float], megabytes: list[float]) -> tuple[float, float]:
    """Return slope and its standard uncertainty in MB/s from the means of ten blocks (neighbours are correlated)."""
    size = max(1, len(times_s) // 10)
    blocks = [slice(i, i + size) for i in range(0, size * 10, size)]
    x = [statistics.fmean(times_s[b]) for b in blocks if times_s[b]]
    y = [statistics.fmean(megabytes[b]) for b in blocks if megabytes[b]]
    fit = statistics.linear_regression(x, y)
    spread = sum((v - fit.slope * u - fit.intercept) ** 2 for u, v in zip(x, y, strict=True)) / max(1, len(x) - 2)
    centre = statistics.fmean(x)
    return fit.slope, (spread / sum((u - centre) ** 2 for u in x)) ** 0.5


def main() -> None:
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else SECONDS
    result = run(seconds, warm_up_s=min(300.0, seconds / 4))
    body = (
        "Measuring 20 times a second, with SCPI and HTTP clients that come and go, a stream, pictures and history.\n\n"
        "| time after warm-up | readings | memory at first | at last | slope | file descriptors | errors |\n"
        "|---|---|---|---|---|---|---|\n"
        f"| {result.seconds:.0f} s | {result.readings} | {result.warm_mb:.1f} MB | {result.end_mb:.1f} MB |"
        f" {result.slope_mb_per_h:+.2f} ± {result.u_slope_mb_per_h:.2f} MB/h (k=1) |"
        f" {result.descriptors_first} → {result.descriptors_last} | {result.errors} |\n"
    )
    print(body)
    write_section("daemon-soak", "Daemon soak", "make soak", body)


if __name__ == "__main__":
    main()
