"""An effect by another law than its own: what it does is more here and less there along its covariates.

The effect's own change of the signal is taken times a factor, a curve through a few knots along a covariate (or a table
along two). The factor is 1 where the data follow the effect's own equation, and never below 0. Cause, stage and sign
are the effect's; the law is the data's. `freed` makes the kind; its name is the effect's.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from functools import lru_cache
from typing import Any, ClassVar, Final, Self, cast

import numpy as np
from scipy.interpolate import PchipInterpolator

from simulators.effects.base import DIGITAL_NUMBER, ELECTRONS, KINDS_KEPT, Moments, parameter
from simulators.effects.catalogue import CatalogueEffect, elapsed_s
from simulators.effects.context import ExposureContext, Signal, largest
from simulators.effects.tile_moments import TileMoments

LARGEST: Final = 100.0  # times the effect's own size
_PREFIX: Final = "at_"
_FAINT: Final = 1e-3  # of the range of a signal, below which its logarithm is no axis
_WHOLE: Final = ("edge_share", "outliers", "unsteady")  # what a capture has one figure of


@dataclass(frozen=True)
class _Axis:
    """A covariate along which a law may be free."""

    unit: str  # unit of its values
    # Gives it for a signal in front of the effect and a context; broadcasts against the signal
    value: Callable[[Signal, ExposureContext], Any]
    scale: Callable[[Any], Any] = np.asarray  # takes values to a scale with even knots


def _log(values: Any) -> Any:
    return np.log10(np.maximum(values, 1e-12))


def _setting(name: str) -> Callable[[Signal, ExposureContext], Any]:
    return lambda signal, context: np.asarray(getattr(context.settings, name), dtype=np.float64)


def _on_screen(index: int) -> Callable[[Signal, ExposureContext], Any]:
    return lambda signal, context: context.geometry.screen_xy()[index]


_AXES: Final[Mapping[str, _Axis]] = {
    "exposure_s": _Axis("s", _setting("exposure_s"), _log),
    "gain_db": _Axis("dB", _setting("gain_db")),
    "f_number": _Axis("1", lambda signal, context: np.asarray(context.f_number, dtype=np.float64), _log),
    "temperature_C": _Axis("°C", _setting("temperature_c")),
    "source_level": _Axis("1", _setting("source_level")),
    "timestamp_s": _Axis("s", lambda signal, context: np.asarray(elapsed_s(context), dtype=np.float64)),
    "field_radius": _Axis("1", lambda signal, context: context.geometry.field_radius()),
    "image_x": _Axis("px", lambda signal, context: context.geometry.x_px),
    "image_y": _Axis("px", lambda signal, context: context.geometry.y_px),
    "screen_x": _Axis("1", _on_screen(0)),
    "screen_y": _Axis("1", _on_screen(1)),
    "signal": _Axis("1", lambda signal, context: signal, _log),
    "patch_level": _Axis("1", lambda signal, context: signal, _log),
}


def axis_values(effect: CatalogueEffect, axis: str, signal: Signal, context: ExposureContext) -> Any:
    """Return the values of a covariate for a signal in front of an effect; None where the law cannot be free along it.

    Signals count from black on, with a thousandth of the range added, so that their logarithm ends.
    """
    if axis not in _AXES:
        return None
    if axis == "signal":
        return np.maximum(signal - _black_dn(effect, context), 0.0) + _FAINT * _range(effect, context)
    return _AXES[axis].value(signal, context)


def _black_dn(effect: CatalogueEffect, context: ExposureContext) -> Any:
    known: Any = context.settings.black_level_dn
    return 0.0 if known is None or effect.unit_in != DIGITAL_NUMBER else np.nan_to_num(known)


def _range(effect: CatalogueEffect, context: ExposureContext) -> float:
    if effect.unit_in == DIGITAL_NUMBER:
        return float(context.full_scale_dn)
    return float(context.camera.full_well_e or 1e4) if effect.unit_in == ELECTRONS else 0.0


def axis_scale(axis: str, values: Any) -> Any:
    """Return values of a covariate on the scale on which knots are even."""
    return _AXES[axis].scale(values)


def unscaled(axis: str, values: Any) -> Any:
    """Return values of a covariate from that scale."""
    return np.power(10.0, values) if _AXES[axis].scale is _log else np.asarray(values)


class FreeLaw(CatalogueEffect):
    """What all kinds of `freed` have in common."""

    law: tuple[float, ...]
    axes: ClassVar[tuple[str, ...]]
    plain: ClassVar[type[CatalogueEffect]]

    @property
    def own(self) -> CatalogueEffect:
        """Return the effect by its own law."""
        return self.plain(**{entry.name: getattr(self, entry.name) for entry in fields(self.plain)})

    def knots(self, axis: str) -> tuple[float, ...]:
        """Return the positions of the law's knots along a covariate, in its unit."""
        return cast(tuple[float, ...], getattr(self, _PREFIX + axis))

    def weight(self, signal: Signal, context: ExposureContext) -> Any:
        """Return the factor on what the effect does; broadcasts against the signal."""
        first, *second = self.axes
        at = axis_scale(first, self.knots(first))
        seen = np.clip(axis_scale(first, axis_values(self, first, signal, context)), at[0], at[-1])
        found = _curve(tuple(at.tolist()), self.law)(seen)
        if not second:
            return np.maximum(found, 0.0)
        return np.maximum(np.sum(found * self._hats(second[0], signal, context), axis=-1), 0.0)

    def _hats(self, axis: str, signal: Signal, context: ExposureContext) -> Any:
        """Return how much of each knot counts along a covariate, linear between them, (…, knots)."""
        at = axis_scale(axis, self.knots(axis))
        seen = np.clip(axis_scale(axis, axis_values(self, axis, signal, context)), at[0], at[-1])
        return np.stack([np.interp(seen, at, unit) for unit in np.eye(len(at))], axis=-1)

    def mean(self, signal: Signal, context: ExposureContext) -> Signal:
        own = self.own.mean(signal, context)
        return cast(Signal, (signal + self.weight(signal, context) * (own - signal)).astype(signal.dtype))

    def slope(self, signal: Signal, context: ExposureContext) -> Any:
        if {"signal", "patch_level"} & set(self.axes):
            step = 1e-4 * np.maximum(np.abs(signal), 1e-3 * np.maximum(largest(signal), 1e-30))
            return (self.mean(signal + step, context) - self.mean(signal - step, context)) / (2.0 * step)
        return 1.0 + self.weight(signal, context) * (self.own.slope(signal, context) - 1.0)

    def sample(self, signal: Signal, context: ExposureContext, rng: np.random.Generator) -> Signal:
        """Return one outcome: what is random goes by the root where the effect acts by its square."""
        own, weight = self.own, self.weight(signal, context)
        mean = own.mean(signal, context)
        scattered = own.sample(signal, context, rng) - mean
        share = np.sqrt(weight) if self.acts_by_square else weight
        return cast(Signal, (signal + weight * (mean - signal) + share * scattered).astype(signal.dtype))

    def moments(self, before: Moments, context: ExposureContext) -> Moments:
        """Return the moments: carried by the law's own slope, and so much of all else that the effect adds."""
        own, signal = self.own, before.mean
        weight = self.weight(signal, context)
        after = own.moments(before, context)
        mean = signal + weight * (after.mean - signal)
        carried = before.passed(mean, self.slope(signal, context))
        unweighted = before.passed(after.mean, own.slope(signal, context))
        changed = {name: _added(name, carried, after, unweighted, weight) for name in _names(before)}
        return after.changed(mean=mean, **changed)

    def free(self) -> tuple[str, ...]:
        """Return the parameters to fit: the law's, and the shape's where the law leaves the effect's own covariate."""
        shape = () if self.where in self.axes or len(self.axes) > 1 else self.own.free()[1:]
        return (*self.law_names(), *shape)

    def law_names(self) -> tuple[str, ...]:
        """Return the names of the law's own parameters."""
        return tuple(f"law[{i}]" for i in range(len(self.law)))

    def reach(self, parameter: str, full_scale_dn: float) -> tuple[float, float]:
        """Return the bounds of a parameter; no law takes the effect farther than its own bounds would."""
        low, high = super().reach(parameter, full_scale_dn)
        if parameter != "law":
            return low, high
        name = self.own.free()[0]
        about = self.neutral(name)
        size = float(getattr(self, name)) - about
        lowest, highest = self.own.reach(name, full_scale_dn)
        room = ((highest if size > 0 else lowest) - about) / size if size else high
        return low, float(np.clip(room, 1.0, high))

    def loosened(self, context: ExposureContext) -> tuple[Self, ...]:
        """Return nothing: it is free already."""
        return ()


