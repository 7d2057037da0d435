"""Predicts the statistics of all captures: the simulator's chain of effects, walked with the moments of tiles.

All captures of a design come at once, in the form in which effects see one frame. Arrays have the axes captures ×
tiles × points; the points are the four Gauss points of a tile, so that means are exact for cubic shading and slopes
come with them.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import takewhile
from typing import Any, Final, Literal, Self, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from radiometer.reconciliation.design import Design
from radiometer.reconciliation.lines import TileBands
from radiometer.reconciliation.reduce import PatternImages
from radiometer.reconciliation.statistics import Prediction, of_tiles
from radiometer.typing import Array
from simulators.chain.stages import in_order, place_for
from simulators.chain.undeclared import Undeclared, completed, undeclared_chain
from simulators.effects.base import DIGITAL_NUMBER, ELECTRONS, Effect
from simulators.effects.catalogue import CatalogueEffect
from simulators.effects.context import ExposureContext, FrameGeometry, Signal
from simulators.effects.tile_moments import Moments, TileMoments

Part = Literal["all", "first", "later"]
_MOST_KNOWN: Final = 64  # tables that are kept: a search comes back to the same time constants
_POINTS_AT_ONCE: Final = 256  # frames that look back together: thousands of frames have millions of pairs


class FrameTimes:
    """When the frames of all captures were taken."""

    def __init__(self, stamps_s: Array, owner: NDArray[np.intp], place: NDArray[np.intp], captures: int) -> None:
        """Take up the frames.

        Args:
            owner: (frames,) capture that each belongs to, one after the other.
            place: (frames,) its number within the capture.
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
            for begin in range(0, looking.size, _POINTS_AT_ONCE):
                some = looking[begin : begin + _POINTS_AT_ONCE]
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
            np.nan_to_num(design.black_level_dn)[:, None, None],  # what is not declared is a separate link
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
        self._pictures = [images.picture(p) for p in range(len(design.patterns))]
        tiles = np.stack([_looked_up(images, picture, *_tile_points(design)) for picture in self._pictures])
        self._norm = np.maximum(tiles.mean(axis=(1, 2)), 1e-30)
        self._mean = np.array([picture.mean() for picture in self._pictures]) / self._norm
        self._known: dict[tuple[object, ...], Array] = {}

    def frame_mean(self, signal: Signal) -> Signal:
        """Return the mean over the whole frame, shape (captures, 1, 1)."""
        return np.asarray(_level(signal) * self._mean[self._design.pattern_index][:, None, None])

    def column_mean(self, signal: Signal) -> Signal:
        """Return the mean over the whole column of each point."""
        return self._relative(signal, ("column",), lambda picture: np.broadcast_to(picture.mean(axis=0), picture.shape))

    def spread(self, signal: Signal, radius_fraction: float, beyond: float = 1.0) -> Signal:
        """Return the signal at each tile spread over a fraction of the frame's longer side.

        Beyond the border the picture goes on at a share of what it is there.
        """
        radius = round(radius_fraction, 6)
        found = self._relative(signal, ("spread", radius), lambda picture: _soft(picture, radius))
        if beyond == 1.0:
            return found
        dark = self._relative(signal, ("dark beyond", radius), lambda picture: _soft(picture, radius, "constant"))
        return np.asarray(beyond * found + (1.0 - beyond) * dark)

    def reflected(self, signal: Signal, radius_fraction: float = 0.0) -> Signal:
        """Return the signal at the point reflected about the optical axis, spread where asked for."""
        radius = round(radius_fraction, 6)

        def turned(picture: Array) -> Array:
            return self._turned(_soft(picture, radius) if radius else picture)

        return self._relative(signal, ("reflected", radius), turned)

    def _relative(self, signal: Signal, key: tuple[object, ...], change: Callable[[Array], Array]) -> Signal:
        """Return the signal times what a change makes of each picture, over the tiles' mean."""
        if key not in self._known:
            places = _dense_points(self._design)
            values = (_looked_up(self._images, change(picture), *places) for picture in self._pictures)
            self._known[key] = np.stack([own @ _TO_POINTS for own in values]) / self._norm[:, None, None]
        return np.asarray(_level(signal) * self._known[key][self._design.pattern_index])

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


