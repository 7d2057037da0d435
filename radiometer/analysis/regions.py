"""Figures of a radiance map with their uncertainty: regions, profiles, illuminance and glare of a fisheye picture."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates, uniform_filter

from radiometer.analysis.exports.maps import rgbe
from radiometer.data import Patch, PixelMask, Quantity, RadianceMap
from radiometer.errors import InputError, MeasurementError, required_library
from radiometer.statistics.scale import spread_beyond_noise
from radiometer.typing import Array

# What has no value. A pixel below the noise has one, which scatters about its light as others do: without it a mean of
# dim light would be one of the pixels that noise made brighter.
LOST: Final = PixelMask.SATURATED | PixelMask.UNLIT
_MOST_LOST: Final = 0.01  # share of an image circle without a value
_WHOLE_HEMISPHERE: Final = 0.99  # pixels at the rim of the circle are whole or left out
Projection = Literal["equidistant", "equisolid", "stereographic", "orthographic"]
# Views of Radiance: angular (equidistant), hemispherical (orthographic) and planisphere (stereographic) fisheyes.
_VIEWS: Final = {"equidistant": "a", "orthographic": "h", "stereographic": "s"}
_EFFICACY_LM_W: Final = 179.0  # of Radiance's white, by which a luminance in its pictures is divided
_LARGEST_PX: Final = 1200  # evalglare advises 800 to 1500; its time grows with the square
_DRAWS: Final = 4  # pictures with other noise: its share of u is a few per cent, and known to 40 %
INSTALL: Final = "UGR and DGP need pyradiance, which has evalglare; install it with: pip install 'radiometer[glare]'"


@dataclass(frozen=True, slots=True)
class RegionFigures:
    """Figures of one region; units are the map's."""

    name: str  # its name
    patch: Patch  # where it is
    mean: Quantity  # mean of the pixels with a value
    median: Quantity  # median of them
    lowest: Quantity  # least mean over a box
    highest: Quantity  # greatest mean over a box
    deviation: Quantity  # standard deviation over the pixels, their noise taken off; the camera's pattern is in u
    uniformity: Quantity  # lowest over highest
    good_share: float  # share of pixels with a value
    u_shared: float = 0.0  # uncertainty of the mean that its pixels share beyond what all pixels share, in `unit`
    flags: tuple[str, ...] = ()  # what makes a figure doubtful, a sentence each


def region_figures(found: RadianceMap, name: str, patch: Patch, box_px: int = 5) -> RegionFigures:
    """Return the figures of a region.

    Noise of single pixels averages out; what pixels share does not. What all share drops out of ratios, and what those
    of one level share does as far as the levels are alike (`u_of_ratio`). Extremes are of means
    over a box, for single pixels' extremes are those of the noise. The expected extreme of the noise of n boxes,
    √(2·ln n) standard deviations, counts as a rectangular bound; the boxes overlap, so n is the number of pixels.
    Pixels below the noise count by their values. The value of one that is black in every frame is the most that its
    light can be. Its light is anywhere from 0 to there, and so is that of one outside the response's data.

    Raises InputError if the region leaves the map, MeasurementError if less than half of its pixels have a value.
    """
    if not patch.fits(found.shape):
        raise InputError(f"region {name}: leaves the map of {found.shape[1]} × {found.shape[0]} pixels")
    values, mask = found.radiance[patch.slices].astype(np.float64), found.mask[patch.slices]
    own, shared = found.parts_of_u(patch.slices)
    good = ((mask & LOST) == 0) & np.isfinite(values)
    share = float(good.mean())
    if share < 0.5:
        raise MeasurementError(
            f"region {name}: only {100 * share:.0f} % of its pixels have a value; merge shorter exposures"
        )
    unit, count = found.unit, int(good.sum())
    level = float(values[good].mean())
    u_level, common = float(shared[good].mean()), found.u_rel_common
    dim = (mask & (PixelMask.BELOW_NOISE | LOST)) == PixelMask.BELOW_NOISE
    # Of one that is black in every frame u is the value itself, but for what it shares with others. All have one value.
    black = dim & np.isclose(found.u_radiance[patch.slices], values, rtol=0.01)
    black &= np.isclose(values, np.median(values[black]) if black.any() else 0.0, rtol=0.01)
    open_to_0 = black | (dim & ((mask & PixelMask.EXTRAPOLATED) != 0))
    u_open = float(np.abs(values[open_to_0]).sum()) / math.sqrt(3.0)
    u_mean = math.hypot(math.sqrt(float(np.sum(own[good] ** 2))), u_open) / count
    (boxes, noise), (levels, _) = (_boxes(one, own, good, box_px) for one in (values, shared))
    ends = [int(boxes.argmin()), int(boxes.argmax())]
    low, high = (float(boxes[at]) for at in ends)
    u_low, u_high = (math.hypot(noise[at], _extreme_u(noise[at], values.size)) for at in ends)
    shared_low, shared_high = (float(levels[at]) for at in ends)
    variance = float(values[good].var(ddof=1)) if count > 1 else math.nan  # of one pixel it is not known
    pattern = float(np.mean((found.u_rel_pattern * values[good]) ** 2))
    spread, u_spread = spread_beyond_noise(variance, float(np.mean(own[good] ** 2)) - pattern, count, pattern)
    uniformity = low / high if high > 0 else math.nan
    u_uniformity = u_low / max(high, 1e-30)
    if low > 0:
        of_ends = u_low / high, low * u_high / high**2
        u_uniformity = math.hypot(*of_ends, u_of_ratio(low, high, shared_low, shared_high))
    by_level = min(u_level / max(abs(level), 1e-30), 1.0)
    return RegionFigures(
        name, patch, Quantity(level, math.hypot(u_mean, u_level, level * common), unit),
        Quantity(float(np.median(values[good])), math.hypot(1.2533 * u_mean, u_level, level * common), unit),
        Quantity(low, math.hypot(u_low, shared_low, low * common), unit),
        Quantity(high, math.hypot(u_high, shared_high, high * common), unit),
        Quantity(spread, math.hypot(u_spread, spread * common, spread * by_level), unit),
        Quantity(uniformity, u_uniformity, "1"), share, u_level, _flags(mask, black),
    )  # fmt: skip


