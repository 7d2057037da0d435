"""Maps of radiance written as OpenEXR, Radiance HDR, TIFF, and PNG in false colours."""

from __future__ import annotations

import io
import math
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
import tifffile
from numpy.typing import NDArray
from pydantic import Field

import radiometer
from radiometer.analysis.photometry.photometry import Spectrum, luminous_efficacy
from radiometer.data import PixelMask, Provenance, RadianceMap
from radiometer.data.json_text import json_text, parsed_json
from radiometer.data.reader_limits import bounded_reader
from radiometer.data.reading import LUMINANCE_UNIT, RADIANCE_UNIT
from radiometer.data.storage import write_bytes_atomic
from radiometer.data.validation import FileSection, validate
from radiometer.errors import InputError, MeasurementError, OutputError, UsageError, required_library
from radiometer.reporting.origin import moment

_LABELS: Final = {RADIANCE_UNIT: "radiance in W·sr⁻¹·m⁻²", LUMINANCE_UNIT: "luminance in cd·m⁻²"}
_LETTERS: Final = {"red": "R", "green": "G", "blue": "B"}  # channels of colour pictures, as programs know them
_SHARED: Final = "shared standard uncertainty"  # name of the page with what pixels of one level share
_WITHOUT_VALUE: Final = int(PixelMask.SATURATED | PixelMask.UNLIT)
_CLIPPED_COLOUR: Final = "#ff40ff"
_RADIANCE_LM_PER_W: Final = 179.0  # luminous efficacy in Radiance's pictures (WHTEFFICACY, src/common/color.h)
_MOST_DECADES: Final = 6.0  # more than an eye can tell apart in one picture

_Unit = Literal["W sr-1 m-2", "cd m-2", "relative", "1", "K"]  # of maps that this program writes


class _MapFacts(FileSection):
    """What the description of a map's page of values states."""

    unit: _Unit
    u_rel_common: float = Field(ge=0)
    channels: tuple[str, ...] | None = None
    units: tuple[_Unit, ...] | None = None
    origin: dict[str, Any] = Field(default_factory=dict)
    not_in_u: tuple[str, ...] = ()
    u_rel_pattern: float = Field(0.0, ge=0)


def write_exr(path: Path, picture: MapPicture) -> None:
    """Write a picture as OpenEXR.

    Channels are Y (or R, G, B) for the values, Y.u (R.u, …) for their standard uncertainty, both 32-bit floating
    point, and Y.mask (R.mask, …) for the PixelMask bits. Where pixels of one level share a part of the uncertainty,
    that is Y.shared (R.shared, …). Several quantities have their own names. The header names the
    unit of the first channel and of each, what all pixels share (`u_rel_common`), what pixels may differ by
    (`u_rel_pattern`), and what is in no uncertainty (`not_in_u`).

    Raises:
        MissingLibrary: If the OpenEXR package is not installed.
        OutputError: If the file cannot be written.
    """
    OpenEXR = required_library("OpenEXR", "writing .exr needs the package OpenEXR (pip install OpenEXR); or use .tiff")
    header = {
        "compression": OpenEXR.ZIP_COMPRESSION,
        "type": OpenEXR.scanlineimage,
        "unit": picture.unit,
        "units": "; ".join(f"{_LETTERS.get(name, name)}: {one.unit}" for name, one in picture.maps.items()),
        "u_rel_common": float(picture.first.u_rel_common),
        "u_rel_pattern": float(picture.first.u_rel_pattern),
        "not_in_u": "; ".join(picture.first.not_in_u),
        "software": f"radiometer {radiometer.__version__}",
    }
    file = OpenEXR.File(header, _channels(picture))
    with tempfile.TemporaryDirectory() as scratch:  # the library writes to a name only
        temporary = Path(scratch) / "map.exr"
        try:
            file.write(str(temporary))
        except (OSError, RuntimeError) as error:
            raise OutputError(f"cannot write {path}: {error}") from error
        write_bytes_atomic(path, temporary.read_bytes())