def _tile_points(design: Design) -> tuple[Array, Array]:
    middle = np.array([(t.x + (t.width - 1) / 2, t.y + (t.height - 1) / 2) for t in design.tiles])
    half = np.array([(t.width / 2, t.height / 2) for t in design.tiles]) * GAUSS_POINT
    signs = np.array(_POINTS, dtype=np.float64)
    x = middle[:, :1] + half[:, :1] * signs[:, 0]
    y = middle[:, 1:] + half[:, 1:] * signs[:, 1]
    return x, y


def rise_of(points: Signal) -> tuple[Array, Array]:
    """Return the rise from centre to right and to bottom edge from values at the four points."""
    per_edge = 0.25 / GAUSS_POINT
    x = (points[..., 1] + points[..., 3] - points[..., 0] - points[..., 2]) * per_edge
    y = (points[..., 2] + points[..., 3] - points[..., 0] - points[..., 1]) * per_edge
    return np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64)


def _dense_points(design: Design) -> tuple[Array, Array]:
    x = np.array([t.x + (t.width - 1) / 2 + 0.5 * t.width * _U for t in design.tiles])
    y = np.array([t.y + (t.height - 1) / 2 + 0.5 * t.height * _V for t in design.tiles])
    return x, y


def _tile_context(design: Design, images: PatternImages) -> TileContext:
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
        for x, y in (_tile_points(design), _dense_points(design))
    )
    radiance = _scene_radiance(design, images)
    peak = float(np.nanmax(radiance))
    settings = BatchSettings.of(design)
    numbers = [table[:, None, None, :] for table in design.frame_numbers]
    moments_s = [None if table is None else table[:, None, None, :] for table in design.frame_times_s]
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
        frame_times_s=moments_s[0],
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
            frame_times_s=taken_s,
        )
        for (time_s, warm, since), rested, own, taken_s in zip(
            design.first_and_later, design.since_frame_s, numbers[1:], moments_s[1:], strict=True
        )
    )
    return replace(context, first_frame=first, later_frames=later)


def _column(values: Array) -> Array:
    return values[:, None, None]


def _scene_radiance(design: Design, images: PatternImages) -> Array:
    """Return the radiance of every tile under every pattern, (patterns, tiles) in W·sr⁻¹·m⁻²."""
    known = np.array([[np.nan if v is None else v for v in tile.radiance] for tile in design.tiles]).T
    places, pictures = _tile_points(design), [images.picture(p) for p in range(len(design.patterns))]
    seen = np.stack([_looked_up(images, picture, *places).mean(axis=1) for picture in pictures])
    both = np.isfinite(known) & (seen > 0)
    declared = 1.0 / np.pi  # any positive number serves: the responsivity is fitted
    scale = float(np.sum(known[both]) / np.sum(seen[both])) if both.any() else declared
    guess = np.maximum(seen * scale, 1e-6 * max(float(seen.max()) * scale, 1e-30))
    _, first, number = np.unique(design.patch_of_tile, return_index=True, return_inverse=True)
    guess = np.add.reduceat(guess, first, axis=1)[:, number] / np.bincount(number)[number]  # parts of a patch are alike
    guess[list(design.same_patches)] = guess[0]
    return np.where(np.isfinite(known) & (known > 0), known, guess)


def _level(signal: Signal) -> Signal:
    level: Signal = np.asarray(signal.mean(axis=(-2, -1), keepdims=True))
    return level


def _looked_up(images: PatternImages, picture: Array, x: Array, y: Array) -> Array:
    return _bilinear(picture, (x + 0.5) / images.cell_px - 0.5, (y + 0.5) / images.cell_px - 0.5)


