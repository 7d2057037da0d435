"""Units by their spellings, conversions between those of settings, and the exact values behind printed ones."""

from __future__ import annotations

import math
import re
import unicodedata
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Final, cast

PLANCK_J_S: Final = 6.62607015e-34  # SI 2019, exact
SPEED_OF_LIGHT_M_S: Final = 299_792_458.0  # exact
BOLTZMANN_J_K: Final = 1.380649e-23  # SI 2019, exact
ELEMENTARY_CHARGE_C: Final = 1.602176634e-19  # SI 2019, exact
BASE_ISO: Final = 100.0  # the ISO speed that counts as 0 dB
ZERO_CELSIUS_K: Final = 273.15
_LONGEST_NUMBER: Final = 40  # characters; a fraction of 10^99999999 would fill the memory
_HUGE_POWER: Final = re.compile(r"[eE]\+?0*\d{3}")
_TINY_POWER: Final = re.compile(r"[eE]-0*\d{3}")  # a float holds it, or its zero; a fraction would take long
_FORTRAN_POWER: Final = re.compile(r"([-+]?\d*\.\d+)([-+]\d{3})")  # which leaves out the E of three digits
_PREFIXES: Final = {"": 1.0, "m": 1e-3, "u": 1e-6, "n": 1e-9, "p": 1e-12, "c": 1e-2, "d": 1e-1, "k": 1e3}

# Half-stop dials print these, rounded so far that a third of a stop is as near. Some third-stop dials do as well.
_HALF_STOPS_S: Final = (1.5, 3.0, 1.0 / 3.0)
# What third-stop and half-stop shutter dials print, as times or as the denominators of 1/x.
DIAL_DENOMINATORS: Final = (
    1, 1.3, 1.6, 2, 2.5, 3, 3.2, 4, 5, 6, 8, 10, 13, 15, 20, 25, 30, 40, 50, 60, 80, 100, 125, 160, 200, 250, 320,
    45, 90, 180, 350, 750, 1500, 3000, 6000,
    400, 500, 640, 800, 1000, 1250, 1600, 2000, 2500, 3200, 4000, 5000, 6400, 8000, 10000, 12800, 16000, 32000,
)  # fmt: skip
_DIAL_TIMES: Final = (
    0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 1, 1.3, 1.5, 1.6, 2, 2.5, 3, 3.2, 4, 5, 6, 8, 10, 13, 15, 20, 25, 30, 60,
)  # fmt: skip
LONGEST_OF_DIAL_S: Final = 60.0  # longer ones are by hand (bulb)
_SAME_PRINT_REL: Final = 1e-3
_TELLING: Final = 0.02  # in ln of the time: dials print to 6 %, and where only one prints a time the other is 8 % off


def gain_factor(gain_db: float) -> float:
    """Return the amplitude factor of a gain in dB (20 dB is a factor of 10)."""
    return cast(float, 10.0 ** (gain_db / 20.0))


def photon_energy_j(wavelength_nm: float) -> float:
    """Return the energy in J of one photon of the given vacuum wavelength in nm."""
    return PLANCK_J_S * SPEED_OF_LIGHT_M_S / (wavelength_nm * 1e-9)


def exact_exposure_s(nominal_s: float) -> float:
    """Return the exact exposure time in s behind a printed one.

    Cameras print rounded times but run in thirds or halves of a stop about 1 s: a printed 1/60 s is 2^-6 s, a printed
    1/90 s is 2^-6.5 s.

    Args:
        nominal_s: Printed exposure time in s, above 0.

    Returns:
        The nearest 2^(k/3) s; 2^(k/2) s where that is nearer, or as near and half-stop dials print the time.

    Raises:
        ValueError: If the time is not a positive finite number.
    """
    thirds, halves = _nearest_step(nominal_s, 3), _nearest_step(nominal_s, 2)
    if any(abs(nominal_s / printed - 1.0) < _SAME_PRINT_REL for printed in _HALF_STOPS_S):
        return halves
    return min(thirds, halves, key=lambda exact: abs(math.log(exact / nominal_s)))


