"""The interface by which `radiometer reconcile` looks for an effect: where it shows and how large it may be.

All methods of a catalogue effect take settings and signals that broadcast (scalars for one frame, arrays of captures
× tiles × points for a fit). So none of them may branch on a value; use `numpy.where`.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, ClassVar, Final, Literal, Self, cast

import numpy as np
from scipy.special import ndtri

from radiometer.data import CameraDescription
from simulators.effects.base import ELECTRONS, KINDS_KEPT, PRIOR, Effect, KeepsMean, Stage, UnitSlope, parameter
from simulators.effects.context import ExposureContext, Signal
from simulators.effects.tile_moments import TileMoments

# Where the description of the dark current says neither, as in the ideal chain.
_DARK_REFERENCE_C: Final = 25.0
_DARK_DOUBLING_K: Final = 7.0  # silicon: 6 to 8 K
_VARYING_RATIO: Final = 2.0  # of the longest dark exposure to the shortest
_COMPARABLE_K: Final = 10.0  # one doubling to two of a dark current in silicon
_WANDER_K: Final = 2.0  # engineering prior: what an uncooled sensor wanders by within a session
_PIXELS: Final = ndtri((np.arange(64) + 0.5) / 64.0)
_NORMAL: Final = _PIXELS / _PIXELS.std()  # what pixels scatter by, in standard deviations


@dataclass(frozen=True)
class CatalogueEffect(Effect):
    """An effect that reconcile tries.

    Attributes:
        where: Covariate along which it shows, by its name in result files: exposure_s, gain_db, f_number,
            temperature_C, source_level, timestamp_s, signal, patch_level, field_radius, image_x, image_y, screen_x or
            previous_frame.
        block: Statistic that must improve when the effect is there: mean, slope, variance, spatial, neighbour,
            first, common, bands, row_temporal, columns, rows, edge, outliers, unsteady or comb.
        also: Further statistics that count as its evidence.
        trials: Sets of parameters from which the search starts, the likeliest first.
        fitted: Parameters that are fitted; the others keep their trial's value.
        further: Sets of further parameters, with the values from which a more flexible form starts.
        bends: Parameters that are fitted as well where any of them differs from its default; by default those of
            `further`.
        varies: Setting that must differ between captures: `f_number`, `gain_db` or `temperature_C`.
        settles: The capture that separates the effect from its likenesses, as advice to the user.
        essential: Parameters without which it is not this effect, however well the others fit.
        profiled: Parameter that is searched on a dense grid, for the prediction jumps in it.
        repeats: Whether it may act more than once, as several wrong labels do; `joined` makes one effect of two.
        proportional: Whether a fixed pattern grows with the light.
        log_prior_odds: Natural logarithm of how likely the effect is before any data, against a usual one; added to
            its score.
        prior_reason: Why they are not even.
        acts_by_square: Whether its first parameter is a standard deviation, whose square is what shows.
        is_stepwise: Whether it does not grow from nothing with its first parameter; its limit is a form that shows.
        saturates: `sharply` or `softly` for what limits the signal: the higher the limit the milder. Below a sharp one
            nothing bends.
        law_along: Covariates along which the data may follow another law than its equation; by default `where`.
        neutral_at_one: Parameters that do nothing at 1, as others do at 0.
        looks_back: Whether it acts by what the frame before held (`context.previous_e`).
        is_steep: Whether it may change within a tile as no quadratic surface does: a step, a narrow spot or wave.
        signal_power: Power of the signal with which a steep effect goes, where that is all: 0 for what is added, 1 for
            a factor. The result for one signal on the grid in each tile then holds for all.
        is_sudden: Whether it jumps along the signal: each pixel's noise decides on which side of the jump it is.
        heated: Parameter that doubles within `doubling_K` and is stated at `reference_C`; a search states it at the
            temperature of the session that is nearest to the usual.
    """

    where: ClassVar[str]
    block: ClassVar[str] = "mean"
    also: ClassVar[tuple[str, ...]] = ()
    trials: ClassVar[tuple[Mapping[str, float], ...]]
    fitted: ClassVar[tuple[str, ...]]
    further: ClassVar[tuple[Mapping[str, float], ...]] = ()
    bends: ClassVar[tuple[str, ...]] = ()
    varies: ClassVar[str] = ""
    settles: ClassVar[str] = ""
    essential: ClassVar[tuple[str, ...]] = ()
    profiled: ClassVar[str] = ""
    repeats: ClassVar[bool] = False
    proportional: ClassVar[bool] = False
    log_prior_odds: ClassVar[float] = 0.0
    prior_reason: ClassVar[str] = ""
    acts_by_square: ClassVar[bool] = False
    is_stepwise: ClassVar[bool] = False
    saturates: ClassVar[Literal["", "softly", "sharply"]] = ""
    law_along: ClassVar[tuple[str, ...]] = ()
    neutral_at_one: ClassVar[tuple[str, ...]] = ()
    looks_back: ClassVar[bool] = False
    is_steep: ClassVar[bool] = False
    is_sudden: ClassVar[bool] = False
    signal_power: ClassVar[int | None] = None
    heated: ClassVar[str] = ""

    @classmethod
    def starts(cls, context: ExposureContext) -> tuple[Self, ...]:
        """Return the effects from which a search begins; by default those of `trials`."""
        found = cast(tuple[Self, ...], _of_trials(cls))
        return tuple(start.restated(context) for start in found) if cls.heated else found

    def restated(self, context: ExposureContext) -> Self:
        """Return the same leak, stated at the temperature of the session that is nearest to its own."""
        known = self.values()
        there_c = nearest_temperature_c(context, known["reference_C"])
        size = known[self.heated] * 2.0 ** ((there_c - known["reference_C"]) / known["doubling_K"])
        bounds = next(entry for entry in self.parameters() if entry.name == self.heated)
        return self.with_parameters(
            **{self.heated: float(np.clip(size, bounds.low, bounds.high)), "reference_C": there_c}
        )

    def warmed(self, context: ExposureContext) -> Any:
        """Return by what factor a leak that is `heated` is larger than at the temperature that it is stated at."""
        known: Any = self
        return 2.0 ** (warmer_k(context, known.reference_C) / known.doubling_K)

    def resized(self, factor: float, about: float = 0.0) -> Self:
        """Return the effect with its first fitted parameter's distance from a value times a factor, within bounds."""
        name = self.free()[0]
        known = next(entry for entry in self.parameters() if entry.name == name)
        size = about + factor * (float(getattr(self, name)) - about)
        return self.with_parameters(**{name: min(max(size, known.low), known.high)})

    def reach(self, parameter: str, full_scale_dn: float) -> tuple[float, float]:
        """Return the bounds between which a parameter is fitted.

        Args:
            parameter: Its name; of a table, that of the table.
            full_scale_dn: Full scale of the camera, in which bounds in digital numbers are stated.
        """
        return next(entry for entry in self.parameters() if entry.name == parameter).bounds(full_scale_dn)

    @classmethod
    def covers(cls, context: ExposureContext) -> tuple[Self, ...]:
        """Return flexible forms of the effect that cover other equations of it; none by default.

        Examples are a table over the gains in use, or a second exponential. They keep the name of the effect. The plain
        form is preferred unless the flexible one predicts held-out settings better by 5 nats more than its parameters
        cost.
        """
        return ()

    @classmethod
    def neutral(cls, parameter: str) -> float:
        """Return the value at which a parameter does nothing."""
        return 1.0 if parameter in cls.neutral_at_one else 0.0

    def is_nothing(self) -> bool:
        """Return whether an essential parameter that is fitted does nothing: what the others do is no such effect."""
        return any(getattr(self, name) == self.neutral(name) for name in self.essential if name in self.free())

    def remark(self, camera: CameraDescription, u: Mapping[str, float | None]) -> str:
        """Return what a finding says against a figure that the camera's description states; nothing by default.

        Args:
            u: Standard uncertainty of each parameter that was fitted.
        """
        return ""

    def between(self) -> tuple[Self, ...]:
        """Return this start and those between it and the next, looked at where there are many; by default itself."""
        return (self,)

    def nearby(self, rows: int, turn: int) -> tuple[Self, ...]:
        """Return starts in finer steps about this one, tried where the statistic that it shows in resolves them.

        Args:
            turn: Parameters may be refined in turns; 0 or 1.
        """
        return ()

    def keeps_only_every(self, period: int) -> bool:
        """Tell whether only every so many-th code is left: where others were seen it cannot be there."""
        return False

    def responsivity_taken(self) -> float:
        """Return the factor on the mean signal that the fitted responsivity has taken up already."""
        return 1.0

    def loosened(self, context: ExposureContext) -> tuple[Self, ...]:
        """Return more flexible forms that start from this one, tried where structure remains.

        They must bring 8 nats beyond 3 for each further parameter. Extra parameters default to the plain form, so that
        older model files load unchanged.

        By default those of `further`, or else the covers that have more free parameters, with this one's values where
        they share them: a parameter that was fitted and is then fixed would cost nothing.
        """
        if self.further:
            is_plain = self.free() == self.fitted
            return tuple(self.with_parameters(**form) for form in self.further) if is_plain else ()
        more = (cover for cover in self.covers(context) if len(cover.free()) > len(self.free()))
        shared = ((cover, (name for name in self.free() if "[" not in name and name in cover.free())) for cover in more)
        return tuple(cover.with_parameters(**{name: getattr(self, name) for name in names}) for cover, names in shared)

    def free(self) -> tuple[str, ...]:
        """Return the parameters to fit; `name[2]` is the third entry of a table."""
        bends = self.bends or (tuple(self.further[0]) if self.further else ())
        is_bent = any(known.name in bends and getattr(self, known.name) != known.default for known in self.parameters())
        return (*self.fitted, *bends) if is_bent else self.fitted

    def joined(self, other: CatalogueEffect) -> CatalogueEffect:
        """Return one effect that does what this and another of its kind do.

        Raises:
            NotImplementedError: If the effect does not repeat.
        """
        raise NotImplementedError(f"{self.name} does not repeat")

    def pattern_e(self, context: ExposureContext) -> Any:
        """Return the standard deviation in electrons of a fixed pattern whose growth depends on separate settings.

        None for patterns that are the same in all frames or scale with the light.
        """
        return None

    def excess_kurtosis(self) -> float:
        """Return the excess kurtosis of a fixed pattern's values; 0 for normal ones."""
        return 0.0

    @property
    def grows(self) -> bool:
        """Tell whether it grows from nothing with its first parameter: a limit of the signal and a step do not."""
        return not (self.is_stepwise or self.saturates)

    @property
    def drifts(self) -> bool:
        return self.where in ("timestamp_s", "temperature_C")

    def tile(self, after: TileMoments, before: TileMoments, context: ExposureContext) -> TileMoments:
        """Return the moments with what a steep effect does between a tile's points, a sudden one within its noise."""
        if self.is_sudden:
            pixels = before.mean[..., None] + np.sqrt(np.maximum(before.variance, 0.0))[..., None] * _NORMAL
            there = self.mean(pixels.reshape(*pixels.shape[:-2], -1), context).reshape(pixels.shape)
            return before.passed(there.mean(axis=-1), 1.0).changed(variance=there.var(axis=-1))
        if not self.is_steep:
            return after
        signal: Any = before.mean.mean(axis=-1, keepdims=True)
        scale: Any = 1.0
        if self.signal_power is not None:  # one signal represents all, and the grid is that of one capture, mostly
            signal, scale = np.full((1, 1, 1), float(self.signal_power)), signal**self.signal_power
        points, left = context.within_tiles(lambda at: self.mean(signal, at) - signal)
        more = scale * (points - (self.mean(signal, context) - signal))
        varying = scale**2 * left
        return after.changed(mean=after.mean + more, spatial_variance=after.spatial_variance + varying)

    @classmethod
    def usable(cls, context: ExposureContext) -> bool:
        """Tell whether the data hold what the effect needs at all; by default the setting that must vary."""
        return not cls.varies or setting_varies(context, cls.varies)


