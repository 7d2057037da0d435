"""The light box's real firmware in the loop: simavr runs it, its pins and its serial line are observed from outside."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final
from zlib import crc32

from simulators.light_box.simavr import SimulatedAvr

PINS: Final = {"bleach": ("B", 3), "spot": ("B", 1), "spot_red": ("B", 2), "fixation": ("D", 3)}
RANGE_PINS: Final = {
    "bleach": ("D", 4),
    "spot": ("D", 5),
    "spot_red": ("D", 6),
    "fixation": ("D", 7),
    "spot_green": ("C", 4),
    "field": ("C", 5),
}
SELECT_PINS: Final = {"spot_green": ("C", 2), "field": ("C", 3)}  # high: the shared output drives this LED
SHARED: Final = {"spot_green": "spot_red", "field": "bleach"}
TRIGGER: Final = ("B", 0)  # PB0, as wired in the firmware
BUTTON: Final = ("D", 2)  # PD2, as wired in the firmware
BYTE_CYCLES: Final = 1360  # 10 bits at 117 647 Bd, what the firmware's divider gives
LAG_S: Final = 0.1  # a machine that is later than this cannot keep up


def rested_eeprom(serial: str) -> bytes:
    """Return the beginning of the EEPROM of a box whose buckets are full (docs/reference/light-box-protocol.md)."""
    record = bytes([1, *[64] * 6, 8])
    return serial.encode("ascii")[:8].ljust(16, b"\xff") + record + (crc32(record) & 0xFFFF).to_bytes(2, "little")


@dataclass(slots=True)
class PinRecord:
    """Edges of a pin: cycle and level, oldest first."""

    edges: list[tuple[int, bool]] = field(default_factory=list)

    def note(self, cycle: int, level: bool) -> None:
        """Add an edge; a repetition of the same level is none."""
        if not self.edges or self.edges[-1][1] != level:
            self.edges.append((cycle, level))

    @property
    def level(self) -> bool:
        """Return the present level."""
        return bool(self.edges) and self.edges[-1][1]

    def high_fraction(self, start: int, end: int) -> float:
        """Return the fraction of the cycles from `start` to `end` in which the pin was high."""
        level, since, high = False, start, 0
        for cycle, new in self.edges:
            if cycle <= start:
                level = new
            elif cycle < end:
                high += (cycle - since) * level
                level, since = new, cycle
        return (high + (end - since) * level) / (end - start)

    def last_high(self) -> int | None:
        """Return the cycle at which the pin was high for the last time; None where it is high or never was."""
        falls = [cycle for cycle, level in self.edges if not level]
        return falls[-1] if falls and not self.level and len(self.edges) > 1 else None


class AvrBox:
    """The firmware on a simulated ATmega328P, with its UART, LED pins and button in reach.

    Args:
        hex_file: Firmware as `make -C drivers/firmware/light_box` builds it.
        lag_s: Longest step of box time; what the machine cannot keep up with beyond it is given up.
        memory: Content of the EEPROM; that of a box that has rested where None.
    """

    def __init__(
        self, hex_file: Path, serial: str = "AVR00001", lag_s: float = LAG_S, memory: bytes | None = None
    ) -> None:
        self.avr = SimulatedAvr(hex_file, eeprom=rested_eeprom(serial) if memory is None else memory)
        self._lag_cycles = round(lag_s * self.avr.frequency_hz)
        self.pins = {name: PinRecord() for name in PINS}
        self.range_pins = {name: PinRecord() for name in RANGE_PINS}
        self.select_pins = {name: PinRecord() for name in SELECT_PINS}
        self.trigger = PinRecord()
        self.sent = bytearray()
        self._incoming: deque[int] = deque()
        self._next_byte = 0
        self._given_up = 0
        self.avr.on_byte(self.sent.append)
        for name in PINS:
            self.avr.on_pin(*PINS[name], self.pins[name].note)
        for name, record in self.range_pins.items():
            self.avr.on_pin(*RANGE_PINS[name], record.note)
        for name, record in self.select_pins.items():
            self.avr.on_pin(*SELECT_PINS[name], record.note)
        self.avr.on_pin(*TRIGGER, self.trigger.note)
        self.avr.drive_pin(*BUTTON, True)
        self.avr.drive_analogue(0, 750)  # TMP36 at 25 °C
        self.avr.drive_analogue(1, 3000)  # 12 V through 30k/10k

    def send(self, line: bytes) -> None:
        """Queue bytes for the UART; they arrive at line speed."""
        self._incoming.extend(line)

    def run(self, duration_s: float) -> None:
        """Let box time pass."""
        self._run_to(self.avr.cycle + round(duration_s * self.avr.frequency_hz))

    def reset(self) -> None:
        """Pull the reset line, as opening the port of an Arduino does: the program starts anew, the EEPROM stays."""
        self._incoming.clear()
        self.avr.reset()

    def press(self, *, pressed: bool = True) -> None:
        """Press or release the button now."""
        self.avr.drive_pin(*BUTTON, not pressed)

    def duty(self, channel: str, window_s: float = 0.008) -> float:
        """Return the fraction of the latest `window_s` in which a channel's pin was high and drove its own LED."""
        end = self.avr.cycle
        partners = {**SHARED, **{output: name for name, output in SHARED.items()}}
        if channel in partners:
            selected = self.select_pins[channel if channel in SHARED else partners[channel]].level
            if selected != (channel in SHARED):
                return 0.0
        return self.pins[SHARED.get(channel, channel)].high_fraction(end - round(window_s * self.avr.frequency_hz), end)

    def is_high_current(self, channel: str) -> bool:
        """Tell whether a channel's current switch is at the high range."""
        return self.range_pins[channel].level

    def take_sent(self) -> bytes:
        """Return and forget what the UART has sent."""
        taken = bytes(self.sent)
        self.sent.clear()
        return taken

    def exchange(self, received: bytes, time_s: float) -> bytes:
        """Take bytes, run up to a real time in s, return what was sent: see PtyServer."""
        self.send(received)
        target = round(time_s * self.avr.frequency_hz) - self._given_up
        behind = target - self.avr.cycle
        if behind > self._lag_cycles:
            self._given_up += behind - self._lag_cycles
            target = self.avr.cycle + self._lag_cycles
        self._run_to(target)
        return self.take_sent()

    def _run_to(self, cycle: int) -> None:
        while self._incoming and max(self._next_byte, self.avr.cycle) < cycle:
            self.avr.run_until(self._next_byte)
            self.avr.send_byte(self._incoming.popleft())
            self._next_byte = self.avr.cycle + BYTE_CYCLES
        self.avr.run_until(cycle)
