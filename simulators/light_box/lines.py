"""Serial lines to something simulated: in simulated time, and as a pseudo-terminal that any program opens."""

from __future__ import annotations

import contextlib
import os
import re
import select
import threading
import time
import tty
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, NamedTuple, Protocol, Self

import numpy as np

from simulators.light_box.box import SimulatedLightBox


@dataclass(slots=True)
class LineFaults:
    """Corrupts, drops and invents bytes."""

    corrupt: float = 0.0  # probability that a byte becomes another one
    drop: float = 0.0  # probability that a byte is lost
    insert: float = 0.0  # probability that a byte is followed by an invented one
    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(0))  # source of chance
    touched: int = 0  # how many bytes were corrupted, dropped or invented

    def apply(self, sent: bytes) -> bytes:
        """Return what arrives of `sent`."""
        if not sent or self.corrupt == self.drop == self.insert == 0.0:
            return sent
        arrived = np.frombuffer(sent, dtype=np.uint8).copy()
        chance = self.rng.random((3, arrived.size))
        wrong = chance[0] < self.corrupt
        arrived[wrong] ^= self.rng.integers(1, 256, int(wrong.sum()), dtype=np.uint8)
        lost, followed = chance[1] < self.drop, chance[2] < self.insert
        self.touched += int(wrong.sum() + lost.sum() + followed.sum())
        invented = self.rng.integers(0, 256, arrived.size, dtype=np.uint8)
        pairs = np.stack([arrived, invented], axis=1)
        return bytes(pairs[np.stack([~lost, followed], axis=1)].tobytes())


class Arrived(NamedTuple):
    """A line without its end and when its end arrived on the host's clock, in s."""

    text: bytes
    time_s: float


@dataclass(slots=True)
class VirtualLine:
    """Carries bytes between a host and a twin; `now` is true time and only moves while the host waits."""

    twin: SimulatedLightBox  # the box at the other end
    faults: LineFaults = field(default_factory=LineFaults)  # what happens to the bytes, both ways
    byte_time_s: float = 10 / 115200  # time that a byte takes on the wire
    latency_s: float = 0.0  # mean of the exponential delay that each message has besides, each way, in s
    least_latency_s: float = 0.0
    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(0))  # source of the delays
    name: str = "simulated line"
    _time_s: float = 0.0
    _outward: deque[tuple[float, bytes]] = field(default_factory=deque)
    _inward: deque[tuple[float, bytes]] = field(default_factory=deque)
    _buffer: bytes = b""

    def now(self) -> float:
        return self._time_s

    def open(self) -> None:
        self._inward.clear()
        self._buffer = b""

    def close(self) -> None:
        """Close the line."""

    def wait(self, duration_s: float) -> None:
        """Let time pass without the host doing anything."""
        self._carry(self._time_s + duration_s)
        self._time_s += duration_s

    def write(self, line: bytes) -> float:
        arrival_s = self._time_s + len(line) * self.byte_time_s + self._latency()
        earliest_s = self._outward[-1][0] if self._outward else 0.0
        self._outward.append((max(arrival_s, earliest_s), self.faults.apply(line)))
        return self._time_s

    def read_line(self, timeout_s: float) -> Arrived | None:
        deadline_s = self._time_s + timeout_s
        while True:
            line, end, rest = self._buffer.partition(b"\n")
            if end:
                self._buffer = rest
                return Arrived(line, self._time_s)
            self._carry_one(deadline_s)
            if not self._inward or self._inward[0][0] > deadline_s:
                self._time_s = deadline_s
                return None
            arrival_s, received = self._inward.popleft()
            self._time_s = max(self._time_s, arrival_s)
            self._buffer += received

    def _latency(self) -> float:
        return self.least_latency_s + (float(self.rng.exponential(self.latency_s)) if self.latency_s else 0.0)

    def _carry_one(self, deadline_s: float) -> None:
        """Let the box run until it has sent something or the deadline has come."""
        while not self._inward:
            next_s = self.twin.next_time_s()
            moments = [deadline_s]
            moments += [self._outward[0][0]] if self._outward else []
            # a tick later at least, for rounding may place the box's next millisecond a hair before the present
            moments += [max(next_s, self.twin.time_s + 4e-6)] if next_s is not None else []
            self._carry(min(moments))
            if min(moments) >= deadline_s:
                return

    def _carry(self, time_s: float) -> None:
        while self._outward and self._outward[0][0] <= time_s:
            arrival_s, sent = self._outward.popleft()
            self.twin.receive(sent, max(arrival_s, self.twin.time_s))
            self._collect()
        self.twin.advance(max(time_s, self.twin.time_s))
        self._collect()

    def _collect(self) -> None:
        while self.twin.emitted:
            left_s, line = self.twin.emitted.popleft()
            earliest_s = self._inward[-1][0] if self._inward else 0.0
            arrival_s = max(left_s, earliest_s) + len(line) * self.byte_time_s + self._latency()
            self._inward.append((arrival_s, self.faults.apply(line)))


IDLE_S: Final = 0.002  # short against the 5 ms of a line at 115 200 baud
LAG_S: Final = 0.5  # half of the box's dead-man time


def was_left_behind(link: Path) -> bool:
    """Return whether a name is the link of a server that was killed: into a process, and to nothing that is there."""
    if not link.is_symlink() or not re.fullmatch(r"/proc/\d+/fd/\d+", str(link.readlink())):
        return False
    try:
        link.stat()
    except FileNotFoundError:
        return True
    except OSError:  # another user's process
        return False
    return False


