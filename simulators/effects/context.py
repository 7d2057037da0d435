"""The information on a frame that an effect may use, in addition to the signal."""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from radiometer.data import CameraDescription, FrameSettings, LensDescription

Signal = NDArray[np.floating[Any]]


def largest(signal: Signal) -> Signal:
    """Return the largest absolute value of all frames, of each model by itself where several are stacked, (…, 1, 1)."""
    axes = tuple(range(-min(signal.ndim, 3), 0))
    return np.asarray(np.max(np.abs(signal), axis=axes, initial=0.0, keepdims=True))


@dataclass(frozen=True, slots=True, eq=False)
class FrameGeometry:
    """Positions of the pixels (or of the tiles that represent them) on the sensor and on the screen.

    All coordinates broadcast against the signal: shapes (1, width) and (height, 1) for an image, (n,) each for n
    tiles. They count unbinned pixels of the whole sensor, so that a region of interest keeps its field angles.
    """

    x_px: Signal  # column coordinate of each pixel centre on the sensor
    y_px: Signal  # row coordinate
    sensor_width: int  # sensor width in pixels
    sensor_height: int  # sensor height in pixels
    # Where the optical axis meets the sensor; None for its middle
    principal_point_px: tuple[float, float] | None = None
    pixel_spacing_um: float = 4.5  # distance between neighbouring sensor pixels in µm
    binning: int = 1  # pixels summed in each direction
    screen_rotation_rad: float = 0.0  # rotation of the screen as the camera sees it
    screen_shift_px: tuple[float, float] = (0.0, 0.0)  # shift of the screen's middle on the sensor in pixels
    weights: Signal | None = None  # share of the frame that each tile represents; None where all weigh alike

    @classmethod
    def of_image(
        cls,
        width: int,
        height: int,
        *,
        x: int = 0,
        y: int = 0,
        binning: int = 1,
        sensor_width: int | None = None,
        sensor_height: int | None = None,
        **more: Any,
    ) -> FrameGeometry:
        """Return the geometry of an image of `width` × `height` stored pixels whose corner is at sensor (x, y).

        Args:
            binning: Sensor pixels per stored pixel in each direction.
            sensor_width: Sensor width in pixels; by default what the image covers.
            sensor_height: Sensor height in pixels.
        """
        middle = (binning - 1) / 2
        return cls(
            (x + binning * np.arange(width, dtype=np.float64) + middle)[np.newaxis, :],
            (y + binning * np.arange(height, dtype=np.float64) + middle)[:, np.newaxis],
            sensor_width or x + binning * width,
            sensor_height or y + binning * height,
            binning=binning,
            **more,
        )

    @property
    def is_image(self) -> bool:
        """Tell whether neighbouring entries of the signal are neighbouring pixels."""
        return self.x_px.ndim == 2 and self.x_px.shape[0] == 1 and self.y_px.ndim == 2

    @property
    def shape(self) -> tuple[int, ...]:
        """Return the shape of the signal."""
        return np.broadcast_shapes(self.x_px.shape, self.y_px.shape)

    @property
    def centre_px(self) -> tuple[float, float]:
        """Return (x, y) of the optical axis on the sensor in pixels."""
        return self.principal_point_px or ((self.sensor_width - 1) / 2, (self.sensor_height - 1) / 2)

    def radius_um(self) -> Signal:
        """Return the distance from the optical axis on the sensor in µm."""
        x, y = self.centre_px
        radius: Signal = np.hypot(self.x_px - x, self.y_px - y) * self.pixel_spacing_um
        return radius

    def field_radius(self) -> Signal:
        """Return ρ, the distance from the optical axis in half sensor diagonals (1 in the corners)."""
        half_diagonal_um = 0.5 * math.hypot(self.sensor_width, self.sensor_height) * self.pixel_spacing_um
        return self.radius_um() / half_diagonal_um

    def field_xy(self) -> tuple[Signal, Signal]:
        """Return the place (x, y) from the optical axis in half sensor diagonals; ρ² = x² + y²."""
        x, y = self.centre_px
        half = 0.5 * math.hypot(self.sensor_width, self.sensor_height)
        return (self.x_px - x) / half, (self.y_px - y) / half

    def screen_xy(self) -> tuple[Signal, Signal]:
        """Return screen coordinates (u, v), each −1 to 1 over the longer side of the unrotated sensor."""
        dx = self.x_px - (self.sensor_width - 1) / 2 - self.screen_shift_px[0]
        dy = self.y_px - (self.sensor_height - 1) / 2 - self.screen_shift_px[1]
        c, s = math.cos(self.screen_rotation_rad), math.sin(self.screen_rotation_rad)
        half = 0.5 * max(self.sensor_width, self.sensor_height)
        return (c * dx + s * dy) / half, (c * dy - s * dx) / half

    def sensor_xy(self) -> tuple[Signal, Signal]:
        """Return sensor coordinates (x, y) from the sensor's middle, each −1 to 1 over its longer side."""
        half = 0.5 * max(self.sensor_width, self.sensor_height)
        return (self.x_px - (self.sensor_width - 1) / 2) / half, (self.y_px - (self.sensor_height - 1) / 2) / half

    def row_fraction(self) -> Signal:
        """Return the row as a fraction of the sensor's height, 0 at the row read first."""
        return self.y_px / max(self.sensor_height - 1, 1)


