"""Cameras served in processes of their own on loopback, for the benchmarks of the wire."""

from __future__ import annotations

import fcntl
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from drivers.cameras.camera_opening import answers

ROOT = Path(__file__).resolve().parents[1]
LOOPBACK = "127.0.0.1"
# One camera at a time per network: another network namespace has a port of its own.
NETWORK = Path("/proc/self/ns/net")
PORT_LOCK = (
    Path(tempfile.gettempdir()) / f"radiometer-gige-port-{NETWORK.stat().st_ino if NETWORK.exists() else 0}.lock"
)


def radiometer(*words: str) -> list[str]:
    return [sys.executable, "-m", "radiometer", *words]


@contextmanager
def only_camera() -> Iterator[None]:
    """Wait until no other camera is served on this computer, and keep it so to the end of the block."""
    with PORT_LOCK.open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield


@contextmanager
def served(command: list[str]) -> Iterator[subprocess.Popen[bytes]]:
    """Run a program that serves a camera, from its first answer to the end of the block."""
    with only_camera():
        yield from _served(command)


def _served(command: list[str]) -> Iterator[subprocess.Popen[bytes]]:
    process = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        end = time.monotonic() + 30
        while not answers(LOOPBACK, attempts=1, timeout_s=0.2):
            if time.monotonic() > end or process.poll() is not None:
                raise SystemExit(f"{' '.join(command)} did not come up")
        yield process
    finally:
        process.kill()
        process.wait()
