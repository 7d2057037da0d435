"""Read what Micro-Manager and pymmcore-plus write with the pixels: exposure, gain, binning, temperature and so on.

Three places are read, in this order. First a page's own tag (Micro-Manager's MMStack files). Then the planes of
OME-XML (pymmcore-plus, and anything else that writes it). Last a JSON file next to the pictures
(`_frame_metadata.json` of pymmcore-plus, `metadata.txt` of Micro-Manager).
"""

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

from radiometer.data.capture_header import as_binning
from radiometer.data.json_text import RepeatedKey, parsed_json
from radiometer.data.statements import Statement, StatementMap, value_of
from radiometer.errors import CaptureError
from radiometer.importing.found import FoundFrame
from radiometer.moments import moment_of
from radiometer.units import heading_parts

TAG: Final = 51123  # MicroManagerMetadata; also in the TIFF tag tables of ImageJ and tifffile
FACT: Final = "acquisition"
_SIDECARS: Final = ("_frame_metadata.json", "metadata.txt")
_LARGEST_TEXT: Final = 50_000_000  # characters: far beyond the metadata of any acquisition

_NO_PLANE: Final = ElementTree.Element("Plane")


@dataclass(frozen=True, slots=True)
class PlaneFacts:
    """What is stated of one picture; what is not stated is None."""

    source: str  # where it stands, in words
    exposure_s: float | None = None  # exposure in s
    timestamp_s: float | None = None  # time in s, on the acquisition's clock or since 1970
    gain_db: float | None = None  # gain in dB where its unit is stated
    gain: str | None = None  # gain in the device's own unit, as text
    binning: str | None = None  # binning, as text such as "2"
    bit_depth: int | None = None  # bits per pixel
    temperature_c: float | None = None  # sensor temperature in °C
    camera: str | None = None  # name of the camera
    device: Mapping[str, Any] = field(default_factory=dict)  # properties of the camera by name
    doubts: tuple[str, ...] = ()  # what is stated as unknown
    band: str | None = None  # of what wavelength the light is, where the file holds several
    scene: str | None = None  # of which image the picture is, where the file holds several

    @property
    def states_anything(self) -> bool:
        """Return whether a setting is stated, or of what the picture is."""
        stated = (self.exposure_s, self.gain_db, self.gain, self.temperature_c, self.band, self.scene)
        return bool(self.doubts) or any(one is not None for one in stated)

    def header(self) -> dict[str, Statement]:
        """Return the camera's properties as statements, where a user may point to."""
        return {name: Statement(value) for name, value in self.device.items()}


def planes_of(path: Path, pages: Sequence[Any], ome_xml: str | None) -> list[PlaneFacts | None]:
    """Return what is stated of each page of a TIFF file; None where nothing is.

    Args:
        ome_xml: Its OME-XML; None where it has none.

    Raises:
        CaptureError: If a key occurs twice in an object of its JSON.
    """
    tagged = [_of_tag(page, path) for page in pages]
    if any(tagged):
        return tagged
    if ome_xml:
        planes = _of_ome(ome_xml, path, [page.index for page in pages])
        if any(planes):
            return planes
    return [_of_sidecar(path)] if len(pages) == 1 else [None] * len(pages)


def completed(frame: FoundFrame, facts: PlaneFacts, mapped: StatementMap) -> FoundFrame:
    """Return a frame with what an acquisition program states of it; that goes before names, after EXIF and the user."""
    settings, taken, extra = frame.settings, dict(frame.taken), dict(frame.extra)
    camera, doubts = dict(frame.camera), list(facts.doubts)
    taken[FACT] = facts.source
    known = frame.exposure_known
    if facts.exposure_s is not None and taken.get("exposure_s", "file name") == "file name":
        settings, known = replace(settings, exposure_s=facts.exposure_s), True
        taken["exposure_s"] = facts.source
    if facts.timestamp_s is not None:
        settings = replace(settings, timestamp_s=facts.timestamp_s)
        taken["timestamp_s"] = facts.source
    if facts.temperature_c is not None and "temperature" not in mapped.places:
        settings = replace(settings, temperature_c=facts.temperature_c)
        taken["temperature_C"] = facts.source
    if "gain" in mapped.places:
        pass  # the user's word is in the frame already
    elif facts.gain_db is not None:
        settings = replace(settings, gain_db=facts.gain_db)
        taken["gain_db"] = facts.source
    elif facts.gain is not None:
        extra["device_gain"] = facts.gain
        camera["mode"] = f"gain {facts.gain}"  # frames of other gains are another set: their ratio is not known
        doubts.append(f"the gain is {facts.gain} in a unit of the camera's own: it counts as 0 dB of this set")
    if facts.binning is not None:
        camera["binning"] = as_binning(facts.binning)
    if facts.bit_depth is not None:
        camera["stated_top_dn"] = float((1 << facts.bit_depth) - 1)
    if facts.camera:
        camera.setdefault("model", facts.camera)
    if facts.band is not None:
        camera["band"] = facts.band
    if facts.scene is not None:
        camera["scene"] = facts.scene  # frames of another image are another set: they show something else
    changed = replace(frame, settings=settings, exposure_known=known, camera=camera, taken=taken, extra=extra)
    return changed.doubting(*doubts)