@lru_cache(maxsize=KINDS_KEPT)
def _of_trials(kind: type[CatalogueEffect]) -> tuple[CatalogueEffect, ...]:
    return tuple(kind(**trial) for trial in kind.trials)


class Scaling(CatalogueEffect):
    """An effect that multiplies the signal by a factor that does not depend on it."""

    @abstractmethod
    def factor(self, context: ExposureContext) -> Signal | float:
        """Return the factor."""

    def mean(self, signal: Signal, context: ExposureContext) -> Signal:
        return cast(Signal, (signal * self.factor(context)).astype(signal.dtype))

    def slope(self, signal: Signal, context: ExposureContext) -> Signal | float:
        return self.factor(context)


class Offset(UnitSlope, CatalogueEffect):
    """An effect that adds something that does not depend on the signal."""

    @abstractmethod
    def offset(self, context: ExposureContext) -> Signal | float:
        """Return what is added, in `unit_out`."""

    def mean(self, signal: Signal, context: ExposureContext) -> Signal:
        return cast(Signal, (signal + self.offset(context)).astype(signal.dtype))


@dataclass(frozen=True)
class FixedOffsets(KeepsMean, CatalogueEffect):
    """An effect that adds fixed offsets, normal with standard deviation s, to pixels, or to whole rows or columns."""

    stage = Stage.READOUT
    unit_in = unit_out = ELECTRONS
    acts_by_square = True
    trials = ({"sigma_e": 0.3}, {"sigma_e": 1.0})
    fitted = ("sigma_e",)
    settles = "an average of many dark frames"
    lines: ClassVar[Literal["", "row", "column"]] = ""
    sigma_e: float = parameter(0.0, "e-", 0.0, 1000.0, source=PRIOR)

    def sample(self, signal: Signal, context: ExposureContext, rng: np.random.Generator) -> Signal:
        rows, columns = signal.shape
        shape = {"": (rows, columns), "row": (rows, 1), "column": (1, columns)}[self.lines]
        pattern = context.fixed_rng(self.name).standard_normal(shape, dtype=np.float32)
        return cast(Signal, signal + self.sigma_e * pattern)

    def spatial_variance(self, signal: Signal, context: ExposureContext) -> float:
        """Return s² in e-² for a lone pixel."""
        return self.sigma_e**2

    def tile(self, after: TileMoments, before: TileMoments, context: ExposureContext) -> TileMoments:
        """Return the moments with a pattern of lines booked as one."""
        if not self.lines:
            return after
        name = f"fixed_{self.lines}_variance"
        more = {name: getattr(before, name) + self.sigma_e**2}
        return after.changed(spatial_variance=before.spatial_variance, **more)


