"""The flat field of camera and lens: cos⁴ times a polynomial about the principal point, fitted to an even source."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import optimize

from radiometer.data import CameraDescription, FlatField, LensDescription, PixelMask, RadianceMap
from radiometer.errors import MeasurementError
from radiometer.statistics.least_squares import solve
from radiometer.statistics.model_choice import aicc
from radiometer.statistics.scale import robust_sigma
from radiometer.typing import Array

_TILES_ACROSS = 32  # over the shorter side: a fall-off has no finer structure, and dust fills few of them
_FEWEST_TILES = 24  # at least four values for each of at most six parameters
_AXIS_WITHIN = 0.3  # of half the diagonal, to each side: where the optical axis is looked for
_FARTHEST_AXIS = 0.2  # of it: mounts centre lenses to a few per cent; a gradient or a scene moves the fit to the limit
_OUTLIER_SIGMA = 5.0  # of some thousand tiles of normal scatter none is so far off


@dataclass(frozen=True, slots=True, eq=False)
class _Tiles:
    """Means of tiles: position in pixels, value, standard uncertainty of the mean."""

    x: Array
    y: Array
    value: Array
    u: Array

    def only(self, kept: NDArray[np.bool_]) -> _Tiles:
        return _Tiles(self.x[kept], self.y[kept], self.value[kept], self.u[kept])


def fit_flat_field(
    even: RadianceMap, camera: CameraDescription, lens: LensDescription, *, source_u_rel: float = 0.0
) -> FlatField:
    """Return the sensitivity over the picture from a map of an evenly bright source.

    The falloff is cos⁴α of the focal length (where that and the pixel pitch are known) times 1 + k₂ρ² + k₄ρ⁴ + k₆ρ⁶.
    Only the terms that the data require are kept. Its uncertainty is what the fit leaves over, that of the fit
    itself, and that of the source's evenness.

    Args:
        even: Merged map of the source, without flat field correction; clipped pixels are left out.
        camera: Pixel pitch or spacing in µm.
        lens: Focal length in mm, f-number, principal point where known.
        source_u_rel: Relative standard uncertainty of the source's evenness over the picture.

    Raises:
        MeasurementError: If too little of the picture is usable, or its falloff is no falloff of a lens.
    """
    tiles = _tiles(even)
    middle = ((even.shape[1] - 1) / 2.0, (even.shape[0] - 1) / 2.0)
    start = np.array(lens.principal_point_px or middle)
    radius = math.hypot(*even.shape) / 2.0
    focal = _focal_length_px(camera, lens)
    tiles = _without_outliers(tiles, start, radius, focal)
    best = min((_fit(tiles, start, radius, focal, order) for order in range(4)), key=lambda found: found[0])
    _, centre, coefficients, left_over = best
    k = np.zeros(3)
    k[: coefficients.size - 1] = coefficients[1:] / coefficients[0]
    flat = FlatField(
        principal_point_px=(float(centre[0]), float(centre[1])),
        focal_length_px=focal,
        radius_px=radius,
        coefficients=(float(k[0]), float(k[1]), float(k[2])),
        u_rel=math.hypot(left_over, source_u_rel),
        shape=even.shape,
        f_number=lens.f_number,
    )
    _refuse_nonsense(flat, start)
    return flat


def _focal_length_px(camera: CameraDescription, lens: LensDescription) -> float | None:
    pitch_um = camera.pixel_spacing_um or camera.pixel_pitch_um
    if lens.focal_length_mm is None or pitch_um is None:
        return None
    return lens.extension * lens.focal_length_mm * 1e3 / pitch_um


def _tiles(even: RadianceMap) -> _Tiles:
    """Return means over square tiles of which at least half of the pixels are sound."""
    height, width = even.shape
    side = max(1, min(height, width) // _TILES_ACROSS)
    rows, columns = height // side, width // side
    cut = (slice(0, rows * side), slice(0, columns * side))
    bad = PixelMask.SATURATED | PixelMask.DEFECTIVE | PixelMask.INCONSISTENT | PixelMask.UNLIT
    sound = (even.mask[cut] & bad == 0) & (even.radiance[cut] > 0)

    def total(values: Array) -> Array:
        return np.asarray(values.reshape(rows, side, columns, side).sum(axis=(1, 3)), dtype=np.float64)

    count = total(sound.astype(np.float64))
    used = count >= 0.5 * side * side
    if used.sum() < max(_FEWEST_TILES, 0.5 * used.size):  # an even source lights the whole picture
        raise MeasurementError(
            "too little of the flat frames is usable (clipped or dark); expose an even source to half of full scale"
        )
    y, x = np.mgrid[:height, :width][:, cut[0], cut[1]].astype(np.float64)
    value = total(np.where(sound, even.radiance[cut], 0.0).astype(np.float64))
    variance = total(np.where(sound, even.parts_of_u(cut)[0] ** 2, 0.0))
    n = np.maximum(count, 1.0)
    mean_x, mean_y = (total(np.where(sound, axis, 0.0)) / n for axis in (x, y))
    return _Tiles(mean_x[used], mean_y[used], (value / n)[used], (np.sqrt(variance) / n)[used])


def _basis(tiles: _Tiles, centre: Array, radius: float, focal: float | None, order: int) -> Array:
    r2 = (tiles.x - centre[0]) ** 2 + (tiles.y - centre[1]) ** 2
    cos4 = 1.0 if focal is None else 1.0 / (1.0 + r2 / focal**2) ** 2
    return np.stack([cos4 * (r2 / radius**2) ** n for n in range(order + 1)], axis=1)


def _solve(tiles: _Tiles, centre: Array, radius: float, focal: float | None, order: int) -> tuple[Array, Array]:
    """Return (level and coefficients, weighted residuals) for a given principal point."""
    basis = _basis(tiles, centre, radius, focal, order)
    # Tiles differ by dust and unevenness more than by their noise, so that all count alike.
    level = float(np.median(tiles.value))
    coefficients = solve(basis / level, tiles.value / level)
    return coefficients, np.asarray((tiles.value - basis @ coefficients) / level)


def _fit(
    tiles: _Tiles, start: Array, radius: float, focal: float | None, order: int
) -> tuple[float, Array, Array, float]:
    """Return (Akaike's criterion, principal point, coefficients, relative uncertainty of the falloff at a tile)."""
    centre, free = start, order + 1
    if order > 0 or focal is not None:

        def residuals(place: Array) -> Array:
            return _solve(tiles, place, radius, focal, order)[1]

        found = optimize.least_squares(
            residuals,
            start,
            bounds=(start - _AXIS_WITHIN * radius, start + _AXIS_WITHIN * radius),
            x_scale=0.05 * radius,
        )
        centre, free = found.x, free + 2
    coefficients, residual = _solve(tiles, centre, radius, focal, order)
    count = residual.size
    mean_square = float(residual @ residual) / max(count - free, 1)
    criterion = aicc(float(residual @ residual), count, free)
    noise = float(np.mean((tiles.u / tiles.value) ** 2))
    beyond_noise = max(0.0, mean_square - noise)
    return criterion, centre, coefficients, math.sqrt(beyond_noise + mean_square * free / count)


def _without_outliers(tiles: _Tiles, centre: Array, radius: float, focal: float | None) -> _Tiles:
    """Return the tiles without those that dust or reflections set apart from a smooth falloff."""
    for _ in range(3):
        _, residual = _solve(tiles, centre, radius, focal, 3)
        spread = robust_sigma(residual)
        kept = np.abs(residual) <= _OUTLIER_SIGMA * max(spread, 1e-9)
        if kept.all() or kept.sum() < _FEWEST_TILES:
            break
        tiles = tiles.only(kept)
    return tiles


def _refuse_nonsense(flat: FlatField, start: Array) -> None:
    height, width = flat.shape
    away_px = float(np.max(np.abs(np.array(flat.principal_point_px) - start)))
    if away_px > _FARTHEST_AXIS * flat.radius_px:
        raise MeasurementError(
            f"the fall-off seems to be about a point {away_px:.0f} px from the optical axis: the light was not even, or"
            " lens.principal_point_px is missing; use an integrating sphere or a diffuser before the lens"
        )
    corners = flat.at(np.array([0.0, width - 1.0, 0.0, width - 1.0]), np.array([0.0, 0.0, height - 1.0, height - 1.0]))
    if corners.min() < 0.05 or corners.max() > 1.5:
        raise MeasurementError(
            f"the fitted falloff leaves {100 * corners.min():.0f} % at a corner (and {100 * corners.max():.0f} % at "
            "another): this is no even source; use an integrating sphere or a diffuser before the lens"
        )