def is_dial_time(seconds: float) -> bool:
    """Return whether a time in s is one that a camera's dial prints."""
    close = (abs(seconds * d - 1.0) < 0.005 for d in DIAL_DENOMINATORS)
    return any(close) or any(abs(seconds / t - 1.0) < 0.005 for t in _DIAL_TIMES)


def exact_exposures_s(nominal_s: Sequence[float]) -> list[float]:
    """Return the exact exposure times in s behind those that one camera printed.

    Its dial runs in thirds or in halves of a stop. A time that both print (1/3 s, 1/6 s) is what the others show:
    with 1/5 s it is a third, with 1/90 s a half. Where they show neither, or both, it is as in `exact_exposure_s`.
    Times of which one is on no dial are no stops, and those beyond a minute are by hand: both are as printed.

    Args:
        nominal_s: Printed exposure times in s, above 0.

    Raises:
        ValueError: If a time is not a positive finite number.
    """
    ways = [{steps: _nearest_step(one, steps) for steps in (3, 2)} for one in nominal_s]
    nearer = [
        abs(math.log(way[2] / one)) - abs(math.log(way[3] / one)) for one, way in zip(nominal_s, ways, strict=True)
    ]
    shown = {3 if by > 0.0 else 2 for by in nearer if abs(by) > _TELLING}
    dial = shown.pop() if len(shown) == 1 else None
    if not all(is_dial_time(one) for one in nominal_s if one <= LONGEST_OF_DIAL_S):
        return list(nominal_s)
    return [
        one if one > LONGEST_OF_DIAL_S else exact_exposure_s(one) if dial is None or abs(by) > _TELLING else way[dial]
        for one, by, way in zip(nominal_s, nearer, ways, strict=True)
    ]


def exact_f_number(nominal: float) -> float:
    """Return the exact f-number behind a printed one (f/5.6 is 2^(5/2), f/1.7 is 2^(3/4)).

    f-numbers run in thirds or halves of a stop: N = 2^(k/6) or 2^(k/4); the nearest of both is taken.

    Args:
        nominal: Printed f-number, above 0.

    Raises:
        ValueError: If the f-number is not a positive finite number.
    """
    thirds, halves = _nearest_step(nominal, 6), _nearest_step(nominal, 4)
    return min(thirds, halves, key=lambda exact: abs(math.log(exact / nominal)))


def _nearest_step(value: float, steps_per_octave: int) -> float:
    if not (math.isfinite(value) and value > 0):
        raise ValueError(f"{value!r} is not a positive finite number")
    return float(2.0 ** (round(math.log2(value) * steps_per_octave) / steps_per_octave))


@dataclass(frozen=True, slots=True)
class Unit:
    """A unit of a quantity."""

    name: str  # how the unit is reported
    to_base: Callable[[float], float]  # turns a number in this unit into one in the quantity's base unit


def _times(factor: float, offset: float = 0.0) -> Callable[[float], float]:
    return lambda value: value * factor + offset


def _all(spellings: str, convert: Callable[[float], float]) -> dict[str, Callable[[float], float]]:
    return dict.fromkeys(spellings.split("|"), convert)


def _decibel(reference: float) -> Callable[[float], float]:
    """Return the gain in dB of amplitude of a factor or speed."""
    return lambda value: 20.0 * math.log10(value / reference) if value > 0 else math.nan


