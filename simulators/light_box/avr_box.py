"""The light box's real firmware in the loop: simavr runs it, its pins and its serial line are observed from outside.

simavr runs real machine code, cycle by cycle, through ctypes. Debian packages `libsimavr2` (or `libsimavr-dev`). Only
exported functions are called. Four fields of the simulator's structure are touched; their place is verified against
the addresses of two callbacks behind them.
"""

from __future__ import annotations

import ctypes
import ctypes.util
import struct
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final
from zlib import crc32

from radiometer.errors import InputError, MissingLibrary

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

# struct avr_t of sim_avr.h, libsimavr 1.6 and 1.7 on 64-bit machines
_STATE, _FREQUENCY, _VCC, _AVCC, _AREF, _CYCLE, _RUN_LIMIT, _RUN, _SLEEP = 60, 64, 68, 72, 76, 80, 96, 160, 168
_CRASHED: Final = 7  # cpu_Crashed
_LONGEST_PROGRAM: Final = 1_000_000  # characters: 32 KiB of flash memory are 90,000 in Intel HEX
_UART_INPUT, _UART_OUTPUT = 0, 1  # numbers of simavr's interrupts, avr_uart.h
_Notify = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_uint32, ctypes.c_void_p)
_Sleep = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_uint64)


class SimulatedAvr:
    """An ATmega328P with a program in its flash.

    Args:
        frequency_hz: Clock frequency in Hz.
        eeprom: First bytes of the EEPROM.

    Raises:
        MissingLibrary: If simavr is not installed or of an unknown version.
        InputError: If the program cannot be read.
    """

    def __init__(self, hex_file: Path, frequency_hz: int = 16_000_000, eeprom: bytes = b"") -> None:
        self._library = _load()
        self._avr = self._library.avr_make_mcu_by_name(b"atmega328p")
        self._kept: list[Any] = []
        self._library.avr_init(self._avr)
        self._verify_layout()
        self.frequency_hz = frequency_hz
        self._field(ctypes.c_uint32, _FREQUENCY).value = frequency_hz
        for millivolts in (_VCC, _AVCC, _AREF):
            self._field(ctypes.c_uint32, millivolts).value = 5000
        self._field(ctypes.c_uint64, _RUN_LIMIT).value = frequency_hz // 1000
        self._dont_sleep()
        code = read_intel_hex(hex_file)
        self._library.avr_loadcode(self._avr, code, len(code), 0)
        if eeprom:
            self._write_eeprom(eeprom)
        self._cycle = self._field(ctypes.c_uint64, _CYCLE)
        self._state = self._field(ctypes.c_int, _STATE)
        self._uart = self._irq("uar", "0", _UART_INPUT)
        # Debian's simavr polls INT0 and INT1 in every cycle while their pins are low, even with both disabled.
        for interrupt in (0, 1):
            self._library.avr_extint_set_strict_lvl_trig(self._avr, interrupt, 0)
        flags = ctypes.c_uint32(0)  # no sleeping and no console of the UART's own
        self._library.avr_ioctl(self._avr, _ioctl("uas", "0"), ctypes.byref(flags))

    @property
    def cycle(self) -> int:
        """Return the number of clock cycles since power-on."""
        return int(self._cycle.value)

    @property
    def time_s(self) -> float:
        """Return the time since power-on in s."""
        return self.cycle / self.frequency_hz

    def run_until(self, cycle: int) -> None:
        """Run up to a cycle. Raises InputError if the program crashes."""
        run, avr, present = self._library.avr_run, self._avr, self._cycle
        while present.value < cycle:
            run(avr)
        if self._state.value == _CRASHED:
            raise InputError("the program crashed in simavr")

    def reset(self) -> None:
        """Reset the microcontroller; what its EEPROM holds stays."""
        self._library.avr_reset(self._avr)

    def send_byte(self, byte: int) -> None:
        """Hand a byte to the UART's receiver, as if its stop bit had just come."""
        self._library.avr_raise_irq(self._uart, byte)

    def on_byte(self, notify: Callable[[int], None]) -> None:
        """Call `notify` with each byte that the UART sends."""
        self._watch(self._irq("uar", "0", _UART_OUTPUT), lambda value: notify(value & 0xFF))

    def on_pin(self, port: str, pin: int, notify: Callable[[int, bool], None]) -> None:
        """Call `notify` with cycle and level at each change of a pin."""
        self._watch(self._irq("iog", port, pin), lambda value: notify(self.cycle, bool(value & 1)))

    def drive_pin(self, port: str, pin: int, level: bool) -> None:
        """Drive an input pin from outside; the level stays."""
        # struct avr_ioport_external_t of avr_ioport.h: name 7 bits, mask 8, value 8
        external = ctypes.c_uint64(ord(port) | (1 << pin) << 7 | (int(level) << pin) << 15)
        self._library.avr_ioctl(self._avr, _ioctl("iop", port), ctypes.byref(external))
        self._library.avr_raise_irq(self._irq("iog", port, pin), int(level))

    def drive_analogue(self, input_number: int, millivolts: int) -> None:
        """Put a voltage on an ADC input; it stays."""
        self._library.avr_raise_irq(self._irq("adc", " ", input_number), millivolts)

    def _field(self, kind: Any, offset: int) -> Any:
        return kind.from_address(self._avr + offset)

    def _verify_layout(self) -> None:
        for name, offset in (("avr_callback_run_raw", _RUN), ("avr_callback_sleep_raw", _SLEEP)):
            expected = ctypes.cast(getattr(self._library, name), ctypes.c_void_p).value
            if self._field(ctypes.c_uint64, offset).value != expected:
                raise MissingLibrary("this version of libsimavr is laid out in another way; 1.6 of Debian 12 is known")

    def _dont_sleep(self) -> None:
        """Let a sleeping processor jump to its next event instead of waiting in real time."""
        nothing = _Sleep(lambda avr, cycles: None)
        self._kept.append(nothing)
        self._field(ctypes.c_uint64, _SLEEP).value = ctypes.cast(nothing, ctypes.c_void_p).value

    def _write_eeprom(self, content: bytes) -> None:
        buffer = ctypes.create_string_buffer(content, len(content))
        # struct avr_eeprom_desc_t of avr_eeprom.h: pointer, uint16 offset, uint32 size
        description = struct.pack("PHxxI", ctypes.addressof(buffer), 0, len(content))
        self._library.avr_ioctl(self._avr, _ioctl("ees", "p"), description)

    def _irq(self, module: str, name: str, index: int) -> int:
        return int(self._library.avr_io_getirq(self._avr, _ioctl(module, name), index))

    def _watch(self, irq: int, notify: Callable[[int], None]) -> None:
        callback = _Notify(lambda irq, value, parameter: notify(value))
        self._kept.append(callback)
        self._library.avr_irq_register_notify(irq, callback, None)


