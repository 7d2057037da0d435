"""Turns what a file states (a number, its unit, a word for "unknown") into a value in a known unit, or refuses it.

Every reader of other people's files asks this module; no reader has separate units.

A unit comes from the file: a keyword, a header cell, a type tag, or the definition of the format. A number for
"unknown" (65535, 999, −999, −1, blank) gives no value, and a doubt is reported. A unit that is missing or not known
stops the reader. The error names the option that settles it.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from radiometer.data.storage import read_yaml
from radiometer.data.validation import refuse_unknown
from radiometer.errors import ConfigurationError, UnsettledError, UsageError
from radiometer.plausible import PLAUSIBLE
from radiometer.units import Unit, read_number, unit_in_words, unit_names, unit_of

MAP_FORMAT: Final = "radiometer-import-map/1"


@dataclass(frozen=True, slots=True)
class Unknown:
    """What means "unknown" for a quantity."""

    numbers: frozenset[float] = frozenset()  # numbers as written
    low: float = -math.inf  # least value in the base unit; anything below means "unknown"
    high: float = math.inf  # greatest value in the base unit; anything above means "unknown"

    @classmethod
    def outside(cls, quantity: str, numbers: frozenset[float]) -> Unknown:
        """Return what is outside the plausible range of a quantity, and some numbers."""
        return cls(numbers, PLAUSIBLE[quantity].low, PLAUSIBLE[quantity].high)


# Gain steps by the maker's name in the header. ZWO: "ASI Cameras software development kit", ASI_GAIN, tenths of a dB.
# QHY, Atik, Touptek and Player One count in steps that differ between models: their unit is unknown.
_MAKERS_GAIN: Final = {"ZWO": "0.1dB", "ASI": "0.1dB"}
# The sentinels: 65535 and 4294967295 are full 16- and 32-bit counters, the others are what makers' programs write.
_COUNTERS: Final = frozenset({65_535.0, 4_294_967_295.0, -32_768.0, -1.0, -999.0, -9999.0})
_MOST_DN: Final = 4_294_967_295.0  # of 32 bits
UNKNOWN: Final[Mapping[str, Unknown]] = {
    "exposure": Unknown.outside("exposure", _COUNTERS),
    # −1 °C is a temperature.
    "temperature": Unknown.outside("temperature", (_COUNTERS - {-1.0}) | {999.0, 9999.0}),
    "gain": Unknown.outside("gain", _COUNTERS | {999.0}),
    "iso": Unknown.outside("iso", _COUNTERS | {0.0}),
    "conversion_gain": Unknown.outside("conversion_gain", _COUNTERS | {0.0, 999.0}),
    "read_noise": Unknown.outside("read_noise", _COUNTERS),
    "f_number": Unknown.outside("f_number", _COUNTERS | {0.0}),
    "black_level": Unknown(_COUNTERS, low=0.0, high=_MOST_DN),
    "luminance": Unknown.outside("luminance", frozenset({-1.0, -999.0})),
    "wavelength": Unknown(low=0.0),
    "level": Unknown(low=0.0),
}
# What a user may map, and the quantity of each.
FACTS: Final[Mapping[str, str]] = {
    **{name: name for name in UNKNOWN},
    **dict.fromkeys(("kind", "filter", "model", "serial", "mode"), "text"),
    **dict.fromkeys(
        ("power", "number", "mean", "variance", "sigma", "frames", "pixels", "photons", "source_level"), "number"
    ),
    **dict.fromkeys(("timestamp", "time"), "time"),
    # Of thresholds over time, and of logs with a reference meter.
    "threshold": "threshold",
    "reference": "reference",
    **dict.fromkeys(("value", "colour"), "number"),
    "night": "text",
    "u_reference": "u_relative",
}
_MISSING: Final = frozenset(
    {"", "-", "--", "?", "n/a", "na", "nan", "none", "null", "unknown", "undef", "undefined", "#n/a", "inf", "-inf"}
)


def gain_unit_of_maker(camera: str) -> str:
    """Return the unit in which a camera's maker counts gain, by the camera's name; "" where it is not known."""
    return next((unit for maker, unit in _MAKERS_GAIN.items() if re.search(rf"\b{maker}(?=\b|\d)", camera)), "")


def is_unknown(written: Any) -> bool:
    """Return whether what a file states is a blank or a word for "unknown"."""
    if written is None or isinstance(written, bool):
        return True
    if isinstance(written, float) and not math.isfinite(written):
        return True
    return isinstance(written, str) and written.strip().strip("\x00").lower() in _MISSING


@dataclass(frozen=True, slots=True)
class Statement:
    """One thing that a file states."""

    written: Any  # the value as written
    unit: str = ""  # its unit as the file states it; "" where it states none
    comment: str = ""  # what the file says of it in words, where a unit may stand


def value_of(
    statement: Statement,
    fact: str,
    place: str,
    doubts: list[str],
    *,
    defined: str = "",
    where: str = "",
    has_option: bool = True,
) -> float | None:
    """Return what a file states of a fact in the base unit of its quantity; None where it is unknown.

    Args:
        fact: Name of the fact, a key of `FACTS`.
        doubts: Lines to which is added what is reported.
        defined: Unit that the format's definition gives where the file states none; "" where it gives none.
        has_option: Whether the command of this reader has the option --map.

    Raises:
        UnsettledError: If the unit is missing, not known, or contradicts itself; the message names the way out.
    """
    quantity = FACTS.get(fact, fact)
    if is_unknown(statement.written):
        return None
    try:
        value, own_unit = read_number(str(statement.written))
    except ValueError as error:
        doubts.append(
            f"{place} states {str(statement.written).strip()!r}, which is no number ({error}): {fact} unknown"
        )
        return None
    unit = unit_stated(statement, own_unit, fact, place, defined, where, has_option=has_option)
    base = unit.to_base(value)
    limits = UNKNOWN.get(quantity, Unknown())
    if value in limits.numbers or not math.isfinite(base) or not limits.low <= base <= limits.high:
        doubts.append(f"{place} states {value:g}{_of_unit(unit)}, which means no {fact} is known: it is left out")
        return None
    return base


def _of_unit(unit: Unit) -> str:
    return f" {unit.name}" if unit.name not in ("", "1") else ""


def unit_stated(
    statement: Statement,
    own_unit: str,
    fact: str,
    place: str,
    defined: str = "",
    where: str = "",
    *,
    has_option: bool = True,
) -> Unit:
    """Return the one unit that number, header and comment name, else the defined one.

    Raises:
        UnsettledError: If there is none, or several.
    """
    quantity = FACTS.get(fact, fact)

    def unsettled(spelling: str) -> UnsettledError:
        offered = tuple(unit_names(quantity)) if has_option else ()
        return UnsettledError.of_unit(where, place, statement.written, spelling, fact, offered)

    stated: dict[str, Unit] = {}
    for spelling in filter(None, (own_unit, statement.unit)):
        unit = unit_of(spelling, quantity)
        if unit is None:
            raise unsettled(spelling)
        stated[spelling] = unit
    unit, spelling = unit_in_words(statement.comment, quantity) if statement.comment else (None, "")
    if unit is not None:
        stated[spelling] = unit
    elif spelling:
        raise unsettled(spelling)
    probe = 1.0 if quantity != "conversion_gain" else 2.0
    if len({round(u.to_base(probe), 12) for u in stated.values()}) > 1:
        both = " and ".join(map(repr, stated))
        raise unsettled(both)
    if stated:
        return next(iter(stated.values()))
    if quantity == "number":
        defined = "1"
    named = unit_of(defined, quantity) if defined else None
    if named is None:
        raise unsettled("")
    return named


@dataclass(frozen=True, slots=True)
class Place:
    """Where a fact stands: keyword, tag or column, and its unit where that is given with it."""

    name: str
    unit: str = ""

    @classmethod
    def parse(cls, text: str) -> Place:
        """Return the place of "EXPTIME", "IMG_EXP:ms" or "0.01:s" (a number that is true of all frames)."""
        name, _, unit = text.rpartition(":") if ":" in text else (text, "", "")
        return cls(name.strip(), unit.strip())

    @property
    def constant(self) -> float | None:
        """Return the number where the place is one."""
        try:
            return read_number(self.name)[0] if self.name[:1].isdigit() or self.name[:1] in "+-." else None
        except ValueError:
            return None

    def __str__(self) -> str:
        return f"{self.name}:{self.unit}" if self.unit else self.name


@dataclass(frozen=True, slots=True)
class StatementMap:
    """Where a user states that facts stand."""

    # Places by fact, the first that a file has counts
    places: Mapping[str, tuple[Place, ...]] = field(default_factory=dict)
    # Facts of which every file must have one of the places (those given one by one, not by a file)
    demanded: frozenset[str] = frozenset()

    @classmethod
    def parse(cls, texts: Sequence[str]) -> StatementMap:
        """Return the map of words such as "exposure=IMG_EXP:ms" and of YAML files that hold such entries.

        Raises:
            UsageError: If a word has no such form, or a fact or unit is not known.
            ConfigurationError: If a file has another form.
        """
        places: dict[str, tuple[Place, ...]] = {}
        demanded = set[str]()
        for text in texts:
            fact, sign, place = text.partition("=")
            if not sign and text.lower().endswith((".yaml", ".yml")):
                places |= {fact: found for fact, found in _from_file(Path(text)).items() if fact not in demanded}
                continue
            if not sign or not place.strip():
                raise UsageError(
                    f"--map {text!r}: expected FACT=PLACE:UNIT, such as exposure=IMG_EXP:ms, or a YAML file"
                )
            places[fact.strip()] = (_checked(fact.strip(), place, f"--map {text!r}"),)
            demanded.add(fact.strip())
        return cls(places, frozenset(demanded))

    @classmethod
    def of(cls, mapped: StatementMap | Sequence[str]) -> StatementMap:
        """Return a map, or that of words. Raises as `parse`."""
        return mapped if isinstance(mapped, StatementMap) else cls.parse(mapped)

    def to_mapping(self) -> dict[str, Any]:
        """Return the map as a file of it holds it: what `--map FILE` reads again."""
        return {
            "format": MAP_FORMAT,
            "map": {fact: [str(place) for place in found] for fact, found in self.places.items()},
        }

    def words(self) -> tuple[str, ...]:
        """Return the map in the words of `--map`, for a record."""
        return tuple(f"{fact}={place}" for fact, found in self.places.items() for place in found)

    def find(self, fact: str, header: Mapping[str, Statement], where: str) -> tuple[Place, Statement] | None:
        """Return the mapped place of a fact that a header has, and what stands there; None where none is mapped.

        Raises:
            UnsettledError: If the user states a place that the header has not.
        """
        for place in self.places.get(fact, ()):
            if place.constant is not None:
                return place, Statement(place.constant, place.unit)
            found = _entry(header, place.name)
            if found is not None:
                # The user's word on the unit counts above the file's.
                return place, Statement(found.written, place.unit) if place.unit else found
        if fact in self.demanded:
            named = ", ".join(str(p) for p in self.places[fact])
            raise UnsettledError(
                f"{where}: states nothing under {named}, which --map {fact} names; it has {_some(header)}"
            )
        return None


def first_stated(
    fact: str,
    header: Mapping[str, Statement],
    places: Iterable[Place],
    mapped: StatementMap,
    doubts: list[str],
    where: str,
) -> tuple[str, float] | None:
    """Return where a fact stands first and its value in the base unit: the user's place, else the format's own.

    Args:
        fact: A key of `FACTS`.
        places: Where the format has it, the best first, each with the unit that its definition gives.
        mapped: Where the user states that facts stand.
        doubts: Lines to which is added what is reported.

    Raises:
        UnsettledError: If a unit is missing or not known, or the user's place is not there.
    """
    if (found := mapped.find(fact, header, where)) is not None:
        place, statement = found
        value = value_of(statement, fact, place.name, doubts, where=where)
        return None if value is None else (f"{place} (--map)", value)
    for place in places:
        if place.name in header:
            value = value_of(header[place.name], fact, place.name, doubts, defined=place.unit, where=where)
            if value is not None:
                return place.name, value
    return None


def text_stated(
    fact: str, header: Mapping[str, Statement], places: Iterable[str], mapped: StatementMap, where: str
) -> tuple[str, str] | None:
    """Return where a fact in words stands first, and the words; None where nothing does."""
    if (found := mapped.find(fact, header, where)) is not None and not is_unknown(found[1].written):
        return found[0].name, str(found[1].written).strip("\x00 ")
    for place in places:
        if place in header and not is_unknown(words := str(header[place].written).strip("\x00 ")):
            return place, words
    return None


def places(text: str) -> tuple[Place, ...]:
    """Return the places of words such as "XPOSURE:s EXPTIME:s ITIME"."""
    return tuple(Place.parse(word) for word in text.split())


def _entry(header: Mapping[str, Statement], name: str) -> Statement | None:
    if name in header:
        return header[name]
    return next((value for key, value in header.items() if key.lower() == name.lower()), None)


def _some(header: Mapping[str, Statement]) -> str:
    names = list(header)
    return ", ".join(names[:40]) + (" …" if len(names) > 40 else "")


def _checked(fact: str, text: str, where: str) -> Place:
    if fact not in FACTS:
        raise UsageError(f"{where}: {fact!r} is no fact that is read; choose from {', '.join(FACTS)}")
    place = Place.parse(str(text))
    if place.unit and unit_of(place.unit, FACTS[fact]) is None:
        if FACTS[fact] == "text":
            return Place(str(text).strip())
        offered = ", ".join(unit_names(FACTS[fact]))
        raise UsageError(f"{where}: {place.unit!r} is no unit of {fact}; choose from {offered}")
    return place


def _from_file(path: Path) -> dict[str, tuple[Place, ...]]:
    content = read_yaml(path)
    refuse_unknown(content, ("format", "map"), str(path), ConfigurationError)
    entries = content.get("map")
    if content.get("format") != MAP_FORMAT or not isinstance(entries, dict):
        raise ConfigurationError(f"{path}: expected `format: {MAP_FORMAT}` and `map:` with facts and their places")
    return {
        str(fact): tuple(
            _checked(str(fact), str(text), str(path)) for text in (found if isinstance(found, list) else [found])
        )
        for fact, found in entries.items()
    }
