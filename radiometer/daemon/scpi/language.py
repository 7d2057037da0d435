"""The language: numbers of errors (SCPI-99, 2.21), headers and arguments (IEEE 488.2, 7), how a header is found."""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Callable, Coroutine, Sequence
from dataclasses import dataclass
from enum import Enum, auto
from functools import cached_property
from typing import TYPE_CHECKING, Any, Final, Literal, Protocol

from radiometer.daemon.journal import JournalError
from radiometer.daemon.scpi import formats
from radiometer.daemon.scpi.formats import string
from radiometer.daemon.station import Station
from radiometer.errors import (
    CalibrationError,
    DeviceError,
    DeviceTimeout,
    LightEnded,
    MeasurementError,
    SettingOutOfRange,
    UnsafeStimulus,
    UsageError,
)

if TYPE_CHECKING:
    from radiometer.daemon.scpi.session import Session


MESSAGES: Final = {
    0: "No error",
    -101: "Invalid character",
    -102: "Syntax error",
    -103: "Invalid separator",
    -104: "Data type error",
    -108: "Parameter not allowed",
    -109: "Missing parameter",
    -112: "Program mnemonic too long",
    -113: "Undefined header",
    -114: "Header suffix out of range",
    -131: "Invalid suffix",
    -138: "Suffix not allowed",
    -141: "Invalid character data",
    -151: "Invalid string data",
    -161: "Invalid block data",
    -200: "Execution error",
    -213: "Init ignored",
    -221: "Settings conflict",
    -222: "Data out of range",
    -224: "Illegal parameter value",
    -225: "Out of memory",
    -230: "Data corrupt or stale",
    -240: "Hardware error",
    -241: "Hardware missing",
    -250: "Mass storage error",
    -310: "System error",
    -340: "Calibration failed",
    -350: "Queue overflow",
    -363: "Input buffer overrun",
    -365: "Time out error",
    -440: "Query UNTERMINATED after indefinite response",
}

# Bits of the standard event status register, by the hundred of the error number.
OPERATION_COMPLETE: Final = 1 << 0
_EVENT_BITS: Final = ((-499, -400, 1 << 2), (-399, -300, 1 << 3), (-299, -200, 1 << 4), (-199, -100, 1 << 5))
POWER_ON: Final = 1 << 7


class ScpiError(Exception):
    """An entry of the error queue.

    Args:
        detail: What exactly; follows the standard text after a semicolon.
    """

    def __init__(self, number: int, detail: str = "") -> None:
        self.number, self.detail = number, detail
        super().__init__(self.entry)

    @property
    def entry(self) -> str:
        """Return the reply to SYSTem:ERRor?, at most 255 characters in the quotes as the standard wants."""
        text = MESSAGES[self.number] + (f";{self.detail}" if self.detail else "")
        return f"{self.number},{string(text, longest=255)}"

    @property
    def event_bit(self) -> int:
        """Return the bit that the error sets in the standard event status register."""
        return next((bit for low, high, bit in _EVENT_BITS if low <= self.number <= high), 0)

    @property
    def is_command_error(self) -> bool:
        """Return whether the message itself is wrong, so that the rest of it is thrown away."""
        return -199 <= self.number <= -100


_MAPPING: Final[tuple[tuple[type[Exception], int], ...]] = (
    (SettingOutOfRange, -222),
    (UnsafeStimulus, -222),
    (LightEnded, -221),
    (JournalError, -250),
    (CalibrationError, -340),
    (MeasurementError, -200),
    (UsageError, -222),
    (DeviceTimeout, -365),
    (DeviceError, -240),
    (TimeoutError, -365),
)


def scpi_error(error: Exception) -> ScpiError:
    """Return the entry of the error queue for one of our own errors."""
    number = next((number for kind, number in _MAPPING if isinstance(error, kind)), -310)
    return ScpiError(number, str(error))