def read_intel_hex(path: Path) -> bytes:
    """Return the bytes of an Intel HEX file from address 0 on, gaps as 0xFF.

    Raises:
        InputError: If the file is missing or not of that form.
    """
    code = bytearray()
    try:
        with path.open(encoding="ascii") as stream:  # devices have no end
            text = stream.read(_LONGEST_PROGRAM + 1)
        if len(text) > _LONGEST_PROGRAM:
            raise InputError(f"{path} is no program of this board: it has more than {_LONGEST_PROGRAM} characters")
        for number, line in enumerate(text.split(), 1):
            record = bytes.fromhex(line.removeprefix(":"))
            if len(record) < 5 or sum(record) % 256 or record[0] != len(record) - 5:
                raise InputError(f"{path}, line {number}: damaged Intel HEX record")
            if record[3] == 0:
                address = record[1] * 256 + record[2]
                code.extend(b"\xff" * (address + record[0] - len(code)))
                code[address : address + record[0]] = record[4:-1]
    except (OSError, ValueError) as error:
        raise InputError(f"cannot read the program {path}: {error}") from error
    return bytes(code)


def _ioctl(module: str, name: str) -> int:
    return int.from_bytes(f"{module}{name}".encode("ascii"), "big")


def _load() -> Any:
    name = ctypes.util.find_library("simavr") or "libsimavr.so.2"
    try:
        library = ctypes.CDLL(name)
    except OSError as error:
        raise MissingLibrary("simavr is not installed; Debian: apt install libsimavr2") from error
    pointer, word = ctypes.c_void_p, ctypes.c_uint32
    signatures: dict[str, tuple[list[Any], Any]] = {
        "avr_make_mcu_by_name": ([ctypes.c_char_p], pointer),
        "avr_init": ([pointer], ctypes.c_int),
        "avr_run": ([pointer], ctypes.c_int),
        "avr_reset": ([pointer], None),
        "avr_loadcode": ([pointer, ctypes.c_char_p, word, word], None),
        "avr_io_getirq": ([pointer, word, ctypes.c_int], pointer),
        "avr_raise_irq": ([pointer, word], None),
        "avr_irq_register_notify": ([pointer, _Notify, pointer], None),
        "avr_ioctl": ([pointer, word, pointer], ctypes.c_int),
        "avr_extint_set_strict_lvl_trig": ([pointer, ctypes.c_uint8, ctypes.c_uint8], None),
    }
    for function, (arguments, result) in signatures.items():
        getattr(library, function).argtypes = arguments
        getattr(library, function).restype = result
    return library


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
