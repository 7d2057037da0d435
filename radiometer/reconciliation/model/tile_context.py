"""All captures of a design at once, in the form in which effects see one frame.

Arrays have the axes captures × tiles × points; the points are the four Gauss points of a tile, so that means are
exact for cubic shading and slopes come with them.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Final, Literal, Self, cast

import numpy as np
from numpy.typing import NDArray

from radiometer.reconciliation.measure.design import Design
from radiometer.reconciliation.measure.reduce import PatternImages
from radiometer.typing import Array
from simulators.chain.undeclared import completed
from simulators.effects.context import ExposureContext, FrameGeometry, Signal

Part = Literal["all", "first", "later"]
_MOST_KNOWN: Final = 64  # tables that are kept: a search comes back to the same time constants
_AT_ONCE: Final = 256  # frames that look back together: thousands of frames have millions of pairs


class FrameTimes:
    """When the frames of all captures were taken."""

    def __init__(self, stamps_s: Array, owner: NDArray[np.intp], place: NDArray[np.intp], captures: int) -> None:
        """Take up the frames.

        Args:
            stamps_s: (frames,) times.
            owner: (frames,) capture that each belongs to, one after the other.
            place: (frames,) its number within the capture.
            captures: How many captures there are.
        """
        self._stamps_s, self._owner = stamps_s, owner
        self._starts = np.searchsorted(owner, np.arange(captures))
        lone = np.bincount(owner, minlength=captures)[owner] == 1
        self._meant = {"all": place >= 0, "first": place == 0, "later": (place > 0) | lone}
        self._known: dict[tuple[Part, float], Array] = {}

    @classmethod
    def of(cls, design: Design) -> Self | None:
        """Return the times of a design's frames; None where that of any frame is not known."""
        frames = [(index, at, number) for at, c in enumerate(design.captures) for number, index in enumerate(c.frames)]
        stamps = [stamp for index, _, _ in frames if (stamp := design.header.frames[index].timestamp_s) is not None]
        if len(stamps) < len(frames):
            return None
        _, owner, place = (np.array(column, dtype=np.intp) for column in zip(*frames, strict=True))
        return cls(np.array(stamps, dtype=np.float64), owner, place, len(design.captures))

    def fading(self, tau_s: float, part: Part) -> Array:
        """Return Σ exp(−age/τ) over each capture's frames before those of another, on average over these.

        Args:
            tau_s: Time constant in s.
            part: The frames that look back: all of a capture, its first one or the others; a lone one is all parts.

        Returns:
            (captures that look back, captures).
        """
        if (part, tau_s) not in self._known:
            if len(self._known) >= _MOST_KNOWN:
                self._known.clear()
            found = np.zeros((self._starts.size, self._starts.size))
            looking = np.flatnonzero(self._meant[part])
            for begin in range(0, looking.size, _AT_ONCE):
                some = looking[begin : begin + _AT_ONCE]
                age_s = self._stamps_s[some, None] - self._stamps_s
                kept = np.where(age_s > 0, np.exp(-np.maximum(age_s, 0.0) / tau_s), 0.0)
                np.add.at(found, self._owner[some], np.add.reduceat(kept, self._starts, axis=1))
            self._known[part, tau_s] = found / np.bincount(self._owner[looking])[:, None]
        return self._known[part, tau_s]


@dataclass(frozen=True, slots=True, eq=False)
class CapturesPast:
    """The earlier frames of each capture, as some of its frames see them."""

    times: FrameTimes  # when the frames were taken
    held_e: Array  # (captures, tiles) electrons in each frame of a capture
    part: Part = "all"  # the frames that look back

    def faded(self, tau_s: float) -> Array:
        """Return the sum of what all earlier frames held, each times exp(−age/τ), (captures, tiles, 1) in electrons."""
        return np.asarray((self.times.fading(tau_s, self.part) @ self.held_e)[:, :, None])


