"""Starts the daemon again and again, and takes the time until it listens and until a client gets its first reading."""

from __future__ import annotations

import statistics
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

from benchmarks._sections import write_section
from testing.daemon_process import ROOT, DaemonProcess, machine_note

STARTS = 10
FULL = ROOT / "configs" / "bench-simulated.yaml"


@dataclass(frozen=True, slots=True)
class StartResult:
    """Times in s from the start of the process, one per start."""

    listening_s: list[float]
    reading_s: list[float]


def run(starts: int) -> StartResult:
    """Start the daemon on the shipped bench, its camera at full size, with a new journal each time."""
    listening, reading = list[float](), list[float]()
    for _ in range(starts):
        with tempfile.TemporaryDirectory() as folder:
            daemon = DaemonProcess(Path(folder), "--every", "1", bench=FULL)
            begun = time.monotonic()
            with daemon:
                listening.append(time.monotonic() - begun)
                daemon.wait_for_reading()
                reading.append(time.monotonic() - begun)
    return StartResult(listening, reading)


def main() -> None:
    note = machine_note()
    result = run(STARTS)
    rows = [
        f"| {what} | {statistics.median(times):.2f} s | {max(times):.2f} s |\n"
        for what, times in (("it listens", result.listening_s), ("a client has its first reading", result.reading_s))
    ]
    body = note + (
        f"`radiometer serve` on the shipped bench (1616 × 1240 pixels), started {STARTS} times as a separate"
        " process.\n\n| from the start until | median | longest |\n|---|---|---|\n" + "".join(rows)
    )
    print(body, result)
    write_section("daemon-start", "Start of the daemon", "python -m benchmarks daemon_start", body)


if __name__ == "__main__":
    main()
