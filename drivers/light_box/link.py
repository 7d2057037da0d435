"""The light-box protocol: its lines, numbered requests, deadlines, bounded retries, events on the side, clocks."""

from __future__ import annotations

import contextlib
import math
import re
import secrets
import zlib
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Final, NoReturn

import numpy as np

from drivers.light_box.serial_line import Line, Received
from radiometer.devices.light_box import ClockEstimate
from radiometer.errors import DeviceError, DeviceLost, DeviceTimeout, MeasurementError, UnsafeStimulus

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


REPLY_TIMEOUT_S: Final = 0.1  # an answer takes 8 ms on the wire; USB adapters hold bytes back for up to 16 ms
ATTEMPTS: Final = 16  # 1.6 s: longer than any pause of a busy machine or a USB hub that comes back
EVENT_SLOTS: Final = 1024  # presses not yet taken; no person gives as many between two looks
DARK_SOON: Final = "its light may be on until it goes dark by itself, 1 s after it heard this program last; reopen it"
KEPT_BY_BOX: Final = 16  # events that the firmware holds for a host that asks again
TICK_S: Final = 4e-6  # the box stamps in steps of 4 µs
# A ceramic resonator, as on the Arduino Uno, is within 0.5 % of its frequency (Murata CSTCE, data sheet).
RATE_PRIOR: Final = 0.005
MOST_RATE: Final = 0.01  # what the account of the exposure adds for the box's times
# Three spans in a row must show a rate: a program or simulated box that waited for the processor shows it in one.
SPANS: Final = 3
SPAN_S: Final = 0.7  # delays of 7 ms are as much as MOST_RATE in it
WINDOW: Final = 512  # samples; older ones say nothing of the rate of the box's clock now
DELAY_SLACK_S: Final = 0.0005  # samples whose free delay exceeds the least by more are left out


@dataclass(frozen=True, slots=True)
class ClockSample:
    """One exchange: sent and received on the host's clock, received and answered on the box's, in s."""

    sent_s: float  # host time before the request left
    box_received_s: float  # box time of the request's last byte
    box_answered_s: float  # box time at which the answer was made
    received_s: float  # host time of the answer's last byte
    request_wire_s: float = 0.0  # time that the request's bytes take on the wire
    answer_wire_s: float = 0.0  # time that the answer's bytes take

    @property
    def free_delay_s(self) -> float:
        """Return the part of the round trip that neither the box's work nor the wire explains, in s."""
        away_s = (self.received_s - self.sent_s) - (self.box_answered_s - self.box_received_s)
        free_s = away_s - self.request_wire_s - self.answer_wire_s
        return free_s if free_s >= 0 else away_s  # a line without wire time: USB or a pseudo-terminal

    @property
    def offset_s(self) -> float:
        """Return host time minus box time in s, taking the free delay as equal both ways."""
        away_s = (self.received_s - self.sent_s) - (self.box_answered_s - self.box_received_s)
        wire_s = self.request_wire_s if away_s >= self.request_wire_s + self.answer_wire_s else 0.0
        return self.sent_s + wire_s + self.free_delay_s / 2 - self.box_received_s