Border = Literal["nearest", "constant"]  # of a picture: it goes on, or is dark

GAUSS_POINT: Final = 1.0 / math.sqrt(3.0)
_DENSE: Final = 12  # points per side of a tile where light from elsewhere varies within it
_POINTS: Final = ((-1, -1), (1, -1), (-1, 1), (1, 1))  # (x, y) signs
_STEPS: Final = (2.0 * np.arange(_DENSE) + 1.0) / _DENSE - 1.0
_V, _U = (axis.ravel() for axis in np.meshgrid(_STEPS, _STEPS, indexing="ij"))  # places −1 … 1 of the grid in a tile
_PLANE: Final = np.column_stack([np.ones_like(_U), _U, _V])
_AT_POINTS: Final = np.array([(1.0, x * GAUSS_POINT, y * GAUSS_POINT) for x, y in _POINTS])
_TO_POINTS: Final = np.asarray(_AT_POINTS @ np.linalg.pinv(_PLANE)).T
_SURFACE: Final = np.linalg.qr(np.column_stack([_PLANE, _U**2, _U * _V, _V**2]))[0]


@dataclass(frozen=True, slots=True, eq=False)
class BatchSettings:
    """The settings of all captures, with the names of FrameSettings; arrays of shape (captures, 1, 1)."""

    exposure_s: Array
    gain_db: Array
    f_number: Array
    black_level_dn: Array
    temperature_c: Array
    timestamp_s: Array
    source_level: Array
    is_dark: NDArray[np.bool_]
    pattern: NDArray[np.str_]

    @classmethod
    def of(cls, design: Design) -> BatchSettings:
        """Return the settings of a design's captures."""
        return cls(
            design.exposure_s[:, None, None],
            design.gain_db[:, None, None],
            design.f_number[:, None, None],
            np.nan_to_num(design.black_level_dn)[:, None, None],  # what is not declared is a link of its own
            design.temperature_c[:, None, None],
            design.timestamp_s[:, None, None],
            design.source_level[:, None, None],
            design.closed[:, None, None],
            np.array(design.patterns)[design.pattern_index][:, None, None],
        )

    def at(self, time_s: Array, temperature_c: Array) -> BatchSettings:
        """Return the settings at another time and temperature of each capture, one figure for each."""
        shape = self.timestamp_s.shape
        return replace(self, timestamp_s=time_s.reshape(shape), temperature_c=temperature_c.reshape(shape))


