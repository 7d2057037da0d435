"""The light box's firmware, compiled for this machine with its registers as variables: every line of C in microseconds.

What interrupts and pins do in real time is the business of the tests in simavr; here it is what the code decides.
"""

from __future__ import annotations

import ctypes
import shutil
import subprocess
from _ctypes import dlclose, dlopen
from pathlib import Path
from zlib import crc32

from simulators.light_box.avr_box import rested_eeprom
from testing.patience import within

FIRMWARE = Path(__file__).resolve().parents[1] / "drivers" / "firmware" / "light_box"
HOST = Path(__file__).resolve().parents[1] / "tests" / "unit" / "firmware" / "host"
SOURCES = (
    "clock",
    "uart",
    "pwm",
    "light",
    "memory",
    "limits",
    "button",
    "sensors",
    "text",
    "events",
    "commands",
    "protocol",
)
SERIAL = "LB000007"
EEPROM_BYTES = 1024
FLAGS = ("-O1", "-std=gnu11", "-shared", "-fPIC", "-fshort-enums", "-Wall", "-Wextra", "-Werror", "-DF_CPU=16000000UL")


def built_for_avr(folder: Path, *options: str) -> Path | None:
    """Return the HEX file that `make` builds in a folder; None where its compiler is absent."""
    if shutil.which("avr-gcc") is None:
        return None
    command = ["make", "-s", "-C", str(FIRMWARE), f"BUILD={folder}", *options]
    subprocess.run(command, check=True, capture_output=True, timeout=within(120.0))
    return folder / "light_box.hex"


def build(firmware: Path, target: Path, *defines: str) -> Path:
    """Compile the firmware's sources and the board around them into a library that calls its own functions.

    Without -Bsymbolic another library of the process that has a `crc32` too would be called in their place.
    """
    sources = [str(firmware / f"{name}.c") for name in SOURCES] + [str(HOST / "board.c")]
    flags = [*FLAGS, f"-I{HOST}", f"-I{firmware}", *(f"-D{one}" for one in defines)]
    subprocess.run(["gcc", *flags, "-Wl,-Bsymbolic", "-o", str(target), *sources], check=True, capture_output=True)
    return target


def rested_memory(serial: str = SERIAL) -> bytes:
    """Return the EEPROM of a box whose buckets are full: its serial number and, at 16, one record of its allowance."""
    return rested_eeprom(serial).ljust(EEPROM_BYTES, b"\xff")


class FirmwareBox:
    """A box that has just been powered; time passes only when the test lets it.

    Args:
        library: As `build` made it; copied, for its variables are those of one box.
        copy: Where the copy goes.
        reset_flags: Of the microcontroller: bit 3 watchdog, 2 brown-out, 1 external, 0 power.
        memory: Content of the EEPROM; that of a rested box where None.
    """

    def __init__(
        self, library: Path, copy: Path, reset_flags: int = 1, serial: str = SERIAL, memory: bytes | None = None
    ) -> None:
        self._copy = Path(shutil.copy(library, copy))
        self._handle = dlopen(str(copy), ctypes.DEFAULT_MODE)
        self._board = ctypes.CDLL(str(copy), handle=self._handle)
        self._board.board_start(rested_memory(serial) if memory is None else memory, reset_flags)
        for name in ("board_pass", "board_pass_watched", "board_cut_after"):
            getattr(self._board, name).argtypes = [ctypes.c_uint32]
        self._board.board_memory_writes.restype = ctypes.c_uint32
        self._taken = ctypes.create_string_buffer(65536)
        self._sequence = 0

    def close(self) -> None:
        """Forget the box; its file stays till then, for one that takes over its number would be taken for the same."""
        dlclose(self._handle)
        self._copy.unlink()

    def run(self, ms: int) -> None:
        """Let ms pass."""
        self._board.board_pass(ms)

    def run_watched(self, ms: int) -> list[tuple[float, float]]:
        """Let ms pass and return how many seconds at full duty each channel gave at the low and the high current."""
        given = (ctypes.c_double * 12)()
        self._board.board_pass_watched(ms)
        self._board.board_take_seconds(given)
        return [(given[2 * n], given[2 * n + 1]) for n in range(6)]

    @property
    def memory(self) -> bytes:
        """Return what the EEPROM holds."""
        content = ctypes.create_string_buffer(EEPROM_BYTES)
        self._board.board_memory(content)
        return content.raw

    @property
    def memory_writes(self) -> int:
        """Return how many bytes of the EEPROM were written since power-on."""
        return int(self._board.board_memory_writes())

    def cut_memory_after(self, count: int) -> None:
        """Let power fail while the EEPROM is written, after so many bytes more; nothing is written from then on."""
        self._board.board_cut_after(count)

    def send(self, raw: bytes, *, damaged: bool = False) -> None:
        """Hand over bytes, with a framing error if they are damaged."""
        self._board.board_send(raw, len(raw), damaged)

    def send_at_once(self, raw: bytes) -> None:
        """Hand over bytes while the main program is busy."""
        self._board.board_send_at_once(raw, len(raw))

    def take(self) -> bytes:
        """Return what was sent since the last call."""
        size = self._board.board_take(self._taken)
        return self._taken.raw[:size]

    def ask(self, words: str) -> str:
        """Send a request and return what comes back without number and checksum."""
        self._sequence = (self._sequence + 1) % 256
        body = f"#{self._sequence:02X} {words}"
        self.take()
        self.send(f"{body}*{crc32(body.encode()):08X}\n".encode())
        answers = [line for line in self.take().decode().splitlines() if line.startswith("=")]
        assert len(answers) == 1, answers
        assert answers[0].startswith(f"={self._sequence:02X} ")
        return answers[0][4:-9]

    def contact(self, *, closed: bool) -> None:
        """Turn the button's contact."""
        self._board.board_contact(closed)

    def analog(self, temperature: int, supply: int) -> None:
        """Set both inputs' counts of 1024, and convert them often enough."""
        self._board.board_analog(temperature, supply)

    def ticks(self, count: int) -> None:
        """Set the clock's ticks of 4 µs within the millisecond."""
        self._board.board_ticks(count)

    def duties(self) -> list[float]:
        """Return the duty at the four outputs (bleach/field, spot, red/green, fixation), 0 to 1."""
        steps = (ctypes.c_uint32 * 4)()
        self._board.board_outputs(steps)
        return [steps[0] / 2048, steps[1] / 8192, steps[2] / 8192, steps[3] / 2048]

    def pins(self, port: str) -> int:
        """Return the levels of a port's outputs."""
        return int(self._board.board_port(ord(port)) & self._board.board_directions(ord(port)) & 0xFF)

    def register(self, name: str) -> int:
        """Return what stands in a register of the microcontroller."""
        wide = name in ("OCR1A", "OCR1B", "UBRR0", "ADC")
        return int((ctypes.c_uint16 if wide else ctypes.c_uint8).in_dll(self._board, name).value)
