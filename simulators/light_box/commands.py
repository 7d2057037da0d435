"""The simulated light box's commands: words in, an answer out."""

from __future__ import annotations

import re
import zlib
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from simulators.light_box.channel import CHANNELS_OF_VERSION, PARTNERS, Channel, steps_of

if TYPE_CHECKING:
    from simulators.light_box.box import SimulatedLightBox


_NUMBER: Final = re.compile(r"[0-9]{1,10}")
LONGEST_MS: Final = 600_000  # as the firmware
LONGEST_BLINK_MS: Final = 60_000  # as the firmware


class Refused(Exception):
    """A command is refused with one of the protocol's error numbers."""

    def __init__(self, code: int) -> None:
        self.code = code


def checked(line: bytes) -> bytes | None:
    """Return what stands before the star of a whole, undamaged request; None where the line is not one."""
    body, star, checksum = line[:-9], line[-9:-8], line[-8:]
    if len(body) < 6 or star != b"*" or not re.fullmatch(rb"#[0-9A-F]{2} .+", body, re.DOTALL):
        return None
    if not re.fullmatch(rb"[0-9A-F]{8}", checksum) or int(checksum, 16) != zlib.crc32(body):
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
            if action is None:
                raise Refused(2)
            fields = action(words[1:])
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

    def _do_sl(self, words: list[str]) -> list[object]:
        return self._shine("S", words, 3)

    def _do_ra(self, words: list[str]) -> list[object]:
        return self._shine("R", words, 4)

    def _do_pu(self, words: list[str]) -> list[object]:
        return self._shine("P", words, 4)

    def _do_bl(self, words: list[str]) -> list[object]:
        return self._shine("B", words, 6)

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

    def _shine(self, mode: str, words: list[str], count: int) -> list[object]:
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