def u_of_ratio(one: float, other: float, u_one: float, u_other: float) -> float:
    """Return the uncertainty of a ratio of two levels, one over other, by what pixels of one level share.

    The correlation of its errors at two levels is taken as the ratio of the lower to the higher. It is 1 where both are
    the same. It is small where they rest on other exposures and other parts of the response curve.
    """
    alike = max(min(one, other), 0.0) / max(one, other, 1e-30)
    parts = u_one / other, u_other * one / other**2
    return math.sqrt(max(parts[0] ** 2 + parts[1] ** 2 - 2.0 * alike * parts[0] * parts[1], 0.0))


def image_circle(found: RadianceMap, radius_px: float | None) -> tuple[Array, Array, float]:
    """Return distances from the map's centre in pixels, which are within the image circle, and its radius in pixels.

    The radius is half of the shorter side by default. Raises MeasurementError where pixels within it are saturated, or
    more than 1 % have no value.
    """
    radius = radius_px if radius_px is not None else min(found.shape) / 2.0
    r = np.hypot(*(at - (size - 1) / 2.0 for at, size in zip(np.indices(found.shape), found.shape, strict=True)))
    mask = found.mask[r <= radius]
    if (mask & PixelMask.SATURATED).any():
        raise MeasurementError(
            "pixels within the image circle are saturated, so its light has no upper bound: merge shorter exposures"
        )
    if float(np.mean((mask & PixelMask.BELOW_NOISE) != 0)) > _MOST_LOST:
        raise MeasurementError("more than 1 % of the image circle is below the noise; take longer exposures")
    return r, r <= radius, radius


def _boxes(values: Array, own: Array, good: Array, box_px: int) -> tuple[Array, Array]:
    """Return means over a box where all of it is good, and the standard deviation of the noise of each."""
    side = max(1, min(box_px, *values.shape))
    weight = uniform_filter(good.astype(np.float64), side, mode="constant")
    whole = weight > 1.0 - 0.5 / side**2
    if not whole.any():
        return values[good], own[good]
    mean, square = (uniform_filter(np.where(good, one, 0.0), side, mode="constant")[whole] for one in (values, own**2))
    return mean, np.sqrt(np.maximum(square, 0.0)) / side


def _extreme_u(noise: float, count: int) -> float:
    """Return the expected extreme of n noises as a rectangular bound."""
    return noise * math.sqrt(2.0 * math.log(max(2, count))) / math.sqrt(3.0)


