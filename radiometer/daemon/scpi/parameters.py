"""Kinds of parameters: how each is read, refused and described."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final, Literal, Protocol

from radiometer.daemon.scpi.errors import ScpiError
from radiometer.daemon.scpi.lexer import Argument, Kind
from radiometer.daemon.station import Station

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
