"""What light from elsewhere in the picture does to a pixel: for images by computing it, for tiles by looking it up."""

from __future__ import annotations

from typing import Any, Final, Protocol, cast

import cv2
import numpy as np

from simulators.effects.context import ExposureContext, Signal

_SHARP_PX: Final = 0.1  # a blur that changes nothing


class Surroundings(Protocol):
    """The picture around each entry of a signal."""

    def frame_mean(self, signal: Signal) -> Signal | float:
        """Return the mean over the whole frame."""

    def column_mean(self, signal: Signal) -> Signal:
        """Return the mean over the whole column of each entry."""

    def spread(self, signal: Signal, radius_fraction: float, beyond: float = 1.0) -> Signal:
        """Return the signal spread by a Gaussian whose sigma is a fraction of the frame's longer side.

        Beyond the border the picture goes on at a share of what it is at the border.
        """

    def reflected(self, signal: Signal, radius_fraction: float = 0.0) -> Signal:
        """Return the signal at the point reflected about the optical axis, spread like `spread` where asked for."""


class ImageSurroundings:
    """Computes them from the pixels of an image."""

    def __init__(self, context: ExposureContext) -> None:
        self._context = context

    def frame_mean(self, signal: Signal) -> float:
        return self._context.frame_mean(signal)

    def column_mean(self, signal: Signal) -> Signal:
        return cast(Signal, signal.mean(axis=0, keepdims=True))

    def spread(self, signal: Signal, radius_fraction: float, beyond: float = 1.0) -> Signal:
        sigma = radius_fraction * max(signal.shape)
        step = max(1, int(sigma / 4.0))  # a wide Gaussian needs no fine picture
        height, width = signal.shape
        small = cv2.resize(signal, (max(1, width // step), max(1, height // step)), interpolation=cv2.INTER_AREA)
        coarse = sigma * small.shape[1] / width
        soft = cv2.GaussianBlur(small, (0, 0), coarse, borderType=cv2.BORDER_REPLICATE)
        if beyond != 1.0:
            dark = cv2.GaussianBlur(small, (0, 0), coarse, borderType=cv2.BORDER_CONSTANT)
            soft = beyond * soft + (1.0 - beyond) * dark
        return cast(Signal, cv2.resize(soft, (width, height), interpolation=cv2.INTER_LINEAR))

    def reflected(self, signal: Signal, radius_fraction: float = 0.0) -> Signal:
        if radius_fraction * max(signal.shape) > _SHARP_PX:
            signal = self.spread(signal, radius_fraction)
        geometry = self._context.geometry
        x, y = geometry.centre_px
        columns = np.rint((2 * x - geometry.x_px[0] - geometry.x_px[0, 0]) / geometry.binning).astype(int)
        rows = np.rint((2 * y - geometry.y_px[:, 0] - geometry.y_px[0, 0]) / geometry.binning).astype(int)
        inside = np.outer((rows >= 0) & (rows < signal.shape[0]), (columns >= 0) & (columns < signal.shape[1]))
        picked = signal[np.clip(rows, 0, signal.shape[0] - 1)][:, np.clip(columns, 0, signal.shape[1] - 1)]
        return cast(Signal, np.where(inside, picked, 0.0).astype(signal.dtype))


def surroundings_of(context: ExposureContext) -> Surroundings:
    """Return the surroundings that a context knows of (tiles), or those computed from its image."""
    known: Any = getattr(context, "surroundings", None)
    return cast(Surroundings, known) if known is not None else ImageSurroundings(context)


def picture_mean(radiance: Signal, context: ExposureContext) -> Any:
    """Return the mean of the picture over the brightest of its scene, whatever the level of the source."""
    level = np.maximum(np.asarray(context.settings.source_level), 1e-9)  # none in darks, where nothing shows
    return surroundings_of(context).frame_mean(radiance) / (context.peak_radiance * level)


def column_light(charge_e: Signal, context: ExposureContext) -> Any:
    """Return the mean rate in e-/s of the column of each entry."""
    return surroundings_of(context).column_mean(charge_e) / np.asarray(context.settings.exposure_s)
