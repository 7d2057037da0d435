"""The light box's simulated twin: its protocol, its timers and its LEDs as a state machine in true time.

Written from docs/reference/light-box-protocol.md; shares no code with the driver or the firmware.
"""

from __future__ import annotations

import heapq
import math
import re
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Final, NamedTuple
from zlib import crc32

from simulators.light_box.channel import (
    AMBIENT_C,
    CHANNELS_OF_VERSION,
    PARTNERS,
    REFERENCE_CHANNELS,
    REFERENCE_LEDS,
    Channel,
    ChannelLimits,
    Emission,
    LedParameters,
    LedState,
    steps_of,
)

DEADMAN_MS: Final = 1000  # as the firmware
HELD_OFF_MS: Final = 3000  # as the firmware: a button held for 3 s darkens the box
LINE_SIZE: Final = 64  # as the firmware
TICK_MS: Final = 0.004  # timer 1 at 16 MHz / 64
BOOT_MS: Final = 0.008  # the clock starts two ticks before the main program
GAP_MS: Final = 5000  # as the firmware
IN_A_ROW: Final = 8  # as the firmware
REFILL_MS: Final = 75_000  # as the firmware
_NUMBER: Final = re.compile(r"[0-9]{1,10}")
LONGEST_MS: Final = 600_000  # as the firmware
LONGEST_BLINK_MS: Final = 60_000  # as the firmware
# Commands that light a channel: mode, and how many words they have.
_LIGHTING: Final = {"SL": ("S", 3), "RA": ("R", 4), "PU": ("P", 4), "BL": ("B", 6)}


class Refused(Exception):
    """A command is refused with one of the protocol's error numbers."""

    def __init__(self, code: int) -> None:
        self.code = code


def checked(line: bytes) -> bytes | None:
    """Return what stands before the star of a whole, undamaged request; None where the line is not one."""
    body, star, checksum = line[:-9], line[-9:-8], line[-8:]
    if len(body) < 6 or star != b"*" or not re.fullmatch(rb"#[0-9A-F]{2} .+", body, re.DOTALL):
        return None
    if not re.fullmatch(rb"[0-9A-F]{8}", checksum) or int(checksum, 16) != crc32(body):
        return None
    return body