def _bilinear(picture: Array, x: Array, y: Array) -> Array:
    from scipy.ndimage import map_coordinates

    return cast(Array, map_coordinates(picture, (y, x), order=1, mode="nearest"))


def _soft(picture: Array, radius_fraction: float, border: Border = "nearest") -> Array:
    from scipy.ndimage import gaussian_filter

    return cast(Array, gaussian_filter(picture, radius_fraction * max(picture.shape), mode=border))


_SMALLEST_VARIANCE_DN2: Final = 1e-3  # a value that always rounds or clips to one code has none


@dataclass(frozen=True, slots=True, eq=False)
class Nuisance:
    """Parameters that are fitted with the effects and never named."""

    off: Undeclared  # what the camera's description leaves out
    log_radiance: Array  # natural logarithm of each patch's radiance over the stated one, (patterns, tiles)
    # Rise of each tile's radiance from centre to edge, relative, (patterns, 2, tiles); unknown scenes only
    slope: Array

    @classmethod
    def start(cls, design: Design) -> Nuisance:
        """Return nuisances that change nothing."""
        patterns, tiles = len(design.patterns), len(design.tiles)
        off = Undeclared(texture=np.zeros((patterns, tiles)))
        return cls(off, np.zeros((patterns, tiles)), np.zeros((patterns, 2, tiles)))

    def with_off(self, **figures: Any) -> Nuisance:
        """Return the nuisances with other figures of the camera."""
        return replace(self, off=replace(self.off, **figures))


