"""Glare of a fisheye picture: UGR and DGP by evalglare of Radiance, with the uncertainty of the picture."""

from __future__ import annotations

import importlib
import math
from collections.abc import Callable
from typing import Final

import numpy as np
from scipy.ndimage import map_coordinates

from radiometer.analysis.exports.maps import rgbe
from radiometer.analysis.regions.figures import LOST, Projection, image_circle
from radiometer.data import Quantity, RadianceMap
from radiometer.errors import InputError, MeasurementError, MissingLibrary
from radiometer.typing import Array

# Views of Radiance: angular (equidistant), hemispherical (orthographic) and planisphere (stereographic) fisheyes.
_VIEWS: Final = {"equidistant": "a", "orthographic": "h", "stereographic": "s"}
_EFFICACY_LM_W: Final = 179.0  # of Radiance's white, by which a luminance in its pictures is divided
_LARGEST_PX: Final = 1200  # evalglare advises 800 to 1500; its time grows with the square
_DRAWS: Final = 4  # pictures with other noise: its share of u is a few per cent, and known to 40 %
INSTALL: Final = "UGR and DGP need pyradiance, which has evalglare; install it with: pip install 'radiometer[glare]'"


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
    evaluate = _evalglare()
    if not found.unit.startswith("cd"):
        raise InputError("glare needs a map in cd·m⁻²: name the light's spectrum with --spectrum")
    if not 180.0 <= field_of_view_deg <= 360.0:
        raise InputError(f"field of view {field_of_view_deg:g}°: UGR and DGP need the hemisphere, 180° or more")
    luminance, own, shared, radius = _circle(found, radius_px)
    rng = np.random.default_rng(seed)

    def indices(values: Array, field_deg: float) -> Array:
        return evaluate(_picture(values, radius, projection, field_deg))

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


def _evalglare() -> Callable[[bytes], Array]:
    """Return what gives (UGR, DGP) of a Radiance picture. Raises MissingLibrary."""
    try:
        library = importlib.import_module("pyradiance")
    except ImportError as error:
        raise MissingLibrary(INSTALL) from error

    def evaluate(picture: bytes) -> Array:
        try:
            printed = library.evalglare(picture).decode("ascii", "replace")
        except Exception as error:  # pyradiance raises what its version has: RuntimeError, CalledProcessError
            raise MeasurementError(f"evalglare refuses the picture: {str(error).strip()[:200]}") from error
        names, _, values = printed.strip().splitlines()[-1].partition(":")
        known = dict(zip(names.split(","), values.split(), strict=False))
        if not {"ugr", "dgp"} <= set(known):
            raise MeasurementError(f"evalglare printed {printed.strip()[:80]!r}; update pyradiance")
        return np.array([float(known["ugr"]), float(known["dgp"])])

    return evaluate


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
    side = luminance.shape[0]
    view, values = _VIEWS.get(projection), luminance
    if view is None:
        view, values = "a", _equidistant(luminance, radius, math.radians(field_deg) / 2.0)
    # The picture's edge is at side/2, which may be a part of a pixel beyond the circle.
    whole = _field_at_edge(side / 2.0 / radius, field_deg, view)
    form = f"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\nVIEW= -vt{view} -vv {whole:.6f} -vh {whole:.6f}\n\n"
    planes = np.repeat(values[:, :, None] / _EFFICACY_LM_W, 3, axis=2).astype(np.float32)
    return f"{form}-Y {side} +X {side}\n".encode("ascii") + rgbe(planes).tobytes()


def _field_at_edge(part: float, field_deg: float, view: str) -> float:
    """Return the full angle in degrees at the picture's edge, `part` of the circle's radius."""
    half = math.radians(field_deg) / 2.0
    if view == "a":
        return field_deg * part
    if view == "h":
        return 2.0 * math.degrees(math.asin(min(1.0, part * math.sin(min(half, math.pi / 2.0)))))
    return 4.0 * math.degrees(math.atan(part * math.tan(half / 2.0)))


def _equidistant(luminance: Array, radius: float, half: float) -> Array:
    side = luminance.shape[0]
    y, x = np.indices(luminance.shape) - (side - 1) / 2.0
    r = np.hypot(x, y)
    from_r = radius * np.sin(np.minimum(r / radius, 1.0) * half / 2.0) / math.sin(half / 2.0)
    scale = np.where(r > 0.0, from_r / np.maximum(r, 1e-9), 1.0)
    taken = map_coordinates(luminance, np.array([y, x]) * scale + (side - 1) / 2.0, order=1)
    return np.asarray(np.where(r <= radius, taken, 0.0))