@dataclass(slots=True)
class Commands:
    """Runs one command on a box."""

    box: SimulatedLightBox

    def run(self, text: str) -> str:
        """Return the answer to a command without its number and checksum; Refused becomes an error number."""
        words = text.split(" ")
        try:
            if len(words) > 7 or not all(words):
                raise Refused(3)
            action = getattr(self, f"_do_{words[0].lower()}", None) if words[0].isupper() else None
            if words[0] in _LIGHTING:
                fields = self._shine(*_LIGHTING[words[0]], words[1:])
            elif action is not None:
                fields = action(words[1:])
            else:
                raise Refused(2)
        except Refused as refused:
            return f"ER {refused.code:02d}"
        return " ".join(["OK", *(str(field) for field in fields)])

    def _do_hi(self, words: list[str]) -> list[object]:
        version = _number(words[0]) if len(words) == 1 else None
        if version is None:
            raise Refused(3)
        if version not in CHANNELS_OF_VERSION or version > self.box.settings.newest_version:
            raise Refused(9)
        self.box.spoken = version
        self.box.darken_all()
        self.box.session = True
        return ["radiometer-light-box", version, "2.1", self.box.settings.serial, self._channel_count]

    @property
    def _channel_count(self) -> int:
        return min(CHANNELS_OF_VERSION[self.box.spoken], len(self.box.channels))

    def _do_fl(self, words: list[str]) -> list[object]:
        self._require_version_2()
        _none(words)
        if not self.box.session:
            raise Refused(7)
        if self.box.held:
            raise Refused(12)
        if not self.box.flash.fire(self.box.whole_ms):
            raise Refused(6)
        self.box.lit()
        return self._do_fs([])

    def _do_fs(self, words: list[str]) -> list[object]:
        self._require_version_2()
        _none(words)
        return list(self.box.flash.state(self.box.whole_ms))

    def _require_version_2(self) -> None:
        if self.box.spoken < 2:
            raise Refused(2)

    def _do_ch(self, words: list[str]) -> list[object]:
        limits = self._channel(words, 1).limits
        low, high = limits.low_limit, limits.high_limit
        return [limits.name, limits.peak_nm, limits.steps, 1953, low, high, limits.bucket, limits.refill]

    def _do_of(self, words: list[str]) -> list[object]:
        if words == ["*"]:
            self.box.darken_all()
        else:
            self._channel(words, 1).darken()
            self.box.lit()
        return []

    def _do_rb(self, words: list[str]) -> list[object]:
        channel = self._channel(words, 1)
        level = channel.driven_level
        steps = steps_of(level, channel.limits.steps)
        return [channel.mode, "H" if channel.high else "L", level, steps, channel.bucket]

    def _do_st(self, words: list[str]) -> list[object]:
        _none(words)
        box = self.box
        supply_mv, tenths_celsius = round(1000 * box.settings.supply_v), round(10 * box.settings.ambient_celsius)
        return [
            supply_mv,
            tenths_celsius,
            box.bad_lines,
            0,
            box.darkened,
            box.reset_cause,
            int(box.button),
            int(box.session),
        ]

    def _do_tm(self, words: list[str]) -> list[object]:
        _none(words)
        return [f"{self.box.line_ms:.3f}", f"{self.box.box_ms:.3f}", f"{self.box.latest_event:02X}"]

    def _do_ev(self, words: list[str]) -> list[object]:
        if len(words) != 1 or not re.fullmatch("[0-9A-F]{2}", words[0]):
            raise Refused(3)
        event = self.box.events.get(int(words[0], 16))
        if event is None:
            raise Refused(10)
        return [event]

    def _shine(self, mode: str, count: int, words: list[str]) -> list[object]:
        channel = self._channel(words)
        if len(words) != count or words[1] not in ("L", "H"):
            raise Refused(3)
        high = words[1] == "H"
        level = _within(words[2], 0, 65535)
        longest = LONGEST_BLINK_MS if mode == "B" else LONGEST_MS
        times = [_within(word, 1, longest) for word in words[3:5]]
        blinks = _within(words[5], 0, 65535) if mode == "B" else 0
        if not self.box.session:
            raise Refused(7)
        self._start(channel, mode, level, high, times, blinks)
        self.box.lit()
        return [words[1], level, steps_of(level, channel.limits.steps)]

    def _start(self, channel: Channel, mode: str, level: int, high: bool, times: list[int], blinks: int) -> None:
        bright_ms = {"P": times[0] if times else 1, "B": times[0] * blinks if times and blinks else 1}.get(mode, 1)
        code = channel.refusal(level, high, 0)
        if not code and level and self._partner_lit(channel):
            code = 11
        if not code and level and self.box.held:
            code = 12
        code = code or channel.refusal(level, high, bright_ms)
        if code:
            raise Refused(code)
        if mode == "R":
            if channel.mode != "O" and channel.high != high:
                raise Refused(8)
            channel.start_ramp(level, high, times[0])
        else:
            channel.start(mode, level, high, *times, *([blinks] if mode == "B" else []))

    def _partner_lit(self, channel: Channel) -> bool:
        partner = PARTNERS.get(channel.limits.name)
        return any(other.limits.name == partner and other.mode != "O" for other in self.box.channels)

    def _channel(self, words: list[str], count: int | None = None) -> Channel:
        number = _number(words[0]) if words else None
        if number is None:
            raise Refused(3)
        if number >= self._channel_count:
            raise Refused(4)
        if count is not None and len(words) != count:
            raise Refused(3)
        return self.box.channels[number]


def _number(word: str) -> int | None:
    number = int(word) if _NUMBER.fullmatch(word) else None
    return number if number is not None and number < 2**32 else None


