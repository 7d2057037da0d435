"""What an effect of the forward model is: a pure function with a name, a stage, units and bounded parameters.

A new effect is one file in this folder with a frozen dataclass derived from `Effect`:

    @dataclass(frozen=True)
    class ExposureTimeOffset(Effect):
        '''Adds a constant to the exposure time: H' = H·(t + Δt)/t.'''

        name = "exposure_time_offset"
        stage = Stage.SHUTTER
        unit_in = unit_out = EXPOSURE
        offset_s: float = parameter(0.0, "s", -1e-3, 1e-3, source="...")

        def mean(self, signal, context):
            t = context.settings.exposure_s
            return signal * ((t + self.offset_s) / t)

Only `mean` must be given. `sample` defaults to the mean (an effect without randomness), `variance` to zero and
`slope` to a finite difference; an effect that mixes pixels or clips overrides `moments`.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import MISSING, dataclass, field, fields, replace
from enum import IntEnum
from functools import lru_cache
from typing import Any, ClassVar, Final, Self

import numpy as np

from radiometer.errors import ConfigurationError
from radiometer.numbers import unit_text
from simulators.effects.context import ExposureContext, Signal, largest
from simulators.effects.tile_moments import Moments as Moments
from simulators.effects.tile_moments import TileMoments

RADIANCE: Final = "W sr-1 m-2"
IRRADIANCE: Final = "W m-2"
EXPOSURE: Final = "J m-2"
PHOTONS: Final = "photon"
ELECTRONS: Final = "e-"
DIGITAL_NUMBER: Final = "DN"

PRIOR: Final = "engineering prior; refined on a real rig"  # source of bounds that no datasheet gives
KINDS_KEPT: Final = 2048  # classes of which facts are kept: several times the catalogue; laws make classes without end
_RELATIVE_STEP: Final = 1e-4  # of a central difference: neither rounding nor bending matters
_LARGEST_FULL_SCALE_DN: Final = 2.0**32  # of any converter that may ever stand in a model file


class Stage(IntEnum):
    """Stages of the chain in the order that the light passes them."""

    SOURCE = 0
    SCENE = 1
    OPTICS = 2
    SHUTTER = 3
    PHOTONS = 4
    ELECTRONS = 5
    WELL = 6
    READOUT = 7
    DIGITAL = 8


@dataclass(frozen=True, slots=True)
class Parameter:
    """What is known of one parameter of an effect."""

    name: str  # its name, with the unit as suffix
    unit: str  # its unit; "1" for a pure number
    low: float  # lowest allowed value
    high: float  # highest allowed value
    source: str  # where its default and bounds come from
    default: Any  # its default
    # Whether the range scales with the converter's; `low` and `high` are then those of the widest one
    of_full_scale: bool = False

    def bounds(self, full_scale_dn: float) -> tuple[float, float]:
        """Return the lowest and the highest value for a camera of this highest digital number."""
        share = full_scale_dn / _LARGEST_FULL_SCALE_DN if self.of_full_scale else 1.0
        return self.low * share, self.high * share


def parameter(default: Any, unit: str, low: float, high: float, *, source: str, of_full_scale: bool = False) -> Any:
    """Declare a parameter of an effect (a dataclass field).

    Args:
        default: Default: a float, or a tuple of floats for a table (bounds then hold for each entry).
        unit: Its unit; "1" for a pure number.
        source: Where default and bounds come from.
        of_full_scale: Whether the bounds are shares of the camera's highest digital number, whatever its bit depth.
    """
    widest = _LARGEST_FULL_SCALE_DN if of_full_scale else 1.0
    known = {"unit": unit, "low": low * widest, "high": high * widest, "source": source}
    return field(default=default, metadata=known | {"of_full_scale": of_full_scale})


@dataclass(frozen=True)
class Effect(ABC):
    """One entry of the forward model.

    Attributes:
        name: Canonical snake_case name.
        stage: Where in the chain it acts.
        unit_in: Unit of the signal it takes.
        unit_out: Unit of the signal it gives.
        before: Name of an effect of the same stage that it is put in front of when added to a model; by default it
            is put as late in its stage as its unit fits.
        last_in_place: Whether it acts on what all others that belong there bring, whichever was added first.
    """

    name: ClassVar[str]
    stage: ClassVar[Stage]
    unit_in: ClassVar[str]
    unit_out: ClassVar[str]
    before: ClassVar[str | None] = None
    last_in_place: ClassVar[bool] = False

    def __post_init__(self) -> None:
        for known in self.parameters():
            _refuse_out_of_bounds(self.name, known, getattr(self, known.name))

    @classmethod
    def parameters(cls) -> tuple[Parameter, ...]:
        """Return name, unit, bounds, source and default of all parameters. Raises TypeError for an undeclared field."""
        return _declared(cls)

    def values(self) -> dict[str, Any]:
        """Return the value of every parameter by name."""
        return {entry.name: getattr(self, entry.name) for entry in fields(self)}

    def with_parameters(self, **values: Any) -> Self:
        """Return the effect with some parameters changed. Raises ConfigurationError outside their bounds."""
        return replace(self, **values)

    @abstractmethod
    def mean(self, signal: Signal, context: ExposureContext) -> Signal:
        """Return the expected signal in `unit_out` for a signal in `unit_in`; a new array, same shape."""

    def sample(self, signal: Signal, context: ExposureContext, rng: np.random.Generator) -> Signal:
        """Return one random outcome in `unit_out`. `rng` belongs to this effect and this frame alone.

        What stays from frame to frame (fixed pattern) is drawn from `context.fixed_rng(self.name)` instead.
        """
        return self.mean(signal, context)

    def variance(self, signal: Signal, context: ExposureContext) -> Signal | float:
        """Return the temporal variance that this effect adds to a pixel, in unit_out²."""
        return 0.0

    def spatial_variance(self, signal: Signal, context: ExposureContext) -> Signal | float:
        """Return the fixed-pattern variance that this effect adds, in unit_out²."""
        return 0.0

    def common_variance(self, signal: Signal, context: ExposureContext) -> Signal | float:
        """Return the variance common to all pixels of a frame that this effect adds, in unit_out²."""
        return 0.0

    def ordered_variance(self, signal: Signal, context: ExposureContext) -> Signal | float:
        """Return how a capture's frames behind its first differ by their order, as a variance in unit_out²."""
        return 0.0

    def slope(self, signal: Signal, context: ExposureContext) -> Signal | float:
        """Return d(mean)/d(signal) pixel by pixel; by central difference unless an effect knows better."""
        step = _RELATIVE_STEP * largest(signal)
        step = np.where(step > 0, step, _RELATIVE_STEP)
        rise = np.asarray(self.mean(signal + step, context)) - np.asarray(self.mean(signal - step, context))
        return np.asarray(rise / (2.0 * step))

    def moments(self, before: Moments, context: ExposureContext) -> Moments:
        """Return the moments after the effect by linear propagation; clipping and mixing effects override it.

        Statistics of tiles follow by `tile`, and the first frame of a series by `drifts`.
        """
        mean = before.mean
        after = before.passed(self.mean(mean, context), self.slope(mean, context))
        added = {name: getattr(self, name)(mean, context) for name in _added_by(type(self))}
        more = {name: getattr(after, name) + v for name, v in added.items() if not isinstance(v, float) or v}
        if not (isinstance(after, TileMoments) and isinstance(before, TileMoments)):
            return after.changed(**more)
        if context.first_frame is not None and context.later_frames is not None and self.drifts:
            moved = self.mean(mean, context.first_frame) - self.mean(mean, context.later_frames)
            more["first_excess"] = after.first_excess + moved
        after = after.changed(**more) if more else after
        return self.tile(after, before, context)

    @property
    def drifts(self) -> bool:
        """Return whether it depends on time or temperature: the first frame of a series then differs from the
        others."""
        return False

    def tile(self, after: TileMoments, before: TileMoments, context: ExposureContext) -> TileMoments:
        """Return the moments with what the effect does to the other statistics of a tile; nothing by default."""
        return after