@lru_cache(maxsize=256)
def _curve(at: tuple[float, ...], law: tuple[float, ...]) -> PchipInterpolator:
    """Return the curve through a law's values at its knots along the first covariate; one for each of a second."""
    values = np.reshape(law, (len(at), -1))
    return PchipInterpolator(at, values if values.shape[1] > 1 else values[:, 0], axis=0)


def _names(before: Moments) -> tuple[str, ...]:
    more = _WHOLE if isinstance(before, TileMoments) else ()
    return (*before.squared, *before.linear, *more)


def _added(name: str, carried: Moments, after: Moments, unweighted: Moments, weight: Any) -> Any:
    """Return one of the moments: what is carried, and so much of what the effect adds to carrying."""
    there, plain = getattr(after, name), getattr(unweighted, name)
    if there is plain:
        return getattr(carried, name)
    if name in _WHOLE and np.ndim(weight) >= 3:
        weight = np.mean(weight, axis=(-2, -1), keepdims=True)
    return getattr(carried, name) + weight * (there - plain)


@lru_cache(maxsize=KINDS_KEPT)
def freed(plain: type[CatalogueEffect], axes: tuple[str, ...]) -> type[FreeLaw]:
    """Return an effect's kind whose law is free along one or two covariates.

    Args:
        plain: The effect's own kind.
    """
    tables = {"law": parameter((1.0,), "1", 0.0, LARGEST, source="a curve fitted to data; 1 is the effect's own law")}
    tables |= {_PREFIX + axis: _knots_of(axis) for axis in axes}
    body = tables | {
        "__annotations__": dict.fromkeys(tables, "tuple[float, ...]"),
        "__module__": plain.__module__,
        "__doc__": plain.__doc__,
        "axes": axes,
        "plain": plain,
    }
    return dataclass(frozen=True)(type(plain.__name__, (FreeLaw, plain), body))


def _knots_of(axis: str) -> Any:
    return parameter((1.0,), _AXES[axis].unit, -1e12, 1e12, source="spread over what the data hold")


def kind_for(plain: type[CatalogueEffect], keys: tuple[str, ...]) -> type[CatalogueEffect]:
    """Return the kind that has parameters of these names: one of a free law where knots are among them."""
    axes = tuple(key.removeprefix(_PREFIX) for key in keys if key.removeprefix(_PREFIX) in _AXES and key[:3] == _PREFIX)
    return freed(plain, axes) if axes and "law" in keys else plain
