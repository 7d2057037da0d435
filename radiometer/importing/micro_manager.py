"""What Micro-Manager and pymmcore-plus write beside the pixels: exposure, gain, binning, bit depth, temperature, time.

Three places are read, in this order: a page's own tag (Micro-Manager's MMStack files), the planes of OME-XML
(pymmcore-plus, and anything else that writes it), and a JSON file beside the pictures (`_frame_metadata.json` of
pymmcore-plus, `metadata.txt` of Micro-Manager).
"""

from __future__ import annotations

import json
import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

from radiometer.importing.found import FoundFrame

TAG: Final = 51123  # MicroManagerMetadata; also in the TIFF tag tables of ImageJ and tifffile
FACT: Final = "acquisition"
_SIDECARS: Final = ("_frame_metadata.json", "metadata.txt")
_SECONDS: Final = {"s": 1.0, "ms": 1e-3, "µs": 1e-6, "us": 1e-6, "min": 60.0}
_LARGEST_TEXT: Final = 50_000_000


@dataclass(frozen=True, slots=True)
class PlaneFacts:
    """What is said of one picture; what is not said is None.

    Attributes:
        source: Where it stands, in words.
        exposure_s: Exposure in s.
        timestamp_s: Time in s, on the acquisition's clock or since 1970.
        gain_db: Gain in dB where its unit is stated.
        gain: Gain in the device's own unit, as text.
        binning: Binning, as text such as "2".
        bit_depth: Bits per pixel.
        temperature_c: Sensor temperature in °C.
        camera: Name of the camera.
    """

    source: str
    exposure_s: float | None = None
    timestamp_s: float | None = None
    gain_db: float | None = None
    gain: str | None = None
    binning: str | None = None
    bit_depth: int | None = None
    temperature_c: float | None = None
    camera: str | None = None
    device: Mapping[str, Any] = field(default_factory=dict)


def planes_of(path: Path, pages: Sequence[Any], ome_xml: str | None) -> list[PlaneFacts | None]:
    """Return what is said of each page of a TIFF file; None where nothing is.

    Args:
        path: The file.
        pages: Its pages.
        ome_xml: Its OME-XML; None where it has none.
    """
    tagged = [_of_tag(page) for page in pages]
    if any(tagged):
        return tagged
    if ome_xml:
        planes = _of_ome(ome_xml, len(pages))
        if any(planes):
            return planes
    return [_of_sidecar(path)] if len(pages) == 1 else [None] * len(pages)


def completed(frame: FoundFrame, facts: PlaneFacts) -> FoundFrame:
    """Return a frame with what an acquisition program says of it; that goes before names, after EXIF."""
    settings, taken, extra = frame.settings, dict(frame.taken), dict(frame.extra)
    camera, doubts = dict(frame.camera), list[str]()
    taken[FACT] = facts.source
    known = frame.exposure_known
    if facts.exposure_s is not None and not taken.get("exposure_s", "file name").startswith("EXIF"):
        settings, known = replace(settings, exposure_s=facts.exposure_s), True
        taken["exposure_s"] = facts.source
    if facts.timestamp_s is not None:
        settings = replace(settings, timestamp_s=facts.timestamp_s)
        taken["timestamp_s"] = facts.source
    if facts.temperature_c is not None:
        settings = replace(settings, temperature_c=facts.temperature_c)
        taken["temperature_C"] = facts.source
    if facts.gain_db is not None:
        settings = replace(settings, gain_db=facts.gain_db)
        taken["gain_db"] = facts.source
    elif facts.gain is not None:
        extra["device_gain"] = facts.gain
        camera["unit"] = f"gain {facts.gain}"  # frames of other gains are another set: their ratio is not known
        doubts.append(f"the gain is {facts.gain} in a unit of the camera's own: it is taken as 0 dB of this set")
    if facts.binning is not None:
        camera["binning"] = facts.binning
    if facts.bit_depth is not None:
        camera["stated_top_dn"] = float((1 << facts.bit_depth) - 1)
    if facts.camera:
        camera.setdefault("model", facts.camera)
    changed = replace(frame, settings=settings, exposure_known=known, camera=camera, taken=taken, extra=extra)
    return changed.doubting(*doubts)


def _of_tag(page: Any) -> PlaneFacts | None:
    tag = page.tags.get(TAG)
    said = tag.value if tag is not None else None
    if isinstance(said, bytes | str):
        said = _json(said if isinstance(said, str) else said.decode("utf-8", "replace"))
    return _of_micro_manager(said, "tag MicroManagerMetadata") if isinstance(said, Mapping) else None


def _of_micro_manager(said: Mapping[str, Any], source: str) -> PlaneFacts:
    """Return the facts of Micro-Manager's own keys, those of the device with its name before them."""
    flat = _flattened(said)
    camera = str(flat.get("Camera") or flat.get("Core-Camera") or "")
    device = {key.removeprefix(f"{camera}-"): value for key, value in flat.items() if key.startswith(f"{camera}-")}
    elapsed = _number(flat.get("ElapsedTime-ms", flat.get("Time-ms")))
    received = _stamp(flat.get("ReceivedTime")) if elapsed is None else None
    exposure = _number(flat.get("Exposure-ms", device.get("Exposure")))
    return PlaneFacts(
        source,
        None if exposure is None else 1e-3 * exposure,
        received if elapsed is None else 1e-3 * elapsed,
        *_gain(device),
        _text(flat.get("Binning", device.get("Binning"))),
        _bits(flat.get("BitDepth", device.get("BitDepth"))),
        _number(device.get("CCDTemperature", device.get("Temperature"))),
        camera or None,
        device,
    )


