"""Predicts the statistics of all captures from the ideal camera and a set of effects."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import takewhile
from typing import Final

import numpy as np

from radiometer.reconcile.measure.design import Array, Design
from radiometer.reconcile.measure.pattern_images import PatternImages
from radiometer.reconcile.measure.row_bands import TileBands
from radiometer.reconcile.model.chain_steps import (
    LIGHT_LINKS,
    link_of,
    rise_of,
    scaled,
    textured,
    tilt_of,
    with_shot_noise,
)
from radiometer.reconcile.model.tile_context import TileContext, scene_radiance, tile_context
from radiometer.units import photon_energy_j
from simulators.effects.catalogue import CatalogueEffect
from simulators.effects.context import Signal
from simulators.effects.full_well_saturation import FullWellSaturation
from simulators.effects.rounding import rounded, rounding_amplitude
from simulators.effects.tile_moments import TileMoments

# Stand in where capture.yaml says nothing; they are fitted then, and told as assumptions.
TYPICAL_E_PER_DN: Final = 2.5
TYPICAL_READ_NOISE_E: Final = 5.0
TYPICAL_QUANTUM_EFFICIENCY: Final = 0.5
TYPICAL_PITCH_UM: Final = 4.5
_SMALLEST_VARIANCE_DN2: Final = 1e-3  # a value that always rounds or clips to one code has none
_LAG: Final = "image_lag"
_COARSER: Final = "missing_codes"
_WELL_SHARE: Final = 0.6  # below it the well is never felt


@dataclass(frozen=True, slots=True, eq=False)
class Nuisance:
    """What is fitted beside the effects and never named.

    Attributes:
        log_responsivity: Natural logarithm of the responsivity over the declared one.
        log_radiance: The same of each patch's radiance, (patterns, tiles).
        log_gain: The same of the conversion gain K (fitted only where none is declared).
        log_read: The same of the read noise variance (fitted only where none is declared).
        black_dn: Black level in DN over the declared one (fitted only where none is declared).
        dark_e_per_s: Dark current over the declared one (fitted only where none is declared).
        slope: Rise of each tile's radiance from centre to edge, relative, (patterns, 2, tiles); unknown scenes only.
        texture: Relative variance of each tile's radiance within it, (tiles,); unknown scenes only.
    """

    log_responsivity: float
    log_radiance: Array
    slope: Array
    texture: Array
    log_gain: float = 0.0
    log_read: float = 0.0
    black_dn: float = 0.0
    dark_e_per_s: float = 0.0

    @classmethod
    def start(cls, design: Design) -> Nuisance:
        """Return nuisances that change nothing."""
        patterns, tiles = len(design.patterns), len(design.tiles)
        return cls(0.0, np.zeros((patterns, tiles)), np.zeros((patterns, 2, tiles)), np.zeros(tiles))


@dataclass(frozen=True, slots=True, eq=False)
class Prediction:
    """Expected statistics, named and shaped as in CaptureStatistics.

    Attributes:
        signal: (captures, tiles) light signal in electrons, for regressors.
        gain: (captures,) DN per electron.
        fixed: (captures, tiles) fixed-pattern part of `spatial` in DN².
        unrounded: Moments in DN before they are rounded to whole codes.
        band_variance: (captures, tiles) variance of light that goes as a wave along the rows, in DN².
        band_frequency: Periods of that wave per row.
        mixed_x: (captures, tiles) correlation of neighbours in a row that exchange charge, without what rows share.
        mixed_y: The same in a column.
        limit_variance: (captures, tiles) part of `fixed` in DN² that limits which differ from pixel to pixel leave.
    """

    mean: Array
    slope_x: Array
    slope_y: Array
    variance: Array
    spatial: Array
    neighbour_x: Array
    neighbour_y: Array
    first: Array
    common_variance: Array
    row_variance: Array
    fixed_column_variance: Array
    fixed_row_variance: Array
    edge: Array
    outliers: Array
    comb_step: float
    comb_kept: float
    signal: Array
    gain: Array
    fixed: Array
    unrounded: TileMoments
    band_variance: Array
    band_frequency: float
    mixed_x: Array
    mixed_y: Array
    limit_variance: Array

    @property
    def rounding(self) -> Array:
        """Return how far rounding to whole codes may move the mean, in DN, (captures, tiles)."""
        return _of_tiles(rounding_amplitude(self.unrounded), self.mean.shape)


@dataclass(frozen=True, slots=True, eq=False)
class TileModel:
    """The ideal camera of a capture header with effects added to it, evaluated on tiles.

    Attributes:
        design: Captures and tiles.
        context: The captures as the effects see them.
        radiance: (patterns, tiles) radiance in W·sr⁻¹·m⁻².
        images: Mean picture of each pattern.
        effects: Effects beside the ideal chain, to be fitted.
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
        radiance = scene_radiance(design, images)
        model = cls(design, tile_context(design, images), radiance, images)
        return replace(model, context=replace(model.context, previous_e=model._previous_signal(Nuisance.start(design))))

    def with_effects(self, effects: Sequence[CatalogueEffect]) -> TileModel:
        """Return the model with exactly these effects."""
        return replace(self, effects=tuple(effects))

    def predict(self, nuisance: Nuisance) -> Prediction:
        """Return the expected statistics."""
        return self.trace(nuisance).prediction

    def trace(self, nuisance: Nuisance) -> Trace:
        """Return the expected statistics with the moments between the links of the chain."""
        return self._run(nuisance, 0, (), None)

    def predict_again(self, trace: Trace, effects: Sequence[CatalogueEffect]) -> Prediction:
        """Return the statistics expected with other effects, from the first link on that differs.

        Args:
            trace: The chain as it ran with this model's effects.
            effects: The effects to have instead.
        """
        old, new = self.effects, tuple(effects)
        shared = sum(1 for _ in takewhile(lambda pair: pair[0] is pair[1], zip(old, new, strict=False)))
        links = [link_of(effect) for effect in (*old[shared:], *new[shared:])]
        if not links:
            return trace.prediction
        first = min(links)
        light = trace.light if first > LIGHT_LINKS else None
        return self.with_effects(new)._run(trace.nuisance, first, trace.between[: first + 1], light).prediction

    # ---- the chain, link by link ---------------------------------------------------------------------------

    def _run(
        self, nuisance: Nuisance, first: int, between: tuple[TileMoments, ...], light: TileMoments | None
    ) -> Trace:
        model = self._lagging(nuisance)
        gain = model._gain(nuisance)
        links = model._links(nuisance, gain)
        passed = list(between) or [model._scene(nuisance)]
        for number in range(first, len(links)):
            if number == LIGHT_LINKS:
                light = passed[-1]
            passed.append(links[number](passed[-1]))
        assert light is not None
        return Trace(nuisance, tuple(passed), light, model._summary(passed[-1], passed[-2], light, gain))

    def _scene(self, nuisance: Nuisance) -> TileMoments:
        scene = (self.radiance * np.exp(nuisance.log_radiance))[self.design.pattern_index]
        slopes = nuisance.slope[self.design.pattern_index]
        points = tilt_of(slopes[:, 0], slopes[:, 1]) if nuisance.slope.any() else 1.0
        return TileMoments.exactly(scene[:, :, None] * np.ones(4) * points * self.context.settings.source_level)

    def _links(self, nuisance: Nuisance, gain: Array) -> tuple[Callable[[TileMoments], TileMoments], ...]:
        """Return what happens to the light, in order; effects act in the links that `link_of` numbers."""
        settings = self.context.settings
        open_s = np.where(settings.is_dark, 0.0, settings.exposure_s)
        sensitivity = self._quantum_efficiency() * float(np.exp(nuisance.log_responsivity))
        return (
            lambda moments: self._apply(moments, 0),
            lambda moments: self._apply(scaled(moments, self._lens_factor()), 1),
            lambda moments: self._apply(scaled(moments, open_s), 2),
            lambda moments: scaled(self._apply(scaled(moments, self._photons_per_exposure()), 3), sensitivity),
            lambda moments: self._apply(textured(moments, nuisance.texture), 4),
            lambda moments: self._apply(self._with_dark_electrons(moments, nuisance), 5),
            lambda moments: self._full(self._apply(moments, 6)),
            lambda moments: self._apply(self._with_read_noise(moments, nuisance), 7),
            lambda moments: self._apply(scaled(moments, gain[:, None, None]), 8),
            lambda moments: self._apply(self._on_black(moments, nuisance), 9),
            lambda moments: self._apply(self._rounded(moments), 10),
        )

    def _full(self, moments: TileMoments) -> TileMoments:
        well = self.design.header.camera.full_well_e
        if well is None or self.passes_well or float(moments.mean.max()) < _WELL_SHARE * well:
            return moments
        full = FullWellSaturation(well).moments(moments, self.context)
        assert isinstance(full, TileMoments)
        return full

    def _with_read_noise(self, moments: TileMoments, nuisance: Nuisance) -> TileMoments:
        read = self.design.header.camera.read_noise_e
        read_e2 = (TYPICAL_READ_NOISE_E if read is None else read) ** 2 * float(np.exp(nuisance.log_read))
        return replace(moments, variance=moments.variance + read_e2)

    def _on_black(self, moments: TileMoments, nuisance: Nuisance) -> TileMoments:
        black = np.nan_to_num(self.context.settings.black_level_dn) + nuisance.black_dn  # type: ignore[arg-type]
        return replace(moments, mean=moments.mean + black)

    def _rounded(self, moments: TileMoments) -> TileMoments:
        if any(effect.name == _COARSER for effect in (*self.given, *self.effects)):  # it rounds by itself
            return replace(moments, variance=moments.variance + 1.0 / 12.0)
        return rounded(moments)

    def _apply(self, moments: TileMoments, link: int) -> TileMoments:
        for effect in (*self.given, *self.effects):
            if link_of(effect) == link:
                after = effect.moments(moments, self.context)
                assert isinstance(after, TileMoments)
                moments = after
        return moments

    # ---- figures of the declared camera --------------------------------------------------------------------

    def _lens_factor(self) -> Array:
        lens = self.design.header.lens
        tau = 1.0 if lens.transmittance is None else lens.transmittance
        closeness = 1.0 + lens.magnification / lens.pupil_magnification
        factor = np.pi * tau / (4.0 * (self.design.f_number * closeness) ** 2)
        if lens.vignetting != "cos4":
            return np.asarray(factor[:, None, None])
        tangent = self.context.geometry.radius_um() / (1000.0 * (lens.focal_length_mm or 16.0))
        return np.asarray(factor[:, None, None] / (1.0 + tangent**2) ** 2)

    def _photons_per_exposure(self) -> float:
        pitch_um = self.design.header.camera.pixel_pitch_um or TYPICAL_PITCH_UM
        return (pitch_um * 1e-6) ** 2 / photon_energy_j(self.context.wavelength_nm)

    def _quantum_efficiency(self) -> float:
        return self.design.header.camera.quantum_efficiency or TYPICAL_QUANTUM_EFFICIENCY

    def _gain(self, nuisance: Nuisance) -> Array:
        e_per_dn = self.design.header.camera.conversion_gain_e_per_dn or TYPICAL_E_PER_DN
        return np.asarray(10.0 ** (self.design.gain_db / 20.0) / e_per_dn * np.exp(nuisance.log_gain))

    def _with_dark_electrons(self, moments: TileMoments, nuisance: Nuisance) -> TileMoments:
        after = with_shot_noise(moments, self._dark_e(nuisance, self.design.temperature_c))
        ends = [self._dark_e(nuisance, warm) for _, warm in (self.design.first_frames, self.design.later_frames)]
        return replace(after, first_excess=after.first_excess + (ends[0] - ends[1])) if ends[0].any() else after

    def _dark_e(self, nuisance: Nuisance, temperature_c: Array) -> Array:
        camera = self.design.header.camera
        reference = 25.0 if camera.dark_current_reference_C is None else camera.dark_current_reference_C
        warmer = np.nan_to_num(temperature_c - reference)
        rate = (camera.dark_current_e_per_s or 0.0) + nuisance.dark_e_per_s
        per_second = rate * 2.0 ** (warmer / (camera.dark_current_doubling_K or 7.0))
        return np.asarray((per_second * self.design.exposure_s)[:, None, None])

    def _lagging(self, nuisance: Nuisance) -> TileModel:
        """Return the model whose previous frames hold what all its effects and nuisances make of their light."""
        if not any(effect.name == _LAG for effect in (*self.given, *self.effects)):
            return self
        effects, given = (tuple(e for e in some if e.name != _LAG) for some in (self.effects, self.given))
        previous = replace(self, effects=effects, given=given)._previous_signal(nuisance)
        return replace(self, context=replace(self.context, previous_e=previous))

    def _previous_signal(self, nuisance: Nuisance) -> Array:
        """Return the light that the frame before each capture held, in electrons, (captures, tiles, 1)."""
        signal = self.trace(nuisance).light.mean.mean(axis=2)
        order = np.argsort([capture.frames[0] for capture in self.design.captures])
        before = np.zeros_like(signal)
        before[order[1:]] = signal[order[:-1]]
        return np.asarray(before[:, :, None])

    # ---- from moments at points to statistics of tiles -----------------------------------------------------

    def _summary(self, final: TileMoments, unrounded: TileMoments, light: TileMoments, gain: Array) -> Prediction:
        shape = light.mean.shape

        def tiles(values: Signal) -> Array:
            return _of_tiles(values, shape[:2])

        def captures(values: Signal) -> Array:
            return np.asarray(np.broadcast_to(values, (shape[0], 1, 1))[:, 0, 0], dtype=np.float64)

        mean, variance = tiles(final.mean), tiles(final.variance)
        if not self.design.uniform:  # a scene's noise is that of the later frames, without the first one's own light
            n = self.design.frame_count[:, None]
            variance = variance - np.where(n > 2, gain[:, None] * tiles(final.first_excess) / n, 0.0)
        lines = tiles(final.row_variance)
        columns, rows = tiles(final.fixed_column_variance), tiles(final.fixed_row_variance)
        # A frame's mean is taken out of each tile, and with it what its rows have in common.
        shared = np.broadcast_to(np.asarray(self.context.tile_height, dtype=np.float64)[..., 0], shape[:2])
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
            row_variance=lines.mean(axis=1),
            fixed_column_variance=columns.mean(axis=1),
            fixed_row_variance=rows.mean(axis=1),
            edge=captures(final.edge_share),
            outliers=captures(final.outliers),
            comb_step=final.comb_step,
            comb_kept=final.comb_kept,
            signal=tiles(light.mean),
            gain=gain,
            fixed=fixed,
            unrounded=unrounded,
            band_variance=band,
            band_frequency=final.band_frequency,
            mixed_x=tiles(final.neighbour_x) / safe,
            mixed_y=tiles(final.neighbour_y) / safe,
            limit_variance=tiles(np.broadcast_to(final.limit_variance, final.mean.shape)),
        )


@dataclass(frozen=True, slots=True, eq=False)
class Trace:
    """The chain as it ran once.

    Attributes:
        nuisance: The nuisances.
        between: Moments before the first link, between the links, and behind the last.
        light: Light per pixel in electrons before anything electronic happens to it.
        prediction: The expected statistics.
    """

    nuisance: Nuisance
    between: tuple[TileMoments, ...]
    light: TileMoments
    prediction: Prediction


def _of_tiles(values: Signal, shape: tuple[int, ...]) -> Array:
    """Return the mean over the points of each tile, of this shape."""
    values = np.asarray(values, dtype=np.float64)
    if values.shape[-1] == 1:
        return np.broadcast_to(values[..., 0], shape)
    return np.asarray(0.25 * (values[..., 0] + values[..., 1] + values[..., 2] + values[..., 3]))