def _flags(mask: NDArray[np.uint8], black: NDArray[np.bool_]) -> tuple[str, ...]:
    parts = (PixelMask.EXTRAPOLATED, PixelMask.INCONSISTENT, PixelMask.MOVED)
    outside, apart, moved = ((mask & part) != 0 for part in parts)
    dark, beyond = (f"{pixels.sum()} of {pixels.size} pixels are" for pixels in (black, outside))
    contradicted, still = (f"of {pixels.sum()} of {pixels.size} pixels" for pixels in (apart, moved))
    known = {
        "saturated: highest, mean and uniformity are bounds": mask & PixelMask.SATURATED,
        f"below noise: {dark} black in every frame; lowest and mean are upper bounds": black,
        f"extrapolated: {beyond} outside the response's data": outside,
        f"inconsistent: the frames {contradicted} disagree beyond their noise, which no uncertainty holds": apart,
        f"moved: the values {still} are those of the frames that agree": moved,
    }
    return tuple(text for text, pixels in known.items() if pixels.any())


def ratio_of(first: RegionFigures, second: RegionFigures, common_u_rel: float) -> Quantity:
    """Return the ratio of two regions' means; what all pixels share drops out.

    Light that the lens scatters from the bright region into the dark one is in no uncertainty here. Raises
    MeasurementError if the second mean is not above 0.
    """
    if second.mean.value <= 0.0:
        raise MeasurementError(f"region {second.name}: its mean is not above 0, so the contrast has no bound")
    one, other = first.mean.value, second.mean.value
    noise, its_noise = (
        math.sqrt(max(each.mean.u**2 - (common_u_rel * each.mean.value) ** 2 - each.u_shared**2, 0.0))
        for each in (first, second)
    )
    levels = u_of_ratio(one, other, first.u_shared, second.u_shared)
    return Quantity(one / other, math.hypot(noise / other, its_noise * one / other**2, levels), "1")


class Profile(NamedTuple):
    """Values along a line, shape (points,) each; not a number where a pixel has no value."""

    distance_px: Array  # distance from the line's start in pixels
    value: Array  # values in the map's unit
    u: Array  # their standard uncertainty, with what all pixels share

    def points(self, unit: str, common_u_rel: float) -> dict[str, tuple[float, Quantity]]:
        """Return distance and value at the start, the lowest, the highest and the end; without those of no value."""
        known = np.flatnonzero(np.isfinite(self.value))
        if not known.size:
            return {}
        own = np.sqrt(np.maximum(self.u**2 - (self.value * common_u_rel) ** 2, 0.0))[known]
        low, high = int(self.value[known].argmin()), int(self.value[known].argmax())
        extremes = {known[at]: _extreme_u(float(own[at]), known.size) for at in (low, high)}
        places = {"start": 0, "lowest": known[low], "highest": known[high], "end": self.value.size - 1}
        return {
            name: (
                float(self.distance_px[at]),
                Quantity(float(self.value[at]), math.hypot(self.u[at], extremes.get(at, 0.0)), unit),
            )
            for name, at in places.items()
            if np.isfinite(self.value[at])
        }


def profile(found: RadianceMap, start: tuple[float, float], end: tuple[float, float], width_px: int = 1) -> Profile:
    """Return the values along a line from (x, y) to (x, y) in pixels, averaged over its width.

    Raises InputError if an end or the width leaves the map, or both ends are the same.
    """
    height, width = found.shape
    length = math.dist(start, end)
    if length < 1.0:
        raise InputError("profile: the two points are less than a pixel apart")
    normal = ((start[1] - end[1]) / length, (end[0] - start[0]) / length)
    sides = (-(width_px - 1) / 2.0, (width_px - 1) / 2.0)
    for at_x, at_y in ((x + off * normal[0], y + off * normal[1]) for x, y in (start, end) for off in sides):
        if not (-0.5 <= at_x <= width - 0.5 and -0.5 <= at_y <= height - 0.5):
            raise InputError(
                f"profile: {at_x:g},{at_y:g}, within its width of {width_px} pixels, is outside the map of "
                f"{width} × {height} pixels"
            )
    steps = np.linspace(0.0, 1.0, math.ceil(length) + 1)
    across = (np.arange(width_px) - (width_px - 1) / 2.0)[:, None]
    x, y = (start[k] + (end[k] - start[k]) * steps + normal[k] * across for k in (0, 1))
    lost = np.where((found.mask & LOST) != 0, np.nan, found.radiance).astype(np.float64)
    values = map_coordinates(lost, [y, x], order=1, mode="nearest").mean(axis=0)
    own, shared = (map_coordinates(part, [y, x], order=1, mode="nearest") for part in found.parts_of_u(np.s_[:, :]))
    u_own = np.hypot(np.sqrt(np.mean(own**2, axis=0) / width_px), np.mean(shared, axis=0))
    return Profile(steps * length, values, np.hypot(u_own, values * found.u_rel_common))


