"""Turns what a file states (a number, its unit, a word for "unknown") into a value in a known unit, or refuses it.

Every reader of other people's files asks this module; no reader has units of its own. The rules:

* A unit comes from the file: a keyword, a header cell, a type tag, or the definition of the format.
* A number for "unknown" (65535, 999, −999, −1, blank) gives no value, and a doubt is reported.
* A unit that is missing or not known stops the reader. The error names the option that settles it.
"""

from __future__ import annotations

import math
import re
import unicodedata
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import Any, Final

from radiometer.data.storage import read_yaml
from radiometer.errors import ConfigurationError, UnsettledError, UsageError

MAP_FORMAT: Final = "radiometer-import-map/1"
BASE_ISO: Final = 100.0  # the ISO speed that counts as 0 dB
ZERO_CELSIUS_K: Final = 273.15
_LONGEST_NUMBER: Final = 40  # characters; a fraction of 10^99999999 would fill the memory
_HUGE_POWER: Final = re.compile(r"[eE][+-]?0*\d{3}")
_PREFIXES: Final = {"k": 1e3, "": 1.0, "d": 1e-1, "c": 1e-2, "m": 1e-3, "u": 1e-6, "n": 1e-9, "p": 1e-12}


@dataclass(frozen=True, slots=True)
class Unit:
    """A unit of a quantity.

    Attributes:
        quantity: Name of the quantity, a key of `QUANTITIES`.
        name: How the unit is reported.
        to_base: Turns a number in this unit into one in the quantity's base unit.
    """

    quantity: str
    name: str
    to_base: Callable[[float], float]


@dataclass(frozen=True, slots=True)
class Quantity:
    """A quantity that files state.

    Attributes:
        base: Its base unit.
        spellings: Function into the base unit by spelling, in normal form (`_normal`).
        unknown: Numbers that mean "unknown".
        low: Least value in the base unit; anything below means "unknown".
        high: Greatest value in the base unit; anything above means "unknown".
    """

    base: str
    spellings: Mapping[str, Callable[[float], float]]
    unknown: frozenset[float] = frozenset()
    low: float = -math.inf
    high: float = math.inf


def _times(factor: float, offset: float = 0.0) -> Callable[[float], float]:
    return lambda value: value * factor + offset


def _all(spellings: str, convert: Callable[[float], float]) -> dict[str, Callable[[float], float]]:
    return dict.fromkeys(spellings.split("|"), convert)


def _decibel(reference: float) -> Callable[[float], float]:
    """Return the gain in dB of amplitude of a factor or speed."""
    return lambda value: 20.0 * math.log10(value / reference) if value > 0 else math.nan


