"""The facts of an XMP packet by their names, whatever form they are written in."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping

_RDF = "{http://www.w3.org/1999/02/22-rdf-syntax-ns#}"


def read_xmp(packet: bytes) -> Mapping[str, tuple[str, ...]]:
    """Return the properties of an XMP packet: local name → values in order; empty where the packet is damaged.

    A property may be an attribute of its description, an element with text, or an element that holds a sequence.

    Source: ISO 16684-1:2019, section 7.
    """
    start, end = packet.find(b"<x:xmpmeta"), packet.rfind(b"</x:xmpmeta>")
    if start < 0 or end < 0:
        return {}
    try:
        root = ElementTree.fromstring(packet[start : end + len(b"</x:xmpmeta>")])
    except ElementTree.ParseError:
        return {}
    found: dict[str, tuple[str, ...]] = {}
    for description in root.iter(f"{_RDF}Description"):
        for name, value in description.attrib.items():
            if not name.startswith(_RDF):
                found[_local(name)] = (value.strip(),)
        for entry in description:
            items = tuple((item.text or "").strip() for item in entry.iter(f"{_RDF}li"))
            found[_local(entry.tag)] = items or ((entry.text or "").strip(),)
    return found


def numbers(properties: Mapping[str, tuple[str, ...]], name: str) -> tuple[float, ...]:
    """Return a property's numbers, whether they are in a sequence or between commas; () where there are none."""
    words = [word for value in properties.get(name, ()) for word in value.replace(",", " ").split()]
    try:
        return tuple(float(word) for word in words)
    except ValueError:
        return ()


def _local(name: str) -> str:
    return name.rpartition("}")[2]