MAX_MNEMONIC: Final = 12  # IEEE 488.2, 7.6.1.4.1
_SPACE: Final = re.compile(r"[\x00-\x09\x0b-\x20]*")
_HEADER: Final = re.compile(r"(?:\*[A-Za-z]+|:?[A-Za-z][A-Za-z0-9_]*(?::[A-Za-z][A-Za-z0-9_]*)*)\??")
_NUMBER: Final = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[ \t]*[eE][ \t]*[+-]?\d+)?")
_SUFFIX: Final = re.compile(r"[ \t]*([A-Za-z%/][A-Za-z0-9%/.\-]*)")
_RADIX: Final = re.compile(r"#(?:[Hh]([0-9A-Fa-f]{1,16})|[Qq]([0-7]{1,21})|[Bb]([01]{1,64}))")
_WORD: Final = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
_STRING: Final = re.compile(r'"((?:[^"]|"")*)"|\'((?:[^\']|\'\')*)\'')


class Kind(Enum):
    """Kind of an argument."""

    NUMBER = auto()
    WORD = auto()
    STRING = auto()
    BLOCK = auto()


@dataclass(frozen=True, slots=True)
class Argument:
    """One argument."""

    kind: Kind  # what it is
    text: str  # number without its suffix, word, string without its quotes, or the block's bytes as Latin-1
    suffix: str = ""  # unit of a number as written, such as "ms"; "" if none


@dataclass(frozen=True, slots=True)
class Unit:
    """One program message unit."""

    header: str  # as written, without the question mark
    is_query: bool  # whether a question mark followed
    arguments: tuple[Argument, ...]  # what followed the header


def split_message(message: str) -> tuple[tuple[Unit, ...], ScpiError | None]:
    """Return the units of a message up to the first error, and that error (a ScpiError, not raised).

    Args:
        message: The message without its terminator, bytes decoded as Latin-1.
    """
    units: list[Unit] = []
    position = _skip_space(message, 0)
    try:
        while position < len(message):
            if message[position] != ";":
                unit, position = _unit(message, position)
                units.append(unit)
            if position < len(message):
                if message[position] != ";":
                    raise ScpiError(-103, f"';' expected at character {position + 1}")
                position = _skip_space(message, position + 1)
    except ScpiError as error:
        return tuple(units), error
    return tuple(units), None


def block_end(buffer: bytes | bytearray, upto: int) -> int:
    """Return where the definite-length block ends that holds byte `upto`; `upto` if none does.

    A newline inside a block is data, not the end of the message.
    """
    position = 0
    while (start := buffer.find(b"#", position, upto)) >= 0:
        if buffer.count(b'"', 0, start) % 2 or buffer.count(b"'", 0, start) % 2:
            position = start + 1
            continue
        digits = buffer[start + 1 : start + 2]
        count = int(digits) if digits.isdigit() else 0
        length = bytes(buffer[start + 2 : start + 2 + count])
        end = start + 2 + count + int(length) if count and length.isdigit() and len(length) == count else start + 1
        if end > upto:
            return end
        position = end
    return upto


def _unit(message: str, position: int) -> tuple[Unit, int]:
    match = _HEADER.match(message, position)
    if match is None:
        raise ScpiError(-101 if not message[position].isalnum() else -102, f"at character {position + 1}")
    header = match[0]
    if any(len(word) > MAX_MNEMONIC + 2 for word in header.lstrip("*:").rstrip("?").split(":")):
        raise ScpiError(-112, header[:40])
    after = match.end()
    position = _skip_space(message, after)
    arguments: list[Argument] = []
    if position < len(message) and message[position] != ";":
        if position == after:
            raise ScpiError(-103, f"after {header[:40]}")
        arguments, position = _arguments(message, position)
    return Unit(header.rstrip("?"), header.endswith("?"), tuple(arguments)), position


def _arguments(message: str, position: int) -> tuple[list[Argument], int]:
    arguments: list[Argument] = []
    while True:
        argument, position = _argument(message, position)
        arguments.append(argument)
        position = _skip_space(message, position)
        if position >= len(message) or message[position] == ";":
            return arguments, position
        if message[position] != ",":
            raise ScpiError(-103, f"',' expected at character {position + 1}")
        position = _skip_space(message, position + 1)
        if position >= len(message):
            raise ScpiError(-109, "after ','")