class PictureSurroundings:
    """Looks up what surrounds the tiles in the mean picture of each pattern.

    Ratios to the tiles' own signal are kept, so that they follow whatever the chain does to all light alike.
    """

    def __init__(self, design: Design, images: PatternImages) -> None:
        self._design, self._images = design, images
        self._spread: dict[tuple[float, Border], Array] = {}
        self._tiles = self._sampled([images.picture(p) for p in range(len(design.patterns))])
        self._norm = np.maximum(self._tiles.mean(axis=(1, 2)), 1e-30)
        self._mean = np.array([images.picture(p).mean() for p in range(len(design.patterns))]) / self._norm
        self._reflected: dict[float, Array] = {}
        self._columns: Array | None = None

    def frame_mean(self, signal: Signal) -> Signal:
        """Return the mean over the whole frame, shape (captures, 1, 1)."""
        return np.asarray(self._level(signal) * self._mean[self._design.pattern_index][:, None, None])

    def column_mean(self, signal: Signal) -> Signal:
        """Return the mean over the whole column of each point."""
        if self._columns is None:
            pictures = [self._images.picture(p) for p in range(len(self._design.patterns))]
            means = [np.broadcast_to(picture.mean(axis=0), picture.shape) for picture in pictures]
            self._columns = self._smoothed(means)
        return self._relative(signal, self._columns)

    def spread(self, signal: Signal, radius_fraction: float, beyond: float = 1.0) -> Signal:
        """Return the signal at each tile spread over a fraction of the frame's longer side.

        Beyond the border the picture goes on at a share of what it is there.
        """
        found = self._softened(round(radius_fraction, 6), "nearest")
        if beyond != 1.0:
            found = beyond * found + (1.0 - beyond) * self._softened(round(radius_fraction, 6), "constant")
        return self._relative(signal, found)

    def _softened(self, radius_fraction: float, border: Border) -> Array:
        key = (radius_fraction, border)
        if key not in self._spread:
            pictures = [_soft(self._images.picture(p), *key) for p in range(len(self._design.patterns))]
            self._spread[key] = self._smoothed(pictures)
        return self._spread[key]

    def reflected(self, signal: Signal, radius_fraction: float = 0.0) -> Signal:
        """Return the signal at the point reflected about the optical axis, spread where asked for."""
        key = round(radius_fraction, 6)
        if key not in self._reflected:
            pictures = [self._images.picture(p) for p in range(len(self._design.patterns))]
            soft = [_soft(picture, key) for picture in pictures] if key else pictures
            self._reflected[key] = self._smoothed([self._turned(picture) for picture in soft])
        return self._relative(signal, self._reflected[key])

    def _relative(self, signal: Signal, sampled: Array) -> Signal:
        ratio = sampled / self._norm[:, None, None]
        return np.asarray(self._level(signal) * ratio[self._design.pattern_index])

    def _level(self, signal: Signal) -> Signal:
        level: Signal = np.asarray(signal.mean(axis=(-2, -1), keepdims=True))
        return level

    def _sampled(self, pictures: list[Array]) -> Array:
        x, y = tile_points(self._design)
        cell = self._images.cell_px
        return np.stack([_bilinear(picture, (x + 0.5) / cell - 0.5, (y + 0.5) / cell - 0.5) for picture in pictures])

    def _smoothed(self, pictures: list[Array]) -> Array:
        """Return values at the tiles' points that have the mean and the least-squares slopes of each tile's pixels."""
        x, y = _dense_points(self._design)
        cell = self._images.cell_px
        found = []
        for picture in pictures:
            values = _bilinear(picture, (x + 0.5) / cell - 0.5, (y + 0.5) / cell - 0.5)
            found.append(values @ _TO_POINTS)
        return np.stack(found)

    def _turned(self, picture: Array) -> Array:
        centre = self._design.header.lens.principal_point_px
        height, width = self._design.shape
        x0, y0 = centre or ((width - 1) / 2, (height - 1) / 2)
        rows, columns = np.indices(picture.shape)
        cell = self._images.cell_px
        far_x = np.asarray(2 * (x0 + 0.5) / cell - 1.0 - columns)
        far_y = np.asarray(2 * (y0 + 0.5) / cell - 1.0 - rows)
        inside = (
            (far_x >= -0.5) & (far_x <= picture.shape[1] - 0.5) & (far_y >= -0.5) & (far_y <= picture.shape[0] - 0.5)
        )
        return np.where(inside, _bilinear(picture, far_x, far_y), 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class TileContext(ExposureContext):
    """The context of all captures at once."""

    surroundings: PictureSurroundings | None = None
    frames: Any = 1.0
    tile_pixels: Any = 1.0
    tile_height: Any = 1.0
    grid: FrameGeometry | None = None
    times: FrameTimes | None = None

    def within_tiles(self, change: Callable[[ExposureContext], Signal]) -> tuple[Signal, Signal | float]:
        """Return the values of a change that is steep within a tile at its points, and the residual variance.

        Args:
            change: Gives it for a context, (captures, tiles, points); here one whose points are a fine grid.
        """
        grid = self.grid
        if grid is None:
            return change(self), 0.0
        parts = {"first_frame": self.first_frame, "later_frames": self.later_frames}
        moved = {name: None if part is None else replace(part, geometry=grid) for name, part in parts.items()}
        return from_grid(change(replace(self, geometry=grid, **cast(Any, moved))))

    def frame_mean(self, signal: Signal) -> Any:
        """Return the mean over the whole frame, shape (captures, 1, 1)."""
        return self.surroundings.frame_mean(signal) if self.surroundings else signal.mean(axis=(-2, -1), keepdims=True)

    def remembering(self, held_e: Array) -> TileContext:
        """Return the context with what the frames of each capture held, (captures, tiles) in electrons."""
        times = self.times
        if times is None:
            return self

        def seen(context: ExposureContext | None, part: Part) -> ExposureContext | None:
            return None if context is None else replace(context, past=CapturesPast(times, held_e, part))

        first, later = seen(self.first_frame, "first"), seen(self.later_frames, "later")
        return replace(self, past=CapturesPast(times, held_e), first_frame=first, later_frames=later)

    def warmed(self, kelvin: float) -> TileContext:
        """Return the context of captures that are so much warmer."""

        def warm(context: ExposureContext | None) -> Any:
            if context is None:
                return None
            settings: Any = context.settings
            return replace(context, settings=settings.at(settings.timestamp_s, settings.temperature_c + kelvin))

        own = cast(TileContext, warm(self))
        return replace(own, first_frame=warm(self.first_frame), later_frames=warm(self.later_frames))


def from_grid(values: Signal) -> tuple[Signal, Signal]:
    """Return values on the grid of a tile as values at its four points, and the residual variance.

    The four values have the mean and the least-squares slopes of all; the variance is that about a quadratic surface,
    as that of a tile's pixels is.
    """
    left = np.mean(values**2, axis=-1) - np.sum((values @ _SURFACE) ** 2, axis=-1) / values.shape[-1]
    return np.asarray(values @ _TO_POINTS), np.asarray(np.maximum(left, 0.0)[..., None])


def tile_points(design: Design) -> tuple[Array, Array]:
    """Return column and row coordinates of the tiles' Gauss points in pixels, each (tiles, 4)."""
    middle = np.array([(t.x + (t.width - 1) / 2, t.y + (t.height - 1) / 2) for t in design.tiles])
    half = np.array([(t.width / 2, t.height / 2) for t in design.tiles]) * GAUSS_POINT
    signs = np.array(_POINTS, dtype=np.float64)
    x = middle[:, :1] + half[:, :1] * signs[:, 0]
    y = middle[:, 1:] + half[:, 1:] * signs[:, 1]
    return x, y


def tilt_of(rise_x: Array, rise_y: Array) -> Array:
    """Return the factor at the four points of tiles whose relative rise from centre to edge is given."""
    signs_x, signs_y = np.array(_POINTS, dtype=np.float64).T
    tilt = rise_x[:, :, None] * signs_x + rise_y[:, :, None] * signs_y
    return np.asarray(1.0 + GAUSS_POINT * tilt)


def rise_of(points: Signal) -> tuple[Array, Array]:
    """Return the rise from centre to right and to bottom edge from values at the four points."""
    per_edge = 0.25 / GAUSS_POINT
    x = (points[..., 1] + points[..., 3] - points[..., 0] - points[..., 2]) * per_edge
    y = (points[..., 2] + points[..., 3] - points[..., 0] - points[..., 1]) * per_edge
    return np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64)


