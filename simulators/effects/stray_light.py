"""Light that reaches a pixel from elsewhere: glare, ghosts, and the room."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final, Protocol, Self, cast

import cv2
import numpy as np

from simulators.effects.base import IRRADIANCE, Stage, UnitSlope, parameter
from simulators.effects.catalogue import CatalogueEffect, Offset
from simulators.effects.context import ExposureContext, Signal
from simulators.effects.tile_moments import TileMoments

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


@dataclass(frozen=True)
class VeilingGlare(CatalogueEffect):
    """Spreads a share of all light evenly: E' = (1 − v)·E + v·mean(E)·(1 + g·x + h·y + c·(ρ² − ½)).

    ρ is 1 in the corner, x and y are in the same unit; g, h and c are 0 for an even veil.

    Source: ISO 9358; typical 0.2 to 3 %.
    """

    name = "veiling_glare"
    stage = Stage.OPTICS
    unit_in = unit_out = IRRADIANCE
    where = "patch_level"
    block = "mean"
    trials = ({"share": 0.005}, {"share": 0.02})
    fitted = ("share",)
    further = ({"tilt_x": 0.01, "tilt_y": 0.01, "bowl": 0.01},)
    settles = "the same patches with a bright and with a dark surround"
    share: float = parameter(0.0, "1", -0.05, 0.5, source="engineering prior; refined on a real rig")
    tilt_x: float = parameter(0.0, "1", -1.0, 1.0, source="reflections in the barrel are brighter on one side")
    tilt_y: float = parameter(0.0, "1", -1.0, 1.0, source="the same downwards")
    bowl: float = parameter(0.0, "1", -1.0, 1.0, source="change from middle to corner; ISO 9358 asks for it")

    def mean(self, signal: Signal, context: ExposureContext) -> Signal:
        veil = self.share * surroundings_of(context).frame_mean(signal) * self._field(context)
        return cast(Signal, (signal * (1.0 - self.share) + veil).astype(signal.dtype))

    def slope(self, signal: Signal, context: ExposureContext) -> float:
        return 1.0 - self.share

    @property
    def _is_uneven(self) -> bool:
        return bool(self.tilt_x or self.tilt_y or self.bowl)

    def _field(self, context: ExposureContext) -> Any:
        if not self._is_uneven:
            return 1.0
        x, y = context.geometry.field_xy()
        return 1.0 + self.tilt_x * x + self.tilt_y * y + self.bowl * (np.square(x) + np.square(y) - 0.5)


_WIDTHS: Final = (0.02, 0.04, 0.08, 0.16, 0.32)  # as fractions of the longer side
_MOST: Final = 0.5  # of the light that any lens scatters
_BEYOND: Final = 0.5  # of the light at the border
_LITTLE: Final = 0.005  # of the light, at each width


@dataclass(frozen=True)
class StrayLightKernel(CatalogueEffect):
    """Spreads a share of the light over a wide Gaussian: E' = (1 − v)·E + v·(E ∗ G_σ).

    With wings of any other form it is a sum of Gaussians of five widths, E' = E + Σ vₖ·(E ∗ Gₖ − E). The scene beyond
    the border is unknown. The picture is continued there as at the border, or at a share of it, down to darkness.
    That share is free whatever the wings, for light missing at the border looks like a fall-off.

    Source: the far tail of a point-spread function; σ a tenth of the picture and more.
    """

    name = "stray_light_kernel"
    stage = Stage.OPTICS
    unit_in = unit_out = IRRADIANCE
    where = "image_x"
    block = "mean"
    trials = (
        {"share": 0.01, "radius": 0.05},
        {"share": 0.01, "radius": 0.08},
        {"share": 0.01, "radius": 0.12},
        {"share": 0.01, "radius": 0.2},
        {"share": 0.01, "radius": 0.3},
    )
    fitted = ("share", "radius", "edge_share")
    settles = "one bright patch with several sizes of surround"
    essential = ("radius",)  # a kernel of any width is any glare
    share: float = parameter(0.0, "1", -0.05, _MOST, source="engineering prior; refined on a real rig")
    radius: float = parameter(0.1, "1", 0.02, 1.0, source="sigma as a fraction of the longer side")
    edge_share: float = parameter(
        0.05, "1", 0.0, 0.4, source="part of the kernel in the last line before an edge, over the patch's own mean"
    )
    wings: tuple[float, ...] = parameter((), "1", 0.0, 0.5, source="shares of the widths 0.02, 0.04 … 0.32")
    beyond: float = parameter(1.0, "1", 0.0, 2.0, source="light beyond the border over that at the border")

    def mean(self, signal: Signal, context: ExposureContext) -> Signal:
        around, spread = surroundings_of(context), signal * (1.0 - self._lost)
        for share, radius in self._kernels():
            spread = spread + share * around.spread(signal, radius, self.beyond)
        return cast(Signal, spread.astype(signal.dtype))

    def slope(self, signal: Signal, context: ExposureContext) -> float:
        return 1.0 - self._lost

    def loosened(self, context: ExposureContext) -> tuple[Self, ...]:
        """Return wings of any form, which start as the Gaussian nearest to this one, and as a little of each width.

        Before them the form whose picture goes on otherwise beyond the border.
        """
        others = (self.with_parameters(beyond=_BEYOND),) if self.beyond == 1.0 else ()
        if self.wings:
            return others
        nearest = int(np.argmin(np.abs(np.log(np.array(_WIDTHS) / self.radius))))
        near = tuple((0.6 if k == nearest else 0.1) * max(self.share, 0.0) for k in range(len(_WIDTHS)))
        even = (_LITTLE,) * len(_WIDTHS)  # a heavy tail is taken for a Gaussian far narrower than it
        return (*others, *(self.with_parameters(share=0.0, wings=wings) for wings in (near, even)))

    def free(self) -> tuple[str, ...]:
        further = ("beyond",) if self.beyond != 1.0 else ()
        if not self.wings:
            return (*self.fitted, *further)
        return (*(f"wings[{k}]" for k in range(len(self.wings))), "edge_share", *further)

    def _kernels(self) -> tuple[tuple[float, float], ...]:
        """Return share and width of each kernel."""
        return tuple(zip(self.wings, _WIDTHS, strict=True)) if self.wings else ((self.share, self.radius),)

    @property
    def _lost(self) -> float:
        return sum(share for share, _ in self._kernels())

    def tile(self, after: TileMoments, before: TileMoments, context: ExposureContext) -> TileMoments:
        """Return the moments with what the kernel carries across an edge, which depends on where the patch ends."""
        return after.changed(edge_share=before.edge_share + np.full((1, 1, 1), self._lost * self.edge_share))


@dataclass(frozen=True)
class Ghost(UnitSlope, CatalogueEffect):
    """Adds the picture turned about the axis: E'(x) = E(x) + g·(E ∗ G_σ)(−x); σ is 0 for a sharp ghost.

    Source: double reflection between two lens surfaces.
    """

    name = "ghost"
    stage = Stage.OPTICS
    unit_in = unit_out = IRRADIANCE
    where = "image_x"
    block = "mean"
    trials = ({"share": 0.003}, {"share": 0.02})
    fitted = ("share",)
    further = ({"blur": 0.03},)
    settles = "one bright patch moved across the picture"
    share: float = parameter(0.0, "1", -0.02, 0.3, source="engineering prior; refined on a real rig")
    blur: float = parameter(0.0, "1", 0.0, 0.3, source="σ over the longer side: ghosts are seldom in focus")

    def mean(self, signal: Signal, context: ExposureContext) -> Signal:
        turned = surroundings_of(context).reflected(signal, self.blur)
        return cast(Signal, (signal + self.share * turned).astype(signal.dtype))


@dataclass(frozen=True)
class AmbientLightLeak(Offset):
    """Adds light that the source's drive does not change: E' = E + a·((1 − l) + l·(4/N)²)·(1 + g·x + h·y).

    l is 0 for light that leaks past the lens and 1 for light that comes through it (a lit room). The coordinates x
    and y run from −1 to 1 over the sensor's longer side; g and h are 0 where the light is even.

    Source: a dark room leaks; typical 1e-6 to 1e-3 of the brightest patch.
    """

    name = "ambient_light_leak"
    stage = Stage.OPTICS
    unit_in = unit_out = IRRADIANCE
    where = "source_level"
    block = "mean"
    trials = ({"irradiance_w_m2": 1e-06, "through_lens": 0.0},)
    fitted = ("irradiance_w_m2",)
    further = ({"tilt_x": 0.05, "tilt_y": 0.05},)
    settles = "frames with the lamp off and with the cap on"
    irradiance_w_m2: float = parameter(
        0.0, "W m-2", -1000.0, 1000000.0, source="engineering prior; refined on a real rig"
    )
    through_lens: float = parameter(0.0, "1", 0.0, 1.0, source="0 past the lens, 1 through it")
    tilt_x: float = parameter(0.0, "1", -1.0, 1.0, source="a window or a gap is on one side")
    tilt_y: float = parameter(0.0, "1", -1.0, 1.0, source="the same from top to bottom")

    def offset(self, context: ExposureContext) -> Any:
        known: Any = 4.0 if context.f_number is None else context.f_number
        through = (4.0 / np.asarray(known)) ** 2
        x, y = context.geometry.sensor_xy()
        even = self.irradiance_w_m2 * (1.0 - self.through_lens + self.through_lens * through)
        return even * (1.0 + self.tilt_x * x + self.tilt_y * y) if self.tilt_x or self.tilt_y else even

    @classmethod
    def starts(cls, context: ExposureContext) -> tuple[Self, ...]:
        """Return starts at shares of the brightest patch's irradiance, past and through the lens."""
        peak = math.pi * context.peak_radiance / 64.0
        return tuple(cls(share * peak, through) for through in (0.0, 1.0) for share in (1e-6, 1e-4, 1e-2))