class SerialDevice(Protocol):
    """What can sit behind the pseudo-terminal: bytes in, time passes, bytes out."""

    def exchange(self, received: bytes, time_s: float) -> bytes:
        """Take bytes that the host sent, let time pass up to `time_s`, return the bytes sent meanwhile."""


@dataclass(slots=True)
class PtyServer:
    """Serves a simulated device on a pseudo-terminal, in real time, from a separate thread.

    A real device runs while this program waits for a processor, and hears its host meanwhile. This one stands still
    then, beyond `LAG_S`: else it would go dark for a silence that was none.
    """

    device: SerialDevice  # what sits behind it
    # Symbolic link kept on the pseudo-terminal, so that its name stays when it is plugged in again
    link: Path | None = None
    faults_in: LineFaults = field(default_factory=LineFaults)  # what happens to the bytes from the host
    faults_out: LineFaults = field(default_factory=LineFaults)  # what happens to the bytes to the host
    clock: Callable[[], float] = time.monotonic  # real time in s
    lock: threading.Lock = field(default_factory=threading.Lock)
    _started_s: float = 0.0
    _given_up_s: float = 0.0
    _latest_s: float = 0.0
    _master: int = -1
    _slave: int = -1
    _target: str = ""  # where the link leads
    _thread: threading.Thread | None = None
    _stopping: threading.Event = field(default_factory=threading.Event)

    @property
    def port(self) -> str:
        """Return the name under which the port is opened."""
        return str(self.link) if self.link is not None else os.ttyname(self._slave)

    def start(self) -> None:
        """Plug the device in."""
        self._started_s, self._given_up_s, self._latest_s = self.clock(), 0.0, 0.0
        self.plug()
        self._stopping.clear()
        self._thread = threading.Thread(target=self._serve, name="simulated serial device", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Unplug the device and end its thread; stopping twice does nothing."""
        self._stopping.set()
        if self._thread is not None:
            self._thread.join()
            self._thread = None
        self.unplug()

    def plug(self) -> None:
        """Make the pseudo-terminal; the slave side is held open so that a host may come and go."""
        with self.lock:
            self._master, self._slave = os.openpty()
            tty.setraw(self._slave)
            os.set_blocking(self._master, False)
            if self.link is not None:
                if was_left_behind(self.link):
                    self.link.unlink()
                # Through this process: if it is killed the link leads nowhere, and never to another program's terminal.
                self._target = f"/proc/{os.getpid()}/fd/{self._slave}"
                self.link.symlink_to(self._target)

    def unplug(self) -> None:
        """Take the pseudo-terminal away, as a pulled cable does; the device goes on running."""
        with self.lock:
            for handle in (self._master, self._slave):
                if handle >= 0:
                    os.close(handle)
            self._master = self._slave = -1
            if self.link is not None and self.link.is_symlink() and str(self.link.readlink()) == self._target:
                self.link.unlink()  # another box may have taken the name meanwhile

    def say(self, raw: bytes) -> None:
        """Send bytes to the host that the device never sent, as a boot loader or a loose contact does."""
        with self.lock:
            if self._master >= 0:
                self._send(raw)

    def time_s(self) -> float:
        """Return the device's time in s: real time since the start, less what this program was kept from running."""
        time_s = self.clock() - self._started_s - self._given_up_s
        stood_still_s = max(0.0, time_s - self._latest_s - LAG_S)
        self._given_up_s += stood_still_s
        self._latest_s = time_s - stood_still_s
        return self._latest_s

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def _serve(self) -> None:
        while not self._stopping.is_set():
            received = self._receive()
            with self.lock:
                answer = self.device.exchange(self.faults_in.apply(received), self.time_s())
                if answer and self._master >= 0:
                    self._send(self.faults_out.apply(answer))

    def _receive(self) -> bytes:
        with self.lock:
            master = self._master
        if master < 0:
            self._stopping.wait(IDLE_S)
            return b""
        try:
            ready, _, _ = select.select([master], [], [], IDLE_S)
            return os.read(master, 4096) if ready else b""
        except (OSError, ValueError):  # unplugged in between
            return b""

    def _send(self, answer: bytes) -> None:
        with contextlib.suppress(BlockingIOError):  # no reader: a real port drops bytes too
            os.write(self._master, answer)


@dataclass(slots=True)
class WiredLightBox:
    """A light-box twin on a wire of limited speed, as PtyServer serves it."""

    twin: SimulatedLightBox  # the box
    byte_time_s: float = 10 / 115200  # time that a byte takes on the wire, both ways
    _arriving: list[tuple[float, bytes]] = field(default_factory=list)
    _leaving: list[tuple[float, bytes]] = field(default_factory=list)

    def exchange(self, received: bytes, time_s: float) -> bytes:
        """Carry bytes both ways up to `time_s`, each message after the time its bytes take."""
        if received:
            start_s = max(self._arriving[-1][0] if self._arriving else 0.0, time_s)
            self._arriving.append((start_s + len(received) * self.byte_time_s, received))
        while self._arriving and self._arriving[0][0] <= time_s:
            arrival_s, part = self._arriving.pop(0)
            self.twin.receive(part, max(arrival_s, self.twin.time_s))
        self.twin.advance(max(time_s, self.twin.time_s))
        while self.twin.emitted:
            left_s, line = self.twin.emitted.popleft()
            start_s = max(self._leaving[-1][0] if self._leaving else 0.0, left_s)
            self._leaving.append((start_s + len(line) * self.byte_time_s, line))
        done = [line for when, line in self._leaving if when <= time_s]
        self._leaving = [(when, line) for when, line in self._leaving if when > time_s]
        return b"".join(done)