def _dense_points(design: Design) -> tuple[Array, Array]:
    """Return image coordinates of a grid of points in each tile, each (tiles, points)."""
    x = np.array([t.x + (t.width - 1) / 2 + 0.5 * t.width * _U for t in design.tiles])
    y = np.array([t.y + (t.height - 1) / 2 + 0.5 * t.height * _V for t in design.tiles])
    return x, y


def tile_context(design: Design, images: PatternImages) -> TileContext:
    """Return the context of all captures of a design."""
    camera, lens = design.header.camera, design.header.lens
    geometry, grid = (
        FrameGeometry(
            x[None],
            y[None],
            design.shape[1],
            design.shape[0],
            principal_point_px=lens.principal_point_px,
            pixel_spacing_um=camera.pixel_spacing_um or camera.pixel_pitch_um or 4.5,
        )
        for x, y in (tile_points(design), _dense_points(design))
    )
    radiance = scene_radiance(design, images)
    peak = float(np.nanmax(radiance))
    settings = BatchSettings.of(design)
    numbers = [table[:, None, None, :] for table in design.frame_numbers]
    context = TileContext(
        cast(Any, settings),
        geometry,
        camera.model_copy(update={"pixel_pitch_um": completed(camera).pixel_pitch_um}),
        lens,
        design.header.source.wavelength_nm or 550.0,
        code=np.maximum(radiance / peak, 1e-9)[design.pattern_index][:, :, None],
        peak_radiance=peak,
        since_light_s=_column(design.since_light_s),
        since_frame_s=_column(design.since_frame_s[0]),
        surroundings=PictureSurroundings(design, images),
        frames=design.frame_count[:, None, None],
        tile_pixels=np.array([t.width * t.height for t in design.tiles], dtype=np.float64)[None, :, None],
        tile_height=np.array([t.height for t in design.tiles], dtype=np.float64)[None, :, None],
        frame_numbers=numbers[0],
        grid=grid,
        times=FrameTimes.of(design),
    )
    if not (design.frame_count > 1).any():
        return context
    first, later = (
        replace(
            context,
            settings=cast(Any, settings.at(time_s, warm)),
            since_light_s=_column(since),
            since_frame_s=_column(rested),
            frame_numbers=own,
        )
        for (time_s, warm, since), rested, own in zip(
            (design.first_frames, design.later_frames), design.since_frame_s, numbers[1:], strict=True
        )
    )
    return replace(context, first_frame=first, later_frames=later)