def _channels(picture: MapPicture) -> dict[str, Any]:
    channels: dict[str, Any] = {}
    for name, found in picture.maps.items():
        letter = "Y" if len(picture.maps) == 1 else _LETTERS.get(name, name)
        channels[letter] = np.ascontiguousarray(found.radiance)
        channels[f"{letter}.u"] = np.ascontiguousarray(found.u_radiance)
        channels[f"{letter}.mask"] = found.mask.astype(np.uint32)
        if found.u_shared is not None:
            channels[f"{letter}.shared"] = np.ascontiguousarray(found.u_shared)
    return channels


def write_hdr(path: Path, picture: MapPicture) -> None:
    """Write a picture as .hdr; values in its unit, EXPOSURE 1, negative values as 0.

    Programs that read the form take luminance as 179 lm/W times the values: cd·m⁻² are divided by that.
    The form keeps no uncertainty and resolves 0.4 %; it holds no path and no user name.

    Raises:
        OutputError: If the file cannot be written.

    Source: Ward 1991, "Real pixels", Graphics Gems II; Radiance, picture format.
    """
    grey = picture.first.radiance
    planes = [picture.maps[name].radiance for name in ("red", "green", "blue")] if picture.is_colour else [grey] * 3
    height, width = grey.shape
    is_luminance = picture.unit == LUMINANCE_UNIT
    header = (
        "#?RADIANCE\n"
        f"SOFTWARE=radiometer {radiometer.__version__}\n"
        f"UNIT={f'{LUMINANCE_UNIT} / {_RADIANCE_LM_PER_W:g}' if is_luminance else picture.unit}\n"
        "EXPOSURE=1\n"
        "FORMAT=32-bit_rle_rgbe\n\n"
        f"-Y {height} +X {width}\n"
    )
    values = np.stack(planes, axis=-1) / np.float32(_RADIANCE_LM_PER_W if is_luminance else 1.0)
    write_bytes_atomic(path, header.encode("ascii") + rgbe(values).tobytes())


