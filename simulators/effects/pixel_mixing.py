"""Effects that mix neighbouring pixels: blur of the light and exchange of charge, as images and as moments."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Final, cast

import cv2
import numpy as np

from simulators.effects.context import ExposureContext, Signal
from simulators.effects.tile_moments import TileMoments

_REACH_PX: Final = 40  # farther than any blur that leaves a picture


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


def exchange_between_neighbours(signal: Signal, share: Signal | float) -> Signal:
    """Return an image after each pixel exchanged a share of its difference with its four neighbours.

    Args:
        signal: Image, (height, width).
        share: Share that goes to each neighbour: one number, or one per pixel (its own and its neighbour's average
            counts, so that no charge is lost).
    """
    own = np.broadcast_to(np.asarray(share, dtype=signal.dtype), signal.shape)
    result = np.array(signal)
    across = 0.5 * (own[:, 1:] + own[:, :-1]) * (signal[:, 1:] - signal[:, :-1])
    down = 0.5 * (own[1:] + own[:-1]) * (signal[1:] - signal[:-1])
    result[:, :-1] += across
    result[:, 1:] -= across
    result[:-1] += down
    result[1:] -= down
    return result


def exchange_moments(moments: TileMoments, share: Signal, light: float) -> TileMoments:
    """Return the moments of an even field whose white noise is mixed by such an exchange.

    A pixel keeps 1 − 4x and receives x from each neighbour: the variance becomes (1 − 4x)² + 4x² and the covariance
    of neighbours 2x·(1 − 4x) of what it was. `light` scales the share (1 for all of it).
    """
    x = share * light
    kept = np.square(1.0 - 4.0 * x) + 4.0 * np.square(x)
    covariance = 2.0 * x * (1.0 - 4.0 * x) * moments.variance
    return replace(
        moments,
        variance=moments.variance * kept,
        spatial_variance=moments.spatial_variance * kept,
        neighbour_x=moments.neighbour_x + covariance,
        neighbour_y=moments.neighbour_y + covariance,
    )