# OME's UnitsTime (schema 2016-06) and the FITS standard 4.0, table 34, are covered. "m" is minute or metre: unknown.
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
        "cd/m2|cd/m^2|cd|cd m2|cd m-2|cd m^-2|cd*m-2|cd.m-2|cd per m2|cd/sqm|cd/qm|nit|nits|lm/sr/m2|candela/m2",
        _times(1.0),
    ),
    **_all("mcd/m2|mcd m2|mcd m-2|mnit", _times(1e-3)),
    **_all("ucd/m2|ucd m2|ucd m-2", _times(1e-6)),
    **_all("kcd/m2|kcd m2", _times(1e3)),
    **_all("asb|apostilb|apostilbs", _times(1.0 / math.pi)),
    **_all("fL|ftL|ft-L|footlambert|footlamberts|foot-lambert", _times(3.4262590996)),  # 1/π cd·ft⁻²
}
_WAVELENGTH: Final = {
    **_all("nm|nanometre|nanometer|nanometres|nanometers", _times(1.0)),
    **_all("um|micron|microns|micrometre|micrometer", _times(1e3)),
    **_all("Å|A|angstrom|angstroms|ångström", _times(0.1)),
    **_all("m", _times(1e9)),
}
CD_M2_AT_0_MAG: Final = 10.8e4
"""Luminance in cd·m⁻² of 0 mag/arcsec².

Source: Unihedron, "Convert visual mags/arcsecond² to cd/m²" (unihedron.com/projects/darksky/magconv.php): after
discussions of 2005, uncertain by at least 1 %; a constant factor, which a camera's responsivity takes up.
"""
MAGNITUDE: Final = _all(
    "mag|mag/arcsec2|mag arcsec2|mag/arcsec^2|mag arcsec-2|mag per arcsec2|mpsas|msas|sqm",
    lambda value: CD_M2_AT_0_MAG * 10.0 ** min(-0.4 * value, 300.0),  # beyond it numbers of floating point end
)
"""Magnitudes per square arcsecond, as sky quality meters give them, in cd·m⁻²."""
# A trusted meter's readings: only their proportions count, unless they are logarithms.
_REFERENCE: Final = {
    **MAGNITUDE,
    **_LUMINANCE,
    **_all("lx|lux", _times(1.0)),
    **_all("klx", _times(1e3)),
    **_all("W/m2|W/m^2|W m-2|W/sr/m2|W sr-1 m-2|1|linear", _times(1.0)),
}
# Relative standard uncertainties; of magnitudes in proportion to the light.
_RELATIVE: Final = {
    **_all("rel|relative|share|1", _times(1.0)),
    **_all("%|percent|per cent", _times(0.01)),
    **_all("mag", _times(0.4 * math.log(10.0))),
}


def _logarithms() -> dict[str, Callable[[float], float]]:
    """Return thresholds by spelling as log10 of the linear unit, luminances as that of cd·m⁻²."""

    def of_linear(convert: Callable[[float], float]) -> Callable[[float], float]:
        return lambda value: math.log10(convert(value)) if value > 0.0 else math.nan

    per_e = 1.0 / math.log(10.0)
    found = {
        **_all("log10|log|log units|log10 units", _times(1.0)),
        **_all("ln|loge", _times(per_e)),
        # Perimeters' decibels: 10 per log10 unit of luminance. Attenuation grows while the threshold falls.
        **_all("dB|decibel|decibels", _times(0.1)),
        **_all("dB attenuation|dB sensitivity|dB of attenuation", _times(-0.1)),
    }
    for name, convert in {**_LUMINANCE, **_all("td|troland|trolands|linear", _times(1.0))}.items():
        found[name] = of_linear(convert)
        found[f"log10 {name}"] = found[f"log {name}"] = _times(1.0, math.log10(convert(1.0)))
        found[f"ln {name}"] = _times(per_e, math.log10(convert(1.0)))
    return found