@dataclass(slots=True)
class BoxClock:
    """Host time of the box's stamps: a straight line through the exchanges with the least delay.

    The free delay may be on either way, so that an offset is known to ± half of the least delay (rectangular,
    standard uncertainty the half width by √3; GUM 4.3.7); scatter and rate add the rest.
    """

    samples: deque[ClockSample] = field(default_factory=lambda: deque(maxlen=WINDOW))

    def add(self, sample: ClockSample) -> None:
        """Take one more exchange into account."""
        self.samples.append(sample)

    def estimate(self) -> ClockEstimate:
        """Return offset and drift at the latest sample. Raises MeasurementError where there is no sample."""
        latest_s = self._latest().box_received_s
        offset_s, u_offset_s, rate, u_rate = self._fit(latest_s)
        return ClockEstimate(offset_s, -1e6 * rate, 1e6 * u_rate, u_offset_s, len(self.samples))

    def host_time_s(self, box_time_s: float) -> tuple[float, float]:
        """Return the host time of a box time and its standard uncertainty, in s.

        Raises:
            MeasurementError: If no exchange has succeeded yet.
        """
        offset_s, u_offset_s, _, _ = self._fit(box_time_s)
        return box_time_s + offset_s, u_offset_s

    def least_rate(self) -> float:
        """Return by how much the clocks' rates differ at least in each of the latest spans, wherever delays were.

        It is 0 where they run alike, or too little time has passed.
        """
        later, rates = self._latest(), list[float]()
        for sample in reversed(self.samples):
            if later.sent_s - sample.sent_s >= SPAN_S:
                moved_s = later.offset_s - sample.offset_s
                least_s = abs(moved_s) - (later.free_delay_s + sample.free_delay_s) / 2.0
                passed_s = later.box_received_s - sample.box_received_s
                if passed_s <= 0.0:
                    return math.inf  # a clock that stands
                rates.append(math.copysign(max(least_s, 0.0), moved_s) / passed_s)
                later = sample
                if len(rates) == SPANS:
                    return max(0.0, min(rates), -max(rates))
        return 0.0

    def most_rate(self) -> float:
        """Return by how much the clocks' rates differ at most, wherever delays were; inf before a second exchange."""
        samples = list(self.samples)
        return min((_most_rate(samples[0], later) for later in samples[1:]), default=math.inf)

    def _latest(self) -> ClockSample:
        if not self.samples:
            raise MeasurementError("the box's clock has not been compared with the host's yet; call synchronise()")
        return self.samples[-1]

    def _fit(self, box_time_s: float) -> tuple[float, float, float, float]:
        """Return offset at a box time, its uncertainty, rate of the offset (s per s), its uncertainty."""
        self._latest()
        least_s = min(sample.free_delay_s for sample in self.samples)
        good = [sample for sample in self.samples if sample.free_delay_s <= least_s + DELAY_SLACK_S]
        times_s = np.array([sample.box_received_s for sample in good])
        offsets_s = np.array([sample.offset_s for sample in good])
        mean_time_s, mean_offset_s = float(times_s.mean()), float(offsets_s.mean())
        # Each offset scatters by the slack left in its delay; TICK_S by its rounding.
        sigma_s = math.hypot((least_s + DELAY_SLACK_S) / 2 / math.sqrt(3), TICK_S)
        # A rate of 0 ± RATE_PRIOR joins the fit as one more observation.
        spread = float(((times_s - mean_time_s) ** 2).sum()) / sigma_s**2
        information = spread + 1 / RATE_PRIOR**2
        rate = float((times_s - mean_time_s) @ (offsets_s - mean_offset_s)) / sigma_s**2 / information
        u_rate = 1 / math.sqrt(information)
        away_s = box_time_s - mean_time_s
        u_asymmetry_s = least_s / 2 / math.sqrt(3)
        u_offset_s = math.sqrt(u_asymmetry_s**2 + sigma_s**2 / len(good) + (u_rate * away_s) ** 2 + TICK_S**2 / 12)
        return mean_offset_s + rate * away_s, u_offset_s, rate, u_rate


def _most_rate(first: ClockSample, later: ClockSample) -> float:
    passed_s = later.box_received_s - first.box_received_s
    moved_s = abs(later.offset_s - first.offset_s) + (later.free_delay_s + first.free_delay_s) / 2.0
    return moved_s / passed_s if passed_s > 0.0 else math.inf


@dataclass(slots=True)
class EventInbox:
    """Releases events in the order of their numbers, which wrap at 256."""

    expected: int | None = None  # number of the next event to release; None before the first synchronisation
    lost: int = 0  # events that could not be had any more
    _waiting: dict[int, Event] = field(default_factory=dict)

    def start_after(self, number: int) -> None:
        """Forget everything; the next event is the one after `number`."""
        self.expected = (number + 1) % 256
        self._waiting.clear()

    def put(self, event: Event) -> None:
        """Take an event in; one that was released before is left out."""
        if self.expected is not None and (event.number - self.expected) % 256 < 128:
            self._waiting[event.number] = event

    def missing(self, latest: int) -> list[int]:
        """Return the numbers up to `latest` that have not come, oldest first; gives up what the box has dropped."""
        if self.expected is None:
            return []
        ahead = (latest - self.expected + 1) % 256
        if ahead >= 128:  # `latest` is before what was released: an old answer
            return []
        numbers = [(self.expected + step) % 256 for step in range(ahead)]
        for number in numbers[: max(ahead - KEPT_BY_BOX, 0)]:
            if number not in self._waiting:
                self.skip(number)
        return [number for number in numbers if number not in self._waiting]

    def skip(self, number: int) -> None:
        """Give up an event that the box no longer keeps."""
        self._waiting.setdefault(number, Event(number, "--", "-", 0.0))
        self.lost += 1

    def release(self) -> list[Event]:
        """Return the events that have come without a gap, in order."""
        released = []
        while self.expected is not None and self.expected in self._waiting:
            event = self._waiting.pop(self.expected)
            self.expected = (self.expected + 1) % 256
            if event.kind != "--":
                released.append(event)
        return released