def vertical_illuminance(
    found: RadianceMap, projection: Projection, field_of_view_deg: float, u_field_deg: float, radius_px: float | None
) -> Quantity:
    """Return the illuminance in lx (or irradiance in W·m⁻²) on a plane across the axis of a fisheye picture.

    E = Σ L·cos θ·dω over the image circle up to 90°, with the solid angle dω of each pixel under the projection.
    The field of view is above 0 and at most 360°. Raises InputError if the map is a relative one, and MeasurementError
    if the picture holds less than the hemisphere.
    """
    if found.unit == "relative":
        raise InputError("a relative map has no illuminance; merge with a calibration")
    r, inside, radius = image_circle(found, radius_px)

    def weight(field_deg: float) -> Array:
        cosine, solid = _angles(r[inside] / radius, math.radians(field_deg) / 2.0, projection)
        return np.where(cosine > 0.0, cosine * solid, 0.0) / radius**2

    (noise, shared), light, here = found.parts_of_u(inside), found.radiance[inside], weight(field_of_view_deg)
    if (held := float(np.sum(here)) / math.pi) < _WHOLE_HEMISPHERE:
        raise MeasurementError(
            f"the picture holds {100 * held:.3g} % of the hemisphere, weighted by the cosine: its illuminance has no "
            "upper bound; take a lens of 180° whose whole circle is in the picture"
        )
    value = float(np.sum(here * light))
    more, less = (float(np.sum(weight(field_of_view_deg + moved) * light)) for moved in (u_field_deg, -u_field_deg))
    u_own = float(np.linalg.norm(here * noise)), float(np.sum(here * shared))
    u = math.hypot(*u_own, value * found.u_rel_common, (more - less) / 2.0)
    return Quantity(value, u, "lx" if found.unit.startswith("cd") else "W m-2")


def _angles(part: Array, half: float, projection: Projection) -> tuple[Array, Array]:
    """Return cos θ, and the solid angle per area of the circle of radius 1, for r as part of the circle's radius.

    dω = sin θ·(dθ/dr)/r. Source: Schneider, Schwalbe and Maas 2009, ISPRS J. Photogramm. 64, 259.
    """
    if projection == "equidistant":
        theta = part * half
        return np.cos(theta), half**2 * np.sinc(theta / np.pi)
    if projection == "equisolid":
        scale = math.sin(half / 2.0)
        sine = part * scale
        return 1.0 - 2.0 * sine**2, np.full(part.shape, 4.0 * scale**2)
    if projection == "stereographic":
        scale = math.tan(half / 2.0)
        tangent_2 = (part * scale) ** 2
        return (1.0 - tangent_2) / (1.0 + tangent_2), 4.0 * scale**2 / (1.0 + tangent_2) ** 2
    scale = math.sin(min(half, math.pi / 2.0))
    cosine = np.sqrt(np.maximum(1.0 - (part * scale) ** 2, 0.0))
    return cosine, scale**2 / np.maximum(cosine, 1e-6)


def glare_of(
    found: RadianceMap,
    projection: Projection,
    field_of_view_deg: float,
    u_field_deg: float = 0.0,
    radius_px: float | None = None,
    seed: int = 1,
) -> tuple[Quantity, Quantity]:
    """Return UGR and DGP of a fisheye picture, with their standard uncertainties.

    Arguments are as for `radiometer.analyse`; the map is in cd·m⁻², `seed` is of the drawn noise.

    evalglare finds the glare sources by its own defaults. Scale and field of view are moved by their standard
    uncertainties, and noise is drawn anew; what the indices change by adds up in squares.

    Raises MissingLibrary without pyradiance, InputError for another unit or less than a hemisphere, and
    MeasurementError as `image_circle`, or if evalglare fails.

    Source: UGR: CIE 117-1995. DGP: Wienold and Christoffersen 2006, Energy and Buildings 38, 743.
    """
    if not found.unit.startswith("cd"):
        raise InputError("glare needs a map in cd·m⁻²: name the light's spectrum with --spectrum")
    if field_of_view_deg < 180.0:
        raise InputError(f"field of view {field_of_view_deg:g}°: UGR and DGP need the hemisphere, 180° or more")
    luminance, own, shared, radius = _circle(found, radius_px)
    rng = np.random.default_rng(seed)

    def indices(values: Array, field_deg: float) -> Array:
        return _evalglare(_picture(values, radius, projection, field_deg))

    value = indices(luminance, field_of_view_deg)
    together = np.hypot(luminance * found.u_rel_common, shared)
    moved = [(indices(np.maximum(luminance + s * together, 0.0), field_of_view_deg) - value) / s for s in (-1, 1)]
    variance = np.mean(np.square(moved), axis=0)
    if u_field_deg > 0.0:
        # Less than a hemisphere is refused, so the field is moved upwards alone.
        variance = variance + (indices(luminance, field_of_view_deg + u_field_deg) - value) ** 2
    drawn = [np.maximum(luminance + own * rng.standard_normal(own.shape), 0.0) for _ in range(_DRAWS)]
    variance = variance + np.mean([(indices(one, field_of_view_deg) - value) ** 2 for one in drawn], axis=0)
    ugr, dgp = (Quantity(float(one), math.sqrt(two), "1") for one, two in zip(value, variance, strict=True))
    return ugr, dgp


