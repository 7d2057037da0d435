"""Measures from a radiance map: regions, contrast, profiles, and the illuminance of a fisheye picture."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from radiometer.analysis.exports.maps import MapPicture, in_luminance, read_tiff
from radiometer.analysis.photometry.photometry import spectrum as spectrum_of
from radiometer.analysis.regions.figures import (
    Projection,
    RegionFigures,
    profile,
    ratio_of,
    region_figures,
    vertical_illuminance,
)
from radiometer.analysis.regions.glare import glare_of
from radiometer.api.files import PathLike
from radiometer.api.meter import PatchLike, as_patch
from radiometer.api.radiance import Radiance, quantity_in_words
from radiometer.api.result import Drawn, or_null
from radiometer.data import Patch, Quantity, RadianceMap
from radiometer.data.drawing import new_axes, picture
from radiometer.data.storage import write_text_atomic
from radiometer.errors import UsageError
from radiometer.reporting.origin import Origin
from radiometer.reporting.page import listed, page, section, table
from radiometer.reporting.pictures import label, mark
from radiometer.typing import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_MOST_IN_HEADLINE: Final = 3
_FIGURES = ("mean", "median", "lowest", "highest", "deviation", "uniformity")


@dataclass(frozen=True, eq=False, repr=False)
class MapAnalysis(Drawn):
    """Figures of a radiance map; all uncertainties are standard ones (k = 1).

    Attributes:
        origin: File of the map, or its repr.
        map: The map in the unit of the figures.
        regions: Figures by region.
        contrast: Ratio of two regions' means.
        profile: Distance in pixels, values and standard uncertainty along the line.
        illuminance: Vertical illuminance of a fisheye picture.
        ugr: Unified glare rating of a fisheye picture.
        dgp: Daylight glare probability of a fisheye picture.
        assumptions: What was assumed, a sentence each.
    """

    origin: str
    map: RadianceMap
    regions: tuple[RegionFigures, ...]
    contrast: Quantity | None = None
    profile: tuple[Array, Array, Array] | None = None
    illuminance: Quantity | None = None
    ugr: Quantity | None = None
    dgp: Quantity | None = None
    assumptions: tuple[str, ...] = field(default=())

    def to_mapping(self) -> dict[str, Any]:
        """Return the documented JSON form."""
        mapping: dict[str, Any] = {
            "map": self.origin,
            "unit": self.map.unit,
            "regions": {
                one.name: {
                    "patch": [one.patch.x, one.patch.y, one.patch.width, one.patch.height],
                    **{name: getattr(one, name).to_mapping() for name in _FIGURES},
                    "good_share": one.good_share,
                    "flags": list(one.flags),
                }
                for one in self.regions
            },
            **{name: or_null(getattr(self, name)) for name in ("contrast", "illuminance", "ugr", "dgp")},
            "assumptions": list(self.assumptions),
        }
        if self.profile is not None:
            names = ("distance_px", "value", "u")
            mapping["profile"] = {name: one.tolist() for name, one in zip(names, self.profile, strict=True)}
        return mapping

    @property
    def of_picture(self) -> dict[str, Quantity]:
        """Return the figures of no single region by name, those that were asked for."""
        named = {"contrast": self.contrast, "vertical illuminance": self.illuminance, "UGR": self.ugr, "DGP": self.dgp}
        return {name: one for name, one in named.items() if one is not None}

    @property
    def flags(self) -> list[str]:
        """Return what makes a figure doubtful, a sentence each."""
        return [f"{one.name}: {flag}" for one in self.regions for flag in one.flags]

    def write_csv(self, path: PathLike) -> None:
        """Write a row for each figure; one of no region has no name. Raises OutputError."""
        stream = io.StringIO()
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(["region", "figure", "value", "u", "unit"])
        figures = [(one.name, name, getattr(one, name)) for one in self.regions for name in _FIGURES]
        figures += [("", name.split()[-1].lower(), one) for name, one in self.of_picture.items()]
        writer.writerows([region, name, one.value, one.u, one.unit] for region, name, one in figures)
        write_text_atomic(Path(path), stream.getvalue())

    def write_report(self, path: PathLike) -> None:
        """Write a self-contained page. Raises OutputError if it cannot be written."""
        quantity = quantity_in_words(self.map.unit)
        rows = [(one.name, *(getattr(one, name).text(bare=True) for name in _FIGURES)) for one in self.regions]
        parts = [
            picture(self.plot, f"{self.origin}: {quantity}"),
            section(f"Regions: {quantity}, k = 2", table(("region", *_FIGURES), rows, words=(0,))),
            section(
                "Further figures, k = 2", listed([f"{name}: {one.text()}" for name, one in self.of_picture.items()])
            ),
            section("Flags and assumptions", listed([*self.flags, *self.assumptions])),
        ]
        more = ", …" if len(self.regions) > _MOST_IN_HEADLINE else ""
        outcome = f"Mean {quantity}: {', '.join(self._means[:_MOST_IN_HEADLINE])}{more} (k = 2)"
        known = self.map.provenance.parameters.get("origin", {})
        exposures = ", ".join(f"{one:.4g} s" for one in self.map.exposures_s)
        further = (("map", self.origin), ("merged", str(known.get("merged", ""))), ("exposure times", exposures))
        origin = Origin.of_map(known, further=further)
        write_text_atomic(Path(path), page("Figures of a radiance map", outcome, parts, kind="analyse", origin=origin))

    @property
    def _means(self) -> list[str]:
        return [f"{one.name} {one.mean.text(bare=True)}" for one in self.regions]

    def plot(self, axes: Axes | None = None) -> Axes:
        """Draw the map in false colours with its regions."""
        from matplotlib.patches import Rectangle

        where = Radiance({"mono": self.map}).plot(axes if axes is not None else new_axes())
        for one in self.regions:
            corner = (one.patch.x - 0.5, one.patch.y - 0.5)
            where.add_patch(Rectangle(corner, one.patch.width, one.patch.height, fill=False, color="red"))
            mark(where, label(one.name), corner, (0, 2), "red", va="bottom")
        return where

    def __str__(self) -> str:
        """Return the regions' means in one line."""
        lux = [] if self.illuminance is None else [self.illuminance.text()]
        return f"{', '.join([*self._means, *lux])} (k = 2)"


