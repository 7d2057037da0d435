"""The AVR simulator simavr through ctypes: an ATmega328P that runs real machine code, cycle by cycle.

Debian packages `libsimavr2` (or `libsimavr-dev`). Only exported functions are called. Four fields of the simulator's
structure are touched; their place is verified against the addresses of two callbacks behind them.
"""

from __future__ import annotations

import ctypes
import ctypes.util
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

from radiometer.errors import InputError, MissingLibrary

# struct avr_t of sim_avr.h, libsimavr 1.6 and 1.7 on 64-bit machines
_STATE, _FREQUENCY, _VCC, _AVCC, _AREF, _CYCLE, _RUN_LIMIT, _RUN, _SLEEP = 60, 64, 68, 72, 76, 80, 96, 160, 168
_CRASHED: Final = 7  # cpu_Crashed
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
        for number, line in enumerate(path.read_text(encoding="ascii").split(), 1):
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