@dataclass(frozen=True, slots=True, eq=False)
class TileModel:
    """The ideal camera of a capture header with effects added to it, evaluated on tiles."""

    design: Design  # captures and tiles
    context: TileContext  # the captures as the effects see them
    radiance: Array  # (patterns, tiles) radiance in W·sr⁻¹·m⁻²
    images: PatternImages  # mean picture of each pattern
    effects: tuple[CatalogueEffect, ...] = ()  # effects added to the ideal chain, to be fitted
    given: tuple[CatalogueEffect, ...] = ()  # effects that the starting model holds already
    passes_well: bool = False  # whether the data pass the declared full well, which then limits nothing

    @classmethod
    def of(cls, design: Design, images: PatternImages) -> TileModel:
        """Return the ideal camera."""
        model = cls(design, _tile_context(design, images), _scene_radiance(design, images), images)
        return model._looking_back(Nuisance.start(design))

    def with_effects(self, effects: Sequence[CatalogueEffect]) -> TileModel:
        """Return the model with exactly these effects."""
        return replace(self, effects=tuple(effects))

    def warmed(self, kelvin: float) -> TileModel:
        """Return the model of the same captures, all of them so much warmer."""
        return replace(self, context=self.context.warmed(kelvin))

    def predict(self, nuisance: Nuisance, like: Trace | None = None) -> Prediction:
        """Return the expected statistics.

        Args:
            like: The chain as it ran for the same captures with other effects or nuisances; only what comes behind the
                first step that differs is worked out.
        """
        return self.trace(nuisance, like).prediction

    def trace(self, nuisance: Nuisance, like: Trace | None = None) -> Trace:
        """Return the expected statistics with the moments between the steps of the chain."""
        walk = self.begun(nuisance, like)
        if like is not None and len(walk.passed) == len(walk.chain) + 1 == len(like.passed):
            return like
        walk = self.walked(walk, len(walk.chain))
        prediction = self.summary(walk.passed[-1], self.signal(walk), self.taken * self.gain(walk))
        return Trace(walk.nuisance, walk.taken, walk.links, walk.chain, walk.passed, prediction)

    # ---- the chain, step by step ---------------------------------------------------------------------------

    @property
    def taken(self) -> float:
        """Return the factor on the electrons' mean by which effects lower the responsivity, which is fitted.

        A wrong conversion gain moves no mean then: it moves the number of electrons behind it, and with them their
        noise and all that acts by their number.
        """
        return math.prod(effect.responsivity_taken() for effect in (*self.given, *self.effects))

    def links(self, nuisance: Nuisance, like: Walk | None = None) -> tuple[Effect, ...]:
        """Return the links of the declared camera; effects act in front of the link that `place_for` gives.

        Where a chain is known, its unchanged links are reused.
        """
        taken = self.taken
        if like is not None and nuisance.off is like.nuisance.off and taken == like.taken:
            return like.links
        header = self.design.header
        ends = header.camera.full_well_e is not None and not self.passes_well
        off = replace(nuisance.off, log_responsivity=nuisance.off.log_responsivity - math.log(taken))
        links = undeclared_chain(header.camera, header.lens, off, self.design.pattern_index, ends_in_well=ends)
        known = {} if like is None else {type(link): link for link in like.links}
        return tuple(_as_known(link, known.get(type(link))) for link in links)

    def _chain(self, links: tuple[Effect, ...]) -> tuple[Effect, ...]:
        steps = (*links, *self.given, *self.effects)
        return tuple(steps[number] for number in _ordered(tuple(map(type, steps)), len(links)))

    def begun(self, nuisance: Nuisance, like: Walk | None = None) -> Walk:
        """Return the walk as far as it is the same as a known one: in front of its first step where none is."""
        links = self.links(nuisance, like)
        chain = self._chain(links)
        if like is None or not like.shows(nuisance):
            return Walk(nuisance, self.taken, links, chain, (self._scene(nuisance),))
        shared = sum(1 for _ in takewhile(lambda pair: pair[0] is pair[1], zip(like.chain, chain, strict=False)))
        return Walk(nuisance, self.taken, links, chain, like.passed[: 1 + shared])

    def walked(self, walk: Walk, until: int) -> Walk:
        """Return a walk that went on to the front of a step of its chain, by number; behind the last is one more."""
        ahead = walk.chain[len(walk.passed) - 1 : until]
        model, passed = self._looking_back(walk.nuisance) if any(map(_looks_back, ahead)) else self, [*walk.passed]
        for step in ahead:
            passed.append(model.through(step, passed[-1]))
        return replace(walk, passed=tuple(passed))

    def through(self, step: Effect, moments: TileMoments) -> TileMoments:
        """Return the moments behind a step."""
        after = step.moments(moments, self.context)
        assert isinstance(after, TileMoments)
        return after

    def _scene(self, nuisance: Nuisance) -> TileMoments:
        scene = (self.radiance * np.exp(nuisance.log_radiance))[self.design.pattern_index]
        found = scene[:, :, None] * np.ones(4)
        if nuisance.slope.any():
            (signs_x, signs_y), slopes = (
                np.array(_POINTS, dtype=np.float64).T,
                nuisance.slope[self.design.pattern_index],
            )
            found = found * (1.0 + GAUSS_POINT * (slopes[:, 0, :, None] * signs_x + slopes[:, 1, :, None] * signs_y))
        return TileMoments.exactly(found)

    def signal(self, walk: Walk) -> Array:
        """Return the light signal of a walk in electrons, (captures, tiles)."""
        light = walk.in_front(1 + _first_of(walk.links, ELECTRONS)).mean
        return of_tiles(light, light.shape[:-1])

    def gain(self, walk: Walk) -> Array:
        """Return DN per electron of a walk, (captures,)."""
        place = _first_of(walk.links, DIGITAL_NUMBER)
        gain = np.asarray(walk.links[place].slope(walk.in_front(place).mean, self.context), dtype=np.float64)
        return np.asarray(np.broadcast_to(gain, (*gain.shape[:-3], len(self.design.captures), 1, 1))[..., 0, 0])

    def _looking_back(self, nuisance: Nuisance) -> TileModel:
        """Return the model whose previous frames hold, in electrons, what its effects and nuisances make of light."""
        ahead = replace(
            self,
            effects=tuple(effect for effect in self.effects if not effect.looks_back),
            given=tuple(effect for effect in self.given if not effect.looks_back),
        )
        links, moments = self.links(nuisance), self._scene(nuisance)
        for step in ahead._chain(links):
            moments = ahead.through(step, moments)
            if step.unit_out == ELECTRONS:
                break
        signal = moments.mean.mean(axis=2)
        order = np.argsort([capture.frames[0] for capture in self.design.captures])
        before = np.zeros_like(signal)
        before[order[1:]] = signal[order[:-1]]
        context = replace(self.context, previous_e=before[:, :, None])
        return replace(self, context=context.remembering(signal))

    # ---- from moments at points to statistics of tiles -----------------------------------------------------

    def summary(self, final: TileMoments, signal: Array, gain: Array) -> Prediction:
        """Return the statistics that moments come to; those of several models are along a first axis.

        Args:
            signal: (captures, tiles) light signal in electrons.
            gain: (captures,) DN per electron.
        """
        shape = signal.shape[-2:]

        def tiles(values: Signal) -> Array:
            return of_tiles(values, (*np.shape(values)[:-3], *shape))

        def captures(values: Signal) -> Array:
            return of_tiles(values[..., 0], (*values.shape[:-3], shape[0]))

        def everywhere(values: Signal | float) -> Array:
            return tiles(np.broadcast_to(values, final.mean.shape))

        mean, variance, n = tiles(final.mean), tiles(final.variance), self.design.frame_count[:, None]
        if not self.design.uniform:  # a scene's noise is that of the later frames, without the first one's own light
            variance = variance - np.where(n > 2, gain[..., None] * tiles(final.first_excess) / n, 0.0)
        lines, columns, rows = map(tiles, (final.row_variance, final.fixed_column_variance, final.fixed_row_variance))
        # A frame's mean is taken out of each tile, and with it what its rows have in common.
        shared = np.broadcast_to(np.asarray(self.context.tile_height, dtype=np.float64)[..., 0], shape)
        within = lines * (1.0 - 1.0 / shared)
        band, left = tiles(final.band_variance), TileBands.of(self.design, final.band_frequency)
        total = np.maximum(variance + within + band * left.within, _SMALLEST_VARIANCE_DN2)
        white = np.maximum(variance + lines * self.design.rough_rows + band * left.rough, _SMALLEST_VARIANCE_DN2)
        fixed = tiles(final.spatial_variance)
        spatial = white / n + fixed + columns * self.design.rough_columns + rows * self.design.rough_rows
        fixed = fixed + columns + rows
        rise_x, rise_y = rise_of(final.mean)
        safe = np.maximum(total, 1e-30)
        return Prediction(
            mean=mean,
            slope_x=rise_x,
            slope_y=rise_y,
            variance=total,
            spatial=spatial,
            neighbour_x=(tiles(final.neighbour_x) + within + band * left.within) / safe,
            neighbour_y=(tiles(final.neighbour_y) - lines / shared + band * left.lag) / safe,
            first=tiles(final.first_excess),
            common_variance=tiles(final.common_variance),
            ordered_variance=everywhere(final.ordered_variance),
            row_variance=lines.mean(axis=-1),
            fixed_column_variance=columns.mean(axis=-1),
            fixed_row_variance=rows.mean(axis=-1),
            edge=captures(final.edge_share),
            outliers=captures(final.outliers),
            unsteady=captures(final.unsteady),
            comb_step=final.comb_step,
            comb_kept=final.comb_kept,
            signal=signal,
            gain=gain,
            fixed=fixed,
            unrounded=final.unrounded or final,
            band_variance=band,
            band_frequency=final.band_frequency,
            mixed_x=tiles(final.neighbour_x) / safe,
            mixed_y=tiles(final.neighbour_y) / safe,
            limit_variance=everywhere(final.limit_variance),
            renewed_variance=everywhere(final.renewed_variance),
            beyond_x=everywhere(final.beyond_x) / safe,
            beyond_y=everywhere(final.beyond_y) / safe,
            beyond_rows=everywhere(final.beyond_rows) / safe,
            uneven_noise=everywhere(final.uneven_noise),
        )


