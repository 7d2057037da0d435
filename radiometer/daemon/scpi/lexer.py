"""Splits a program message into units: header and arguments (IEEE 488.2, chapter 7)."""

from __future__ import annotations

import re
from dataclasses import dataclass
from enum import Enum, auto
from typing import Final

from radiometer.daemon.scpi.errors import ScpiError

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
