"""Takes camera, box, broker and disk away from the daemon again and again, each at moments of its own."""

from __future__ import annotations

import contextlib
import os
import random
import shutil
import socket
import sqlite3
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

DISK_MB = 256


@dataclass(slots=True)
class Fault:
    """Something that goes away and comes back.

    Attributes:
        name: What it is.
        take: Takes it away.
        give: Brings it back.
        longest_s: Longest absence in s.
        times: How often it went so far.
    """

    name: str
    take: Callable[[], None]
    give: Callable[[], None]
    longest_s: float
    times: int = 0


class Losses(threading.Thread):
    """Takes one thing away and brings it back, every `every_s` on average, until stopped."""

    def __init__(self, fault: Fault, every_s: float, seed: int) -> None:
        super().__init__(daemon=True, name=f"loss of {fault.name}")
        self.fault, self._every_s, self._rng, self._ended = fault, every_s, random.Random(seed), threading.Event()

    def run(self) -> None:
        while not self._ended.wait(self._every_s * self._rng.uniform(0.5, 1.5)):
            self.fault.take()
            self.fault.times += 1
            self._ended.wait(self._rng.uniform(1.0, self.fault.longest_s))
            self.fault.give()

    def stop(self) -> None:
        """End with the thing there."""
        self._ended.set()
        self.join(60)


class Broker:
    """Debian's mosquitto on a port of its own; killed, all that it retained is gone."""

    def __init__(self, folder: Path) -> None:
        self._program = shutil.which("mosquitto") or "/usr/sbin/mosquitto"
        with socket.create_server(("127.0.0.1", 0)) as free:
            self.port = int(free.getsockname()[1])
        self._settings = folder / "mosquitto.conf"
        self._settings.write_text(f"listener {self.port} 127.0.0.1\nallow_anonymous true\npersistence false\n")
        self._process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        """Start it and return once it accepts."""
        self._process = subprocess.Popen(
            [self._program, "-c", str(self._settings)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        give_up = time.monotonic() + 20
        while time.monotonic() < give_up:
            with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", self.port), timeout=1):
                return
            time.sleep(0.05)
        raise RuntimeError("mosquitto did not come up")

    def kill(self) -> None:
        """Kill it."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            self._process = None


@contextlib.contextmanager
def small_disk(folder: Path) -> Iterator[tuple[Path, bool]]:
    """Give a folder on a disk that can be filled, and whether it is one of its own (root only; else not)."""
    disk = folder / "disk"
    disk.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", f"size={DISK_MB}m", "tmpfs", str(disk)]
    own = os.geteuid() == 0 and subprocess.run(mount, capture_output=True, check=False).returncode == 0
    try:
        yield disk, own
    finally:
        if own:
            subprocess.run(["umount", "-l", str(disk)], check=False)


class FullDisk:
    """Fills the disk that the journal lies on; where it is not one of its own, locks the journal instead."""

    def __init__(self, disk: Path, *, own: bool) -> None:
        self._ballast, self._own, self._journal = disk / "ballast", own, disk / "journal.sqlite"
        self._lock: sqlite3.Connection | None = None

    def take(self) -> None:
        """Leave no byte free, not even those that the journal's log has had and may write again."""
        if not self._own:
            self._lock = sqlite3.connect(self._journal, timeout=10.0, isolation_level=None, check_same_thread=False)
            self._lock.execute("BEGIN EXCLUSIVE")
            return
        with (
            contextlib.suppress(sqlite3.Error),
            contextlib.closing(sqlite3.connect(self._journal, timeout=10.0)) as connection,
        ):
            connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        with contextlib.suppress(OSError), self._ballast.open("wb", buffering=0) as ballast:
            for size in (2**20, 4096):
                with contextlib.suppress(OSError):
                    while ballast.write(b"\0" * size):
                        pass

    def give(self) -> None:
        """Free it again."""
        if self._lock is not None:
            self._lock.execute("ROLLBACK")
            self._lock.close()
            self._lock = None
        self._ballast.unlink(missing_ok=True)
