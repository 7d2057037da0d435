"""The lines of the light-box protocol: written, read and checked. See docs/reference/light-box-protocol.md."""

from __future__ import annotations

import re
import zlib
from dataclasses import dataclass
from typing import Final

PROTOCOL_VERSIONS: Final = (2, 1)  # the newest first
_REPLY = re.compile(rb"=([0-9A-F]{2}|--) (OK|ER)((?: [!-)+-~]+)*)")
_EVENT = re.compile(rb"!([0-9A-F]{2}) ([A-Z]{2}) ([0-9A-Z]) ([0-9]{1,10}\.[0-9]{3})")
_TIMES = re.compile(r"([0-9]{1,10}\.[0-9]{3}) ([0-9]{1,10}\.[0-9]{3}) ([0-9A-F]{2})")

ERROR_TEXTS: Final = {
    1: "the line was damaged",
    2: "it does not know that command",
    3: "the arguments are not of the form it takes",
    4: "it has no such channel",
    5: "the level is above its limit for that channel",
    6: "the channel's energy budget does not allow it now; it refills in darkness within ten minutes",
    7: "it has gone dark and ended the session; open it again",
    8: "a ramp cannot change the current range; darken the channel first",
    9: "it speaks another version of the protocol; flash the firmware that came with this program",
    10: "it no longer keeps that event",
    11: "the channel that shares its output is lit; darken that first",
    12: "its button is held, which keeps every light off; let go of it",
}


@dataclass(frozen=True, slots=True)
class Reply:
    """An answer: to which request (None: to a line it could not read), and fields or an error code (0: done)."""

    sequence: int | None
    error: int
    fields: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Event:
    """Something that happened by itself: running number, type, argument, and box time in s."""

    number: int
    kind: str
    argument: str
    box_time_s: float


def request_line(sequence: int, words: str) -> bytes:
    """Return the bytes of a request.

    Args:
        sequence: 0 to 255.
    """
    body = f"#{sequence:02X} {words}".encode("ascii")
    return body + f"*{zlib.crc32(body):08X}\n".encode("ascii")


def parse_line(line: bytes) -> Reply | Event | None:
    """Return the reply or event that a line holds; None where it holds neither undamaged.

    Args:
        line: Bytes without the line end. What stands before the last "=" or "!" is left aside.
    """
    start = max(line.rfind(b"="), line.rfind(b"!"))
    body, star, checksum = line[max(start, 0) :].rstrip(b"\r").rpartition(b"*")
    if not star or checksum != f"{zlib.crc32(body):08X}".encode("ascii"):
        return None
    reply = _REPLY.fullmatch(body)
    if reply:
        return _reply(reply)
    event = _EVENT.fullmatch(body)
    return _event(event) if event else None


def parse_event_fields(number: int, fields: tuple[str, ...]) -> Event | None:
    """Return the event that an answer to EV holds; None where it holds none."""
    if len(fields) != 3:
        return None
    match = _EVENT.fullmatch(f"!{number:02X} {' '.join(fields)}".encode("ascii"))
    return _event(match) if match else None


def parse_times(fields: tuple[str, ...]) -> tuple[float, float, int] | None:
    """Return two box times in s and the latest event's number from an answer to TM; None where it holds none."""
    match = _TIMES.fullmatch(" ".join(fields))
    return (float(match[1]) / 1000.0, float(match[2]) / 1000.0, int(match[3], 16)) if match else None


def _reply(match: re.Match[bytes]) -> Reply | None:
    sequence = None if match[1] == b"--" else int(match[1], 16)
    fields = tuple(match[3].decode("ascii").split())
    if match[2] == b"OK":
        return Reply(sequence, 0, fields)
    if len(fields) != 1 or not fields[0].isdigit() or int(fields[0]) == 0:
        return None
    return Reply(sequence, int(fields[0]), ())


def _event(match: re.Match[bytes]) -> Event:
    number, kind, argument, time_ms = (part.decode("ascii") for part in match.groups())
    return Event(int(number, 16), kind, argument, float(time_ms) / 1000.0)