@dataclass(frozen=True, eq=False)
class Walk:
    """The chain as far as it was walked."""

    nuisance: Nuisance  # the nuisances
    taken: float  # factor by which effects lower the responsivity
    links: tuple[Effect, ...]  # the links of the declared camera
    chain: tuple[Effect, ...]  # these and the effects, in the order of the light
    # Moments in front of each step that was reached; behind the last one too where all were taken
    passed: tuple[TileMoments, ...]

    def in_front(self, place: int) -> TileMoments:
        """Return the moments in front of a link and of what acts before it."""
        return self.passed[self.number(place)]

    def number(self, place: int) -> int:
        """Return the number of the first step that acts in front of a link, or of the link where none does."""
        return 1 + next(at for at, step in enumerate(self.chain) if step is self.links[place - 1]) if place else 0

    def shows(self, nuisance: Nuisance) -> bool:
        """Return whether the scene is that of these nuisances."""
        return nuisance.log_radiance is self.nuisance.log_radiance and nuisance.slope is self.nuisance.slope


@dataclass(frozen=True, eq=False)
class Trace(Walk):
    """The chain as it ran once."""

    prediction: Prediction  # the expected statistics


def _looks_back(step: Effect) -> bool:
    return isinstance(step, CatalogueEffect) and step.looks_back


