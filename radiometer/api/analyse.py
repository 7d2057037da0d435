"""Measures from a radiance map: regions, contrast, profiles, and the illuminance of a fisheye picture."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Final

import numpy as np

from radiometer.analysis.exports.maps import MapPicture, in_luminance, read_tiff
from radiometer.analysis.photometry.photometry import spectrum as spectrum_of
from radiometer.analysis.regions import (
    Profile,
    Projection,
    RegionFigures,
    glare_of,
    profile,
    ratio_of,
    region_figures,
    vertical_illuminance,
)
from radiometer.analysis.signal.situation import contradicted, same_light
from radiometer.api.files import PathLike
from radiometer.api.meter import PatchLike, as_patch
from radiometer.api.radiance import Radiance, quantity_in_words
from radiometer.api.result import Drawn
from radiometer.data import Patch, Quantity, RadianceMap
from radiometer.data.drawing import new_axes
from radiometer.data.storage import csv_text, write_text_atomic
from radiometer.errors import UsageError
from radiometer.numbers import below, upper_limit
from radiometer.plausible import Count, FieldOfView, LineDistance, Uncertainty
from radiometer.reporting.origin import Origin
from radiometer.reporting.page import listed, page, section, table
from radiometer.reporting.pictures import MODEL, dress, label, mark, picture

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_MOST_IN_HEADLINE: Final = 3
_FIGURES = ("mean", "median", "lowest", "highest", "deviation", "uniformity")
_COVERAGE: Final = 2.0
_TOP_SHARE: Final = 0.1  # of the map's height, where a name above its region would leave the picture


@dataclass(frozen=True, eq=False, repr=False)
class MapAnalysis(Drawn):
    """Figures of a radiance map; all uncertainties are standard ones (k = 1).

    Attributes:
        origin: File of the map, or its repr.
        map: The map in the unit of the figures.
        regions: Figures by region.
        contrast: Ratio of two regions' means.
        profile: Distance in pixels, values and standard uncertainty along the line.
        line: (x1, y1, x2, y2) of its ends in pixels.
        illuminance: Vertical illuminance of a fisheye picture.
        ugr: Unified glare rating of a fisheye picture.
        dgp: Daylight glare probability of a fisheye picture.
        assumptions: What was assumed, a sentence each.
    """

    origin: str
    map: RadianceMap
    regions: tuple[RegionFigures, ...]
    contrast: Quantity | None = None
    profile: Profile | None = None
    line: tuple[float, float, float, float] | None = None
    illuminance: Quantity | None = None
    ugr: Quantity | None = None
    dgp: Quantity | None = None
    assumptions: tuple[str, ...] = field(default=())
    coverage: ClassVar[str] = "k = 2, < at 95 %"  # of all figures of a table

    def to_mapping(self) -> dict[str, Any]:
        line = {} if self.profile is None else {"profile": self.profile._asdict()}
        names = (*_FIGURES, "good_share", "flags")
        regions = {
            one.name: {"patch": astuple(one.patch), **{name: getattr(one, name) for name in names}}
            for one in self.regions
        }
        asked = ("contrast", "illuminance", "ugr", "dgp", "assumptions")
        return self.plain(*asked, map=self.origin, unit=self.map.unit, regions=regions, **line)

    @property
    def of_picture(self) -> dict[str, Quantity]:
        """Return the figures of no single region by name, those that were asked for."""
        named = {"contrast": self.contrast, "vertical illuminance": self.illuminance, "UGR": self.ugr, "DGP": self.dgp}
        return {name: one for name, one in named.items() if one is not None}

    def region_rows(self, names: Sequence[str] = _FIGURES) -> list[tuple[str, ...]]:
        """Return name and figures of each region as they are printed, U at k = 2; below the noise a limit.

        Lowest and highest share what all pixels share, so they have the digits of their difference.
        """
        rows = []
        for one in self.regions:
            texts = {"deviation": one.deviation.text(_COVERAGE, bare=True)}
            texts |= self._texts({"mean": one.mean, "median": one.median})
            texts |= self._texts({"lowest": one.lowest, "highest": one.highest}, side_by_side=True)
            known = math.isfinite(one.uniformity.value)  # of pixels that are all 0 it is not
            texts["uniformity"] = _or_limit(one.uniformity, one.uniformity.u) if known else "unknown"
            rows.append((one.name, *(texts[name] for name in names)))
        return rows

    def profile_rows(self) -> list[tuple[str, str, str]]:
        """Return name, distance in pixels and value of the profile's start, extremes and end, as they are printed."""
        points = {} if self.profile is None else self.profile.points(self.map.unit, self.map.u_rel_common)
        if not points:
            return []
        texts = self._texts({name: one for name, (_, one) in points.items()}, side_by_side=True)
        return [(name, f"{distance:.1f}", texts[name]) for name, (distance, _) in points.items()]

    @property
    def profile_title(self) -> str:
        """Return between which points the profile runs, and how long it is; "" without one."""
        if self.profile is None or self.line is None:
            return ""
        x1, y1, x2, y2 = (f"{one:g}" for one in self.line)
        return f"Profile from {x1},{y1} to {x2},{y2}, {self.profile.distance_px[-1]:.1f} px"

    def _texts(self, figures: Mapping[str, Quantity], *, side_by_side: bool = False) -> dict[str, str]:
        """Return figures in the map's unit as they are printed, without it."""
        common, values = self.map.u_rel_common, [one.value for one in figures.values()]
        own = {name: math.sqrt(max(one.u**2 - (one.value * common) ** 2, 0.0)) for name, one in figures.items()}
        finest = max(max(values) - min(values), _COVERAGE * max(own.values())) if side_by_side else math.inf
        return {name: _or_limit(one, own[name], finest or math.inf) for name, one in figures.items()}

    @property
    def flags(self) -> list[str]:
        """Return what makes a figure doubtful, a sentence each."""
        return [f"{one.name}: {flag}" for one in self.regions for flag in one.flags]

    def write_csv(self, path: PathLike) -> None:
        """Write a row for each figure and point of the profile; one of no region has no name. Raises OutputError."""
        figures = [(one.name, name, getattr(one, name)) for one in self.regions for name in _FIGURES]
        figures += [("", name.split()[-1].lower(), one) for name, one in self.of_picture.items()]
        rows = [["region", "figure", "value", "u", "unit", "distance_px"]]
        rows += [[region, name, one.value, one.u, one.unit, ""] for region, name, one in figures]
        for distance, *point in zip(*self.profile, strict=True) if self.profile is not None else ():
            known = ["" if math.isnan(one) else one for one in point]
            rows.append(["", "profile", *known, self.map.unit, distance])
        write_text_atomic(Path(path), csv_text(rows))

    def write_report(self, path: PathLike) -> None:
        """Write a self-contained page. Raises OutputError if it cannot be written."""
        quantity = quantity_in_words(self.map.unit)
        tall = min(2.0, max(0.5, self.map.shape[0] / self.map.shape[1]))
        inches = (8.0, 6.5 * tall), (4.0, 3.4 * tall)
        further = [f"{name}: {one.text()}" for name, one in self.of_picture.items()]
        caption = f"{self.origin}: {quantity}; white pixels are saturated or below the noise"
        regions = table(("region", *_FIGURES), self.region_rows(), words=(0,))
        parts = [
            picture(lambda figure, _: self.plot(figure.subplots()), caption, *inches),
            section(f"Regions: {quantity}, {self.coverage}", regions),
            self._profile_section(quantity),
            section("Further figures, k = 2", listed(further)),
            section("Flags and assumptions", listed([*self.flags, *self.assumptions])),
        ]
        more = ", …" if len(self.regions) > _MOST_IN_HEADLINE else ""
        means = [" ".join(row) for row in self.region_rows(("mean",))[:_MOST_IN_HEADLINE]]
        outcome = f"Mean {quantity}: {', '.join(means)}{more} (k = 2)"
        known = self.map.provenance.parameters.get("origin", {})
        facts = {
            "map": self.origin, "merged": known.get("merged", ""),
            "exposure times": ", ".join(f"{one:.4g} s" for one in self.map.exposures_s),
            "light": known.get("light") or known.get("spectrum", ""),
        }  # fmt: skip
        origin = Origin.of_map(known, further=tuple((name, str(one)) for name, one in facts.items()))
        write_text_atomic(Path(path), page("Figures of a radiance map", outcome, parts, kind="analyse", origin=origin))

    def plot(self, axes: Axes | None = None) -> Axes:
        from matplotlib.patches import Rectangle

        where = Radiance({"mono": self.map}).plot(axes if axes is not None else new_axes())
        for one in self.regions:
            corner = (one.patch.x - 0.5, one.patch.y - 0.5)
            where.add_patch(Rectangle(corner, one.patch.width, one.patch.height, fill=False, color="red"))
            inside = one.patch.y < _TOP_SHARE * self.map.shape[0]
            mark(where, label(one.name), corner, (2, -3 if inside else 2), "red", va="top" if inside else "bottom")
        if self.line is not None:
            x1, y1, x2, y2 = self.line
            where.plot([x1, x2], [y1, y2], color="red", lw=1.2)
            # At its left end, as a colour bar stands at the right; below, as names of regions stand above.
            mark(where, "profile", min((x1, y1), (x2, y2)), (2, -3), "red", va="top")
        return where

    def _profile_section(self, quantity: str) -> str:
        if self.profile is None or not (rows := self.profile_rows()):
            return ""
        distance, value, u = self.profile

        def draw(figure: Figure, _narrow: bool) -> None:
            axes = figure.subplots()
            axes.fill_between(distance, value - _COVERAGE * u, value + _COVERAGE * u, color=MODEL, alpha=0.25, lw=0)
            axes.plot(distance, value, color=MODEL, lw=1.2)
            dress(axes, "distance in pixels", quantity)

        shown = picture(draw, f"{quantity} along the line; the band is U, k = 2, of each point", (8.0, 3.6), (4.0, 3.2))
        figures = table(("point", "distance in px", quantity), rows)
        return section(f"{self.profile_title}, {self.coverage}", shown, figures)

    def __str__(self) -> str:
        means = [" ".join(row) for row in self.region_rows(("mean",))]
        return f"{', '.join([*means, *([self.illuminance.text()] if self.illuminance else [])])} (k = 2)"