# OME's UnitsTime (OME schema 2016-06) and the FITS standard 4.0, table 34, are covered; "m" is minute or metre: unknown.
_TIME: Final = {
    **{f"{p}s": _times(f) for p, f in _PREFIXES.items()},
    **_all("sec|secs|second|seconds|sekunden", _times(1.0)),
    **_all("msec|msecs|millisec|millisecond|milliseconds", _times(1e-3)),
    **_all("usec|usecs|microsec|microsecond|microseconds", _times(1e-6)),
    **_all("nsec|nanosecond|nanoseconds", _times(1e-9)),
    **_all("min|mins|minute|minutes", _times(60.0)),
    **_all("h|hour|hours", _times(3600.0)),
    **_all("d|day|days", _times(86_400.0)),
}
_TEMPERATURE: Final = {
    **_all("C|degC|deg C|degree C|degrees C|celsius|degree celsius|degrees celsius|deg celsius", _times(1.0)),
    **_all("K|kelvin|kelvins|deg K|degK|degrees K", _times(1.0, -ZERO_CELSIUS_K)),
    **_all("F|degF|deg F|fahrenheit", _times(5.0 / 9.0, -160.0 / 9.0)),
}
_GAIN: Final = {
    **_all("dB|db|DB|decibel|decibels", _times(1.0)),
    **_all("01dB|01db", _times(0.1)),  # as in column names, where a point is no letter
    **_all("x|factor|linear", _decibel(1.0)),
    **_all("iso|ISO", _decibel(BASE_ISO)),
}
_CONVERSION: Final = {
    **_all(
        "e/DN|e-/DN|e/ADU|e-/ADU|e/adu|e-/adu|E/ADU|el/ADU|el/adu|electron/adu|electron/ADU|electrons/adu|electrons/ADU|"
        "electrons/DN|electrons per adu|electrons per ADU|photo-electrons per ADU|electrons per DN|e/count|e-/count|"
        "electron|electrons",
        _times(1.0),
    ),
    **_all("DN/e|DN/e-|ADU/e|ADU/e-|adu/e-|DN/electron|ADU/electron", lambda value: 1.0 / value if value else math.nan),
}
_LUMINANCE: Final = {
    **_all(
        # "cd" alone: in a column of luminance nothing else can be meant.
        "cd|cd/m2|cd/m^2|cd m2|cd m-2|cd m^-2|cd*m-2|cd.m-2|cd per m2|cd/sqm|cd/qm|nit|nits|lm/sr/m2|candela/m2", _times(1.0)
    ),
    **_all("mcd/m2|mcd m2|mcd m-2|mnit", _times(1e-3)),
    **_all("kcd/m2|kcd m2", _times(1e3)),
    **_all("fL|ftL|ft-L|footlambert|footlamberts|foot-lambert", _times(3.4262590996)),  # 1/π cd·ft⁻²
}
_WAVELENGTH: Final = {
    **_all("nm|nanometre|nanometer|nanometres|nanometers", _times(1.0)),
    **_all("um|micron|microns|micrometre|micrometer", _times(1e3)),
    **_all("Å|A|angstrom|angstroms|ångström", _times(0.1)),
    **_all("m", _times(1e9)),
}
# Drive levels of a screen as a share of full drive.
_LEVEL: Final = {
    **_all("8bit|8 bit|8-bit|0-255|0 255|of 255|/255", _times(1.0 / 255.0)),
    **_all("10bit|10 bit|10-bit|0-1023", _times(1.0 / 1023.0)),
    **_all("%|percent|per cent|pct|0-100", _times(0.01)),
    **_all("share|fraction|0-1|normalised|normalized|of 1", _times(1.0)),
}
# Gain steps by the maker's name in the header. ZWO: "ASI Cameras software development kit", ASI_GAIN, tenths of a dB.
# QHY, Atik, Touptek and Player One count in steps that differ between models: their unit is unknown.
_MAKERS_GAIN: Final = {"ZWO": "0.1dB", "ASI": "0.1dB"}
# The sentinels: 65535 and 4294967295 are full 16- and 32-bit counters, the others are what makers' programs write.
_COUNTERS: Final = frozenset({65_535.0, 4_294_967_295.0, -32_768.0, -1.0, -999.0, -9999.0})
QUANTITIES: Final[Mapping[str, Quantity]] = {
    "exposure": Quantity("s", _TIME, _COUNTERS, low=0.0),
    "time": Quantity("s", _TIME),
    # No image sensor works below 1 K or above 150 °C; −1 °C is a temperature.
    "temperature": Quantity(
        "degC", _TEMPERATURE, (_COUNTERS - {-1.0}) | {999.0, 9999.0}, low=1.0 - ZERO_CELSIUS_K, high=150.0
    ),
    "gain": Quantity("dB", _GAIN, _COUNTERS | {999.0}),
    "iso": Quantity("ISO", {"ISO": _times(1.0), "iso": _times(1.0)}, _COUNTERS | {0.0}, low=1.0),
    "conversion_gain": Quantity("e-/DN", _CONVERSION, _COUNTERS | {0.0, 999.0}, low=0.0),
    "read_noise": Quantity("e-", _all("e|e-|electron|electrons|electrons rms|e- rms", _times(1.0)), _COUNTERS, low=0.0),
    "f_number": Quantity("1", _all("1|f", _times(1.0)), _COUNTERS | {0.0}, low=0.0),
    "black_level": Quantity("DN", _all("DN|ADU|adu|dn|counts", _times(1.0)), _COUNTERS, low=0.0),
    "luminance": Quantity("cd/m2", _LUMINANCE, frozenset({-1.0, -999.0}), low=0.0),
    "wavelength": Quantity("nm", _WAVELENGTH, low=0.0),
    "level": Quantity("share", _LEVEL, low=0.0),
    "number": Quantity("1", {"1": _times(1.0)}),
    "text": Quantity("text", {}),
}
# What a user may map, and the quantity of each.
FACTS: Final[Mapping[str, str]] = {
    **{name: name for name in QUANTITIES if name not in ("number", "text", "time", "level", "wavelength")},
    "timestamp": "time", "kind": "text", "filter": "text", "model": "text", "serial": "text", "mode": "text",
    "level": "level", "wavelength": "wavelength", "power": "number", "number": "number", "mean": "number", "variance": "number",
    "sigma": "number", "frames": "number", "pixels": "number", "photons": "number", "source_level": "number",
}  # fmt: skip
_MISSING: Final = frozenset(
    {"", "-", "--", "?", "n/a", "na", "nan", "none", "null", "unknown", "undef", "undefined", "#n/a", "inf", "-inf"}
)
_NUMBER: Final = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_WRITTEN: Final = re.compile(rf"(?P<prefix>f/)?(?P<number>{_NUMBER}(?:\s*/\s*{_NUMBER})?)\s*(?P<unit>[^\d\s].*)?")
_COUNTED_UNIT: Final = re.compile(rf"(?P<count>{_NUMBER})\s*(?P<unit>[^\d\s.].*)")
_BRACKETS: Final = re.compile(r"[\[(<{]([^\])>}]*)[\])>}]")


