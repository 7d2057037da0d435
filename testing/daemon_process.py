"""A daemon in a process of its own, on free loopback ports, with a small simulated camera."""

from __future__ import annotations

import json
import os
import re
import signal
import socket
import subprocess
import sys
import threading
import time
import urllib.request
from pathlib import Path
from typing import Any

from testing.patience import within

ROOT = Path(__file__).resolve().parents[1]
_SMALL_BENCH = """\
format: radiometer-bench/1
name: small bench
camera: {kind: simulated, preset: BFS-U3-19S4M, serial: "22500001", seed: 1, width: 160, height: 120}
lens: {focal_length_mm: 16, f_number: 4, transmittance: 0.95, transmittance_u_rel: 0.01, vignetting: cos4}
source: {kind: screen, wavelength_nm: 550}
scene:
  kind: screen
  peak_radiance_W_per_sr_m2: 1.5
  background: 0.05
  patches:
    - {name: bright, x: 10, y: 10, width: 60, height: 100, drive: 0.8}
    - {name: dim, x: 90, y: 10, width: 60, height: 100, drive: 0.4}
calibration: calibrations/simulated.yaml
patch: {x: 20, y: 30, width: 20, height: 20}
"""


def write_small_bench(folder: Path, **camera: Any) -> Path:
    """Write the bench file of a camera of 160 × 120 pixels that looks at two patches."""
    path = folder / "bench.yaml"
    text = _SMALL_BENCH
    for key, value in camera.items():
        text = re.sub(rf'{key}: "?[\w.-]+"?', f"{key}: {json.dumps(value)}", text)
    path.write_text(text, encoding="utf-8")
    return path


def machine_note() -> str:
    """Return a sentence on what else the machine was doing: times are to be read with it."""
    return f"Load average of the machine at the start: {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores.\n\n"


class DaemonProcess:
    """`radiometer serve`, started and ended as a service manager would."""

    def __init__(self, folder: Path, *arguments: str, bench: Path | None = None) -> None:
        self.journal = folder / "journal.sqlite"
        self._command = [
            sys.executable, "-m", "radiometer", "serve", "--journal", str(self.journal), "--scpi-port", "0",
            "--http-port", "0", "--bench", str(bench or write_small_bench(folder)), *arguments,
        ]  # fmt: skip
        self.lines: list[str] = []
        self.scpi_port = self.http_port = 0
        self.process: subprocess.Popen[str] | None = None

    def start(self, deadline_s: float = 60.0) -> DaemonProcess:
        """Start it and return once it listens."""
        self.lines.clear()
        self.process = subprocess.Popen(self._command, cwd=ROOT, stderr=subprocess.PIPE, text=True)
        ready = threading.Event()
        threading.Thread(target=self._read, args=(self.process, ready), daemon=True).start()
        if not ready.wait(within(deadline_s)):
            raise RuntimeError("the daemon did not come up:\n" + "\n".join(self.lines))
        if self.process.poll() is not None:
            raise RuntimeError("the daemon ended:\n" + "\n".join(self.lines))
        return self

    @property
    def pid(self) -> int:
        """Return its process id."""
        assert self.process is not None
        return self.process.pid

    @property
    def url(self) -> str:
        """Return the base address of its HTTP interface."""
        return f"http://127.0.0.1:{self.http_port}"

    def kill(self) -> None:
        """Kill it without warning."""
        assert self.process is not None
        self.process.kill()
        self.process.wait()

    def stop(self, number: int = signal.SIGTERM, deadline_s: float = 20.0) -> int:
        """End it with a signal and return its exit code."""
        assert self.process is not None
        if self.process.poll() is None:
            self.process.send_signal(number)
        try:
            return self.process.wait(within(deadline_s))
        except subprocess.TimeoutExpired:
            self.process.kill()
            raise

    def __enter__(self) -> DaemonProcess:
        return self.start()

    def __exit__(self, *error: object) -> None:
        if self.process is not None and self.process.poll() is None:
            self.stop()

    def get(self, path: str) -> Any:
        """Return the JSON of a path."""
        with urllib.request.urlopen(self.url + path, timeout=within(20)) as reply:
            return json.load(reply)

    def post(self, path: str, body: dict[str, Any]) -> Any:
        """Post JSON and return the JSON reply."""
        request = urllib.request.Request(
            self.url + path, json.dumps(body).encode(), {"Content-Type": "application/json"}
        )
        with urllib.request.urlopen(request, timeout=within(60)) as reply:
            return json.load(reply)

    def ask(self, message: str) -> str:
        """Return the reply to one SCPI message over a connection of its own."""
        with socket.create_connection(("127.0.0.1", self.scpi_port), timeout=within(20)) as line:
            line.sendall(message.encode() + b"\n")
            return line.makefile("rb").readline().decode().rstrip("\n")

    def wait_for_reading(self, deadline_s: float = 30.0) -> None:
        """Return once a reading can be had."""
        give_up = time.monotonic() + within(deadline_s)
        while not self.get("/readings?limit=1"):
            if time.monotonic() > give_up:
                raise RuntimeError("no reading:\n" + "\n".join(self.lines))
            time.sleep(0.05)

    def resident_bytes(self) -> int:
        """Return the memory it occupies."""
        fields = Path(f"/proc/{self.pid}/statm").read_text(encoding="ascii").split()
        return int(fields[1]) * 4096

    def descriptors(self) -> int:
        """Return how many files and sockets it holds open."""
        return len(list(Path(f"/proc/{self.pid}/fd").iterdir()))

    def _read(self, process: subprocess.Popen[str], ready: threading.Event) -> None:
        assert process.stderr is not None
        for line in process.stderr:
            self.lines.append(line.rstrip())
            del self.lines[:-200]
            if found := re.match(r"SCPI on 127\.0\.0\.1:(\d+)", line):
                self.scpi_port = int(found[1])
            elif found := re.match(r"HTTP on http://127\.0\.0\.1:(\d+)", line):
                self.http_port = int(found[1])
            elif line.startswith("journal "):
                ready.set()
        process.stderr.close()
        ready.set()