def warmer_k(context: ExposureContext, reference_c: float) -> Any:
    """Return how much warmer the sensor is than a reference, in K; 0 where its temperature is unknown."""
    temperature: Any = context.settings.temperature_c
    if temperature is None:
        return 0.0
    return np.where(np.isnan(temperature), 0.0, np.asarray(temperature) - reference_c)


def declared_dark_e(context: ExposureContext) -> Any:
    """Return the electrons that heat frees within the exposure, as the camera's description has them."""
    camera = context.camera
    reference = _DARK_REFERENCE_C if camera.dark_current_reference_C is None else camera.dark_current_reference_C
    warmer = 2.0 ** (warmer_k(context, reference) / (camera.dark_current_doubling_K or _DARK_DOUBLING_K))
    return (camera.dark_current_e_per_s or 0.0) * warmer * context.settings.exposure_s * context.geometry.binning**2


def dark_temperatures_c(context: ExposureContext) -> Any:
    """Return the known temperatures of the dark frames, of all where none is dark: those that leaks are seen at."""
    settings: Any = context.settings
    known = np.asarray(np.nan if settings.temperature_c is None else settings.temperature_c, dtype=np.float64)
    dark = np.broadcast_to(getattr(settings, "is_dark", False), known.shape)
    known = known[dark] if np.any(dark) else known
    return known[np.isfinite(known)]


