"""Digital calibration certificates: writes results as DCC XML, and reads a value with its uncertainty from one.

Source: Physikalisch-Technische Bundesanstalt, Digital Calibration Certificate, schema 3.1.2, with D-SI 2.1.0.
"""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal

from pydantic import Field

from radiometer.data import Contribution, Quantity
from radiometer.data.reader_limits import bounded_reader
from radiometer.data.storage import read_yaml
from radiometer.data.validation import ConfigSection, validate
from radiometer.errors import ConfigurationError, InputError
from radiometer.plausible import PLAUSIBLE, Range

SCHEMA_VERSION: Final = "3.1.2"
_COVERED: Final = 0.9545  # of the coverage factors of readings
_DCC, _SI = "https://ptb.de/dcc", "https://ptb.de/si"
_SPACES: Final = {"dcc": _DCC, "si": _SI, "xsi": "http://www.w3.org/2001/XMLSchema-instance"}
# Units of the product as the D-SI writes them.
_UNITS: Final[Mapping[str, str]] = {
    "W sr-1 m-2": r"\watt\steradian\tothe{-1}\metre\tothe{-2}",
    "cd m-2": r"\candela\metre\tothe{-2}",
    "J m-2": r"\joule\metre\tothe{-2}",
    "1": r"\one",
    "s": r"\second",
    "°C": r"\degreecelsius",
}
_OF_SI: Final = {si: unit for unit, si in _UNITS.items()}
_PLAUSIBLE: Final[Mapping[str, Range]] = {"W sr-1 m-2": PLAUSIBLE["radiance"], "cd m-2": PLAUSIBLE["luminance"]}
# D-SI asks for 1 at least; one degree of freedom has 13.97 at 95.45 % (Student's t).
_COVERAGE_FACTORS: Final = Range(1.0, 20.0)
_NUMBER: Final = re.compile(r"[+-]?([0-9]+(\.[0-9]*)?|\.[0-9]+)([eE][+-]?[0-9]+)?")  # xs:double without its words
_NO_XML: Final = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")  # XML 1.0, production 2


class Party(ConfigSection):
    """A laboratory or a customer."""

    name: str = Field(min_length=1)  # its name
    email: str = Field(min_length=3)  # its address for mail
    city: str = Field(min_length=1)  # city
    country: str = Field(pattern="^[A-Z]{2}$")  # two capital letters (ISO 3166-1)
    street: str = ""  # street and number
    post_code: str = ""  # post code


class Person(ConfigSection):
    """Who answers for the result."""

    name: str = Field(min_length=1)
    role: str = ""


class Item(ConfigSection):
    """What was calibrated or measured."""

    name: str = Field(min_length=1)  # what it is
    manufacturer: str = Field(min_length=1)  # who made it
    model: str = ""  # its model
    serial: str = Field(min_length=1)  # its serial number


class Laboratory(ConfigSection):
    """What a certificate states beyond the measurement; nothing of it has a default that would be a guess."""

    format: Literal["radiometer-laboratory/1"]  # name and version of the form
    language: str = Field("en", pattern="^[a-z]{2}$")  # two small letters (ISO 639-1) of the texts
    # Where it was measured
    place: Literal["laboratory", "customer", "laboratoryBranch", "customerBranch", "other"] = "laboratory"
    laboratory: Party  # who measured
    customer: Party  # for whom
    responsible: Person  # who answers for it
    item: Item | None = None  # source that a reading is of; a calibration states its camera itself

    @classmethod
    def read(cls, path: Path) -> Laboratory:
        """Read the file. Raises ConfigurationError naming key and line, InputError if it cannot be read."""
        return validate(cls, read_yaml(path), str(path), ConfigurationError)


@dataclass(frozen=True, slots=True)
class Certified:
    """What a certificate is made of."""

    identifier: str  # number of the certificate, unique in the laboratory
    title: str  # name of the measurement
    date: str  # day of it, ISO 8601
    method: tuple[str, ...]  # how it was measured, in sentences
    item: Item  # what was measured
    equipment: tuple[tuple[str, str], ...]  # name and identification of each instrument and reference
    conditions: tuple[tuple[str, str], ...]  # name and text of each condition
    # Name, value with standard uncertainty, and coverage factor of each result
    results: tuple[tuple[str, Quantity, float], ...]
    budget: tuple[Contribution, ...]  # contributions to the uncertainty of the first result
    version: str  # version of the program