def _normal(spelling: str) -> str:
    """Return a unit's spelling with one sign for micro (U+00B5 and U+03BC), plain powers and single blanks."""
    text = unicodedata.normalize("NFKC", spelling).strip().strip(".").replace("μ", "u").replace("µ", "u")
    text = text.replace("°", "deg ").replace("·", " ").replace("⁻", "-").replace("−", "-").replace("^", "")
    return re.sub(r"\s+", " ", re.sub(r"\bdeg (?=[CFK]\b)", "deg", text)).strip()


def unit_of(spelling: str, quantity: str) -> Unit | None:
    """Return the unit of a quantity that a spelling names, such as "ms", "0.1dB" or "100 ns"; None where it names none.

    Capital letters count where they tell units apart: "Ms" is a megasecond and not known, "SEC" is a second.
    """
    text = _normal(spelling)
    known = QUANTITIES[quantity].spellings
    for candidate in (text, text.replace("_", "/"), text.replace("_", " ")):
        if candidate in known:
            return Unit(quantity, spelling.strip(), known[candidate])
    lower = text.lower()
    matches = {id(convert): convert for name, convert in known.items() if name.lower() == lower}
    # Where case tells a prefix (mS, Ms, MS) or a name (A is ångström, a is none), it counts.
    by_case = (len(text) == 2 and quantity in ("exposure", "time")) or (len(text) == 1 and quantity == "wavelength")
    if len(matches) == 1 and not by_case:
        return Unit(quantity, spelling.strip(), next(iter(matches.values())))
    counted = _COUNTED_UNIT.fullmatch(text)
    if counted and (inner := unit_of(counted["unit"], quantity)) is not None:
        count = float(counted["count"])
        return Unit(quantity, spelling.strip(), lambda value: inner.to_base(value * count))
    return None


def gain_unit_of_maker(camera: str) -> str:
    """Return the unit in which a camera's maker counts gain, by the camera's name; "" where it is not known."""
    return next((unit for maker, unit in _MAKERS_GAIN.items() if re.search(rf"\b{maker}(?=\b|\d)", camera)), "")


def is_unknown(written: Any) -> bool:
    """Tell whether what a file states is a blank or a word for "unknown"."""
    if written is None or isinstance(written, bool):
        return True
    if isinstance(written, float) and not math.isfinite(written):
        return True
    return isinstance(written, str) and written.strip().strip("\x00").lower() in _MISSING


def heading_parts(heading: str, quantity: str) -> tuple[str, Unit | None, str]:
    """Return a column's plain name without its unit, the unit where it is known, and the unit as written.

    `exposure_ms`, `Exposure (ms)`, `exposure [µs]`, `t/ms`, `t in ms` and `ms` alone are understood.
    """
    bracketed = _BRACKETS.search(heading)
    if bracketed and bracketed[1].strip():
        rest = heading[: bracketed.start()] + heading[bracketed.end() :]
        return plain_name(rest), unit_of(bracketed[1], quantity), bracketed[1].strip()
    if (whole := unit_of(heading, quantity)) is not None:
        return "", whole, heading.strip()
    for separator in (" in ", "/", "_", " ", ",", "-"):
        name, _, unit_text = heading.partition(separator)
        while unit_text:
            if name.strip() and (unit := unit_of(unit_text.strip("_ "), quantity)) is not None:
                return plain_name(name), unit, unit_text.strip("_ ")
            more, _, unit_text = unit_text.partition(separator)
            name = f"{name}{separator}{more}"
    return plain_name(heading), None, ""


