"""Predicts the statistics of all captures from the ideal camera and a set of effects."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from radiometer.reconcile.design import Array, Design
from radiometer.reconcile.pattern_images import PatternImages
from radiometer.reconcile.tile_context import GAUSS_POINT, TileContext, scene_radiance, tile_context
from radiometer.units import photon_energy_j
from simulators.effects.base import DIGITAL_NUMBER, ELECTRONS, Stage
from simulators.effects.catalogue import CatalogueEffect
from simulators.effects.context import Signal
from simulators.effects.full_well_saturation import FullWellSaturation
from simulators.effects.tile_moments import TileMoments

# Stand in where capture.yaml says nothing; they are fitted then, and told as assumptions.
TYPICAL_E_PER_DN: Final = 2.5
TYPICAL_READ_NOISE_E: Final = 5.0
TYPICAL_QUANTUM_EFFICIENCY: Final = 0.5
TYPICAL_PITCH_UM: Final = 4.5
_SMALLEST_VARIANCE_DN2: Final = 1e-3  # a value that always rounds or clips to one code has none
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
    signal: Array
    gain: Array
    fixed: Array


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
    """

    design: Design
    context: TileContext
    radiance: Array
    images: PatternImages
    effects: tuple[CatalogueEffect, ...] = ()
    given: tuple[CatalogueEffect, ...] = ()

    @classmethod
    def of(cls, design: Design, images: PatternImages) -> TileModel:
        """Return the ideal camera."""
        radiance = scene_radiance(design, images)
        model = cls(design, tile_context(design, images), radiance, images)
        return replace(model, context=replace(model.context, previous_e=model._previous_signal()))

    def with_effects(self, effects: Sequence[CatalogueEffect]) -> TileModel:
        """Return the model with exactly these effects."""
        return replace(self, effects=tuple(effects))

    def predict(self, nuisance: Nuisance) -> Prediction:
        """Return the expected statistics."""
        gain = self._gain(nuisance)
        light = self._light(nuisance)
        electrons = self._lagging(nuisance)._electrons(light, nuisance)
        final = self._read_out(electrons, gain, nuisance)
        return self._summary(final, light, gain)

    # ---- the chain, stage by stage -------------------------------------------------------------------------

    def _light(self, nuisance: Nuisance) -> TileMoments:
        """Return light per pixel in electrons before anything electronic happens to it."""
        settings = self.context.settings
        scene = (self.radiance * np.exp(nuisance.log_radiance))[self.design.pattern_index]
        slopes = nuisance.slope[self.design.pattern_index]
        points = _tilt(slopes[:, 0], slopes[:, 1]) if nuisance.slope.any() else 1.0
        signal = scene[:, :, None] * np.ones(4) * points * settings.source_level
        moments = TileMoments.exactly(signal)
        moments = self._apply(moments, Stage.SOURCE, Stage.SCENE)
        moments = _scaled(moments, self._lens_factor())
        moments = self._apply(moments, Stage.OPTICS)
        moments = _scaled(moments, np.where(settings.is_dark, 0.0, settings.exposure_s))
        moments = self._apply(moments, Stage.SHUTTER)
        moments = _scaled(moments, self._photons_per_exposure())
        moments = self._apply(moments, Stage.PHOTONS)
        return _scaled(moments, self._quantum_efficiency() * float(np.exp(nuisance.log_responsivity)))

    def _electrons(self, light: TileMoments, nuisance: Nuisance) -> TileMoments:
        textured = light
        if nuisance.texture.any():
            texture = np.maximum(nuisance.texture, 0.0)[None, :, None]
            textured = replace(light, spatial_variance=light.spatial_variance + texture * light.mean**2)
        moments = self._apply(textured, Stage.ELECTRONS, before_shot=True)
        dark = self._dark_e(nuisance)
        moments = replace(moments, mean=moments.mean + dark)
        moments = replace(moments, variance=moments.variance + np.maximum(moments.mean, 0.0))
        moments = self._apply(moments, Stage.ELECTRONS, before_shot=False)
        moments = self._apply(moments, Stage.WELL)
        well = self.design.header.camera.full_well_e
        if well is None or float(moments.mean.max()) < _WELL_SHARE * well:
            return moments
        full = FullWellSaturation(well).moments(moments, self.context)
        assert isinstance(full, TileMoments)
        return full

    def _read_out(self, electrons: TileMoments, gain: Array, nuisance: Nuisance) -> TileMoments:
        read = self.design.header.camera.read_noise_e
        read_e2 = (TYPICAL_READ_NOISE_E if read is None else read) ** 2 * float(np.exp(nuisance.log_read))
        moments = replace(electrons, variance=electrons.variance + read_e2)
        moments = self._apply(moments, Stage.READOUT, unit=ELECTRONS)
        moments = _scaled(moments, gain[:, None, None])
        moments = self._apply(moments, Stage.READOUT, unit=DIGITAL_NUMBER)
        black = np.nan_to_num(self.context.settings.black_level_dn) + nuisance.black_dn  # type: ignore[arg-type]
        moments = replace(moments, mean=moments.mean + black)
        moments = self._apply(moments, Stage.DIGITAL, before="quantisation")
        moments = replace(moments, variance=moments.variance + 1.0 / 12.0)
        return self._apply(moments, Stage.DIGITAL, before=None)

    def _apply(
        self,
        moments: TileMoments,
        *stages: Stage,
        unit: str | None = None,
        before_shot: bool | None = None,
        before: str | bool | None = False,
    ) -> TileMoments:
        for effect in (*self.given, *self.effects):
            if effect.stage not in stages or (unit is not None and effect.unit_in != unit):
                continue
            if before_shot is not None and (effect.before in ("shot_noise", "dark_current")) != before_shot:
                continue
            if before is not False and effect.before != before:
                continue
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

    def _dark_e(self, nuisance: Nuisance) -> Array:
        camera = self.design.header.camera
        reference = 25.0 if camera.dark_current_reference_C is None else camera.dark_current_reference_C
        warmer = np.nan_to_num(self.design.temperature_c - reference)
        rate = (camera.dark_current_e_per_s or 0.0) + nuisance.dark_e_per_s
        per_second = rate * 2.0 ** (warmer / (camera.dark_current_doubling_K or 7.0))
        return np.asarray((per_second * self.design.exposure_s)[:, None, None])

    def _lagging(self, nuisance: Nuisance) -> TileModel:
        """Return the model whose previous frames hold what the fitted responsivity makes of their light."""
        if not any(effect.name == "image_lag" for effect in (*self.given, *self.effects)):
            return self
        previous = np.asarray(self.context.previous_e) * float(np.exp(nuisance.log_responsivity))
        return replace(self, context=replace(self.context, previous_e=previous))

    def _previous_signal(self) -> Array:
        """Return the light that the frame before each capture held, in electrons, (captures, tiles, 1)."""
        signal = self._light(Nuisance.start(self.design)).mean.mean(axis=2)
        order = np.argsort([capture.frames[0] for capture in self.design.captures])
        before = np.zeros_like(signal)
        before[order[1:]] = signal[order[:-1]]
        return np.asarray(before[:, :, None])

    # ---- from moments at points to statistics of tiles -----------------------------------------------------

    def _summary(self, final: TileMoments, light: TileMoments, gain: Array) -> Prediction:
        shape = light.mean.shape

        def tiles(values: Signal) -> Array:
            return np.asarray(np.broadcast_to(values, shape).mean(axis=2), dtype=np.float64)

        def captures(values: Signal) -> Array:
            return np.asarray(np.broadcast_to(values, (shape[0], 1, 1))[:, 0, 0], dtype=np.float64)

        mean, variance = tiles(final.mean), tiles(final.variance)
        lines = tiles(final.row_variance)
        columns, rows = tiles(final.fixed_column_variance), tiles(final.fixed_row_variance)
        total = np.maximum(variance + lines, _SMALLEST_VARIANCE_DN2)
        fixed = tiles(final.spatial_variance) + columns + rows
        rise_x, rise_y = _rise(final.mean)
        safe = np.maximum(total, 1e-30)
        return Prediction(
            mean=mean,
            slope_x=rise_x,
            slope_y=rise_y,
            variance=total,
            spatial=total / self.design.frame_count[:, None] + fixed,
            neighbour_x=(tiles(final.neighbour_x) + lines) / safe,
            neighbour_y=tiles(final.neighbour_y) / safe,
            first=tiles(final.first_excess),
            common_variance=tiles(final.common_variance),
            row_variance=lines.mean(axis=1),
            fixed_column_variance=columns.mean(axis=1),
            fixed_row_variance=rows.mean(axis=1),
            edge=captures(final.edge_share),
            outliers=captures(final.outliers),
            comb_step=final.comb_step,
            signal=tiles(light.mean),
            gain=gain,
            fixed=fixed,
        )