def _flattened(said: Mapping[str, Any]) -> dict[str, Any]:
    """Return keys and plain values; Micro-Manager 2 wraps values, and keeps the devices' in a mapping of their own."""
    flat: dict[str, Any] = {}
    for key, value in said.items():
        if isinstance(value, Mapping) and "PropVal" in value:
            flat[key] = value["PropVal"]
        elif isinstance(value, Mapping) and key in ("UserData", "ScopeData", "PropertyValues"):
            flat |= _flattened(value)
        elif not isinstance(value, Mapping | list):
            flat[key] = value
    return flat


def _of_ome(text: str, count: int) -> list[PlaneFacts | None]:
    """Return what OME-XML says of the planes of its first image, in the order of the pages."""
    if "<!DOCTYPE" in text or len(text) > _LARGEST_TEXT:
        return [None] * count
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError:
        return [None] * count
    pixels = next(iter(root.iterfind(".//{*}Image/{*}Pixels")), None)
    if pixels is None:
        return [None] * count
    order = pixels.get("DimensionOrder", "XYCZT")[2:]
    sizes = {axis: int(pixels.get(f"Size{axis}", "1")) for axis in "CZT"}
    stated = {
        _page_of({axis: int(plane.get(f"The{axis}", "0")) for axis in "CZT"}, order, sizes): plane
        for plane in pixels.iterfind("{*}Plane")
    }
    device, camera = _devices(root)
    bits = _bits(pixels.get("SignificantBits"))
    begun = _stamp(root.findtext(".//{*}Image/{*}AcquisitionDate"))
    return [_of_plane(stated.get(n), device, camera, bits, begun) for n in range(count)]


def _page_of(place: Mapping[str, int], order: str, sizes: Mapping[str, int]) -> int:
    page, step = 0, 1
    for axis in order:
        page += place[axis] * step
        step *= sizes[axis]
    return page


def _of_plane(
    plane: Any, device: Mapping[str, Any], camera: str | None, bits: int | None, begun: float | None
) -> PlaneFacts | None:
    if plane is None or plane.get("ExposureTime") is None:
        return None
    exposure = _number(plane.get("ExposureTime"))
    after = _number(plane.get("DeltaT"))
    unit, after_unit = (_SECONDS.get(plane.get(key, "s"), 1.0) for key in ("ExposureTimeUnit", "DeltaTUnit"))
    stamp = None if after is None else (begun or 0.0) + after * after_unit
    return PlaneFacts(
        "OME-XML",
        None if exposure is None else exposure * unit,
        stamp,
        *_gain(device),
        _text(device.get("Binning")),
        bits,
        _number(device.get("CCDTemperature", device.get("Temperature"))),
        camera,
        device,
    )


def _devices(root: Any) -> tuple[dict[str, Any], str | None]:
    """Return properties and label of the camera in the summary that pymmcore-plus annotates its files with."""
    for entry in root.iterfind(".//{*}MapAnnotation/{*}Value/{*}M"):
        if entry.get("K") != "summary_metadata_json":
            continue
        summary = _json(entry.text or "")
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
        beside = path.parent / name
        if not beside.is_file() or beside.stat().st_size > _LARGEST_TEXT:
            continue
        said = _json(beside.read_text(encoding="utf-8", errors="replace"))
        found = _entry_of(said, path.name) if isinstance(said, Mapping) else None
        if found is not None:
            return _of_frame_dict(found) if "exposure_ms" in found else _of_micro_manager(found, name)
    return None


def _entry_of(said: Mapping[str, Any], name: str) -> Mapping[str, Any] | None:
    for key, entry in said.items():
        if isinstance(entry, Mapping) and not key.startswith("Coords-"):
            own = str(entry.get("FileName", key)).rsplit("/", maxsplit=1)[-1]
            if own == name:
                return entry
    return None


def _of_frame_dict(said: Mapping[str, Any]) -> PlaneFacts:
    """Return the facts of pymmcore-plus's frame-dict."""
    camera = str(said.get("camera_device") or "")
    values = [v for v in said.get("property_values", ()) if isinstance(v, Mapping)]
    device = {str(v.get("prop")): v.get("val") for v in values if v.get("dev") == camera}
    exposure, elapsed = _number(said.get("exposure_ms")), _number(said.get("runner_time_ms"))
    return PlaneFacts(
        "_frame_metadata.json",
        None if exposure is None else 1e-3 * exposure,
        None if elapsed is None else 1e-3 * elapsed,
        *_gain(device),
        _text(device.get("Binning")),
        _bits(device.get("BitDepth")),
        _number(device.get("CCDTemperature")),
        camera or None,
        device,
    )


def _gain(device: Mapping[str, Any]) -> tuple[float | None, str | None]:
    """Return (gain in dB, or None where the unit is the device's own; that as text)."""
    for key, value in device.items():
        plain = key.lower().replace(" ", "")
        if plain in ("gaindb", "gain(db)", "gain_db", "gain[db]"):
            return _number(value), None
    return None, _text(device.get("Gain"))


def _text(value: Any) -> str | None:
    return None if value is None or str(value) == "" else str(value)


def _bits(value: Any) -> int | None:
    number = _number(str(value).lower().removesuffix("bit").strip("- ")) if value is not None else None
    return int(number) if number is not None and 1 <= number <= 16 else None


def _number(value: Any) -> float | None:
    try:
        return None if value is None else float(value)
    except (TypeError, ValueError):
        return None


def _stamp(text: Any) -> float | None:
    """Return a time in s since 1970; one without a zone is UTC, whatever the zone of this machine."""
    try:
        moment = datetime.fromisoformat(str(text).strip())
    except ValueError:
        return None
    return moment.replace(tzinfo=moment.tzinfo or UTC).timestamp()


def _json(text: str) -> Any:
    try:
        return json.loads(text.strip("\x00 \n"))
    except ValueError:
        return None
