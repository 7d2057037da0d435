"""Kills the daemon at random moments while it measures, and checks its journal after each restart."""

from __future__ import annotations

import http.client
import json
import random
import sqlite3
import tempfile
import threading
import time
from dataclasses import dataclass
from pathlib import Path

from benchmarks._sections import write_section
from testing.daemon_process import DaemonProcess

KILLS = 50


@dataclass(frozen=True, slots=True)
class KillResult:
    kills: int
    readings: int
    seen: int
    holes: int
    duplicates: int
    missing: int
    restart_s: float


def run(kills: int, seed: int = 1) -> KillResult:
    """Kill `kills` times; count holes, duplicates, and readings that a client saw but the journal lacks."""
    rng = random.Random(seed)
    seen: dict[int, str] = {}
    repeated = 0
    slowest_s = 0.0
    with tempfile.TemporaryDirectory() as folder:
        daemon = DaemonProcess(Path(folder), "--every", "0")
        for _ in range(kills):
            begun = time.monotonic()
            daemon.start()
            slowest_s = max(slowest_s, time.monotonic() - begun)
            listener = _Listener(daemon.http_port)
            listener.start()
            time.sleep(rng.uniform(0.05, 1.2))
            daemon.kill()
            listener.join(5)
            repeated += len(seen.keys() & listener.lines.keys())
            seen |= listener.lines
        with daemon:
            daemon.wait_for_reading()
        numbers, stored = _journal(daemon.journal)
    return KillResult(
        kills,
        len(numbers),
        len(seen),
        holes=numbers[-1] - len(set(numbers)),
        duplicates=len(numbers) - len(set(numbers)) + repeated,
        missing=sum(stored.get(sequence) != line for sequence, line in seen.items()),
        restart_s=slowest_s,
    )


class _Listener(threading.Thread):
    """Collects every reading that a client sees until the connection breaks."""

    def __init__(self, port: int) -> None:
        super().__init__(daemon=True)
        self._connection = http.client.HTTPConnection("127.0.0.1", port, timeout=20)
        self.lines: dict[int, str] = {}

    def run(self) -> None:
        try:
            self._connection.request("GET", "/readings/stream")
            reply = self._connection.getresponse()
            while line := reply.readline():
                if line.startswith(b"data: ") and line.endswith(b"}\n") and b'"sequence"' in line:
                    self._take(line[6:].decode().rstrip("\n"))
        except (OSError, http.client.HTTPException):
            pass
        finally:
            self._connection.close()

    def _take(self, line: str) -> None:
        reading = json.loads(line)
        if "radiance" in reading:
            self.lines[reading["sequence"]] = line


def _journal(path: Path) -> tuple[list[int], dict[int, str]]:
    connection = sqlite3.connect(path)
    rows = connection.execute("SELECT sequence, json FROM readings ORDER BY sequence").fetchall()
    assert connection.execute("PRAGMA integrity_check").fetchone() == ("ok",)
    connection.close()
    return [sequence for sequence, _ in rows], dict(rows)


def main() -> None:
    result = run(KILLS)
    body = (
        "| kill −9 at random moments | readings in the journal | seen by a client | holes | duplicates |"
        " seen but missing | slowest restart |\n|---|---|---|---|---|---|---|\n"
        f"| {result.kills} | {result.readings} | {result.seen} | {result.holes} | {result.duplicates} |"
        f" {result.missing} | {result.restart_s:.1f} s |\n"
    )
    print(body)
    write_section("daemon-kill", "Daemon killed while measuring", "python -m benchmarks daemon_kill", body)


if __name__ == "__main__":
    main()
