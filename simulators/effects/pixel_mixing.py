"""Effects that mix neighbouring pixels: blur of the light and exchange of charge, as images and as moments."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, Final, cast

import cv2
import numpy as np

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