# Drive levels of a screen as a share of full drive.
_LEVEL: Final = {
    **_all("8bit|8 bit|8-bit|0-255|0 255|of 255|/255", _times(1.0 / 255.0)),
    **_all("10bit|10 bit|10-bit|0-1023", _times(1.0 / 1023.0)),
    **_all("%|percent|per cent|pct|0-100", _times(0.01)),
    **_all("share|fraction|0-1|normalised|normalized|of 1", _times(1.0)),
}
SPELLINGS: Final[Mapping[str, Mapping[str, Callable[[float], float]]]] = {
    "exposure": _TIME,
    "time": _TIME,
    "temperature": _TEMPERATURE,
    "gain": _GAIN,
    "iso": {"ISO": _times(1.0)},
    "conversion_gain": _CONVERSION,
    "read_noise": _all("e|e-|electron|electrons|electrons rms|e- rms", _times(1.0)),
    "f_number": _all("1|f", _times(1.0)),
    "black_level": _all("DN|ADU|adu|dn|counts", _times(1.0)),
    "luminance": _LUMINANCE,
    "wavelength": _WAVELENGTH,
    "level": _LEVEL,
    "reference": _REFERENCE,
    "u_relative": _RELATIVE,
    "threshold": _logarithms(),
    "number": {"1": _times(1.0)},
    "text": {},
}
"""Functions into the base unit by quantity and spelling.

Base units are s, degC, dB, ISO, e-/DN, e-, DN, cd/m2, nm, and log10 of a threshold.
"""
_NUMBER: Final = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_WRITTEN: Final = re.compile(rf"(?P<prefix>f/)?(?P<number>{_NUMBER}(?:\s*/\s*{_NUMBER})?)\s*(?P<unit>[^\d\s].*)?")
_COUNTED_UNIT: Final = re.compile(rf"(?P<count>{_NUMBER})\s*(?P<unit>[^\d\s.].*)")
_LONGEST_HEADING: Final = 1_000  # characters; the search for a unit takes a time that grows with their square
_BRACKETS: Final = re.compile(r"[\[(<{]([^\])>}]*)[\])>}]")


def _normal(spelling: str) -> str:
    """Return a unit's spelling with one sign for micro (U+00B5 and U+03BC), plain powers and single blanks."""
    text = unicodedata.normalize("NFKC", spelling).strip().strip(".").replace("μ", "u").replace("µ", "u")
    text = text.replace("°", "deg ").replace("·", " ").replace("⁻", "-").replace("−", "-").replace("^", "")
    return re.sub(r"\s+", " ", re.sub(r"\bdeg (?=[CFK]\b)", "deg", text)).strip()


def unit_of(spelling: str, quantity: str) -> Unit | None:
    """Return the unit of a quantity that a spelling names, such as "ms", "0.1dB" or "100 ns"; None where it names none.

    Capital letters count where units differ by them: "Ms" is a megasecond and not known, "SEC" is a second.
    """
    text = _normal(spelling)
    known = SPELLINGS[quantity]
    for candidate in (text, text.replace("_", "/"), text.replace("_", " ")):
        if candidate in known:
            return Unit(spelling.strip(), known[candidate])
    lower = text.lower()
    matches = {id(convert): convert for name, convert in known.items() if name.lower() == lower}
    # Case counts where a prefix (mS, Ms, MS) or a name (A is ångström, a is none) depends on it.
    by_case = (len(text) == 2 and quantity in ("exposure", "time")) or (len(text) == 1 and quantity == "wavelength")
    if len(matches) == 1 and not by_case:
        return Unit(spelling.strip(), next(iter(matches.values())))
    counted = _COUNTED_UNIT.fullmatch(text)
    if counted and (inner := unit_of(counted["unit"], quantity)) is not None:
        count = float(counted["count"])
        return Unit(spelling.strip(), lambda value: inner.to_base(value * count))
    return None


def heading_parts(heading: str, quantity: str) -> tuple[str, Unit | None, str]:
    """Return a column's plain name without its unit, the unit where it is known, and the unit as written.

    `exposure_ms`, `Exposure (ms)`, `exposure [µs]`, `t/ms`, `t in ms` and `ms` alone are understood.
    """
    if len(heading) > _LONGEST_HEADING:
        return plain_name(heading), None, ""
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
    sign = next((sign for sign in "%‰" if sign in heading), "")  # no letter: a plain name would lose it
    return plain_name(heading), None, sign


def plain_name(name: str) -> str:
    """Return a name in lower case, with underscores for what is no letter or digit."""
    text = unicodedata.normalize("NFKC", name.strip()).lower().replace("μ", "u").replace("°", "")
    return "_".join("".join(c if c.isalnum() else " " for c in text).split())