def _within(word: str, low: int, high: int) -> int:
    number = _number(word)
    if number is None or not low <= number <= high:
        raise Refused(3)
    return number


def _none(words: list[str]) -> None:
    if words:
        raise Refused(3)


@dataclass(slots=True)
class Flash:
    """A flash behind a diffuser, fired by the box's trigger."""

    exposure_j_sr_m2: float = 100.0  # radiant exposure of one flash at the eye, in J·sr⁻¹·m⁻²
    fired_ms: list[int] = field(default_factory=list)  # box times of the flashes since the start
    _left: int = IN_A_ROW
    _refilled_ms: int = 0
    _gap_ms: int = 0  # after a restart

    def reset(self, now_ms: int) -> None:
        """Restart with the flashes that the box's memory holds; where some are missing, the least gap begins anew."""
        self.state(now_ms)
        self.fired_ms.clear()
        self._refilled_ms, self._gap_ms = 0, GAP_MS if self._left < IN_A_ROW else 0

    def state(self, now_ms: int) -> tuple[int, int]:
        """Return how many flashes are left and after how many ms one may be fired."""
        while self._left < IN_A_ROW and now_ms - self._refilled_ms >= REFILL_MS:
            self._left, self._refilled_ms = self._left + 1, self._refilled_ms + REFILL_MS
        wait_ms = max(0, (self.fired_ms[-1] + GAP_MS if self.fired_ms else self._gap_ms) - now_ms)
        return self._left, wait_ms

    def fire(self, now_ms: int) -> bool:
        """Fire, and return whether the box's limits let it."""
        left, wait_ms = self.state(now_ms)
        if left == 0 or wait_ms:
            return False
        if left == IN_A_ROW:
            self._refilled_ms = now_ms
        self._left -= 1
        self.fired_ms.append(now_ms)
        return True


class Emitted(NamedTuple):
    """A line that left the box, with the true time in s at which its first byte left."""

    time_s: float
    line: bytes


@dataclass(slots=True)
class SimulatedBoxSettings:
    """How this box differs from another."""

    serial: str = "TWIN0001"  # eight characters
    clock_ppm: float = 0.0  # rate of its clock above true time in parts per million
    supply_v: float = 12.0  # LED supply in V
    ambient_celsius: float = AMBIENT_C  # temperature in °C
    channels: tuple[ChannelLimits, ...] = REFERENCE_CHANNELS  # channels and their limits
    newest_version: int = 2  # newest version of the protocol that it speaks
    leds: dict[str, LedParameters] = field(default_factory=lambda: dict(REFERENCE_LEDS))  # LED of each channel