def plain_name(name: str) -> str:
    """Return a name in lower case, with underscores for what is no letter or digit."""
    text = unicodedata.normalize("NFKC", name.strip()).lower().replace("μ", "u").replace("°", "")
    return "_".join("".join(c if c.isalnum() else " " for c in text).split())


def unit_in_words(comment: str, quantity: str) -> tuple[Unit | None, str]:
    """Return the unit that a comment names, and its spelling; (None, spelling) where it names several or an unknown one.

    A unit in square brackets counts first (FITS standard 4.0, section 4.3.2); then one in other brackets; then words
    such as "seconds", "in ms", "degrees C", "electrons per ADU".
    """
    for found in re.finditer(r"[\[(]([^\])]*)[\])]", comment):
        if (unit := unit_of(found[1], quantity)) is not None:
            return unit, found[1].strip()
        # Letters alone in square brackets are a unit by the standard, though one that is not known.
        if comment.lstrip().startswith("[") and re.fullmatch(r"\s*[^\W\d_]{1,12}(/[\w-]+)?\s*", found[1]):
            return None, found[1].strip()
    text = _normal(comment)
    spellings = [s for s in QUANTITIES[quantity].spellings if len(s) > 3 or "/" in s or s in _SURE_WORDS]
    named: dict[str, Unit] = {}
    for spelling in sorted(spellings, key=len, reverse=True):
        pattern = rf"(?<![\w/]){re.escape(spelling)}(?![\w/])"
        if re.search(pattern, text, re.IGNORECASE if len(spelling) > 3 else 0) and (unit := unit_of(spelling, quantity)):
            text = re.sub(pattern, " ", text, flags=re.IGNORECASE)
            named[spelling] = unit
    found_in = re.search(r"\b(?:in|deg|degrees?)\s+([a-zA-Z]{1,3})\b", text)
    if found_in and (unit := unit_of(found_in[1], quantity)) is not None:
        named[found_in[1]] = unit
    sizes = {unit.to_base(1.0) for unit in named.values()}
    if len(sizes) == 1:
        return next(iter(named.items()))[1], next(iter(named))
    return None, ", ".join(named)


_SURE_WORDS: Final = ("ms", "us", "ns", "sec", "dB", "nm", "K", "degC")


@dataclass(frozen=True, slots=True)
class Statement:
    """One thing that a file states.

    Attributes:
        written: The value as written.
        unit: Its unit as the file states it; "" where it states none.
        comment: What the file says of it in words, where a unit may stand.
    """

    written: Any
    unit: str = ""
    comment: str = ""


def value_of(
    statement: Statement,
    fact: str,
    place: str,
    doubts: list[str],
    *,
    defined: str = "",
    where: str = "",
) -> float | None:
    """Return what a file states of a fact in the base unit of its quantity; None where it is unknown.

    Args:
        statement: What stands there.
        fact: Name of the fact, a key of `FACTS`.
        place: Keyword, tag or column, for messages.
        doubts: Lines to which is added what is reported.
        defined: Unit that the format's definition gives where the file states none; "" where it gives none.
        where: The file, for messages.

    Raises:
        UnsettledError: If the unit is missing, not known, or contradicts itself; the message names the option.
    """
    quantity = FACTS.get(fact, fact)
    if is_unknown(statement.written):
        return None
    try:
        value, own_unit = read_number(str(statement.written))
    except ValueError as error:
        doubts.append(f"{place} states {str(statement.written).strip()!r}, which is no number ({error}): {fact} unknown")
        return None
    unit = _unit_stated(statement, own_unit, quantity, fact, place, defined, where)
    base = unit.to_base(value)
    limits = QUANTITIES[quantity]
    if value in limits.unknown or not math.isfinite(base) or not limits.low <= base <= limits.high:
        doubts.append(f"{place} states {value:g}{_of_unit(unit)}, which means no {fact} is known: it is left out")
        return None
    return base


def _of_unit(unit: Unit) -> str:
    return f" {unit.name}" if unit.name not in ("", "1") else ""


