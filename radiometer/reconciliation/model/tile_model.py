"""Predicts the statistics of all captures: the simulator's chain of effects, walked with the moments of tiles."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import takewhile
from typing import Any, Final

import numpy as np

from radiometer.reconciliation.measure.design import Design
from radiometer.reconciliation.measure.pattern_images import PatternImages
from radiometer.reconciliation.measure.row_bands import TileBands
from radiometer.reconciliation.model.tile_context import TileContext, rise_of, scene_radiance, tile_context, tilt_of
from radiometer.reconciliation.prediction import Prediction, of_tiles
from radiometer.typing import Array
from simulators.chain.stages import in_order, place_for
from simulators.chain.undeclared import Undeclared, undeclared_chain
from simulators.effects.base import DIGITAL_NUMBER, ELECTRONS, Effect
from simulators.effects.catalogue import CatalogueEffect
from simulators.effects.context import Signal
from simulators.effects.tile_moments import TileMoments

_SMALLEST_VARIANCE_DN2: Final = 1e-3  # a value that always rounds or clips to one code has none


@dataclass(frozen=True, slots=True, eq=False)
class Nuisance:
    """Parameters that are fitted with the effects and never named.

    Attributes:
        off: What the camera's description leaves out.
        log_radiance: Natural logarithm of each patch's radiance over the stated one, (patterns, tiles).
        slope: Rise of each tile's radiance from centre to edge, relative, (patterns, 2, tiles); unknown scenes only.
    """

    off: Undeclared
    log_radiance: Array
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
    """The ideal camera of a capture header with effects added to it, evaluated on tiles.

    Attributes:
        design: Captures and tiles.
        context: The captures as the effects see them.
        radiance: (patterns, tiles) radiance in W·sr⁻¹·m⁻².
        images: Mean picture of each pattern.
        effects: Effects added to the ideal chain, to be fitted.
        given: Effects that the starting model holds already.
        passes_well: Whether the data pass the declared full well, which then limits nothing.
    """

    design: Design
    context: TileContext
    radiance: Array
    images: PatternImages
    effects: tuple[CatalogueEffect, ...] = ()
    given: tuple[CatalogueEffect, ...] = ()
    passes_well: bool = False

    @classmethod
    def of(cls, design: Design, images: PatternImages) -> TileModel:
        """Return the ideal camera."""
        model = cls(design, tile_context(design, images), scene_radiance(design, images), images)
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
            nuisance: The nuisances.
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
        """Return all steps in the order of the light: what acts in front of each link, by its stage, and the link."""
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
        model, passed = self._looking_back(walk.nuisance) if any(map(looks_back, ahead)) else self, [*walk.passed]
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
        slopes = nuisance.slope[self.design.pattern_index]
        points = tilt_of(slopes[:, 0], slopes[:, 1]) if nuisance.slope.any() else 1.0
        return TileMoments.exactly(scene[:, :, None] * np.ones(4) * points)

    def signal(self, walk: Walk) -> Array:
        """Return the light signal of a walk in electrons, (captures, tiles)."""
        light = walk.in_front(1 + first_of(walk.links, ELECTRONS)).mean
        return of_tiles(light, light.shape[:-1])

    def gain(self, walk: Walk) -> Array:
        """Return DN per electron of a walk, (captures,)."""
        place = first_of(walk.links, DIGITAL_NUMBER)
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
            final: Moments behind the chain.
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

        mean, variance = tiles(final.mean), tiles(final.variance)
        if not self.design.uniform:  # a scene's noise is that of the later frames, without the first one's own light
            n = self.design.frame_count[:, None]
            variance = variance - np.where(n > 2, gain[..., None] * tiles(final.first_excess) / n, 0.0)
        lines = tiles(final.row_variance)
        columns, rows = tiles(final.fixed_column_variance), tiles(final.fixed_row_variance)
        # A frame's mean is taken out of each tile, and with it what its rows have in common.
        shared = np.broadcast_to(np.asarray(self.context.tile_height, dtype=np.float64)[..., 0], shape)
        within = lines * (1.0 - 1.0 / shared)
        band, left = tiles(final.band_variance), TileBands.of(self.design, final.band_frequency)
        total = np.maximum(variance + within + band * left.within, _SMALLEST_VARIANCE_DN2)
        white = np.maximum(variance + lines * self.design.rough_rows + band * left.rough, _SMALLEST_VARIANCE_DN2)
        fixed = tiles(final.spatial_variance)
        spatial = (
            white / self.design.frame_count[:, None]
            + fixed
            + columns * self.design.rough_columns
            + rows * self.design.rough_rows
        )
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
            row_variance=lines.mean(axis=-1),
            fixed_column_variance=columns.mean(axis=-1),
            fixed_row_variance=rows.mean(axis=-1),
            edge=captures(final.edge_share),
            outliers=captures(final.outliers),
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
        )


@dataclass(frozen=True, eq=False)
class Walk:
    """The chain as far as it was walked.

    Attributes:
        nuisance: The nuisances.
        taken: Factor by which effects lower the responsivity.
        links: The links of the declared camera.
        chain: These and the effects, in the order of the light.
        passed: Moments in front of each step that was reached; behind the last one too where all were taken.
    """

    nuisance: Nuisance
    taken: float
    links: tuple[Effect, ...]
    chain: tuple[Effect, ...]
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
    """The chain as it ran once.

    Attributes:
        prediction: The expected statistics.
    """

    prediction: Prediction


def looks_back(step: Effect) -> bool:
    """Return whether a step of the chain asks for what earlier frames held."""
    return isinstance(step, CatalogueEffect) and step.looks_back


@lru_cache(maxsize=4096)
def _ordered(kinds: tuple[type[Effect], ...], links: int) -> tuple[int, ...]:
    """Return the numbers of steps in the order of the light.

    Args:
        kinds: Kinds of the links and, behind them, of the effects.
        links: How many links there are.
    """
    beside: dict[int, list[int]] = defaultdict(list)
    for number in sorted(range(links, len(kinds)), key=lambda number: in_order(kinds[number])):
        beside[place_for(kinds[number], kinds[:links])].append(number)
    numbers = range(links)
    return tuple(step for place in range(links + 1) for step in (*beside[place], *numbers[place : place + 1]))


def _as_known(link: Effect, known: Effect | None) -> Effect:
    """Return the known link of its kind where it is as that one, else the link."""
    if known is None:
        return link
    pairs = ((getattr(link, name), getattr(known, name)) for name in link.values())
    return known if all(a is b or (type(a) is type(b) is not np.ndarray and a == b) for a, b in pairs) else link


def first_of(links: Sequence[Effect], unit: str) -> int:
    """Return the position of the link that first gives a unit."""
    return next(place for place, link in enumerate(links) if link.unit_out == unit)
