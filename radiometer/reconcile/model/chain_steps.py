"""What happens to the moments of tiles between the effects, and in which link of the chain an effect acts."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from radiometer.reconcile.measure.design import Array
from radiometer.reconcile.model.tile_context import GAUSS_POINT
from simulators.effects.base import ELECTRONS, Stage
from simulators.effects.catalogue import CatalogueEffect
from simulators.effects.context import Signal
from simulators.effects.tile_moments import TileMoments, carried

LIGHT_LINKS: Final = 4  # links that the light passes before it is electrons
_LINK_OF_STAGE: Final = {
    Stage.SOURCE: 0,
    Stage.SCENE: 0,
    Stage.OPTICS: 1,
    Stage.SHUTTER: 2,
    Stage.PHOTONS: 3,
    Stage.WELL: 6,
}


def link_of(effect: CatalogueEffect) -> int:
    """Return the link of the chain in which an effect acts."""
    if effect.stage == Stage.ELECTRONS:
        return 4 if effect.before in ("shot_noise", "dark_current") else 5
    if effect.stage == Stage.READOUT:
        return 7 if effect.unit_in == ELECTRONS else 8
    if effect.stage == Stage.DIGITAL:
        return 10 if effect.before is None else 9
    return _LINK_OF_STAGE[effect.stage]


def textured(moments: TileMoments, per_tile: Array) -> TileMoments:
    """Return the moments of a scene whose radiance varies within the tiles by these relative variances, (tiles,)."""
    if not per_tile.any():
        return moments
    texture = np.maximum(per_tile, 0.0)[None, :, None]
    return replace(moments, spatial_variance=moments.spatial_variance + texture * moments.mean**2)


def with_shot_noise(moments: TileMoments, dark: Array) -> TileMoments:
    """Return the moments in electrons with dark electrons added, and with the shot noise of both."""
    mean = moments.mean + dark
    return replace(moments, mean=mean, variance=moments.variance + np.maximum(mean, 0.0))


def scaled(moments: TileMoments, factor: Array | float) -> TileMoments:
    """Return the moments of a signal times a factor."""
    square = np.square(factor)
    return replace(
        moments,
        mean=moments.mean * factor,
        variance=carried(moments.variance, square),
        spatial_variance=carried(moments.spatial_variance, square),
        common_variance=carried(moments.common_variance, square),
        row_variance=carried(moments.row_variance, square),
        band_variance=carried(moments.band_variance, square),
        fixed_column_variance=carried(moments.fixed_column_variance, square),
        fixed_row_variance=carried(moments.fixed_row_variance, square),
        neighbour_x=carried(moments.neighbour_x, square),
        neighbour_y=carried(moments.neighbour_y, square),
        first_excess=carried(moments.first_excess, factor),
        limit_variance=carried(moments.limit_variance, square),
    )


def tilt_of(rise_x: Array, rise_y: Array) -> Array:
    """Return the factor at the four points of tiles whose relative rise from centre to edge is given."""
    signs_x, signs_y = np.array([-1.0, 1.0, -1.0, 1.0]), np.array([-1.0, -1.0, 1.0, 1.0])
    tilt = rise_x[:, :, None] * signs_x + rise_y[:, :, None] * signs_y
    return np.asarray(1.0 + GAUSS_POINT * tilt)


def rise_of(points: Signal) -> tuple[Array, Array]:
    """Return the rise from centre to right and to bottom edge from values at the four points."""
    per_edge = 0.25 / GAUSS_POINT
    x = (points[..., 1] + points[..., 3] - points[..., 0] - points[..., 2]) * per_edge
    y = (points[..., 2] + points[..., 3] - points[..., 0] - points[..., 1]) * per_edge
    return np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64)