class Proportional(Effect):
    """An effect whose output is its input times its slope."""

    def mean(self, signal: Signal, context: ExposureContext) -> Signal:
        return signal * self.slope(signal, context)


class UnitSlope(Effect):
    """An effect whose output grows by as much as its input."""

    def slope(self, signal: Signal, context: ExposureContext) -> float:
        return 1.0


class KeepsMean(UnitSlope):
    """An effect that scatters the signal about an unchanged mean: noise, or a pattern that averages out."""

    def mean(self, signal: Signal, context: ExposureContext) -> Signal:
        return signal


@lru_cache(maxsize=KINDS_KEPT)
def _added_by(kind: type[Effect]) -> tuple[str, ...]:
    """Return the variances that an effect adds to, by name: those that it says anything about."""
    return tuple(name for name in Moments.squared if getattr(kind, name) is not getattr(Effect, name))


@lru_cache(maxsize=KINDS_KEPT)
def _declared(kind: type[Effect]) -> tuple[Parameter, ...]:
    declared = []
    for entry in fields(kind):
        if "unit" not in entry.metadata:
            raise TypeError(f"effect {kind.name}: field {entry.name!r} must be declared with parameter(...)")
        default = None if entry.default is MISSING else entry.default
        declared.append(Parameter(name=entry.name, default=default, **entry.metadata))
    return tuple(declared)


def _refuse_out_of_bounds(effect: str, known: Parameter, value: Any) -> None:
    if type(value) is float and known.low <= value <= known.high and math.isfinite(value):
        return  # the usual case, decided quickly
    try:
        numbers = np.atleast_1d(np.asarray(value, dtype=np.float64))
    except (TypeError, ValueError) as error:
        raise ConfigurationError(f"effect {effect}: {known.name} = {value!r} is not a number") from error
    allowed = np.isfinite(numbers) & (numbers >= known.low) & (numbers <= known.high)
    if not bool(np.all(allowed)):
        shown = value if np.ndim(value) else f"{value:g}"
        of_unit = f" {unit_text(known.unit)}".rstrip()
        raise ConfigurationError(
            f"effect {effect}: {known.name} = {shown}{of_unit} is out of range; "
            f"allowed is {known.low:g} to {known.high:g}{of_unit}"
        )
