"""Writes a GenICam description: features by category, each on a register of its own."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final, Literal
from xml.etree import ElementTree

Kind = Literal["float", "integer", "boolean", "enumeration", "command", "string", "formula"]
Bound = float | int | str  # a string is the name of another node

_LENGTH: Final = {"float": 8, "integer": 4, "boolean": 4, "enumeration": 4, "command": 4, "string": 32}
_NAMESPACE: Final = "http://www.genicam.org/GenApi/Version_1_0"


@dataclass(frozen=True, slots=True)
class Feature:
    """A feature of a camera.

    Attributes:
        name: SFNC name.
        category: Category that it is listed in; "" for a helper that is not listed.
        kind: Type of its node.
        address: Where its register lies; 0 for a formula.
        description: What it is, for tooltips.
        access: "RW", "RO" or "WO".
        unit: Unit of a number.
        minimum: Lowest value, or the node that holds it.
        maximum: Highest value, or the node that holds it.
        increment: Step of an integer.
        entries: Names and values of an enumeration.
        length: Bytes of a string; 0 for the kind's own.
        formula: Expression over `variables` of a formula.
        variables: Names in the formula and the nodes behind them.
        initial: Value at power-on; None where the device itself sets it.
    """

    name: str
    category: str
    kind: Kind
    address: int
    description: str = ""
    access: str = "RW"
    unit: str = ""
    minimum: Bound | None = None
    maximum: Bound | None = None
    increment: int = 0
    entries: Mapping[str, int] = field(default_factory=dict)
    length: int = 0
    formula: str = ""
    variables: Mapping[str, str] = field(default_factory=dict)
    initial: float | int | str | None = None


def genicam_xml(features: Sequence[Feature], vendor: str, model: str) -> bytes:
    """Return the description of a camera as a GenICam XML document.

    Args:
        features: Every feature and helper node.
        vendor: Maker, for the document's head.
        model: Model, for the document's head.
    """
    root = ElementTree.Element(
        "RegisterDescription",
        {
            "ModelName": model,
            "VendorName": vendor,
            "ToolTip": "Simulated camera",
            "StandardNameSpace": "GEV",
            "SchemaMajorVersion": "1",
            "SchemaMinorVersion": "1",
            "SchemaSubMinorVersion": "0",
            "MajorVersion": "1",
            "MinorVersion": "0",
            "SubMinorVersion": "0",
            "ProductGuid": "0",
            "VersionGuid": "0",
            "xmlns": _NAMESPACE,
        },
    )
    _add_categories(root, features)
    for feature in features:
        _add_feature(root, feature)
    ElementTree.SubElement(root, "Port", {"Name": "Device", "NameSpace": "Standard"})
    ElementTree.indent(root)
    return bytes(ElementTree.tostring(root, encoding="utf-8", xml_declaration=True))


def _add_categories(root: ElementTree.Element, features: Sequence[Feature]) -> None:
    listed: dict[str, list[str]] = {}
    for feature in features:
        if feature.category:
            listed.setdefault(feature.category, []).append(feature.name)
    for name, members in (("Root", list(listed)), *listed.items()):
        node = ElementTree.SubElement(root, "Category", {"Name": name, "NameSpace": "Standard"})
        for member in members:
            ElementTree.SubElement(node, "pFeature").text = member


def _add_feature(root: ElementTree.Element, feature: Feature) -> None:
    if feature.kind == "formula":
        _add_formula(root, feature)
    elif feature.kind == "string":
        node = _node(root, "StringReg", feature.name, feature.description)
        _fill(node, Address=f"0x{feature.address:x}", Length=feature.length or _LENGTH["string"], AccessMode="RO")
        _fill(node, pPort="Device")
    else:
        _add_value_node(root, feature)
        _add_register(root, feature)


def _add_value_node(root: ElementTree.Element, feature: Feature) -> None:
    tag = {"float": "Float", "integer": "Integer", "boolean": "Boolean", "enumeration": "Enumeration"}
    node = _node(root, tag.get(feature.kind, "Command"), feature.name, feature.description)
    for name, value in feature.entries.items():
        entry = ElementTree.SubElement(node, "EnumEntry", {"Name": name, "NameSpace": "Standard"})
        _fill(entry, Value=value)
    _fill(node, pValue=f"{feature.name}Register")
    if feature.kind == "boolean":
        _fill(node, OnValue=1, OffValue=0)
    if feature.kind == "command":
        _fill(node, CommandValue=1 if feature.maximum is None else feature.maximum)
        return
    for tag_name, bound in (("Min", feature.minimum), ("Max", feature.maximum)):
        if bound is not None:
            _fill(node, **{f"p{tag_name}" if isinstance(bound, str) else tag_name: bound})
    if feature.increment:
        _fill(node, Inc=feature.increment)
    if feature.unit:
        _fill(node, Unit=feature.unit)


def _add_register(root: ElementTree.Element, feature: Feature) -> None:
    is_float = feature.kind == "float"
    node = _node(root, "FloatReg" if is_float else "IntReg", f"{feature.name}Register", "")
    _fill(node, Address=f"0x{feature.address:x}", Length=_LENGTH[feature.kind], AccessMode=feature.access)
    _fill(node, pPort="Device", Cachable="NoCache")
    if not is_float:
        _fill(node, Sign="Unsigned")
    _fill(node, Endianess="BigEndian")


def _add_formula(root: ElementTree.Element, feature: Feature) -> None:
    node = _node(root, "IntSwissKnife", feature.name, feature.description)
    for name, target in feature.variables.items():
        ElementTree.SubElement(node, "pVariable", {"Name": name}).text = target
    _fill(node, Formula=feature.formula)


def _node(root: ElementTree.Element, tag: str, name: str, description: str) -> ElementTree.Element:
    node = ElementTree.SubElement(root, tag, {"Name": name, "NameSpace": "Standard"})
    if description:
        _fill(node, Description=description)
    return node


def _fill(node: ElementTree.Element, **children: float | str) -> None:
    for tag, value in children.items():
        ElementTree.SubElement(node, tag).text = repr(value) if isinstance(value, float) else str(value)
