"""A serial line to a simulated light box in simulated time: hours pass in seconds, whatever the machine does."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import NamedTuple

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
