"""Throws random and mutated SCPI lines and HTTP requests at the daemon, and drives it through random sequences."""

from __future__ import annotations

import logging
import random
import socket
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import structlog
from hypothesis.stateful import run_state_machine_as_test

from benchmarks._sections import write_section
from radiometer.daemon.scpi.commands import command_table
from testing.daemon_process import DaemonProcess
from testing.scpi_machine import ScpiMachine, machine_settings

SEQUENCES = 1000
LINES = 600_000
_LOOKS = 13  # at the memory, evenly from beginning to end
_BATCH = 50
_ALPHABET = b"*:;,?#'\"()@ \t\r\x00\x7f\xff0123456789eE+-.ABCDSENSRADLUMIEXPimgTRAC"
_REQUESTS = (
    b"GET /readings?limit=1 HTTP/1.1\r\nHost: localhost\r\n\r\n",
    b"GET /frame.png?width=64 HTTP/1.1\r\nHost: localhost\r\n\r\n",
    b"POST /settings HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\nContent-Length: 15\r\n\r\n"
    b'{"gain_db": 1} ',
    b"GET /readings/stream?after=-1 HTTP/1.1\r\nHost: localhost\r\nLast-Event-ID: 99999999999999999999\r\n\r\n",
    b"POST /measure HTTP/1.1\r\nHost: localhost\r\nTransfer-Encoding: chunked\r\n\r\n2\r\n{}\r\n0\r\n\r\n",
    b"GET /status HTTP/1.1\r\nHost: localhost\r\nUpgrade: websocket\r\nConnection: upgrade\r\n\r\n",
)


@dataclass(frozen=True, slots=True)
class FuzzResult:
    scpi_lines: int
    http_requests: int
    seconds: float
    crashes: int
    unanswered: int
    unexpected: int
    memory_mb: list[float]


def run(lines: int, seed: int = 1) -> FuzzResult:
    """Send half of the lines to SCPI and half to HTTP, and see whether the daemon still answers after each batch."""
    rng = random.Random(seed)
    examples = [command.example.encode() for command in command_table().commands]
    begun, unanswered = time.monotonic(), 0
    with (
        tempfile.TemporaryDirectory() as folder,
        DaemonProcess(Path(folder), "--every", "0.2", "--http-rate", "100000") as daemon,
    ):
        daemon.wait_for_reading()
        for _ in range(40):  # memory of a daemon that has been used, before anything hostile
            daemon.ask("READ?")
            daemon.get("/status")
        memory_mb, pid = [daemon.resident_bytes() / 1e6], daemon.pid
        for position in range(0, lines // 2, _BATCH):
            if position >= len(memory_mb) * lines // 2 // (_LOOKS - 1):
                memory_mb.append(daemon.resident_bytes() / 1e6)
            _throw(daemon.scpi_port, b"".join(_line(rng, examples) + b"\n" for _ in range(_BATCH)))
            for _ in range(_BATCH):
                _throw(daemon.http_port, _mutated(rng, rng.choice(_REQUESTS)))
            if position % (10 * _BATCH) == 0:
                unanswered += not _answers(daemon)
        unanswered += not _answers(daemon)
        crashes = int(daemon.process is None or daemon.process.poll() is not None or daemon.pid != pid)
        memory_mb.append(daemon.resident_bytes() / 1e6)
        unexpected = sum("unexpected error" in line for line in daemon.lines)
    return FuzzResult(
        lines // 2,
        lines // 2,
        time.monotonic() - begun,
        crashes,
        unanswered,
        unexpected,
        memory_mb,
    )


def _line(rng: random.Random, examples: list[bytes]) -> bytes:
    kinds: tuple[Callable[[], bytes], ...] = (
        lambda: bytes(rng.choices(_ALPHABET, k=rng.randrange(80))),
        lambda: rng.randbytes(rng.randrange(60)),
        lambda: _mutated(rng, rng.choice(examples)),
        lambda: b";".join(rng.choices(examples, k=rng.randrange(1, 6))),
        lambda: (
            rng.choice(examples).split(b"?")[0] + b" " + rng.choice((b"1e999", b"-1", b"NAN", b"#9999999999", b"MAX"))
        ),
        lambda: b"X" * rng.choice((10, 4096, 5000)),
    )
    weights = (4, 3, 8, 2, 3, 1)
    return rng.choices(kinds, weights)[0]()


def _mutated(rng: random.Random, message: bytes) -> bytes:
    content = bytearray(message)
    for _ in range(rng.randrange(1, 6)):
        position = rng.randrange(len(content) + 1)
        match rng.randrange(4):
            case 0:
                content[position:position] = rng.randbytes(rng.randrange(1, 4))
            case 1:
                del content[position : position + rng.randrange(1, 6)]
            case 2 if content:
                content[position % len(content)] = rng.randrange(256)
            case _:
                content += content[position:][:200]
    return bytes(content)


def _throw(port: int, content: bytes) -> None:
    """Send bytes and hang up, sometimes before the reply is read."""
    try:
        with socket.create_connection(("127.0.0.1", port), timeout=5) as line:
            line.settimeout(0.02)
            line.sendall(content)
            line.recv(65536)
    except (TimeoutError, ConnectionError):
        pass


def _answers(daemon: DaemonProcess) -> bool:
    try:
        return daemon.ask("*CLS;*IDN?").startswith("FLIR") and "devices" in daemon.get("/status")
    except OSError:
        return False


def run_sequences(sequences: int) -> float:
    """Drive sessions through random sequences of 40 steps with failing devices and return the seconds it took.

    Raises:
        AssertionError: With the steps that led there, if one of them ends the daemon or leaves a value out of range.
    """
    begun, before = time.monotonic(), structlog.get_config()
    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(logging.CRITICAL))
    try:
        run_state_machine_as_test(ScpiMachine, settings=machine_settings(sequences, derandomize=False))
    finally:
        structlog.configure(**before)
    return time.monotonic() - begun


def main() -> None:
    sequences_s = run_sequences(SEQUENCES)
    result = run(LINES)
    memory = ", ".join(f"{value:.0f}" for value in result.memory_mb)
    body = (
        "| SCPI lines | HTTP requests | time | crashes | probes unanswered | unexpected errors logged |"
        f" memory at {_LOOKS} even steps in MB |\n|---|---|---|---|---|---|---|\n"
        f"| {result.scpi_lines} | {result.http_requests} | {result.seconds:.0f} s | {result.crashes} |"
        f" {result.unanswered} | {result.unexpected} | {memory} |\n\n"
        f"{SEQUENCES} random sequences of 40 steps of all SCPI commands with failing camera and box: none ended it"
        f" ({sequences_s:.0f} s).\n"
    )
    print(body)
    write_section("daemon-fuzz", "Daemon fuzzed", "python -m benchmarks daemon_fuzz", body)


if __name__ == "__main__":
    main()
