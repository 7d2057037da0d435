"""Writes a GenICam description: features by category, each on a separate register."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final, Literal
from xml.etree import ElementTree

Kind = Literal["float", "integer", "boolean", "enumeration", "command", "string", "formula", "chunk"]
Bound = float | int | str  # a string is the name of another node

_STRING_LENGTH: Final = 32  # bytes of a text register, as GigE Vision's bootstrap has them
_NAMESPACE: Final = "http://www.genicam.org/GenApi/Version_1_0"


@dataclass(frozen=True, slots=True)
class Feature:
    """A feature of a camera."""

    name: str  # SFNC name
    category: str  # category that it is listed in; "" for a helper that is not listed
    kind: Kind  # type of its node
    address: int  # address of its register; 0 for a formula
    description: str = ""  # what it is, for tooltips
    access: str = "RW"  # "RW", "RO" or "WO"
    unit: str = ""  # unit of a number
    minimum: Bound | None = None  # lowest value, or the node that holds it
    maximum: Bound | None = None  # highest value, or the node that holds it
    increment: int = 0  # step of an integer
    entries: Mapping[str, int] = field(default_factory=dict)  # names and values of an enumeration
    length: int = 0  # bytes of a string; 0 for the kind's own
    formula: str = ""  # expression over `variables` of a formula
    variables: Mapping[str, str] = field(default_factory=dict)  # names in the formula and the nodes behind them
    initial: float | int | str | None = None  # value at power-on; None where the device itself sets it
    whole: bool = False  # a float kept in a 32-bit register of whole numbers
    absent: frozenset[str] = frozenset()  # entries of an enumeration that this model of the family does not have
    locked_by: str = ""  # node that is not 0 where the feature cannot be written; "" for one that always can
    selected_by: str = ""  # node whose value times 4 is added to the address; "" for a single register
    # Identifier of a chunk, in hexadecimal; its `formula` turns the raw 32-bit number RAW into the value
    chunk_id: str = ""


_NEVER: Final = "NotImplementedHere"


def genicam_xml(features: Sequence[Feature], vendor: str, model: str) -> bytes:
    """Return the description of a camera as a GenICam XML document.

    Args:
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
    if any(feature.absent for feature in features):
        _fill(_node(root, "Integer", _NEVER, ""), Value=0)
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
    elif feature.kind == "chunk":
        _add_chunk(root, feature)
    elif feature.kind == "string":
        node = _node(root, "StringReg", feature.name, feature.description)
        _fill(node, Address=f"0x{feature.address:x}", Length=feature.length or _STRING_LENGTH, AccessMode="RO")
        _fill(node, pPort="Device")
    else:
        _add_value_node(root, feature)
        _add_register(root, feature)


def _add_value_node(root: ElementTree.Element, feature: Feature) -> None:
    tag = {"float": "Float", "integer": "Integer", "boolean": "Boolean", "enumeration": "Enumeration"}
    node = _node(root, tag.get(feature.kind, "Command"), feature.name, feature.description)
    for name, value in feature.entries.items():
        entry = ElementTree.SubElement(node, "EnumEntry", {"Name": name, "NameSpace": "Standard"})
        if name in feature.absent:
            _fill(entry, pIsImplemented=_NEVER)
        _fill(entry, Value=value)
    if feature.locked_by:
        _fill(node, pIsLocked=feature.locked_by)
    is_kept = feature.kind == "boolean" and feature.access == "RO"
    _fill(node, pValue=f"{feature.name}{'Kept' if is_kept else 'Register'}")
    if (
        is_kept
    ):  # a switch that cannot be written: behind a formula, for Aravis writes to read-only registers all the same
        kept = _node(root, "IntSwissKnife", f"{feature.name}Kept", "")
        ElementTree.SubElement(kept, "pVariable", {"Name": "V"}).text = f"{feature.name}Register"
        _fill(kept, Formula="V")
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
    is_float = feature.kind == "float" and not feature.whole
    node = _node(root, "FloatReg" if is_float else "IntReg", f"{feature.name}Register", "")
    if feature.selected_by:
        _fill(node, pAddress=f"{feature.name}Offset")
        offset = _node(root, "IntSwissKnife", f"{feature.name}Offset", "")
        ElementTree.SubElement(offset, "pVariable", {"Name": "SEL"}).text = feature.selected_by
        _fill(offset, Formula="SEL * 4")
    length = 8 if is_float else 4
    _fill(node, Address=f"0x{feature.address:x}", Length=length, AccessMode=feature.access)
    _fill(node, pPort="Device", Cachable="NoCache")
    if not is_float:
        _fill(node, Sign="Unsigned")
    _fill(node, Endianess="BigEndian")


def _add_chunk(root: ElementTree.Element, feature: Feature) -> None:
    """Add a float that is read from a frame: value, formula over the raw number, its place, and the chunk's port."""
    node = _node(root, "Float", feature.name, feature.description)
    _fill(node, pValue=f"{feature.name}Value")
    if feature.unit:
        _fill(node, Unit=feature.unit)
    value = _node(root, "SwissKnife", f"{feature.name}Value", "")
    ElementTree.SubElement(value, "pVariable", {"Name": "RAW"}).text = f"{feature.name}Register"
    _fill(value, Formula=feature.formula)
    register = _node(root, "IntReg", f"{feature.name}Register", "")
    _fill(register, Address="0x0", Length=4, AccessMode="RO", pPort=f"{feature.name}Port", Cachable="NoCache")
    _fill(register, Sign="Signed", Endianess="LittleEndian")
    port = ElementTree.SubElement(root, "Port", {"Name": f"{feature.name}Port", "NameSpace": "Standard"})
    _fill(port, ChunkID=feature.chunk_id)


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