def rgbe(values: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Return RGBE quadruples of non-negative values, rounded to the nearest.

    Args:
        values: Shape (height, width, 3); negative or not finite values count as 0.

    Returns:
        Shape (height, width, 4), uint8: mantissas of red, green and blue, and the exponent + 128.
    """
    clean = np.where(np.isfinite(values), np.maximum(values, 0.0), 0.0).astype(np.float64)
    largest = clean.max(axis=-1)
    _, exponent = np.frexp(largest)
    # A mantissa that rounds up to 256 moves to the next exponent.
    exponent = exponent + (np.rint(largest / np.exp2(exponent - 8.0)) >= 256.0)
    mantissa = np.rint(clean / np.exp2(exponent - 8.0)[..., None])
    shown = (largest > 1e-38) & (exponent > -128)
    out = np.zeros((*values.shape[:2], 4), np.uint8)
    out[..., :3] = np.where(shown[..., None], np.minimum(mantissa, 255.0), 0.0)
    out[..., 3] = np.where(shown, np.clip(exponent + 128, 0, 255), 0)
    return out


def write_tiff(path: Path, picture: MapPicture) -> None:
    """Write a picture as TIFF of three pages: values and standard uncertainty as float32, mask bits as uint8.

    Where pixels of one level share a part of the uncertainty, that is a fourth page.

    Each page's description is JSON with the quantity and the unit; with the names and units of the channels where they
    are no colours. The first holds `origin` as well: when and with what the frames were taken and merged.

    Raises:
        OutputError: If the file cannot be written.
    """
    names = tuple(_LETTERS) if picture.is_colour else tuple(picture.maps)
    found = [picture.maps[name] for name in names]
    pages: dict[str, NDArray[Any]] = {
        "value": np.stack([one.radiance for one in found], axis=-1),
        "standard uncertainty": np.stack([one.u_radiance for one in found], axis=-1),
        "mask": np.stack([one.mask for one in found], axis=-1),
    }
    if any(one.u_shared is not None for one in found):
        none = np.zeros(found[0].shape, np.float32)
        pages[_SHARED] = np.stack([none if one.u_shared is None else one.u_shared for one in found], axis=-1)
    stream = io.BytesIO()
    with tifffile.TiffWriter(stream) as tiff:
        for quantity, values in pages.items():
            unit = "PixelMask bits" if quantity == "mask" else picture.unit
            facts = {"quantity": quantity, "unit": unit, "u_rel_common": picture.first.u_rel_common}
            if len(names) > 1 and not picture.is_colour:
                facts |= {"channels": names, "units": [one.unit for one in found]}
            if quantity == "value":
                provenance = picture.first.provenance
                facts["origin"] = {**provenance.parameters.get("origin", {}), "merged": moment(provenance.created)}
                facts |= {"not_in_u": picture.first.not_in_u, "u_rel_pattern": picture.first.u_rel_pattern}
            tiff.write(
                values if len(names) > 1 else values[..., 0],
                photometric="rgb" if picture.is_colour else "minisblack",
                planarconfig="contig" if len(names) > 1 else None,
                description=json_text(facts, ascii_only=True),
                software=f"radiometer {radiometer.__version__}",
                metadata=None,
            )
    write_bytes_atomic(path, stream.getvalue())


@bounded_reader(error=InputError)
def read_tiff(path: Path) -> MapPicture:
    """Return the maps of a TIFF that `write_tiff` wrote.

    Raises:
        InputError: If it cannot be read, or is no such file.
    """
    try:
        with tifffile.TiffFile(path) as tiff:
            pages = {}
            for page in tiff.pages:
                facts = parsed_json(page.description)
                pages[str(facts["quantity"])] = (page.asarray(), facts)
        (values, facts), (u, _), (mask, _) = (pages[name] for name in ("value", "standard uncertainty", "mask"))
        shared = pages[_SHARED][0].reshape(*u.shape[:2], -1) if _SHARED in pages else None
    except FileNotFoundError as error:
        raise InputError(f"{path} does not exist; write a map by `radiometer merge -o {path.name}`") from error
    except (OSError, ValueError, KeyError, TypeError, AttributeError, tifffile.TiffFileError) as error:
        raise InputError(
            f"{path}: is no map of radiance with its uncertainty; write one by `radiometer merge -o FILE.tiff`"
        ) from error
    stated = validate(_MapFacts, facts, str(path), InputError)
    names = stated.channels or (tuple(_LETTERS) if values.ndim == 3 else ("mono",))
    value, own, bits = (one.reshape(*one.shape[:2], -1) for one in (values, u, mask))
    units = stated.units or (stated.unit,) * len(names)
    alike = {one.shape for one in (value, own, bits, *([] if shared is None else [shared]))}
    if alike != {(*value.shape[:2], len(names))} or len(units) != len(names):
        raise InputError(f"{path}: its pages are of different sizes; write the map again by `radiometer merge`")
    unknown = np.isfinite(value) & ((bits & _WITHOUT_VALUE) == 0) & ~(np.isfinite(own) & (own >= 0.0))
    if unknown.any():
        raise InputError(
            f"{path}: {int(unknown.sum())} values are without their uncertainty; write the map again by "
            "`radiometer merge`"
        )
    provenance = Provenance("read", (str(path),), parameters={"origin": stated.origin})
    return MapPicture(
        {
            name: RadianceMap(
                *(value[..., n], own[..., n], bits[..., n], units[n], stated.u_rel_common),
                provenance=provenance,
                not_in_u=stated.not_in_u,
                u_shared=None if shared is None else shared[..., n],
                u_rel_pattern=stated.u_rel_pattern,
            )
            for n, name in enumerate(names)
        }
    )


def write_false_colour(path: Path, picture: MapPicture) -> None:
    """Write a map as PNG in false colours on a logarithmic scale, with a scale bar.

    What clips everywhere is magenta, what never rises above the noise is black. Of a colour picture the green
    channel is shown.

    Args:
        picture: The map, with the bounds of the scale where they are requested.

    Raises:
        UsageError: If the bounds are not 0 < low < high.
        MeasurementError: If no pixel has a value above 0.
        OutputError: If the file cannot be written.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.colors import LogNorm
    from matplotlib.figure import Figure
    from matplotlib.patches import Patch as Swatch

    found = picture.first
    low, high = _bounds(picture)
    height, width = found.shape
    inches = 6.4 * min(2.0, max(0.4, height / width))
    figure = Figure(figsize=(8.6, inches + 0.6), dpi=max(100.0, min(300.0, width / 6.4)), layout="constrained")
    axes = figure.add_subplot()
    shown = np.ma.masked_less_equal(found.radiance, 0.0)
    image = axes.imshow(shown, norm=LogNorm(low, high), cmap="inferno", interpolation="nearest")
    axes.set_facecolor("black")
    axes.set_xticks([])
    axes.set_yticks([])
    figure.colorbar(image, ax=axes, label=_LABELS.get(found.unit, "relative radiance"), extend="both", fraction=0.05)
    clipped = found.mask & PixelMask.SATURATED > 0
    if clipped.any():
        axes.imshow(_overlay(clipped), interpolation="nearest")
        axes.legend(handles=[Swatch(color=_CLIPPED_COLOUR, label="clipped in every frame")], loc="lower right")
    stream = io.BytesIO()
    FigureCanvasAgg(figure)
    figure.savefig(stream, format="png", metadata={"Software": f"radiometer {radiometer.__version__}"})
    write_bytes_atomic(path, stream.getvalue())


def _bounds(picture: MapPicture) -> tuple[float, float]:
    if picture.bounds is not None:
        low, high = picture.bounds
        if not 0.0 < low < high:
            raise UsageError(f"the scale runs from {low:g} to {high:g}; it needs 0 < low < high")
        return low, high
    found = picture.first
    sound = found.radiance[(found.radiance > 0) & (found.mask & (PixelMask.BELOW_NOISE | PixelMask.SATURATED) == 0)]
    values = sound if sound.size else found.radiance[found.radiance > 0]
    if not values.size:
        raise MeasurementError("no pixel shows light, so there is nothing to colour")
    low, high = (float(v) for v in np.percentile(values, (0.1, 99.9)))
    low = max(low, high * 10.0**-_MOST_DECADES)
    return (low, high) if low < high else (low / 2.0, high * 2.0)


def _overlay(clipped: NDArray[np.bool_]) -> NDArray[np.uint8]:
    colour = tuple(int(_CLIPPED_COLOUR[i : i + 2], 16) for i in (1, 3, 5))
    overlay = np.zeros((*clipped.shape, 4), np.uint8)
    overlay[clipped] = (*colour, 255)
    return overlay


@dataclass(frozen=True, slots=True, eq=False)
class MapPicture:
    """Maps of one scene: a grey one, three colours in one unit, or several quantities."""

    maps: Mapping[str, RadianceMap]  # by channel: one of any name; "red", "green", "blue"; or one per quantity
    # Lowest and highest value of the false colours; None takes those of the picture
    bounds: tuple[float, float] | None = None

    @property
    def is_colour(self) -> bool:
        """Return whether there are the three colours."""
        return set(self.maps) == set(_LETTERS)

    @property
    def first_name(self) -> str:
        """Return the name of the only map, of the first quantity, or of the green one."""
        return "green" if self.is_colour else next(iter(self.maps))

    @property
    def first(self) -> RadianceMap:
        """Return the map of that name."""
        return self.maps[self.first_name]

    @property
    def unit(self) -> str:
        """Return the unit of the values."""
        return self.first.unit


Writer = Callable[[Path, MapPicture], None]


def in_luminance(found: RadianceMap, spectrum: Spectrum) -> RadianceMap:
    """Return a map in cd·m⁻² under a spectrum.

    Raises:
        UsageError: If the map is relative.
        InputError: If the spectrum holds no visible light.
    """
    if found.unit != RADIANCE_UNIT:
        raise UsageError("a relative map has no luminance; merge with a calibration")
    efficacy = luminous_efficacy(spectrum)
    common = math.hypot(found.u_rel_common, efficacy.u_rel)
    return replace(found.scaled(efficacy.value, LUMINANCE_UNIT), u_rel_common=common)


def writer_for(path: Path) -> Writer:
    """Return what writes the form that a file's ending names.

    Raises:
        UsageError: If there is no such form; the message lists those there are.
    """
    writer = WRITERS.get(path.suffix.lower())
    if writer is None:
        raise UsageError(f"{path}: cannot write {path.suffix or 'a file without an ending'}; use {', '.join(WRITERS)}")
    return writer


WRITERS: Final[dict[str, Writer]] = {
    ".exr": write_exr,
    ".hdr": write_hdr,
    ".tiff": write_tiff,
    ".tif": write_tiff,
    ".png": write_false_colour,
}