def _argument(message: str, position: int) -> tuple[Argument, int]:
    if match := _NUMBER.match(message, position):
        suffix = _SUFFIX.match(message, match.end())
        end = suffix.end() if suffix else match.end()
        number = re.sub(r"[ \t]", "", match[0])
        return Argument(Kind.NUMBER, number, suffix[1] if suffix else ""), end
    if match := _WORD.match(message, position):
        return Argument(Kind.WORD, match[0]), match.end()
    if message[position] in "\"'":
        match = _STRING.match(message, position)
        if match is None:
            raise ScpiError(-151, "closing quote missing")
        quote = message[position]
        return Argument(Kind.STRING, match[0][1:-1].replace(quote * 2, quote)), match.end()
    if message[position] == "#":
        return _hash_argument(message, position)
    raise ScpiError(-101, f"at character {position + 1}")


def _hash_argument(message: str, position: int) -> tuple[Argument, int]:
    if match := _RADIX.match(message, position):
        base = 16 if match[1] else 8 if match[2] else 2
        return Argument(Kind.NUMBER, str(int(match[1] or match[2] or match[3], base))), match.end()
    digits = message[position + 1 : position + 2]
    if digits == "0":
        return Argument(Kind.BLOCK, message[position + 2 :]), len(message)
    if not (digits.isascii() and digits.isdigit()):
        raise ScpiError(-161, "a digit must follow '#'")
    start = position + 2 + int(digits)
    length = message[position + 2 : start]
    if not (length.isascii() and length.isdigit()) or start + int(length) > len(message):
        raise ScpiError(-161, "block is shorter than its stated length")
    end = start + int(length)
    return Argument(Kind.BLOCK, message[start:end]), end


def _skip_space(message: str, position: int) -> int:
    match = _SPACE.match(message, position)
    return match.end() if match else position


_MULTIPLIERS: Final = {
    "S": {"": 1.0, "S": 1.0, "MS": 1e-3, "US": 1e-6, "NS": 1e-9, "MIN": 60.0},
    "DB": {"": 1.0, "DB": 1.0},
    "NM": {"": 1.0, "NM": 1.0, "UM": 1e3, "M": 1e9},
    "": {"": 1.0},
    "PCT": {"": 1.0, "PCT": 0.01, "%": 0.01},
}


class Parameter(Protocol):
    """One parameter of a command."""

    @property
    def name(self) -> str:
        """Return the name for messages and the manual."""

    @property
    def form(self) -> str:
        """Return what is accepted, for the manual."""

    def read(self, argument: Argument, station: Station) -> Any:
        """Return the value of an argument. Raises ScpiError."""


def short_form(word: str) -> str:
    """Return the capitals of a mnemonic: "EXPosure" gives "EXP"."""
    return "".join(char for char in word if not char.islower())


@dataclass(frozen=True, slots=True)
class ParameterLimits:
    """Lowest, highest and default value."""

    low: float
    high: float
    default: float


def always(low: float, high: float, default: float) -> Callable[[Station], ParameterLimits]:
    """Return limits that are the same for every instrument."""
    limits = ParameterLimits(low, high, default)
    return lambda station: limits


@dataclass(frozen=True, slots=True)
class Number:
    """A number with a unit; MINimum, MAXimum and DEFault mean the limits."""

    name: str  # name for messages
    unit: str  # key of the table of suffixes: "S", "DB", "NM", "PCT" or ""
    limits: Callable[[Station], ParameterLimits]  # returns the limits in force
    fraction: Literal["kept", "rounded", "refused"] = "kept"  # registers are rounded, as IEEE 488.2, 10.10 asks
    also: tuple[str, ...] = ()  # words that the handler gets as they are, also in place of a limit

    @property
    def form(self) -> str:
        words = "".join(f" | {word}" for word in self.also if word != "MAXimum")
        unit = {"": "", "PCT": " (fraction, or PCT)"}.get(self.unit, f" ({self.unit.lower().replace('db', 'dB')})")
        return f"<{self.name}{unit}> | MINimum | MAXimum | DEFault{words}"

    def read(self, argument: Argument, station: Station) -> float | int | str:
        if argument.kind is Kind.WORD:
            return self._word(argument.text, station)
        if argument.kind is not Kind.NUMBER:
            raise ScpiError(-104, f"{self.name}: a number is expected")
        value = self._scaled(argument)
        limits = self.limits(station)
        if not limits.low * (1 - 1e-9) <= value <= limits.high * (1 + 1e-9):
            unit = {"PCT": "", "DB": "dB"}.get(self.unit, self.unit.lower())  # a share is given as a fraction
            raise ScpiError(-222, f"{self.name} {value:g} is outside {limits.low:g} to {limits.high:g} {unit}".rstrip())
        return self._whole(value)

    def _whole(self, value: float) -> float | int:
        if self.fraction == "kept":
            return value
        if self.fraction == "refused" and value != round(value):
            raise ScpiError(-224, f"{self.name} {value:g} is no whole number")
        return round(value)

    def _scaled(self, argument: Argument) -> float:
        suffixes = _MULTIPLIERS[self.unit]
        if argument.suffix.upper() not in suffixes:
            raise ScpiError(-131 if self.unit else -138, f"{self.name}: {argument.suffix[:20]}")
        value = float(argument.text) * suffixes[argument.suffix.upper()]
        if not math.isfinite(value):
            raise ScpiError(-222, f"{self.name} is not a finite number")
        return value

    def _word(self, word: str, station: Station) -> float | int | str:
        limits = self.limits(station)
        for name in self.also:
            if word.upper() in (name.upper(), short_form(name)):
                return name
        for name, value in (("MINimum", limits.low), ("MAXimum", limits.high), ("DEFault", limits.default)):
            if word.upper() in (name.upper(), short_form(name)):
                return self._whole(value)
        raise ScpiError(-141, f"{self.name}: {word[:20]}")