def analyse(
    source: Radiance | PathLike,
    *,
    regions: Mapping[str, PatchLike] | None = None,
    contrast: tuple[str, str] | None = None,
    line: tuple[float, float, float, float] | None = None,
    line_width: Count = 1,
    box: Count = 5,
    spectrum: str | None = None,
    fisheye: Projection | None = None,
    field_of_view: FieldOfView | None = None,
    field_of_view_u: Uncertainty = 0.0,
    radius: LineDistance | None = None,
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
    found, origin, taken = _map_of(source, spectrum)
    named = {name: as_patch(one) for name, one in (regions or {}).items()}
    patches = named or {"all": Patch(0, 0, found.shape[1], found.shape[0])}
    figures = {name: region_figures(found, name, one, box) for name, one in patches.items() if one is not None}
    ratio = lux = ugr = dgp = None
    assumptions = []
    if contrast is not None:
        missing = [name for name in contrast if name not in figures]
        if missing:
            raise UsageError(f"--contrast: there is no region {missing[0]!r}; known are {', '.join(figures)}")
        ratio = ratio_of(figures[contrast[0]], figures[contrast[1]], found.u_rel_common)
        assumptions.append("contrast: light scattered in the lens is in no uncertainty")
    if fisheye is not None and field_of_view is not None:
        seen = (found, fisheye, field_of_view, field_of_view_u, radius)
        lux = vertical_illuminance(*seen)
        assumptions.append("illuminance: the axis is at the centre of the map, and the lens follows its projection")
        if glare:
            ugr, dgp = glare_of(*seen)
            assumptions.append("glare: sources are evalglare's by its defaults; nothing beyond the circle shines")
    along = None if line is None else profile(found, line[:2], line[2:], line_width)
    if spectrum is not None:
        assumptions += _of_light(spectrum, found.provenance.parameters.get("origin", {}))
    assumptions += [*taken, *found.not_in_u]
    return MapAnalysis(origin, found, tuple(figures.values()), ratio, along, line, lux, ugr, dgp, tuple(assumptions))


def _of_light(spectrum: str, origin: Mapping[str, str]) -> tuple[str, ...]:
    """Return what a luminance assumes of the light, by what the map states of it."""
    assumed = f"luminance: the light has the spectrum {spectrum} everywhere"
    merged = origin.get("spectrum") or spectrum
    again = f"the map's radiance is for light of {merged}: merge again with --spectrum {spectrum}"
    doubt = contradicted(spectrum, origin.get("light") or None)
    return (assumed, *doubt, *(() if same_light(merged, spectrum) else (again,)))


def _or_limit(one: Quantity, noise_u: float, apart: float = math.inf) -> str:
    """Return a figure that is not negative as it is printed without its unit, or its limit where it may be noise."""
    if one.value < _COVERAGE * noise_u:
        return below(upper_limit(one.value, one.u), bare=True)
    return one.text(_COVERAGE, bare=True, apart=apart)


def _map_of(source: Radiance | PathLike, spectrum: str | None) -> tuple[RadianceMap, str, list[str]]:
    """Return the map that is analysed, where it is from, and which one of several it is."""
    if isinstance(source, Radiance):
        picture_of, origin = source.picture, repr(source)
    else:
        path = Path(source)
        if path.suffix.lower() not in (".tif", ".tiff"):
            raise UsageError(f"{path}: give the map as TIFF, which holds its u: radiometer merge -o FILE.tiff")
        picture_of, origin = read_tiff(path), str(path)
    picture_of = MapPicture(picture_of.maps)
    found, names = picture_of.first, ", ".join(picture_of.maps)
    taken = [f"all figures are of {picture_of.first_name}; the map holds {names}"] if len(picture_of.maps) > 1 else []
    if spectrum is not None:
        found = in_luminance(found, spectrum_of(spectrum))
    return replace(found, radiance=np.asarray(found.radiance)), origin, taken
