"""The features of a simulated Blackfly S: SFNC names, registers, limits, values as shipped.

Registers below 0x400 are those that Aravis's fake device itself acts upon (arvfakecamera.c); ours start at 0x4000.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final, Literal
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from radiometer.data.frame import DigitalNumbers
from radiometer.devices import CameraCapabilities
from radiometer.errors import ConfigurationError


@dataclass(frozen=True, slots=True)
class WireFormat:
    """A pixel format on the wire: PFNC code, bits of a digital number, bits that a pixel takes."""

    code: int
    bit_depth: int
    bits_per_pixel: int


# Codes: EMVA/A3 Pixel Format Naming Convention 2.1. Mono16 of this camera holds 16-bit numbers.
WIRE_FORMATS: Final = {
    "Mono8": WireFormat(0x01080001, 8, 8),
    "Mono10": WireFormat(0x01100003, 10, 16),
    "Mono10p": WireFormat(0x010A0046, 10, 10),
    "Mono12": WireFormat(0x01100005, 12, 16),
    "Mono12p": WireFormat(0x010C0047, 12, 12),
    "Mono12Packed": WireFormat(0x010C0006, 12, 12),
    "Mono16": WireFormat(0x01100007, 16, 16),
    "BayerRG8": WireFormat(0x01080009, 8, 8),
    "BayerRG12": WireFormat(0x01100011, 12, 16),
}


def pack_pixels(dn: DigitalNumbers, format_name: str) -> bytes:
    """Return the payload of a picture.

    Args:
        dn: Digital numbers, any shape, not above the format's full scale.

    Raises:
        ConfigurationError: If the format is unknown or a number is above its full scale.
    """
    wire = WIRE_FORMATS.get(format_name)
    if wire is None:
        raise ConfigurationError(
            f"pixel format {format_name} is not simulated; choose one of {', '.join(WIRE_FORMATS)}"
        )
    if dn.size and int(dn.max()) >> wire.bit_depth:
        raise ConfigurationError(f"{int(dn.max())} DN do not fit {format_name}; the image source gives too many bits")
    flat = dn.ravel()
    if wire.bits_per_pixel == 8:
        return flat.astype(np.uint8, copy=False).tobytes()
    if wire.bits_per_pixel == 16:
        return flat.astype("<u2", copy=False).tobytes()
    if format_name == "Mono12Packed":
        return _packed_pairs(flat.astype(np.uint16, copy=False))
    return _bit_stream(flat.astype(np.uint16, copy=False), wire.bit_depth)


def _packed_pairs(flat: NDArray[np.uint16]) -> bytes:
    pairs = np.pad(flat, (0, flat.size % 2)).reshape(-1, 2)
    low, high = pairs[:, 0], pairs[:, 1]
    packed = np.stack([low >> 4, (high & 0x0F) << 4 | low & 0x0F, high >> 4], axis=1).astype(np.uint8)
    return bytes(packed.tobytes()[: -(-flat.size * 12 // 8)])


def _bit_stream(flat: NDArray[np.uint16], bits: int) -> bytes:
    """Lay the numbers out as one stream of bits, lowest bit first."""
    group = 4 if bits == 10 else 2  # the fewest pixels that fill whole bytes
    lanes = np.pad(flat, (0, -flat.size % group)).reshape(-1, group).astype(np.uint64)
    word = np.bitwise_or.reduce(lanes << (np.arange(group, dtype=np.uint64) * np.uint64(bits)), axis=1)
    stream = word.astype("<u8").view(np.uint8).reshape(-1, 8)[:, : group * bits // 8]
    return bytes(stream.tobytes()[: -(-flat.size * bits // 8)])


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


# Where Aravis's fake device looks (arvfakecamera.h of Aravis 0.8).
VENDOR, MODEL, VERSION, INFO, SERIAL = 0x48, 0x68, 0x88, 0xA8, 0xD8
WIDTH, HEIGHT, BINNING = 0x100, 0x104, 0x108
SENSOR_HEIGHT, SENSOR_WIDTH = 0x118, 0x11C
ACQUISITION, PIXEL_FORMAT, ACQUISITION_MODE = 0x124, 0x128, 0x12C
OFFSET_X, OFFSET_Y = 0x130, 0x134
CONTROL_PRIVILEGE = 0x0A00  # GigE Vision's bootstrap register: 0 where no program controls the camera
# The device itself always runs on its software trigger, pulled when a picture is ready: its one thread then never
# waits for a picture to be made and answers at once. What users see as triggers lies on registers of ours.
INNER_TRIGGER_MODE, INNER_TRIGGER_SOURCE, INNER_TRIGGER = 0x300, 0x304, 0x30C
SOFTWARE_SOURCE: Final = 1  # what both the device and our users take for a software trigger

# Ours.
EXPOSURE_US, GAIN_DB, BLACK_LEVEL_PERCENT, GAMMA, TEMPERATURE_C = 0x4000, 0x4008, 0x4010, 0x4018, 0x4020
FRAME_RATE_HZ, SOURCE_LEVEL, ANSWER_DELAY_MS = 0x4028, 0x4030, 0x4038
EXPOSURE_AUTO, GAIN_AUTO, GAMMA_ENABLE, SHARPENING_ENABLE = 0x4100, 0x4104, 0x4108, 0x410C
LUT_ENABLE, DEFECT_CORRECT, BLACK_CLAMP, FRAME_RATE_ENABLE = 0x4110, 0x4114, 0x4118, 0x411C
SHUTTER_CLOSED, LOSS_PER_MILLE, STALL, DISCONNECT = 0x4120, 0x4124, 0x4128, 0x412C
TRIGGER_SELECTOR, EXPOSURE_MODE, PARAMETERS_LOCKED = 0x4130, 0x4134, 0x4138
TRIGGER_MODE, TRIGGER_SOURCE, TRIGGER_ACTIVATION, TRIGGER_SOFTWARE = 0x4140, 0x4144, 0x4148, 0x414C

AUTO: Final = {"Off": 0, "Once": 1, "Continuous": 2}


def blackfly_features(limits: CameraCapabilities, native_bit_depth: int, temperature_c: float) -> list[Feature]:
    """Return the features of a camera with given limits.

    Args:
        limits: Bounds of exposure, gain and black level (in DN of the native bit depth), formats, sensor size.
        native_bit_depth: Bits of the sensor's digital numbers.
    """
    return [
        *_device_control(temperature_c),
        *_image_format_control(limits),
        *_acquisition_control(limits),
        *_analog_control(limits, native_bit_depth),
        *_processing_control(),
        *_transport_control(),
        *_simulator_control(),
    ]


def _device_control(temperature_c: float) -> list[Feature]:
    category = "DeviceControl"
    return [
        Feature("DeviceVendorName", category, "string", VENDOR),
        Feature("DeviceModelName", category, "string", MODEL),
        Feature("DeviceManufacturerInfo", category, "string", INFO, length=48),
        Feature("DeviceFirmwareVersion", category, "string", VERSION),
        Feature("DeviceSerialNumber", category, "string", SERIAL, length=16),
        Feature("DeviceID", category, "string", SERIAL, length=16),
        Feature("DeviceTemperature", category, "float", TEMPERATURE_C, access="RO", unit="C", initial=temperature_c),
    ]


def _image_format_control(limits: CameraCapabilities) -> list[Feature]:
    category, codes = "ImageFormatControl", {name: WIRE_FORMATS[name].code for name in limits.pixel_formats}
    binned = {"S": "SensorWidth", "B": "BinningHorizontal"}, {"S": "SensorHeight", "B": "BinningHorizontal"}
    return [
        Feature("SensorWidth", category, "integer", SENSOR_WIDTH, access="RO", initial=limits.width),
        Feature("SensorHeight", category, "integer", SENSOR_HEIGHT, access="RO", initial=limits.height),
        Feature("WidthMax", category, "formula", 0, formula="S / B", variables=binned[0]),
        Feature("HeightMax", category, "formula", 0, formula="S / B", variables=binned[1]),
        _extent("Width", WIDTH, 4, lowest=4, initial=limits.width),
        _extent("Height", HEIGHT, 2, lowest=2, initial=limits.height),
        _extent("OffsetX", OFFSET_X, 4, lowest=0, initial=0),
        _extent("OffsetY", OFFSET_Y, 2, lowest=0, initial=0),
        *(
            Feature(f"{own}Room", "", "formula", 0, formula="M - O", variables={"M": f"{side}Max", "O": other})
            for own, side, other in (
                ("Width", "Width", "OffsetX"),
                ("Height", "Height", "OffsetY"),
                ("OffsetX", "Width", "Width"),
                ("OffsetY", "Height", "Height"),
            )
        ),
        Feature("BinningHorizontal", category, "integer", BINNING, minimum=1, maximum=4, initial=1),
        Feature("BinningVertical", category, "integer", BINNING, minimum=1, maximum=4, initial=1),
        Feature("PixelFormat", category, "enumeration", PIXEL_FORMAT, entries=codes, initial=min(codes.values())),
    ]


def _extent(name: str, address: int, step: int, *, lowest: int, initial: int) -> Feature:
    category, room = "ImageFormatControl", f"{name}Room"
    return Feature(name, category, "integer", address, minimum=lowest, maximum=room, increment=step, initial=initial)


def _acquisition_control(limits: CameraCapabilities) -> list[Feature]:
    category = "AcquisitionControl"
    shortest_us, longest_us = (value * 1e6 for value in limits.exposure_s)
    return [
        Feature("AcquisitionMode", category, "enumeration", ACQUISITION_MODE,
                entries={"Continuous": 1, "SingleFrame": 2}),
        Feature("AcquisitionStart", category, "command", ACQUISITION, access="WO"),
        Feature("AcquisitionStop", category, "command", ACQUISITION, access="WO", maximum=0),
        Feature("ExposureMode", category, "enumeration", EXPOSURE_MODE, entries={"Timed": 1}, initial=1),
        Feature("ExposureAuto", category, "enumeration", EXPOSURE_AUTO, entries=AUTO, initial=AUTO["Continuous"]),
        Feature("ExposureTime", category, "float", EXPOSURE_US, unit="us", minimum=shortest_us, maximum=longest_us,
                initial=min(max(10_000.0, shortest_us), longest_us)),
        Feature("AcquisitionFrameRateEnable", category, "boolean", FRAME_RATE_ENABLE, initial=0),
        Feature("AcquisitionFrameRate", category, "float", FRAME_RATE_HZ, unit="Hz", minimum=1.0, maximum=131.0,
                initial=30.0),
        Feature("TriggerSelector", category, "enumeration", TRIGGER_SELECTOR, entries={"FrameStart": 0}, initial=0),
        Feature("TriggerMode", category, "enumeration", TRIGGER_MODE, entries={"Off": 0, "On": 1}, initial=0),
        Feature("TriggerSource", category, "enumeration", TRIGGER_SOURCE, entries={"Line0": 0, "Software": 1},
                initial=0),
        Feature("TriggerActivation", category, "enumeration", TRIGGER_ACTIVATION, entries={"RisingEdge": 0},
                initial=0),
        Feature("TriggerSoftware", category, "command", TRIGGER_SOFTWARE, access="WO"),
    ]  # fmt: skip


def _analog_control(limits: CameraCapabilities, native_bit_depth: int) -> list[Feature]:
    category, percent_per_dn = "AnalogControl", 100.0 / ((1 << native_bit_depth) - 1)
    low, high = (value * percent_per_dn for value in limits.black_level_dn)
    least_db, most_db = limits.gain_db
    return [
        Feature("GainAuto", category, "enumeration", GAIN_AUTO, entries=AUTO, initial=AUTO["Continuous"]),
        Feature("Gain", category, "float", GAIN_DB, unit="dB", minimum=least_db, maximum=most_db,
                initial=max(0.0, least_db)),
        Feature("BlackLevel", category, "float", BLACK_LEVEL_PERCENT, unit="%", minimum=low, maximum=high, initial=low),
        Feature("BlackLevelClampingEnable", category, "boolean", BLACK_CLAMP, initial=1),
        Feature("GammaEnable", category, "boolean", GAMMA_ENABLE, initial=1),
        Feature("Gamma", category, "float", GAMMA, minimum=0.25, maximum=4.0, initial=0.8),
    ]  # fmt: skip


def _processing_control() -> list[Feature]:
    category = "ImageProcessingControl"
    return [
        Feature("SharpeningEnable", category, "boolean", SHARPENING_ENABLE, initial=1),
        Feature("LUTEnable", category, "boolean", LUT_ENABLE, initial=0),
        Feature("DefectCorrectStaticEnable", category, "boolean", DEFECT_CORRECT, initial=1),
    ]


def _transport_control() -> list[Feature]:
    formula = "W * H * ((P >> 16) & 0xFF) / 8"
    variables = {"W": "Width", "H": "Height", "P": "PixelFormat"}
    return [
        Feature("PayloadSize", "TransportLayerControl", "formula", 0, formula=formula, variables=variables),
        Feature("TLParamsLocked", "", "integer", PARAMETERS_LOCKED, minimum=0, maximum=1, initial=0),
    ]


def _simulator_control() -> list[Feature]:
    category = "SimulatorControl"
    return [
        Feature("SimSourceLevel", category, "float", SOURCE_LEVEL, "Relative drive of the light source", minimum=0.0,
                maximum=1.0, initial=1.0),
        Feature("SimShutterClosed", category, "boolean", SHUTTER_CLOSED, "Cap on the lens", initial=0),
        Feature("SimPacketLossPerMille", category, "integer", LOSS_PER_MILLE, "Packets lost of a thousand", minimum=0,
                maximum=1000, initial=0),
        Feature("SimStall", category, "boolean", STALL, "Answers, but sends no pictures", initial=0),
        Feature("SimAnswerDelay", category, "float", ANSWER_DELAY_MS,
                "Holds every frame, and what is asked meanwhile, back", unit="ms", minimum=0.0, maximum=10_000.0,
                initial=0.0),
        Feature("SimDisconnect", category, "boolean", DISCONNECT, "Falls silent for good", initial=0),
    ]  # fmt: skip