@lru_cache(maxsize=4096)
def _ordered(kinds: tuple[type[Effect], ...], links: int) -> tuple[int, ...]:
    steps_at: dict[int, list[int]] = defaultdict(list)
    for number in sorted(range(links, len(kinds)), key=lambda number: in_order(kinds[number])):
        steps_at[place_for(kinds[number], kinds[:links])].append(number)
    numbers = range(links)
    return tuple(step for place in range(links + 1) for step in (*steps_at[place], *numbers[place : place + 1]))


def _as_known(link: Effect, known: Effect | None) -> Effect:
    if known is None:
        return link
    pairs = ((getattr(link, name), getattr(known, name)) for name in link.values())
    return known if all(a is b or (type(a) is type(b) is not np.ndarray and a == b) for a, b in pairs) else link


def _first_of(links: Sequence[Effect], unit: str) -> int:
    return next(place for place, link in enumerate(links) if link.unit_out == unit)


SomeMoments = TypeVar("SomeMoments", bound=Moments)
_AT_ONCE: Final = 1 << 16  # entries of a stacked array: more of them leave the processor's nearest memory


def predict_several(
    models: Sequence[tuple[TileModel, Nuisance]], like: Trace
) -> Iterator[tuple[list[int], Prediction]]:
    """Yield what models of the same captures expect: numbers of some, and their statistics along a first axis."""
    waiting = sorted((_Apart.of(n, *entry, like) for n, entry in enumerate(models)), key=lambda one: one.joins)
    most = max(1, _AT_ONCE // like.passed[0].mean.size)
    while waiting:
        together = _Together(models[0][0], like)
        left = together.walk_with(waiting[:most])
        yield [one.number for one in together.members], together.prediction()
        waiting = left + waiting[most:]


@dataclass(frozen=True, slots=True, eq=False)
class _Apart:
    number: int  # its number
    model: TileModel  # the model
    walk: Walk  # the chain so far
    joins: int  # number of the step of the known chain from which on it has no others

    @classmethod
    def of(cls, number: int, model: TileModel, nuisance: Nuisance, like: Trace) -> Self:
        """Return a model just before the steps that it shares with a known chain."""
        walk = model.begun(nuisance, like)
        behind = zip(reversed(like.chain), reversed(walk.chain), strict=False)
        same = takewhile(lambda pair: pair[0] is pair[1] and not _looks_back(pair[0]), behind)
        shared = min(sum(1 for _ in same), len(walk.chain) + 1 - len(walk.passed))
        return cls(number, model, model.walked(walk, len(walk.chain) - shared), len(like.chain) - shared)


class _Together:
    """Models that go through the rest of a known chain as one."""

    def __init__(self, model: TileModel, like: Trace) -> None:
        self._model, self._like = model, like
        self._passed = list(like.passed)  # in front of the first that joins nothing of it is asked for
        self.members = list[_Apart]()

    def walk_with(self, waiting: Sequence[_Apart]) -> list[_Apart]:
        """Walk to the end of the chain with all that may join; return those that may not."""
        left, chain = list[_Apart](), self._like.chain
        for number in range(waiting[0].joins, 1 + len(chain)):
            joining = [one for one in waiting if one.joins == number]
            if joining:
                left += self._join(joining, number)
            if number < len(chain):
                self._passed[number + 1] = self._model.through(chain[number], self._passed[number])
        return left

    def prediction(self) -> Prediction:
        known = self._like.prediction
        signal = self._of_members(1 + _first_of(self._like.links, ELECTRONS), TileModel.signal, known.signal.shape)
        gain = self._of_members(_first_of(self._like.links, DIGITAL_NUMBER), TileModel.gain, known.gain.shape)
        taken = np.array([[one.model.taken] for one in self.members])
        return self._model.summary(self._passed[-1], signal, taken * gain)

    def _join(self, joining: list[_Apart], number: int) -> list[_Apart]:
        parts, counts = [one.walk.passed[-1] for one in joining], [1] * len(joining)
        if self.members:
            parts, counts = [self._passed[number], *parts], [len(self.members), *counts]
        fits = [_figures(part) == _figures(parts[0]) for part in parts]
        kept = [place for place, fit in enumerate(fits) if fit]
        self._passed[number] = stacked([parts[place] for place in kept], [counts[place] for place in kept])
        fitting = fits[-len(joining) :]
        self.members += [one for one, fit in zip(joining, fitting, strict=True) if fit]
        return [one for one, fit in zip(joining, fitting, strict=True) if not fit]

    def _of_members(self, place: int, of: Callable[[TileModel, Walk], Array], shape: tuple[int, ...]) -> Array:
        """Return what walks show in front of a link: of those who had joined by then at once, of each else."""
        number, like = self._like.number(place), self._like
        late = [one for one in self.members if one.joins > number]
        found = [of(one.model, one.walk)[None] for one in late]
        if early := len(self.members) - len(late):
            walk = Walk(like.nuisance, like.taken, like.links, like.chain, tuple(self._passed))
            found = [np.broadcast_to(of(self._model, walk), (early, *shape)), *found]
        return np.concatenate(found)


def _figures(moments: Moments) -> tuple[Any, ...]:
    """Return what no array holds, and must be alike where moments are stacked."""
    return (moments.unrounded is None, *(getattr(moments, name) for name in moments.figures))


def stacked(parts: Sequence[SomeMoments], counts: Sequence[int]) -> SomeMoments:
    """Return moments of several models along a first axis; a field that all have in common stays as it is.

    The mean always has that axis, by which their number is known.
    """
    first = parts[0]
    further = [part.unrounded for part in parts if part.unrounded]
    found: dict[str, Any] = {"unrounded": stacked(further, counts) if further else None}
    for name in vars(first).keys() - {"unrounded", *first.figures}:
        values = [getattr(part, name) for part in parts]
        if name == "mean" or any(value is not values[0] for value in values):
            found[name] = _stacked([np.asarray(value) for value in values], counts)
    return first.changed(**found)


def _stacked(values: Sequence[Array], counts: Sequence[int]) -> Array:
    shapes = {value.shape[-3:] for value in values}
    found, at = np.empty((sum(counts), *np.broadcast_shapes(*shapes, (1, 1, 1)))), 0
    for value, count in zip(values, counts, strict=True):
        found[at : at + count] = value
        at += count
    return found