def _column(values: Array) -> Array:
    return values[:, None, None]


def scene_radiance(design: Design, images: PatternImages) -> Array:
    """Return the radiance of every tile under every pattern, (patterns, tiles) in W·sr⁻¹·m⁻².

    What is unknown is taken from the pattern's mean picture, brought to the scale of what is known (or of the
    declared camera where nothing is).
    """
    known = np.array([[np.nan if v is None else v for v in tile.radiance] for tile in design.tiles]).T
    x, y = tile_points(design)
    cell = images.cell_px
    seen = np.stack(
        [
            _bilinear(images.picture(p), (x + 0.5) / cell - 0.5, (y + 0.5) / cell - 0.5).mean(axis=1)
            for p in range(len(design.patterns))
        ]
    )
    both = np.isfinite(known) & (seen > 0)
    declared = 1.0 / np.pi  # any positive number serves: the responsivity is fitted
    scale = float(np.sum(known[both]) / np.sum(seen[both])) if both.any() else declared
    guess = np.maximum(seen * scale, 1e-6 * max(float(seen.max()) * scale, 1e-30))
    guess[list(design.same_patches)] = guess[0]
    return np.where(np.isfinite(known) & (known > 0), known, guess)


def _bilinear(picture: Array, x: Array, y: Array) -> Array:
    x = np.clip(x, 0, picture.shape[1] - 1)
    y = np.clip(y, 0, picture.shape[0] - 1)
    left, top = np.floor(x).astype(int), np.floor(y).astype(int)
    right, bottom = np.minimum(left + 1, picture.shape[1] - 1), np.minimum(top + 1, picture.shape[0] - 1)
    fx, fy = x - left, y - top
    upper = picture[top, left] * (1 - fx) + picture[top, right] * fx
    lower = picture[bottom, left] * (1 - fx) + picture[bottom, right] * fx
    return cast(Array, upper * (1 - fy) + lower * fy)


def _soft(picture: Array, radius_fraction: float, border: Border = "nearest") -> Array:
    from scipy.ndimage import gaussian_filter

    return cast(Array, gaussian_filter(picture, radius_fraction * max(picture.shape), mode=border))