def dark_exposures_vary(context: ExposureContext) -> bool:
    """Return whether there are dark frames of two exposures: only they show what grows with exposure."""
    settings: Any = context.settings
    dark = np.asarray(settings.is_dark)
    known = np.broadcast_to(settings.exposure_s, dark.shape)[dark]
    return bool(known.size and known.max() >= _VARYING_RATIO * known.min())


def nearest_temperature_c(context: ExposureContext, usual_c: float) -> float:
    """Return the temperature in °C to state a leak at: the usual one, or the whole °C of the dark frames nearest to it.

    What is stated far from any dark frame is known no better than the law that leads there. Within 10 K of one the
    usual temperature stays, as it does where none is known, so that figures can be compared with datasheets. Darks of
    one temperature determine no doubling: stated at exactly that temperature, their leak needs none.
    """
    known = dark_temperatures_c(context)
    if not known.size:
        return usual_c
    nearest = float(np.clip(usual_c, known.min(), known.max()))
    if abs(nearest - usual_c) <= _COMPARABLE_K:
        return usual_c
    return float(np.round(nearest)) if np.ptp(known) > 0 else nearest


def elapsed_s(context: ExposureContext) -> Any:
    """Return the time of the frame in s from the first; 0 where unknown."""
    stamp: Any = context.settings.timestamp_s
    return 0.0 if stamp is None else np.asarray(stamp)


def over_frames(law: Callable[[ExposureContext], Any], context: ExposureContext) -> Any:
    """Return the mean of a law over a series of frames: of its first one and of the others, each by its share.

    Of a single frame, and where they do not differ, it is the law itself.
    """
    if context.first_frame is None or context.later_frames is None:
        return law(context)
    others = np.asarray(getattr(context, "frames", 1.0)) - 1.0
    return (law(context.first_frame) + others * law(context.later_frames)) / (others + 1.0)


def setting_varies(context: ExposureContext, name: str) -> bool:
    """Tell whether a setting is known of all captures and differs; temperatures by more than a sensor's own wander."""
    known: Any = context.f_number if name == "f_number" else getattr(context.settings, name.lower())
    least = _WANDER_K if name == "temperature_C" else 0.0
    return known is not None and bool(np.isfinite(known).all() and np.ptp(np.asarray(known)) > least)


def gain_of(context: ExposureContext) -> Any:
    """Return the amplitude factor of the frame's gain."""
    return 10.0 ** (np.asarray(context.settings.gain_db) / 20.0)


def well_e(context: ExposureContext) -> float:
    """Return the full well that a camera's description states, or a typical one, in electrons."""
    return context.camera.full_well_e or 10_000.0