class BoxRefusal(DeviceError):
    """The box refused a request; `code` is the protocol's error number."""

    def __init__(self, port: str, words: str, code: int) -> None:
        self.code = code
        reason = ERROR_TEXTS.get(code, f"its error {code} is unknown to this program")
        super().__init__(f"light box on {port} refused {words!r}: {reason}")


@dataclass(slots=True)
class BoxLink:
    """Sends requests until they are answered, and keeps what the box says by itself.

    A request is repeated with the same number; the box answers a repetition without doing it again.
    """

    line: Line  # the serial line, owned by this link
    byte_time_s: float = 10 / 115200  # time that one byte takes on the wire in s
    clock: BoxClock = field(default_factory=BoxClock)  # collects the comparisons of the clocks
    inbox: EventInbox = field(default_factory=EventInbox)  # puts events in order
    retries: int = 0  # requests that were sent again since opening
    damaged_lines: int = 0  # lines that held nothing undamaged since opening
    _sequence: int = field(default_factory=lambda: secrets.randbelow(256))
    _events: deque[Event] = field(default_factory=lambda: deque(maxlen=EVENT_SLOTS))
    _fault: str | None = None
    _turned_off: bool = False

    def request(self, words: str, attempts: int = ATTEMPTS) -> tuple[str, ...]:
        """Return the fields of the answer to a request.

        Args:
            attempts: How often to send it at most.

        Raises:
            DeviceTimeout: If no undamaged answer came.
            DeviceLost: If the port has gone or the box has restarted or gone dark by itself.
            UnsafeStimulus: If the box refused for its own energy limit.
            BoxRefusal: If the box refused for another reason.
        """
        self._refuse_faulty()
        self._sequence = (self._sequence + 1) % 256
        return self._exchange(words, self._sequence, attempts)[0]

    def compare_clocks(self) -> None:
        """Add one comparison of the clocks and fetch the events that were lost. Raises as `request`."""
        self._refuse_faulty()
        for _ in range(ATTEMPTS):  # each try has a separate number: a repeated answer would carry old times
            self._sequence = (self._sequence + 1) % 256
            try:
                fields, sent_s, received, request_bytes = self._exchange("TM", self._sequence, attempts=1)
            except DeviceTimeout:
                continue
            self._take_times(fields, sent_s, received, request_bytes)
            return
        self.give_up(f"light box on {self.line.name} does not report its time; {DARK_SOON}")

    def listen(self, timeout_s: float) -> None:
        """Take in what comes by itself for `timeout_s`. Raises DeviceLost."""
        deadline_s = self.line.now() + timeout_s
        while True:
            with self._noting_loss():
                received = self.line.read_line(max(deadline_s - self.line.now(), 0.0))
            if received is not None:
                self._take_aside(parse_line(received.text))
            elif self.line.now() >= deadline_s:
                return

    def take_events(self) -> list[Event]:
        """Return the button events that have come since the last call, in order."""
        self._sort_events()
        events = list(self._events)
        self._events.clear()
        return events

    def take_turned_off(self) -> bool:
        """Return whether the button, held for 3 s, has turned every light off since the last call."""
        turned_off, self._turned_off = self._turned_off, False
        return turned_off

    @property
    def fault(self) -> str | None:
        """Return why nothing can be asked any more until the box is opened again; None where it can."""
        return self._fault

    def give_up(self, message: str) -> NoReturn:
        """Take no request any more until the box is opened again. Raises DeviceLost."""
        self._fault = message
        raise DeviceLost(message)

    def ask_for_darkness(self) -> None:
        """Ask for darkness without waiting for an answer: a box may hear what it cannot answer. Never raises."""
        self._sequence = (self._sequence + 1) % 256
        with contextlib.suppress(DeviceError):
            self.line.write(request_line(self._sequence, "OF *"))

    def reset(self) -> None:
        """Forget clocks, events and faults, before a new session."""
        self.clock.samples.clear()
        self.inbox = EventInbox()
        self._events.clear()
        self._fault = None

    def _exchange(self, words: str, sequence: int, attempts: int) -> tuple[tuple[str, ...], float, Received, int]:
        line = request_line(sequence, words)
        for attempt in range(attempts):
            self.retries += attempt > 0
            with self._noting_loss():
                sent_s = self.line.write(line)
                found = self._await_reply(sequence, sent_s + REPLY_TIMEOUT_S)
            if found is not None:
                reply, received = found
                if reply.error:
                    raise self._refusal(words, reply.error)
                return reply.fields, sent_s, received, len(line)
        raise self._timeout(words, attempts)

    @contextmanager
    def _noting_loss(self) -> Iterator[None]:
        try:
            yield
        except DeviceLost as lost:
            self._fault = str(lost)
            raise

    def _await_reply(self, sequence: int, deadline_s: float) -> tuple[Reply, Received] | None:
        while True:
            received = self.line.read_line(max(deadline_s - self.line.now(), 0.0))
            if received is None:
                if self.line.now() >= deadline_s:
                    return None
                continue
            found = parse_line(received.text)
            if isinstance(found, Reply) and found.sequence == sequence:
                return found, received
            if isinstance(found, Reply) and found.sequence is None:
                return None  # the box could not read what we sent: send it again now
            self._take_aside(found)

    def _take_aside(self, found: Reply | Event | None) -> None:
        if found is None:
            self.damaged_lines += 1
        elif isinstance(found, Event):
            if found.kind == "BO" and self.inbox.expected is not None:  # its numbers start again
                self._fault = self._restarted()
            self.inbox.put(found)
            self._sort_events()

    def _sort_events(self) -> None:
        for event in self.inbox.release():
            if event.kind == "BT":
                self._events.append(event)
            elif event.kind == "DK" and event.argument == "B":
                self._turned_off = True
            elif event.kind == "DK" and event.argument == "D":
                self._fault = (
                    f"light box on {self.line.name} has gone dark because this program was silent for 1 s; reopen it"
                )

    def _take_times(self, fields: tuple[str, ...], sent_s: float, received: Received, request_bytes: int) -> None:
        times = parse_times(fields)
        if times is None:
            self.give_up(f"light box on {self.line.name} answered TM with {' '.join(fields)!r}; flash its firmware")
        box_received_s, box_answered_s, latest_event = times
        if self.clock.samples and box_received_s < self.clock.samples[-1].box_received_s:
            self.give_up(self._restarted())
        answer_bytes = len(received.text) + 1
        self.clock.add(
            ClockSample(
                sent_s,
                box_received_s,
                box_answered_s,
                received.time_s,
                request_bytes * self.byte_time_s,
                answer_bytes * self.byte_time_s,
            )
        )
        if (off := self.clock.least_rate()) > MOST_RATE:
            self.ask_for_darkness()
            self.give_up(
                f"the clock of the light box on {self.line.name} is off by {100 * off:.2g} % or more, so its light"
                f" lasts longer or shorter than asked; replace its resonator, or flash its firmware; {DARK_SOON}"
            )
        self._fetch_lost_events(latest_event)

    def _fetch_lost_events(self, latest: int) -> None:
        if self.inbox.expected is None:
            self.inbox.start_after(latest)
        for number in self.inbox.missing(latest):
            try:
                fields = self.request(f"EV {number:02X}")
            except BoxRefusal:
                self.inbox.skip(number)
                continue
            event = parse_event_fields(number, fields)
            if event is not None:
                self.inbox.put(event)
        self._sort_events()
        self._refuse_faulty()

    def _refusal(self, words: str, code: int) -> DeviceError:
        refusal = BoxRefusal(self.line.name, words, code)
        if code == 6:
            return UnsafeStimulus(str(refusal))
        if code == 7:
            self._fault = f"{refusal}"
            return DeviceLost(str(refusal))
        return refusal

    def _timeout(self, words: str, attempts: int) -> DeviceTimeout:
        message = f"light box on {self.line.name} did not answer {words!r} within {attempts * REPLY_TIMEOUT_S:.1f} s"
        if attempts >= ATTEMPTS:
            self._fault = f"{message}; {DARK_SOON}"
            return DeviceTimeout(self._fault)
        return DeviceTimeout(message)

    def _refuse_faulty(self) -> None:
        if self._fault is not None:
            raise DeviceLost(self._fault)

    def _restarted(self) -> str:
        return f"light box on {self.line.name} has restarted; every channel is dark, reopen it"