@dataclass(frozen=True, slots=True)
class Boolean:
    """ON, OFF, or a number: 0 is off, all else on."""

    name: str = "state"

    @property
    def form(self) -> str:
        return "ON | OFF | 1 | 0"

    def read(self, argument: Argument, station: Station) -> bool:
        if argument.kind is Kind.WORD and argument.text.upper() in ("ON", "OFF"):
            return argument.text.upper() == "ON"
        if argument.kind is Kind.NUMBER and not argument.suffix:
            return round(float(argument.text)) != 0 if math.isfinite(float(argument.text)) else True
        raise ScpiError(-141 if argument.kind is Kind.WORD else -104, f"{self.name}: ON or OFF is expected")


@dataclass(frozen=True, slots=True)
class Text:
    """A text in quotes."""

    name: str

    @property
    def form(self) -> str:
        return f'"{self.name}"'

    def read(self, argument: Argument, station: Station) -> str:
        if argument.kind is not Kind.STRING:
            raise ScpiError(-104, f"{self.name}: a text in quotes is expected")
        return argument.text


@dataclass(frozen=True, slots=True)
class Choice:
    """One word out of a list, in its short or long form."""

    name: str
    words: tuple[str, ...]

    @property
    def form(self) -> str:
        return " | ".join(self.words)

    def read(self, argument: Argument, station: Station) -> str:
        if argument.kind is not Kind.WORD:
            raise ScpiError(-104, f"{self.name}: one of {self.form} is expected")
        for word in self.words:
            if argument.text.upper() in (word.upper(), short_form(word)):
                return word
        raise ScpiError(-224, f"{self.name}: {argument.text[:20]}; allowed is {self.form}")


Reply = str | None
Outcome = Reply | Coroutine[Any, Any, Reply]
_NODE: Final = re.compile(r"(\[?):?([A-Za-z*]+)(<n>)?(\]?)")


@dataclass(frozen=True, slots=True)
class Call:
    """One call of a command."""

    session: Session  # whose
    values: tuple[Any, ...]  # values of the arguments that were given
    channel: int = 1  # numeric suffix of the header; 1 where none was written


Handler = Callable[[Call], Outcome]