def stated_factor(stated: float) -> float:
    """Return the coverage factor of a reading to three digits, as every face prints it. Raises InputError below 2.

    U is that k times u, so a reader who divides has u again.
    """
    k = float(f"{_COVERAGE_FACTORS.check('coverage_factor', stated):.3g}")
    if k < 2.0:
        raise InputError(f"coverage_factor is {k:g}; for a probability of {100 * _COVERED:g} % it is 2 or more")
    return k


def certificate_xml(content: Certified, laboratory: Laboratory) -> str:
    """Return the certificate as XML.

    Raises InputError if a result's unit has no form in D-SI, or a text holds what XML cannot.
    """
    for prefix, space in _SPACES.items():
        ET.register_namespace(prefix, space)
    root = ET.Element(f"{{{_DCC}}}digitalCalibrationCertificate", {"schemaVersion": SCHEMA_VERSION})
    root.set(f"{{{_SPACES['xsi']}}}schemaLocation", f"{_DCC} {_DCC}/v{SCHEMA_VERSION}/dcc.xsd")
    _grow(root, _administrative(content, laboratory))
    results = [_named("result", name, ("data", ("quantity", _real(name, one, k)))) for name, one, k in content.results]
    budget = [
        _named("quantity", f"{one.name} (type {one.kind})", _real(one.name, Quantity(one.u_rel, 0.0, "1"), None))
        for one in content.budget
    ]
    of_budget = _named("result", "uncertainty budget: relative standard uncertainties", ("data", ("list", *budget)))
    method = ("description", *(("content", text) for text in content.method))
    equipment = [
        _named("measuringEquipment", name, _identified("calibrationLaboratory", one)) for name, one in content.equipment
    ]
    conditions = [
        _named("influenceCondition", name, ("data", ("text", ("content", text)))) for name, text in content.conditions
    ]
    measured = _named(
        "measurementResult", content.title, ("usedMethods", _named("usedMethod", "method", method)),
        equipment and ("measuringEquipments", *equipment), conditions and ("influenceConditions", *conditions),
        ("results", *results, budget and of_budget),
    )  # fmt: skip
    _grow(root, ("measurementResults", measured))
    for written in root.iter(f"{{{_DCC}}}content"):
        written.set("lang", laboratory.language)
    ET.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ET.tostring(root, encoding="unicode") + "\n"


def _grow(parent: ET.Element, node: Sequence[Any]) -> None:
    """Add an element: its tag, without a prefix of the DCC, then its text or its children; empty ones are left out."""
    space, _, tag = node[0].rpartition(":")
    element = ET.SubElement(parent, f"{{{_SPACES[space or 'dcc']}}}{tag}")
    for one in filter(None, node[1:]):
        if not isinstance(one, str):
            _grow(element, one)
        elif (wrong := _NO_XML.search(one)) is None:
            element.text = one
        else:
            raise InputError(
                f"{tag} {one[:40]!r}: character U+{ord(wrong[0]):04X} is not allowed in a certificate; remove it"
            )


def _named(tag: str, name: str, *parts: Sequence[Any]) -> Sequence[Any]:
    return (tag, ("name", ("content", name)), *parts)


def _administrative(content: Certified, laboratory: Laboratory) -> Sequence[Any]:
    item, person, language = content.item, laboratory.responsible, laboratory.language
    software = ("dccSoftware", _named("software", "radiometer", ("release", content.version)))
    core = (
        "coreData", ("countryCodeISO3166_1", laboratory.laboratory.country), ("usedLangCodeISO639_1", language),
        ("mandatoryLangCodeISO639_1", language), ("uniqueIdentifier", content.identifier),
        ("beginPerformanceDate", content.date), ("endPerformanceDate", content.date),
        ("performanceLocation", laboratory.place),
    )  # fmt: skip
    model, maker = item.model and ("model", item.model), _named("manufacturer", item.manufacturer)
    items = ("items", _named("item", item.name, maker, model, _identified("manufacturer", item.serial)))
    signer = (_named("person", person.name), person.role and ("role", person.role), ("mainSigner", "true"))
    return (
        "administrativeData", software, core, items,
        ("calibrationLaboratory", _contact("contact", laboratory.laboratory)),
        ("respPersons", ("respPerson", *signer)), _contact("customer", laboratory.customer),
    )  # fmt: skip