def _of_tag(page: Any, path: Path) -> PlaneFacts | None:
    tag = page.tags.get(TAG)
    if tag is None:
        return None
    page.parent.filehandle.seek(tag.valueoffset)  # tifffile's own value takes the last of a key that occurs twice
    text = page.parent.filehandle.read(tag.valuebytecount).decode("utf-8", "replace")
    content = _json(text, f"{path}, tag {TAG}")
    return _of_micro_manager(content, "tag MicroManagerMetadata") if isinstance(content, Mapping) else None


def _of_micro_manager(content: Mapping[str, Any], source: str) -> PlaneFacts:
    """Return the facts of Micro-Manager's own keys, those of the device with its name before them."""
    flat = _flattened(content)
    camera = str(flat.get("Camera") or flat.get("Core-Camera") or "")
    device = {key.removeprefix(f"{camera}-"): value for key, value in flat.items() if key.startswith(f"{camera}-")}
    doubts = list[str]()
    elapsed = _value("timestamp", flat.get("ElapsedTime-ms", flat.get("Time-ms")), "ElapsedTime-ms", doubts, "ms")
    return PlaneFacts(
        source,
        # Micro-Manager's core counts exposures in ms (MMCore API, setExposure).
        _value("exposure", flat.get("Exposure-ms", device.get("Exposure")), "Exposure-ms", doubts, "ms"),
        _stamp(flat.get("ReceivedTime")) if elapsed is None else elapsed,
        *_gain(device, doubts),
        _text(flat.get("Binning", device.get("Binning"))),
        _bits(flat.get("BitDepth", device.get("BitDepth"))),
        _celsius(device, doubts),
        camera or None,
        {**flat, **device},
        tuple(doubts),
    )


def _flattened(content: Mapping[str, Any]) -> dict[str, Any]:
    """Return keys and plain values; Micro-Manager 2 wraps values, and keeps the devices' in a separate mapping."""
    flat: dict[str, Any] = {}
    for key, value in content.items():
        if isinstance(value, Mapping) and "PropVal" in value:
            flat[key] = value["PropVal"]
        elif isinstance(value, Mapping) and key in ("UserData", "ScopeData", "PropertyValues"):
            flat |= _flattened(value)
        elif not isinstance(value, Mapping | list):
            flat[key] = value
    return flat


def _of_ome(text: str, path: Path, pages: Sequence[int]) -> list[PlaneFacts | None]:
    """Return what OME-XML states of the planes of its images, in the order of the pages.

    Args:
        path: The file, one of perhaps several that the XML describes.
        pages: Numbers of the directories that are frames.
    """
    nothing: list[PlaneFacts | None] = [None] * len(pages)
    if "<!DOCTYPE" in text or len(text) > _LARGEST_TEXT:
        return nothing
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError:
        return nothing
    device, camera = _devices(root, path)
    found: dict[int, PlaneFacts | None] = {}
    images = list(root.iterfind(".//{*}Image"))
    names = [str(image.get("Name") or image.get("ID", "")) for image in images]
    for number, image in enumerate(images):
        pixels = image.find("{*}Pixels")
        if pixels is None:
            continue
        where = _pages_of(pixels, path, root.get("UUID", ""), max(pages, default=-1) + 1)
        begun, bits = _stamp(image.findtext("{*}AcquisitionDate")), _bits(pixels.get("SignificantBits"))
        bands = _bands(pixels)
        # Two images of one name are two scenes all the same.
        again = f" {image.get('ID', number)}" if names.index(names[number]) < number else ""
        scene = f"{names[number]}{again}" if len(images) > 1 else None
        stated = {_place_of(plane, "The"): plane for plane in reversed(list(pixels.iterfind("{*}Plane")))}
        for place, page in where.items():
            own = {**device, **_detector(pixels, place[0])}
            # A file need not describe its planes; their image and channel count all the same.
            facts = _of_plane(stated.get(place, _NO_PLANE), str(path), own, camera, bits, begun)
            facts = replace(facts, band=bands.get(place[0]), scene=scene)
            found.setdefault(page, facts if facts.states_anything else None)
    return [found.get(page) for page in pages]