def unit_in_words(comment: str, quantity: str) -> tuple[Unit | None, str]:
    """Return the unit that a comment names, and its spelling; (None, spelling) where it names several or none known.

    Units are in square brackets (FITS standard 4.0, section 4.3.2), in other brackets, and in words such as
    "seconds", "in ms", "degrees C", "electrons per ADU". All that a comment names must be one unit.
    """
    named: dict[str, Unit] = {}
    for found in re.finditer(r"[\[(]([^\])]*)[\])]", comment):
        if (unit := unit_of(found[1], quantity)) is not None:
            named[found[1].strip()] = unit
        # A short word in square brackets is a unit by the standard, though one that is not known.
        elif comment.lstrip().startswith("[") and re.fullmatch(r"\s*[^\W\d_]{1,12}(/[\w-]+)?\s*", found[1]):
            return None, found[1].strip()
    text = _normal(comment)
    spellings = [s for s in SPELLINGS[quantity] if len(s) > 3 or "/" in s or s in _SURE_WORDS]
    for spelling in sorted(spellings, key=len, reverse=True):
        pattern = rf"(?<![\w/]){re.escape(spelling)}(?![\w/])"
        if re.search(pattern, text, re.IGNORECASE if len(spelling) > 3 else 0) and (
            unit := unit_of(spelling, quantity)
        ):
            text = re.sub(pattern, " ", text, flags=re.IGNORECASE)
            named[spelling] = unit
    last = re.search(r"\b(in|deg|degrees?)\s+([^\s()\[\]]+)(\s*$)?", text)
    if last and (unit := unit_of(last[2], quantity)) is not None:
        named[last[2]] = unit
    elif last and last[1] == "in" and last[3] is not None and quantity == "exposure":
        return None, last[2]  # "exposure time in ticks"; a temperature may be "in the dewar"
    sizes = {unit.to_base(1.0) for unit in named.values()}
    if len(sizes) == 1:
        return next(iter(named.items()))[1], next(iter(named))
    return None, ", ".join(named)


_SURE_WORDS: Final = ("ms", "us", "ns", "sec", "dB", "nm", "K", "degC")


def unit_names(quantity: str) -> Iterator[str]:
    """Return the first spelling of each unit, as an offer."""
    seen: list[float] = []
    for spelling, convert in SPELLINGS[quantity].items():
        if (size := convert(2.0)) not in seen:
            seen.append(size)
            yield spelling


def read_number(text: str) -> tuple[float, str]:
    """Return a number and the unit after it: "0.004", "1/250 s", "f/8", "12 ms", "0,5".

    Raises:
        ValueError: If it is no number, or a comma in it may be a decimal mark or part thousands.
    """
    cleaned = text.strip().strip("\x00").strip()
    if len(cleaned) > _LONGEST_HEADING:
        raise ValueError(f"{cleaned[:_LONGEST_NUMBER]!r}… is not understood")
    if re.fullmatch(r"[-+]?\d+,\d+(?:\D.*)?", cleaned):
        if re.fullmatch(r"[-+]?[1-9]\d{0,2},\d{3}(?:\D.*)?", cleaned):
            raise ValueError("its comma may be a decimal mark or part thousands")
        cleaned = cleaned.replace(",", ".", 1)
    cleaned = f"{fortran[1]}e{fortran[2]}" if (fortran := _FORTRAN_POWER.fullmatch(cleaned)) else cleaned
    found = _WRITTEN.fullmatch(cleaned)
    too_large = found is not None and (
        len(found["number"]) > _LONGEST_NUMBER
        or _HUGE_POWER.search(found["number"])
        or ("/" in found["number"] and _TINY_POWER.search(found["number"]))
    )
    if found is None or too_large:
        raise ValueError(f"{text.strip()[:_LONGEST_NUMBER]!r} is not understood")
    number = found["number"].replace(" ", "")
    try:
        value = float(Fraction(number)) if "/" in number else float(number)
    except ZeroDivisionError as error:
        raise ValueError(f"{number} divides by zero") from error
    if not math.isfinite(value):
        raise ValueError(f"{number} is not finite")
    return value, (found["unit"] or "").strip()