class Past(Protocol):
    """What earlier frames held."""

    def faded(self, tau_s: float) -> Signal:
        """Return the sum of what all earlier frames held in electrons, each times exp(−age/τ)."""


@dataclass(frozen=True, slots=True, eq=False)
class ExposureContext:
    """One frame as the effects see it."""

    # What the camera says that it did (exposure, gain, f-number, temperature, time, level, shutter)
    settings: FrameSettings
    geometry: FrameGeometry  # positions of the pixels
    # What the model's camera is, in its native bit depth; effects take full well, gain and pitch from here
    camera: CameraDescription
    lens: LensDescription = field(default_factory=LensDescription)  # the lens in front of it
    wavelength_nm: float = 550.0  # effective wavelength of the light
    code: Signal | None = None  # display drive 0 to 1 of what each pixel looks at; None where the scene is no display
    peak_radiance: float = 1.0  # radiance at drive 1 and source level 1 in W·sr⁻¹·m⁻²
    # Electrons that the previous frame held at the end of the well stage; None for the first frame
    previous_e: Signal | None = None
    past: Past | None = None  # what all earlier frames held, and when; None where the times of frames are not known
    # Time in s from the last frame with light to this one; None where none came before or is known
    since_light_s: Any = None
    # Time in s from the frame before, with light or without, to this one; infinite for the first of all, None where it
    # is not known
    since_frame_s: Any = None
    frame_index: int = 0  # running number of the frame in its capture; 0 for the first after a change of settings
    # Running numbers in the session, from 0, of the frames that are meant, along the last axis: one of a single frame;
    # NaN where a series has fewer than others
    frame_numbers: Any = (0,)
    frame_times_s: Any = None  # their times in s; None: that of the settings
    device_seed: int = 0  # identity of this particular camera: its fixed patterns follow from it
    # Bits per pixel that leave the camera; None for the native depth. Until `quantisation` all DN (black level too) are
    # native ones; after it they are those of the output.
    output_bit_depth: int | None = None
    extra: dict[str, float] = field(default_factory=dict)  # further covariates that an effect may look up by name
    # For the moments of a series of frames: the circumstances of its first frame; None where they do not differ from
    # those of the others
    first_frame: ExposureContext | None = None
    later_frames: ExposureContext | None = None  # those of the others on average

    @property
    def full_scale_dn(self) -> int:
        """Return the highest digital number that can leave the camera."""
        return (1 << (self.output_bit_depth or self.camera.bit_depth)) - 1

    @property
    def output_scale(self) -> float:
        """Return how many output DN make one native DN."""
        return float(2.0 ** ((self.output_bit_depth or self.camera.bit_depth) - self.camera.bit_depth))

    @property
    def f_number(self) -> float | None:
        """Return the f-number of the frame, or else that of the lens."""
        return self.settings.f_number if self.settings.f_number is not None else self.lens.f_number

    def fixed_rng(self, name: str) -> np.random.Generator:
        """Return a generator that gives the same numbers for every frame of this camera.

        Args:
            name: Name of the effect, so that two effects draw different patterns.
        """
        return np.random.default_rng((self.device_seed, zlib.crc32(name.encode())))

    def within_tiles(self, change: Callable[[ExposureContext], Signal]) -> tuple[Signal, Signal | float]:
        """Return a change of the signal at each entry, and the variance that it has within one.

        Of pixels there is none; tiles overrule this.
        """
        return change(self), 0.0

    def frame_mean(self, signal: Signal) -> float:
        """Return the mean over the whole frame, each tile by its share."""
        return float(np.average(signal, weights=self.geometry.weights))