@dataclass(slots=True)
class SimulatedLightBox:
    """A light box in true time; `advance` lets time pass, `receive` hands it bytes."""

    settings: SimulatedBoxSettings = field(default_factory=SimulatedBoxSettings)  # what box it is
    # Lines that left it, oldest first; whoever carries the line takes them off
    emitted: deque[Emitted] = field(default_factory=deque)
    channels: list[Channel] = field(default_factory=list)
    leds: list[LedState] = field(default_factory=list)
    time_s: float = 0.0
    session: bool = False
    button: bool = False
    bad_lines: int = 0
    darkened: int = 0
    reset_cause: str = "P"
    line_ms: float = 0.0
    events: dict[int, str] = field(default_factory=dict)
    latest_event: int = 0
    # Called whenever what reaches the LEDs may have changed, such as to keep a record of it
    watch: Callable[[], None] | None = None
    spoken: int = 2
    flash: Flash = field(default_factory=Flash)  # the photographic flash behind its trigger
    _held_since_ms: int | None = None
    _booted_s: float = 0.0
    _ms: int = 0
    _silent_since_ms: int = 0
    _agenda: list[tuple[float, bool]] = field(default_factory=list)
    _line: bytearray = field(default_factory=bytearray)
    _overlong: bool = False
    _answered: tuple[bytes, bytes] | None = None

    def __post_init__(self) -> None:
        self.leds = [LedState(self.settings.leds[limits.name]) for limits in self.settings.channels]
        self.channels = [Channel(limits, limits.bucket) for limits in self.settings.channels]
        self.reset("P")

    def reset(self, cause: str = "E") -> None:
        """Restart the box now: P power, B brown-out, E external, W watchdog.

        Everything goes dark; buckets and flashes are what the box's memory holds.
        """
        for channel in self.channels:
            channel.restart()
        self.lit()
        self.session, self.reset_cause = False, cause
        self.flash.reset(self._ms)
        self.bad_lines = self.darkened = self.latest_event = self._ms = self._silent_since_ms = 0
        self.events, self._answered = {}, None
        self.spoken, self._held_since_ms = 2, 0 if self.button else None
        self._line.clear()
        self._booted_s = self.time_s
        self.add_event("BO", cause, BOOT_MS)

    @property
    def whole_ms(self) -> int:
        """Return the box's time in whole ms, as its timers count."""
        return self._ms

    @property
    def held(self) -> bool:
        """Tell whether the button has been held so long that every light stays off."""
        return self._held_since_ms is not None and self._ms >= self._held_since_ms + HELD_OFF_MS

    @property
    def box_ms(self) -> float:
        """Return the box's time in ms, in ticks of 4 µs."""
        exact_ms = (self.time_s - self._booted_s) * 1000.0 * (1.0 + 1e-6 * self.settings.clock_ppm)
        return math.floor(exact_ms / TICK_MS + 1e-6) * TICK_MS

    def press(self, time_s: float, *, pressed: bool = True) -> None:
        """Plan a press (or release) of the button at a true time in s."""
        heapq.heappush(self._agenda, (time_s, pressed))

    def next_time_s(self) -> float | None:
        """Return the next true time at which a line may leave by itself; None where nothing is planned."""
        times = [when for when, _ in self._agenda[:1]]
        waits_ms = [wait for wait in (channel.ms_to_change() for channel in self.channels) if wait is not None]
        if self.session:
            waits_ms.append(max(self._silent_since_ms + DEADMAN_MS - self._ms, 1))
        if self._held_since_ms is not None and not self.held:
            waits_ms.append(max(self._held_since_ms + HELD_OFF_MS - self._ms, 1))
        if waits_ms:
            times.append(self._true_s(self._ms + min(waits_ms)))
        return max(min(times), self.time_s) if times else None

    def advance(self, time_s: float) -> None:
        """Let true time pass up to `time_s` in s."""
        while self._agenda and self._agenda[0][0] <= time_s:
            when, pressed = heapq.heappop(self._agenda)
            self._pass_time(when)
            self._turn_button(pressed)
        self._pass_time(time_s)

    def receive(self, received: bytes, time_s: float) -> None:
        """Take bytes that are complete at true time `time_s` in s."""
        self.advance(time_s)
        for byte in received:
            self._take(byte)

    def emission(self, channel: str, time_s: float) -> Emission:
        """Return what a channel emits at a true time in s, averaged over its PWM."""
        self.advance(time_s)
        return self.leds[self._names.index(channel)].emission(self.time_s)

    def duty(self, channel: str) -> float:
        """Return the duty that a channel's pin has now, 0 to 1."""
        state = self.channels[self._names.index(channel)]
        return steps_of(state.driven_level, state.limits.steps) / state.limits.steps

    def darken_all(self) -> None:
        """Switch every channel off."""
        for channel in self.channels:
            channel.darken()
        self.lit()

    def add_event(self, kind: str, argument: str, when_ms: float) -> None:
        """Number an event, keep it and send it."""
        self.latest_event = (self.latest_event + 1) % 256
        self.events[self.latest_event] = f"{kind} {argument} {when_ms:.3f}"
        self.events.pop((self.latest_event - 16) % 256, None)
        self._send(f"!{self.latest_event:02X} {self.events[self.latest_event]}".encode())

    @property
    def _names(self) -> list[str]:
        return [channel.limits.name for channel in self.channels]

    def _true_s(self, box_ms: float) -> float:
        return self._booted_s + box_ms / 1000.0 / (1.0 + 1e-6 * self.settings.clock_ppm)

    def _pass_time(self, time_s: float) -> None:
        target_s = max(time_s, self.time_s)
        self.time_s = target_s
        target_ms = int(self.box_ms + 1e-6)
        while self._ms < target_ms:
            waits = [wait for wait in (channel.ms_to_change() for channel in self.channels) if wait is not None]
            silent_at = self._silent_since_ms + DEADMAN_MS
            if self._ms < silent_at:
                waits.append(silent_at - self._ms)
            if self._held_since_ms is not None and self._ms < self._held_since_ms + HELD_OFF_MS:
                waits.append(self._held_since_ms + HELD_OFF_MS - self._ms)
            self._step(min([target_ms - self._ms, *waits]))
        self.time_s = target_s

    def _step(self, ms: int) -> None:
        before = [(channel.driven_level, channel.high) for channel in self.channels]
        self._ms += ms
        self.time_s = self._true_s(self._ms)
        silent = self._ms == self._silent_since_ms + DEADMAN_MS
        held = self._held_since_ms is not None and self._ms == self._held_since_ms + HELD_OFF_MS
        if silent or held:  # the box looks at both before it counts what a millisecond costs
            self._account(ms - 1)
            ms = 1
        if silent:
            self._darken_for("D" if self.session else "")
            self.session = False
        if held:
            self._darken_for("B")
        self._account(ms)
        if before != [(channel.driven_level, channel.high) for channel in self.channels]:
            self.lit()

    def _account(self, ms: int) -> None:
        """Let the channels go on for so long; report those whose energy is used up."""
        for index, channel in enumerate(self.channels):
            if ms and channel.advance(ms):
                self.darkened += 1
                self.add_event("DK", str(index), self._ms)

    def _darken_for(self, reason: str) -> None:
        """Switch every channel off, and report why where there is a reason to."""
        for channel in self.channels:
            channel.darken()
        if reason:
            self.darkened += 1
            self.add_event("DK", reason, self._ms)

    def lit(self) -> None:
        """Pass on to the LEDs what the channels do now."""
        for channel, led in zip(self.channels, self.leds, strict=True):
            duty = steps_of(channel.driven_level, channel.limits.steps) / channel.limits.steps
            led.drive(duty, high=channel.high, time_s=self.time_s)
        if self.watch is not None:
            self.watch()

    def _turn_button(self, pressed: bool) -> None:
        if pressed != self.button:
            self.button = pressed
            self._held_since_ms = self._ms if pressed else None
            self.add_event("BT", "D" if pressed else "U", self.box_ms)

    def _take(self, byte: int) -> None:
        if byte == 0x0A:
            if self._line or self._overlong:
                self.line_ms = self.box_ms
                self._answer(bytes(self._line))
            self._line.clear()
            self._overlong = False
        elif byte == ord("#"):
            self._line[:] = b"#"
            self._overlong = False
        elif len(self._line) == LINE_SIZE:
            self._overlong = True
        elif byte != 0x0D:
            self._line.append(byte)

    def _answer(self, line: bytes) -> None:
        body = None if self._overlong else checked(line)
        if body is None:
            self.bad_lines += 1
            self._send(b"=-- ER 01")
            return
        self._silent_since_ms = self._ms
        if self._answered is None or self._answered[0] != line:
            reply = Commands(self).run(body[4:].decode("latin-1"))
            self._answered = (line, body[1:3] + b" " + reply.encode())
        self._send(b"=" + self._answered[1])

    def _send(self, body: bytes) -> None:
        self.emitted.append(Emitted(self.time_s, body + f"*{crc32(body):08X}\n".encode()))