@dataclass(frozen=True, slots=True)
class Command:
    """One line of the command table; either form may be missing."""

    pattern: str  # header with its short form in capitals, optional nodes in brackets, "<n>" for a numeric suffix
    summary: str  # what it does, one or two sentences
    do: Handler | None = None  # handler of the command form
    ask: Handler | None = None  # handler of the query form
    parameters: tuple[Parameter, ...] = ()  # parameters of the command form
    required: int = -1  # how many of them must be given; -1 for all
    # Parameters of the query form, all optional unless `ask_required` says otherwise
    ask_parameters: tuple[Parameter, ...] = ()
    ask_required: int = 0  # how many parameters the query form must be given
    reply: str = ""  # form of the reply, for the manual
    example: str = ""  # a message that works on any instrument; tested
    group: str = ""  # heading in the manual

    def spellings(self) -> list[str]:
        """Return every accepted header in capitals; "<n>" means a numeric suffix, written or not."""
        choices: list[list[str]] = []
        for opened, word, numbered, _ in _NODE.findall(self.pattern):
            forms = {word.upper(), short_form(word)} if not word.startswith("*") else {word.upper()}
            forms = {form + numbered for form in forms}
            choices.append([*sorted(forms), *([""] if opened else [])])
        return [":".join(filter(None, words)) for words in itertools.product(*choices)]

    def call(self, session: Session, unit: Unit, channel: int) -> Outcome:
        """Check the arguments and run the handler. Raises ScpiError."""
        handler = self.ask if unit.is_query else self.do
        if handler is None:
            raise ScpiError(-113, f"{unit.header} has no {'query' if unit.is_query else 'command'} form")
        parameters = self.ask_parameters if unit.is_query else self.parameters
        required = self.ask_required if unit.is_query else len(parameters) if self.required < 0 else self.required
        if len(unit.arguments) > len(parameters):
            raise ScpiError(-108, f"{unit.header} takes at most {len(parameters)}")
        if len(unit.arguments) < required:
            raise ScpiError(-109, f"{unit.header} needs {parameters[len(unit.arguments)].name}")
        pairs = zip(parameters, unit.arguments, strict=False)
        values = tuple(parameter.read(argument, session.station) for parameter, argument in pairs)
        return handler(Call(session, values, channel))


class CommandTable:
    """Finds commands by header."""

    def __init__(self, commands: Sequence[Command]) -> None:
        self.commands = tuple(commands)
        self._by_spelling: dict[str, Command] = {}
        for command in commands:
            for spelling in command.spellings():
                if spelling in self._by_spelling:
                    raise ValueError(
                        f"{spelling} is a spelling of both {self._by_spelling[spelling].pattern} and {command.pattern}"
                    )
                self._by_spelling[spelling] = command

    @cached_property
    def headers(self) -> str:
        """The block that `SYSTem:HELP:HEADers?` answers: a line per command, `/qonly/` and `/nquery/` after SCPI-99."""
        lines = []
        for command in self.commands:
            form = "/nquery/" if command.ask is None else "/qonly/" if command.do is None else ""
            lines.append(f":{command.pattern}{form}" if not command.pattern.startswith("*") else command.pattern + form)
        return formats.block(("\n".join(lines) + "\n").encode())

    def find(self, header: str, path: str) -> tuple[Command, int, str]:
        """Return the command of a header, its numeric suffix, and the path for the next unit of the message.

        Args:
            path: Path left by the unit before; "" at the start of a message.

        Raises:
            ScpiError: If there is no such command.
        """
        if header.startswith("*"):
            return self._known(header.upper(), header), 1, path
        absolute = header[1:] if header.startswith(":") else f"{path}:{header}" if path else header
        spelling, channel = absolute.upper(), 1
        if spelling not in self._by_spelling and any(map(str.isdigit, spelling)):
            spelling, channel = self._with_suffix(spelling)
        elif spelling not in self._by_spelling:
            spelling = next((s for s in self._implied(spelling) if s in self._by_spelling), spelling)
        return self._known(spelling, header), channel, absolute.rpartition(":")[0]

    def _known(self, spelling: str, header: str) -> Command:
        command = self._by_spelling.get(spelling)
        if command is None:
            raise ScpiError(-113, header[:80])
        return command

    def _implied(self, spelling: str) -> list[str]:
        """Return the header with "<n>" put after each node in turn: a suffix not written is 1."""
        words = spelling.split(":")
        return [":".join([*words[: i + 1]]) + "<n>" + ":".join(["", *words[i + 1 :]]) for i in range(len(words))]

    def _with_suffix(self, spelling: str) -> tuple[str, int]:
        found = re.findall(r"([A-Z_]+)(\d+)(?=:|$)", spelling)
        if len(found) != 1 or len(found[0][1]) > 4:
            return spelling, 1
        return re.sub(r"(?<=[A-Z_])\d+(?=:|$)", "<n>", spelling), int(found[0][1])