def _detector(pixels: Any, channel: int) -> dict[str, Any]:
    """Return what OME-XML states of the detector of a channel: gain and offset in its own units, and binning."""
    channels = list(pixels.iterfind("{*}Channel"))
    settings = channels[channel].find("{*}DetectorSettings") if channel < len(channels) else None
    return {} if settings is None else {key: value for key, value in settings.attrib.items() if key != "ID"}


def _bands(pixels: Any) -> dict[int, str]:
    """Return the name of each channel's light, where channels state different wavelengths; else nothing."""
    stated = {
        number: (channel.get("EmissionWavelength") or channel.get("ExcitationWavelength"), channel.get("Name"))
        for number, channel in enumerate(pixels.iterfind("{*}Channel"))
    }
    if len({wavelength for wavelength, _ in stated.values()}) < 2:
        return {}
    return {number: name or f"{wavelength or 'unknown'} nm" for number, (wavelength, name) in stated.items()}


def _place_of(element: Any, prefix: str) -> tuple[int, int, int]:
    return tuple(_whole(element.get(f"{prefix}{axis}"), 0) for axis in "CZT")  # type: ignore[return-value]  # three


def _whole(text: str | None, default: int) -> int:
    return int(text) if text and text.strip().isdigit() else default


def _pages_of(pixels: Any, path: Path, own_uuid: str, count: int) -> dict[tuple[int, int, int], int]:
    """Return the directory of each place (C, Z, T): as TiffData states it, else by DimensionOrder.

    Source: OME data model, OME-TIFF specification: IFD, First*, PlaneCount and their defaults.
    """
    order = pixels.get("DimensionOrder", "XYCZT")[2:]
    sizes = {axis: max(1, _whole(pixels.get(f"Size{axis}"), 1)) for axis in "CZT"}
    found: dict[tuple[int, int, int], int] = {}
    blocks = list(pixels.iterfind("{*}TiffData"))
    for block in blocks:
        if not _is_of(block.find("{*}UUID"), path, own_uuid):
            continue  # a plane of another file
        first = _whole(block.get("IFD"), 0)
        several = _whole(block.get("PlaneCount"), 1 if block.get("IFD") is not None else count - first)
        start = _number_of(_place_of(block, "First"), order, sizes)
        for n in range(min(several, count - first)):
            found.setdefault(_place_at(start + n, order, sizes), first + n)
    return found if blocks else {_place_at(n, order, sizes): n for n in range(count)}


def _is_of(uuid: Any, path: Path, own_uuid: str) -> bool:
    """Return whether a plane is of this file: by its UUID, which renaming keeps, else by the name."""
    if uuid is None:
        return True
    stated = (uuid.text or "").strip()
    return stated == own_uuid if stated and own_uuid else bool(uuid.get("FileName", path.name) == path.name)


def _number_of(place: tuple[int, int, int], order: str, sizes: Mapping[str, int]) -> int:
    number, step = 0, 1
    for axis in order:
        number += place["CZT".index(axis)] * step
        step *= sizes[axis]
    return number


def _place_at(number: int, order: str, sizes: Mapping[str, int]) -> tuple[int, int, int]:
    place = {}
    for axis in order:
        number, place[axis] = divmod(number, sizes[axis])
    return place["C"], place["Z"], place["T"]


def _of_plane(
    plane: Any, where: str, device: Mapping[str, Any], camera: str | None, bits: int | None, begun: float | None
) -> PlaneFacts:
    doubts = list[str]()
    # The schema (OME 2016-06, Plane) gives s where no unit is stated.
    exposure = _value(
        "exposure", plane.get("ExposureTime"), "ExposureTime", doubts, "s", _unit(plane, "ExposureTimeUnit"), where
    )
    after = _value("timestamp", plane.get("DeltaT"), "DeltaT", doubts, "s", _unit(plane, "DeltaTUnit"), where)
    return PlaneFacts(
        "OME-XML",
        exposure,
        None if after is None else (begun or 0.0) + after,
        *_gain(device, doubts),
        _text(device.get("Binning")),
        bits,
        _celsius(device, doubts),
        camera,
        {**device, **{f"Plane {name}": value for name, value in plane.attrib.items()}},
        tuple(doubts),
    )