def _identified(issuer: str, value: str) -> Sequence[Any]:
    return ("identifications", ("identification", ("issuer", issuer), ("value", value)))


def _contact(tag: str, party: Party) -> Sequence[Any]:
    place = [(name, one) for name, one in (("street", party.street), ("postCode", party.post_code)) if one]
    place += [("city", party.city), ("countryCode", party.country)]
    return _named(tag, party.name, ("eMail", party.email), ("location", *place))


def _real(label: str, quantity: Quantity, k: float | None) -> Sequence[Any]:
    """Return a value with its expanded uncertainty; without one where `k` is None."""
    if quantity.unit not in _UNITS:
        raise InputError(f"{label}: the unit {quantity.unit!r} has no form in D-SI that is known here")
    expanded = k is not None and (
        "si:expandedUnc", ("si:uncertainty", repr(float(k * quantity.u))), ("si:coverageFactor", repr(float(k))),
        ("si:coverageProbability", repr(_COVERED)),
    )  # fmt: skip
    value = repr(float(quantity.value))
    return ("si:real", ("si:label", label), ("si:value", value), ("si:unit", _UNITS[quantity.unit]), expanded or ())


@bounded_reader(error=InputError)
def read_certificate(path: Path, unit: str) -> Quantity:
    """Return the value in W sr-1 m-2 or cd m-2 that a DCC of schema 2 or 3 states, with its standard uncertainty U/k.

    Raises InputError if it is no certificate, or does not state just one value in this unit with its uncertainty.
    """
    text = path.read_bytes()
    if b"<!DOCTYPE" in text or b"<!ENTITY" in text:
        raise InputError(f"{path}: holds a document type, which no certificate needs; it is not read")
    try:
        root = ET.fromstring(text)
    except ET.ParseError as error:
        raise InputError(f"{path}: is not XML: {error}") from error
    if root.tag != f"{{{_DCC}}}digitalCalibrationCertificate":
        raise InputError(f"{path}: is no digital calibration certificate; its first element is {root.tag!r}")
    values = [one for results in root.iter(f"{{{_DCC}}}results") for one in results.iter(f"{{{_SI}}}real")]
    units = ["".join(_texts(one, "unit")[:1]) for one in values]
    found = [one for one, si in zip(values, units, strict=True) if _OF_SI.get(si.replace(" ", "")) == unit]
    if len(found) != 1:
        stated = ", ".join(sorted(set(units))) or "none"
        raise InputError(
            f"{path}: states {len(found)} values in {unit}; just one is needed (units of its values: {stated})"
        )
    for uncertainty in ("uncertainty", "valueExpandedMU"):  # of D-SI 1.x and 2.1; of 2.2 and later
        if all(any(_texts(found[0], tag)) for tag in (uncertainty, "coverageFactor")):
            value, expanded, k = (_stated(path, found[0], tag) for tag in ("value", uncertainty, "coverageFactor"))
            _PLAUSIBLE[unit].check(f"{path}: value", value)
            _COVERAGE_FACTORS.check(f"{path}: coverage factor", k)
            if not 0.0 < expanded < float("inf"):
                raise InputError(f"{path}: the expanded uncertainty is {expanded:g}; it must be above 0")
            return Quantity(value, expanded / k, unit)
    raise InputError(f"{path}: the value in {unit} has no expanded uncertainty with its coverage factor")


def _stated(path: Path, parent: ET.Element, tag: str) -> float:
    """Return the number of the one element of a name. Raises InputError."""
    texts = _texts(parent, tag)
    if len(texts) != 1 or not _NUMBER.fullmatch(texts[0]):
        raise InputError(f"{path}: {tag} is {', '.join(map(repr, texts))}; just one number is needed")
    return float(texts[0])


def _texts(parent: ET.Element, tag: str) -> list[str]:
    return [(one.text or "").strip() for one in parent.iter(f"{{{_SI}}}{tag}")]
