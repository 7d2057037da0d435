"""Blur of the light, and what mixing neighbours does to images and moments."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, Final, cast

import cv2
import numpy as np

from simulators.effects.base import IRRADIANCE, Stage, UnitSlope, parameter
from simulators.effects.catalogue import CatalogueEffect
from simulators.effects.context import ExposureContext, Signal
from simulators.effects.tile_moments import TileMoments

_REACH_PX: Final = 40  # farther than any blur that leaves a picture
_FINE: Final = 8  # points per pixel and side where a disc is drawn


def blur_image(signal: Signal, sigma_px: Any, context: ExposureContext) -> Signal:
    """Return an image blurred by a Gaussian; tiles come back as they are."""
    if not context.geometry.is_image or float(sigma_px) <= 0:
        return signal
    soft = cv2.GaussianBlur(np.asarray(signal), (0, 0), float(sigma_px), borderType=cv2.BORDER_REPLICATE)
    return cast(Signal, soft.astype(signal.dtype))


def blur_edge_share(sigma_px: Any) -> Any:
    """Return the share of a step that a Gaussian blur carries into the last line before it.

    The picture is one of whole pixels, so that the share is the kernel's weight beyond its middle: Σ_{k≥1} g_k.
    """
    sigma = np.maximum(sigma_px, 1e-3)
    beyond = sum(np.exp(-0.5 * np.square(k / sigma)) for k in range(1, _REACH_PX))
    return beyond / (1.0 + 2.0 * beyond)


def spread_over_disc(signal: Signal, radius_px: Any, context: ExposureContext) -> Signal:
    """Return an image each point of which is spread evenly over a disc; tiles come back as they are."""
    radius = float(radius_px) if context.geometry.is_image else 0.0
    if radius <= 0.5:  # all of it stays within the pixel
        return signal
    reach = math.ceil(radius + 0.5)
    side = 2 * reach + 1
    place = (np.arange(side * _FINE) + 0.5) / _FINE - side / 2.0
    inside = np.square(place)[:, None] + np.square(place)[None, :] <= radius**2
    kernel = inside.reshape(side, _FINE, side, _FINE).mean(axis=(1, 3))
    spread = cv2.filter2D(np.asarray(signal), -1, kernel / kernel.sum(), borderType=cv2.BORDER_REPLICATE)
    return cast(Signal, spread.astype(signal.dtype))


def disc_edge_share(radius_px: Any) -> Any:
    """Return the share of a step that an even disc carries into the last line before it.

    It is the segment of the disc that is half a pixel and more beyond its middle: (R²·acos(h/R) − h·√(R² − h²))/πR².
    """
    square = np.square(np.maximum(radius_px, 0.5))
    cosine = 0.5 / np.sqrt(square)
    return (np.arccos(cosine) - cosine * np.sqrt(1.0 - np.square(cosine))) / math.pi


def exchange_between_neighbours(signal: Signal, share: Signal | float, further_down: float = 0.0) -> Signal:
    """Return an image after each pixel exchanged a share of its difference with its four neighbours.

    Args:
        signal: Image, (height, width).
        share: Share that goes to each neighbour: one number, or one per pixel (its own and its neighbour's average
            counts, so that no charge is lost).
    """
    own = np.broadcast_to(np.asarray(share, dtype=signal.dtype), signal.shape)
    result = np.array(signal)
    across = 0.5 * (own[:, 1:] + own[:, :-1]) * (signal[:, 1:] - signal[:, :-1])
    down = (0.5 * (own[1:] + own[:-1]) + further_down) * (signal[1:] - signal[:-1])
    result[:, :-1] += across
    result[:, 1:] -= across
    result[:-1] += down
    result[1:] -= down
    return result


def exchange_moments(moments: TileMoments, share: Signal, light: float, further_down: float = 0.0) -> TileMoments:
    """Return the moments of an even field whose white noise is mixed by such an exchange.

    A pixel keeps k = 1 − 2x − 2y and receives x from each neighbour in the row, y = x + `further_down` in the column.
    The variance becomes k² + 2x² + 2y² and the covariance of neighbours 2x·k and 2y·k of what it was. `light` scales
    the share (1 for all of it).
    """
    x = share * light
    y = x + further_down * light
    own = 1.0 - 2.0 * x - 2.0 * y
    kept = np.square(own) + 2.0 * np.square(x) + 2.0 * np.square(y)
    return replace(
        moments,
        variance=moments.variance * kept,
        spatial_variance=moments.spatial_variance * kept,
        neighbour_x=moments.neighbour_x + 2.0 * x * own * moments.variance,
        neighbour_y=moments.neighbour_y + 2.0 * y * own * moments.variance,
    )


@dataclass(frozen=True)
class PsfBlur(UnitSlope, CatalogueEffect):
    """Blurs the picture with a Gaussian of standard deviation σ.

    Source: aberrations and pixel aperture.
    """

    name = "psf_blur"
    stage = Stage.OPTICS
    unit_in = unit_out = IRRADIANCE
    where = "image_x"
    block = "edge"
    trials = (
        {"sigma_px": 0.25}, {"sigma_px": 0.3}, {"sigma_px": 0.35}, {"sigma_px": 0.42}, {"sigma_px": 0.5},
        {"sigma_px": 0.7}, {"sigma_px": 1.0},
    )  # fmt: skip
    fitted = ("sigma_px",)
    settles = "an edge at several f-numbers"
    sigma_px: float = parameter(0.0, "px", 0.0, 50.0, source="engineering prior; refined on a real rig")

    def mean(self, signal: Signal, context: ExposureContext) -> Signal:
        """Return the blurred picture; tiles keep their distance from edges and stay as they are."""
        return blur_image(signal, self.sigma_px, context)

    def tile(self, after: TileMoments, before: TileMoments, context: ExposureContext) -> TileMoments:
        return after.changed(edge_share=before.edge_share + blur_edge_share(np.full((1, 1, 1), self.sigma_px)))


@dataclass(frozen=True)
class Defocus(UnitSlope, CatalogueEffect):
    """Blurs the picture with a Gaussian of standard deviation c/N, or in part (e) with an even disc of the same spread.

    The disc's radius is 2·c/N: a point out of focus, were there no aberration and no diffraction.

    Source: geometrical optics: the circle of confusion is proportional to the aperture.
    """

    name = "defocus"
    stage = Stage.OPTICS
    unit_in = unit_out = IRRADIANCE
    where = "f_number"
    block = "edge"
    trials = (
        {"sigma_f1_px": 1.0}, {"sigma_f1_px": 0.6}, {"sigma_f1_px": 0.8}, {"sigma_f1_px": 1.4}, {"sigma_f1_px": 2.0},
        {"sigma_f1_px": 3.0}, {"sigma_f1_px": 6.0},
    )  # fmt: skip
    fitted = ("sigma_f1_px",)
    varies = "f_number"
    further = ({"evenness": 0.5},)
    settles = "an edge at several f-numbers"
    sigma_f1_px: float = parameter(0.0, "px", 0.0, 200.0, source="standard deviation that f/1 would have")

    evenness: float = parameter(0.0, "1", 0.0, 1.0, source="0 a Gaussian, 1 the disc of geometrical optics")

    def mean(self, signal: Signal, context: ExposureContext) -> Signal:
        soft = blur_image(signal, self._sigma(context), context)
        if not self.evenness:
            return soft
        disc = spread_over_disc(signal, 2.0 * self._sigma(context), context)
        return cast(Signal, ((1.0 - self.evenness) * soft + self.evenness * disc).astype(signal.dtype))

    def tile(self, after: TileMoments, before: TileMoments, context: ExposureContext) -> TileMoments:
        sigma = self._sigma(context)
        share = (1.0 - self.evenness) * blur_edge_share(sigma) + self.evenness * disc_edge_share(2.0 * sigma)
        return after.changed(edge_share=before.edge_share + share)

    def _sigma(self, context: ExposureContext) -> Any:
        known: Any = 4.0 if context.f_number is None else context.f_number
        return self.sigma_f1_px / np.asarray(known)