def _evalglare(picture: bytes) -> Array:
    """Return (UGR, DGP) of a Radiance picture. Raises MissingLibrary, MeasurementError."""
    library = required_library("pyradiance", INSTALL)
    try:
        printed = library.evalglare(picture).decode("ascii", "replace")
    except Exception as error:  # pyradiance raises what its version has: RuntimeError, CalledProcessError
        raise MeasurementError(f"evalglare refuses the picture: {str(error).strip()[:200]}") from error
    names, _, values = printed.strip().splitlines()[-1].partition(":")
    known = dict(zip(names.split(","), values.split(), strict=False))
    if not {"ugr", "dgp"} <= set(known):
        raise MeasurementError(f"evalglare printed {printed.strip()[:80]!r}; update pyradiance")
    return np.array([float(known["ugr"]), float(known["dgp"])])


def _circle(found: RadianceMap, radius_px: float | None) -> tuple[Array, Array, Array, float]:
    """Return luminance, its noise, what pixels share and the radius in pixels: squares around the axis, 0 outside."""
    _, inside, radius = image_circle(found, radius_px)
    # A side as odd or even as the picture's keeps the axis where it is, to half a pixel where the sides differ.
    odd = min(found.shape) % 2
    side = 2 * math.ceil(radius - 0.5 * odd) + odd
    luminance = np.where(inside & ((found.mask & LOST) == 0), np.maximum(found.radiance, 0.0), 0.0)
    parts = (luminance, *(np.where(inside, part, 0.0) for part in found.parts_of_u(np.s_[:, :])))
    luminance, own, shared = (_square(one, side) for one in parts)
    factor = math.ceil(side / _LARGEST_PX)
    own = np.sqrt(_binned(own**2, factor)) / factor
    return _binned(luminance, factor), own, _binned(shared, factor), radius / factor


def _square(values: Array, side: int) -> Array:
    """Return the middle of an array, with zeros where it is smaller."""
    short = [max(0, side - size) for size in values.shape]
    wide = np.pad(values, [(one // 2, one - one // 2) for one in short])
    top, left = ((size - side) // 2 for size in wide.shape)
    return wide[top : top + side, left : left + side]


def _binned(values: Array, factor: int) -> Array:
    size = len(values) // factor
    whole = values[: size * factor, : size * factor]
    return np.asarray(whole.reshape(size, factor, size, factor).mean((1, 3)))


def _picture(luminance: Array, radius: float, projection: Projection, field_deg: float) -> bytes:
    """Return a Radiance picture of grey with its view in the header.

    Radiance has no equisolid view: such a picture is made an equidistant one, by linear interpolation.
    """
    side, half, values = luminance.shape[0], math.radians(field_deg) / 2.0, luminance
    if projection not in _VIEWS:
        projection, values = "equidistant", _equidistant(luminance, radius, half)
    # The picture's edge is at side/2, which may be a part of a pixel beyond the circle.
    whole = 2.0 * math.degrees(math.acos(float(_angles(np.array(side / 2.0 / radius), half, projection)[0])))
    form = f"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\nVIEW= -vt{_VIEWS[projection]} -vv {whole:.6f} -vh {whole:.6f}\n\n"
    planes = np.repeat(values[:, :, None] / _EFFICACY_LM_W, 3, axis=2).astype(np.float32)
    return f"{form}-Y {side} +X {side}\n".encode("ascii") + rgbe(planes).tobytes()


def _equidistant(luminance: Array, radius: float, half: float) -> Array:
    side = luminance.shape[0]
    y, x = np.indices(luminance.shape) - (side - 1) / 2.0
    r = np.hypot(x, y)
    from_r = radius * np.sin(np.minimum(r / radius, 1.0) * half / 2.0) / math.sin(half / 2.0)
    scale = np.where(r > 0.0, from_r / np.maximum(r, 1e-9), 1.0)
    taken = map_coordinates(luminance, np.array([y, x]) * scale + (side - 1) / 2.0, order=1)
    return np.asarray(np.where(r <= radius, taken, 0.0))