def _unit(plane: Any, name: str) -> str:
    """Return a unit as it stands; "" where there is none. A blank one is none that the schema knows."""
    unit = plane.get(name, "")
    return str(unit) if unit.strip() or name not in plane.attrib else repr(unit)


def _value(
    fact: str, written: Any, place: str, doubts: list[str], defined: str, unit: str = "", where: str = ""
) -> float | None:
    return value_of(Statement(written, unit), fact, place, doubts, defined=defined, where=where)


def _devices(root: Any, path: Path) -> tuple[dict[str, Any], str | None]:
    """Return properties and label of the camera in the summary that pymmcore-plus annotates its files with."""
    for entry in root.iterfind(".//{*}MapAnnotation/{*}Value/{*}M"):
        if entry.get("K") != "summary_metadata_json":
            continue
        summary = _json(entry.text or "", f"{path}, its OME-XML")
        if not isinstance(summary, Mapping):
            continue
        labels = [info.get("camera_label") for info in summary.get("image_infos", ()) if isinstance(info, Mapping)]
        for device in summary.get("devices", ()):
            if device.get("label") in labels:
                found = {p["name"]: p.get("value") for p in device.get("properties", ()) if p.get("value") is not None}
                return found, str(device["label"])
    return {}, None


def _of_sidecar(path: Path) -> PlaneFacts | None:
    for name in _SIDECARS:
        json_file = path.parent / name
        if not json_file.is_file() or json_file.stat().st_size > _LARGEST_TEXT:
            continue
        content = _json(json_file.read_text(encoding="utf-8", errors="replace"), str(json_file))
        found = _entry_of(content, path.name) if isinstance(content, Mapping) else None
        if found is not None:
            return _of_frame_dict(found) if "exposure_ms" in found else _of_micro_manager(found, name)
    return None


def _entry_of(content: Mapping[str, Any], name: str) -> Mapping[str, Any] | None:
    for key, entry in content.items():
        if isinstance(entry, Mapping) and not key.startswith("Coords-"):
            own = str(entry.get("FileName", key)).rsplit("/", maxsplit=1)[-1]
            if own == name:
                return entry
    return None


def _of_frame_dict(content: Mapping[str, Any]) -> PlaneFacts:
    """Return the facts of pymmcore-plus's frame-dict."""
    camera = str(content.get("camera_device") or "")
    values = [v for v in content.get("property_values", ()) if isinstance(v, Mapping)]
    device = {str(v.get("prop")): v.get("val") for v in values if v.get("dev") == camera}
    doubts = list[str]()
    return PlaneFacts(
        "_frame_metadata.json",
        _value("exposure", content.get("exposure_ms"), "exposure_ms", doubts, "ms"),
        _value("timestamp", content.get("runner_time_ms"), "runner_time_ms", doubts, "ms"),
        *_gain(device, doubts),
        _text(device.get("Binning")),
        _bits(device.get("BitDepth")),
        _celsius(device, doubts),
        camera or None,
        device,
        tuple(doubts),
    )


def _celsius(device: Mapping[str, Any], doubts: list[str]) -> float | None:
    return _value(
        "temperature", device.get("CCDTemperature", device.get("Temperature")), "CCDTemperature", doubts, "degC"
    )


def _gain(device: Mapping[str, Any], doubts: list[str]) -> tuple[float | None, str | None]:
    """Return (gain in dB, or None where the unit is the device's own; that as text)."""
    for key, value in device.items():
        name, unit, spelling = heading_parts(key, "gain")
        if name == "gain" and unit is not None:
            return _value("gain", value, key, doubts, "", spelling), None
    return None, _text(device.get("Gain"))


def _text(value: Any) -> str | None:
    return None if value is None or str(value) == "" else str(value)


def _bits(value: Any) -> int | None:
    digits = re.fullmatch(r"(\d{1,2})(?:\.0*)?[- ]?(?:bits?)?", str(value).strip().lower())
    return int(digits[1]) if digits and 1 <= int(digits[1]) <= 16 else None


def _stamp(text: Any) -> float | None:
    """Return a time in s since 1970; None where it is none."""
    try:
        return moment_of(str(text)).timestamp()
    except ValueError:
        return None


def _json(text: str, where: str) -> Any:
    """Return what a text holds; None where it is no JSON. Raises CaptureError where a key occurs twice."""
    try:
        return parsed_json(text.strip("\x00 \n"))
    except RepeatedKey as error:
        raise CaptureError(f"{where}: {error}") from error
    except ValueError:
        return None