def analyse(
    source: Radiance | PathLike,
    *,
    regions: Mapping[str, PatchLike] | None = None,
    contrast: tuple[str, str] | None = None,
    line: tuple[float, float, float, float] | None = None,
    line_width: int = 1,
    box: int = 5,
    spectrum: str | None = None,
    fisheye: Projection | None = None,
    field_of_view: float | None = None,
    field_of_view_u: float = 0.0,
    radius: float | None = None,
    glare: bool = False,
) -> MapAnalysis:
    """Measure regions, contrast, a profile and the illuminance of a radiance map, each with its uncertainty.

    Gives mean, median, extremes, uniformity and deviation of each region.

    Examples:
        >>> import radiometer as rm
        >>> chart = rm.merge("out/chart", calibration="calibration.yaml")
        >>> found = rm.analyse(chart, regions={"a": (3, 3, 8, 8), "b": (4, 4, 4, 4)}, contrast=("a", "b"))
        >>> found, found.contrast.unit
        (<MapAnalysis a ... (k = 2)>, '1')

    Args:
        source: Map of `merge`, or the TIFF file that it wrote.
        regions: Patches by name; the whole map by default.
        contrast: Names of the brighter and the darker region.
        line: (x1, y1, x2, y2) of a profile in pixels.
        line_width: Width in pixels that the profile is averaged over.
        box: Side in pixels of the box whose means give the extremes.
        spectrum: Spectrum of the light, for figures in cd·m⁻².
        fisheye: Projection of a fisheye picture: "equidistant", "equisolid", "stereographic" or "orthographic".
        field_of_view: Full angle of its image circle in degrees.
        field_of_view_u: Its standard uncertainty in degrees.
        radius: Radius of its image circle in pixels; half of the shorter side by default.
        glare: Find UGR and DGP of the fisheye picture, by evalglare; needs the extra `glare`.

    Raises:
        UsageError: If options need each other, or a region is not named.
        InputError: If the file is no map, or a region leaves it.
        MeasurementError: If a region or the image circle has too few values.
        MissingLibrary: If glare is asked for and pyradiance is not installed.
    """
    if (fisheye is None) != (field_of_view is None):
        raise UsageError("--fisheye and --field-of-view need each other")
    if glare and fisheye is None:
        raise UsageError("--glare needs a fisheye picture: --fisheye and --field-of-view")
    found, origin = _map_of(source, spectrum)
    named = {name: as_patch(one) for name, one in (regions or {}).items()}
    patches = named or {"all": Patch(0, 0, found.shape[1], found.shape[0])}
    figures = {name: region_figures(found, name, one, box) for name, one in patches.items() if one is not None}
    ratio = None
    assumptions = []
    if contrast is not None:
        missing = [name for name in contrast if name not in figures]
        if missing:
            raise UsageError(f"--contrast: there is no region {missing[0]!r}; known are {', '.join(figures)}")
        ratio = ratio_of(figures[contrast[0]], figures[contrast[1]], found.u_rel_common)
        assumptions.append("contrast: light scattered in the lens is in no uncertainty")
    lux = None
    if fisheye is not None and field_of_view is not None:
        lux = vertical_illuminance(found, fisheye, field_of_view, field_of_view_u, radius)
        assumptions.append("illuminance: the axis is at the centre of the map, and the lens follows its projection")
    ugr = dgp = None
    if glare and fisheye is not None and field_of_view is not None:
        ugr, dgp = glare_of(found, fisheye, field_of_view, field_of_view_u, radius)
        assumptions.append("glare: sources as evalglare finds them by its defaults; nothing beyond the circle shines")
    along = None if line is None else profile(found, line[:2], line[2:], line_width)
    if spectrum is not None:
        assumptions.append(f"luminance: the light has the spectrum {spectrum} everywhere")
    return MapAnalysis(origin, found, tuple(figures.values()), ratio, along, lux, ugr, dgp, tuple(assumptions))


def _map_of(source: Radiance | PathLike, spectrum: str | None) -> tuple[RadianceMap, str]:
    if isinstance(source, Radiance):
        picture_of, origin = source.picture, repr(source)
    else:
        path = Path(source)
        if path.suffix.lower() not in (".tif", ".tiff"):
            raise UsageError(
                f"{path}: give the map as TIFF, which holds its uncertainty: radiometer merge -o FILE.tiff"
            )
        picture_of, origin = read_tiff(path), str(path)
    found = MapPicture(picture_of.maps).first
    if spectrum is not None:
        found = in_luminance(found, spectrum_of(spectrum))
    return replace(found, radiance=np.asarray(found.radiance)), origin