def _unit_stated(
    statement: Statement, own_unit: str, quantity: str, fact: str, place: str, defined: str, where: str
) -> Unit:
    """Return the one unit that number, header and comment name, else the defined one."""
    stated: dict[str, Unit] = {}
    for spelling in filter(None, (own_unit, statement.unit)):
        unit = unit_of(spelling, quantity)
        if unit is None:
            raise UnsettledError.of_unit(where, place, statement.written, spelling, fact, tuple(_names(quantity)))
        stated[spelling] = unit
    unit, spelling = unit_in_words(statement.comment, quantity) if statement.comment else (None, "")
    if unit is not None:
        stated[spelling] = unit
    elif spelling:
        raise UnsettledError.of_unit(where, place, statement.written, spelling, fact, tuple(_names(quantity)))
    probe = 1.0 if quantity != "conversion_gain" else 2.0
    if len({round(u.to_base(probe), 12) for u in stated.values()}) > 1:
        both = " and ".join(map(repr, stated))
        raise UnsettledError.of_unit(where, place, statement.written, both, fact, tuple(_names(quantity)))
    if stated:
        return next(iter(stated.values()))
    if quantity == "number":
        defined = "1"
    named = unit_of(defined, quantity) if defined else None
    if named is None:
        raise UnsettledError.of_unit(where, place, statement.written, "", fact, tuple(_names(quantity)))
    return named


def _names(quantity: str) -> Iterable[str]:
    """Return the first spelling of each unit, as an offer."""
    seen: list[float] = []
    for spelling, convert in QUANTITIES[quantity].spellings.items():
        if (size := convert(2.0)) not in seen:
            seen.append(size)
            yield spelling


def read_number(text: str) -> tuple[float, str]:
    """Return a number and the unit after it: "0.004", "1/250 s", "f/8", "12 ms", "0,5".

    Raises:
        ValueError: If it is no number, or a comma in it may be a decimal mark or part thousands.
    """
    cleaned = text.strip().strip("\x00").strip()
    if re.fullmatch(r"[-+]?\d+,\d+(?:\D.*)?", cleaned):
        if re.fullmatch(r"[-+]?[1-9]\d{0,2},\d{3}(?:\D.*)?", cleaned):
            raise ValueError("its comma may be a decimal mark or part thousands")
        cleaned = cleaned.replace(",", ".", 1)
    found = _WRITTEN.fullmatch(cleaned)
    if found is None or len(found["number"]) > _LONGEST_NUMBER or _HUGE_POWER.search(found["number"]):
        raise ValueError(f"{text.strip()[:_LONGEST_NUMBER]!r} is not understood")
    number = found["number"].replace(" ", "")
    try:
        value = float(Fraction(number)) if "/" in number else float(number)
    except ZeroDivisionError as error:
        raise ValueError(f"{number} divides by zero") from error
    if not math.isfinite(value):
        raise ValueError(f"{number} is not finite")
    return value, (found["unit"] or "").strip()


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
    """Where a user states that facts stand.

    Attributes:
        places: Places by fact, the first that a file has counts.
        demanded: Facts of which every file must have one of the places (those given one by one, not by a file).
    """

    places: Mapping[str, tuple[Place, ...]] = field(default_factory=dict)
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
                raise UsageError(f"--map {text!r}: expected FACT=PLACE:UNIT, such as exposure=IMG_EXP:ms, or a YAML file")
            places[fact.strip()] = (_checked(fact.strip(), place, f"--map {text!r}"),)
            demanded.add(fact.strip())
        return cls(places, frozenset(demanded))

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
            raise UnsettledError(f"{where}: states nothing under {named}, which --map {fact} names; it has {_some(header)}")
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
        header: What the file states.
        places: Where the format has it, the best first, each with the unit that its definition gives.
        mapped: Where the user states that facts stand.
        doubts: Lines to which is added what is reported.
        where: The file, for messages.

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
        offered = ", ".join(_names(FACTS[fact]))
        raise UsageError(f"{where}: {place.unit!r} is no unit of {fact}; choose from {offered}")
    return place


def _from_file(path: Path) -> dict[str, tuple[Place, ...]]:
    content = read_yaml(path)
    entries = content.get("map")
    if content.get("format") != MAP_FORMAT or not isinstance(entries, dict):
        raise ConfigurationError(f"{path}: expected `format: {MAP_FORMAT}` and `map:` with facts and their places")
    return {
        str(fact): tuple(
            _checked(str(fact), str(text), str(path)) for text in (found if isinstance(found, list) else [found])
        )
        for fact, found in entries.items()
    }