def _scaled(moments: TileMoments, factor: Array | float) -> TileMoments:
    square = np.square(factor)
    return replace(
        moments,
        mean=moments.mean * factor,
        variance=moments.variance * square,
        spatial_variance=moments.spatial_variance * square,
        common_variance=moments.common_variance * square,
        row_variance=moments.row_variance * square,
        fixed_column_variance=moments.fixed_column_variance * square,
        fixed_row_variance=moments.fixed_row_variance * square,
        neighbour_x=moments.neighbour_x * square,
        neighbour_y=moments.neighbour_y * square,
        first_excess=moments.first_excess * factor,
    )


def _tilt(rise_x: Array, rise_y: Array) -> Array:
    """Return the factor at the four points of tiles whose relative rise from centre to edge is given."""
    signs_x, signs_y = np.array([-1.0, 1.0, -1.0, 1.0]), np.array([-1.0, -1.0, 1.0, 1.0])
    tilt = rise_x[:, :, None] * signs_x + rise_y[:, :, None] * signs_y
    return np.asarray(1.0 + GAUSS_POINT * tilt)


def _rise(points: Signal) -> tuple[Array, Array]:
    """Return the rise from centre to right and to bottom edge from values at the four points."""
    per_edge = 0.25 / GAUSS_POINT
    x = (points[..., 1] + points[..., 3] - points[..., 0] - points[..., 2]) * per_edge
    y = (points[..., 2] + points[..., 3] - points[..., 0] - points[..., 1]) * per_edge
    return np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64)
