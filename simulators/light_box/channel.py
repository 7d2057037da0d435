"""One channel of the simulated light box: what it does from millisecond to millisecond."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class ChannelLimits:
    """What the box says of a channel: name, peak in nm (0: white), duty steps, level limits, energy bucket."""

    name: str
    peak_nm: int
    steps: int
    low_limit: int
    high_limit: int
    bucket: int
    refill: int


REFERENCE_CHANNELS = (
    ChannelLimits("bleach", 0, 1024, 65535, 60000, 47_000_000, 78),
    ChannelLimits("spot", 453, 8192, 65535, 60000, 846_000_000, 1410),
    ChannelLimits("spot_red", 640, 8192, 65535, 60000, 846_000_000, 1410),
    ChannelLimits("fixation", 640, 1024, 65535, 20000, 846_000_000, 1410),
    ChannelLimits("spot_green", 505, 8192, 65535, 60000, 846_000_000, 1410),
    ChannelLimits("field", 0, 1024, 65535, 60000, 70_500_000, 118),
)
CHANNELS_OF_VERSION = {1: 4, 2: 6}
PARTNERS = {"bleach": "field", "field": "bleach", "spot_red": "spot_green", "spot_green": "spot_red"}


PARTS = 64  # as the firmware
SOON_MS, AHEAD_MS = 256, 512  # as the firmware
PARTS_BEFORE_RAISING = 4  # as the firmware: EEPROM cells wear out


@dataclass(slots=True)
class Channel:
    """State of one channel; `mode` is O, S, R, P or B as on the wire."""

    limits: ChannelLimits  # what is built in
    bucket: int  # energy units left
    # 64ths of the full bucket that the box's memory holds: a reset leaves these. 64 in a box that has rested
    kept: int = PARTS
    mode: str = "O"
    high: bool = False  # whether at the high current
    level: int = 0  # level driven now
    bright: bool = False
    left_ms: int = 0
    on_ms: int = 0
    off_ms: int = 0
    blinks_left: int = 0
    start_level: int = 0
    target: int = 0

    def refusal(self, level: int, high: bool, bright_ms: int) -> int:
        """Return 0, or 5 (level) or 6 (energy) where the box would refuse."""
        if level > (self.limits.high_limit if high else self.limits.low_limit):
            return 5
        return 6 if bright_ms > self.bucket // cost_per_ms(level, high) else 0

    def start(self, mode: str, level: int, high: bool, on_ms: int = 0, off_ms: int = 0, count: int = 0) -> None:
        """Shine steadily (S), for a while (P) or blinking (B)."""
        self.mode = mode if level else "O"
        self.level, self.high, self.bright = level, high, level > 0
        self.left_ms = self.on_ms = on_ms
        self.off_ms, self.blinks_left = off_ms, count
        if level:
            self._lower(self.bucket, cost_per_ms(level, high))

    def start_ramp(self, target: int, high: bool, duration_ms: int) -> None:
        """Move to a level in a straight line."""
        self.start_level = self.level if self.bright else 0
        self.mode, self.high, self.bright = "R", high, True
        self.level, self.target = self.start_level, target
        self.left_ms = self.on_ms = duration_ms
        self._lower(self.bucket, cost_per_ms(max(self.start_level, target), high))

    def restart(self) -> None:
        """Go dark with what the memory holds in the bucket."""
        self.darken()
        self.bucket = self.limits.bucket * self.kept // PARTS

    def darken(self) -> None:
        """Go dark and forget what was planned."""
        self.mode, self.high, self.bright, self.level = "O", False, False, 0

    @property
    def driven_level(self) -> int:
        """Return the level that reaches the LED now."""
        return self.level if self.bright else 0

    def ms_to_change(self) -> int | None:
        """Return after how many ms something changes by itself; None where nothing does."""
        times = []
        if self.mode in "PB":
            times.append(self.left_ms)
        if self.mode == "R":
            times.append(1)
        if self.bright:
            times.append(self.bucket // cost_per_ms(self.level, self.high) + 1)
        return max(min(times), 1) if times else None

    def advance(self, ms: int) -> bool:
        """Let `ms` milliseconds pass, at most `ms_to_change`; return whether the bucket ran empty."""
        if not self._account(ms):
            return True
        self.left_ms -= ms
        if self.mode == "R":
            self._ramp()
        elif self.mode == "P" and self.left_ms <= 0:
            self.darken()
        elif self.mode == "B" and self.left_ms <= 0:
            self._turn()
        return False

    def _account(self, ms: int) -> bool:
        if not self.bright:
            self.bucket = min(self.limits.bucket, self.bucket + ms * self.limits.refill)
            self._raise()
            return True
        each = cost_per_ms(self.level, self.high)
        before, cost = self.bucket, each * ms
        self.bucket = self.bucket - cost if cost <= self.bucket else self.bucket % each
        while self._lower(before - (before - self._soon(each)) // each * each - each, each):
            pass  # the memory falls at the first ms at which it is due, again and again on the way
        if cost > before:  # the whole milliseconds before the last were bright
            self.darken()
            return False
        return True

    def _soon(self, each: int) -> int:
        """Return the units below which the memory is lowered."""
        return self.limits.bucket * self.kept // PARTS + SOON_MS * each

    def _lower(self, units: int, each: int) -> bool:
        """Lower the memory where a bucket of `units` is due for it, and was reached; return whether it was."""
        if not self.kept or not self.bucket <= units < self._soon(each):
            return False
        self.kept = self._parts(max(units - AHEAD_MS * each, 0))
        return True

    def _raise(self) -> None:
        if self.kept >= PARTS - 1:
            return
        while (there := self._parts(self.bucket)) >= self.kept + PARTS_BEFORE_RAISING:
            self.kept = min(there - 1, self.kept + PARTS_BEFORE_RAISING - 1)
        if self.bucket == self.limits.bucket:
            self.kept = max(self.kept, PARTS - 1)

    def _parts(self, units: int) -> int:
        """Return the 64ths, short of all, that are at most so many units."""
        return min(PARTS - 1, ((units + 1) * PARTS - 1) // self.limits.bucket)

    def _ramp(self) -> None:
        passed = self.on_ms - self.left_ms
        way = abs(self.target - self.start_level) * passed // self.on_ms
        self.level = self.start_level + (way if self.target > self.start_level else -way)
        if self.left_ms <= 0:
            self.mode = "S" if self.target else "O"
            self.level, self.bright = self.target, self.target > 0

    def _turn(self) -> None:
        if self.bright and self.blinks_left:
            self.blinks_left -= 1
            if self.blinks_left == 0:
                self.darken()
                return
        self.bright = not self.bright
        self.left_ms = self.on_ms if self.bright else self.off_ms


def cost_per_ms(level: int, high: bool) -> int:
    """Return the energy units that a bright millisecond takes from the bucket."""
    return (level >> 8) + 1 if high else 1


def steps_of(level: int, steps: int) -> int:
    """Return the duty step nearest to a level; 65535 is all of them."""
    return ((level + (level >= 32768)) * steps + 32768) // 65536
