"""What these data would have shown: the amplitude of every entry that stands out by five sigma."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from radiometer.reconcile.design import Array
from radiometer.reconcile.edges import SHARPEST
from radiometer.reconcile.result import Limit
from radiometer.reconcile.screening import change_of
from radiometer.reconcile.state import FitState, with_effects
from radiometer.reconcile.usable import partly_at_the_top
from simulators.effects.catalogue import CatalogueEffect

SIGMAS: Final = 5.0
NEUTRAL: Final[Mapping[str, float]] = {"gamma": 1.0, "ratio": 1.0}  # parameters that do nothing at another value than 0
_BLIND: Final = 1e-6  # share of a change that must survive the nuisances
_LARGEST_FACTOR: Final = 50.0  # times the typical size, beyond which the effect would be absurd
_LOOKS: Final = 12
_STRIDE: Final = 30.0  # largest factor from one look to the next
_CLOSE: Final = 0.1  # of ln χ²
_NOTHING: Final = 1e-6  # a χ² that stands for none
_MOST_FLOOR: Final = 0.999  # share of a border's uncertainty that its floor may be
_MILD_WHEN_LARGE: Final = frozenset(("full_well_saturation", "soft_saturation", "adc_saturation"))
_SHARP: Final = frozenset(("full_well_saturation", "adc_saturation"))  # nothing bends below it
_STEPWISE: Final = _MILD_WHEN_LARGE | {"exposure_quantisation", "missing_codes", "nominal_settings"}
_ABSOLUTE_LIGHT: Final = "W m-2"  # has no scale where no radiance is known: the responsivity takes any
_SQUARED: Final = frozenset(  # a standard deviation acts by its square
    (
        "excess_read_noise",
        "column_pattern",
        "row_pattern",
        "row_temporal_noise",
        "dsnu",
        "prnu",
        "dark_current_nonuniformity",
        "pwm_flicker",
        "mains_ripple",
        "rolling_shutter_banding",
    )
)


def limits(state: FitState, catalogue: Mapping[str, type[CatalogueEffect]]) -> dict[str, Limit]:
    """Return the amplitude of every entry that these data would have shown at five sigma, by name."""
    return {name: _limit(state, name, kind) for name, kind in sorted(catalogue.items())}


def _limit(state: FitState, name: str, kind: type[CatalogueEffect]) -> Limit:
    blind = Limit(None, *_main_parameter(kind, None))
    if name in _SHARP and partly_at_the_top(state.design, state.seen, state.prediction).any():
        return blind  # the very tiles that would show it are left out, wherever it lies
    if not kind.usable(state.model.context) or (blind.unit == _ABSOLUTE_LIGHT and not state.design.has_known_radiance):
        return blind
    here = tuple(effect for effect in state.effects if effect.name == name)
    if here:  # what is named already: how small could it have been?
        state = with_effects(state, [effect for effect in state.effects if effect.name != name])
    starts = here or _few(kind.starts(state.model.context))
    found = [_Grown.of(state, start) for start in starts]
    seen = [grown.limit() for grown in found if grown.information > 0 and grown.size]
    known = [limit for limit in seen if limit.amplitude is not None]
    if not known:
        return blind
    mildest = max if name in _MILD_WHEN_LARGE else min
    return mildest(known, key=lambda limit: abs(limit.amplitude or 0.0))


def _few(starts: tuple[CatalogueEffect, ...]) -> tuple[CatalogueEffect, ...]:
    """Return a few starts spread over all: the smallest and some others."""
    step = max(1, len(starts) // 6)
    return starts[::step]


@dataclass(frozen=True, eq=False)
class _Grown:
    """An effect at one size, and the χ² by which it would stand out there.

    Attributes:
        state: The model without it.
        effect: The effect.
        parameter: The parameter that is its size.
        unit: Its unit.
        information: χ² that it would bring, all nuisances and other effects following.
    """

    state: FitState
    effect: CatalogueEffect
    parameter: str
    unit: str
    information: float

    @classmethod
    def of(cls, state: FitState, effect: CatalogueEffect) -> _Grown:
        """Return the effect with its χ²."""
        parameter, unit = _main_parameter(type(effect), effect)
        return cls(state, effect, parameter, unit, _information(state, effect))

    @property
    def size(self) -> float:
        """Return how far the parameter lies from doing nothing."""
        return _amplitude(self.effect, self.parameter)

    def limit(self) -> Limit:
        """Return the size of five sigma, looked for where the effect has that size: few grow in proportion."""
        if self.effect.name in _STEPWISE or self.parameter not in self.effect.values():
            # It does not grow from nothing: what counts is whether this very form would show.
            shown = self.information >= SIGMAS**2
            return Limit(self.size if shown else None, self.parameter, self.unit)
        below, above, near = None, None, self
        for _ in range(_LOOKS):
            if abs(np.log(max(near.information, _NOTHING) / SIGMAS**2)) < _CLOSE:
                return Limit(abs(near.size), self.parameter, self.unit)
            below, above = (below, near) if near.information > SIGMAS**2 else (near, above)
            other = near._times(_next_size(below, above) / near.size)
            if other is None or abs(other.size) > _LARGEST_FACTOR * abs(self.size):
                break
            near = other
        return Limit(None, self.parameter, self.unit)

    def _times(self, factor: float) -> _Grown | None:
        """Return the effect with its size times a factor; None beyond the parameter's bounds."""
        known = next(entry for entry in self.effect.parameters() if entry.name == self.parameter)
        values, neutral = self.effect.values()[self.parameter], NEUTRAL.get(self.parameter, 0.0)
        table = isinstance(values, tuple)
        old = np.atleast_1d(np.asarray(values, dtype=np.float64))
        new = neutral + factor * (old - neutral)
        if not np.all((known.low <= new) & (new <= known.high)) or np.array_equal(old, new):
            return None
        grown = tuple(new.tolist()) if table else float(new[0])
        return _Grown.of(self.state, self.effect.with_parameters(**{self.parameter: grown}))


def _next_size(below: _Grown | None, above: _Grown | None) -> float:
    """Return where to look next for five sigma: between the two sizes in logarithms, or further on from one."""
    if below is None or above is None:
        known = below or above
        assert known is not None
        power = 0.25 if known.effect.name in _SQUARED else 0.5
        factor = (SIGMAS**2 / max(known.information, _NOTHING)) ** power
        return known.size * float(np.clip(factor * (0.9 if below is None else 1.1), 1.0 / _STRIDE, _STRIDE))
    low, high = (np.log(max(grown.information, _NOTHING) / SIGMAS**2) for grown in (below, above))
    share = float(np.clip(-low / (high - low), 0.1, 0.9))
    return float(below.size * (above.size / below.size) ** share)


def _information(state: FitState, effect: CatalogueEffect) -> float:
    change = state.fit.followed(change_of(state, (*state.effects, effect)))
    part = state.fit.half(state.fit.pull(change))
    whole = float(change @ change)
    information = whole - float(part @ part)
    if information <= _BLIND * whole or information <= 0:
        return 0.0
    return max(information + _edge_in_common(state, change), 0.0)


def _edge_in_common(state: FitState, change: Array) -> float:
    """Return what χ² loses because the floor of the borders' uncertainty is the same in all captures."""
    cut, deviation = state.comparison.cuts["edge"], state.comparison.deviation["edge"]
    moved = change[cut]
    floor = np.where(state.comparison.usable["edge"], np.minimum(SHARPEST / deviation, _MOST_FLOOR), 0.0)
    own = 1.0 - floor**2
    together = float(np.sum(moved * floor / own)) ** 2 / (1.0 + float(np.sum(floor**2 / own)))
    return float(np.sum(moved**2 / own)) - together - float(moved @ moved)


def _main_parameter(kind: type[CatalogueEffect], start: CatalogueEffect | None) -> tuple[str, str]:
    names = start.free() if start is not None else kind.fitted
    known = {entry.name: entry.unit for entry in kind.parameters()}
    name = names[0].split("[")[0] if names else kind.profiled or next(iter(known), "share")
    return name, known.get(name, "1")


def _amplitude(effect: CatalogueEffect, name: str) -> float:
    """Return how far a parameter lies from doing nothing; of a table, its largest entry."""
    if name not in effect.values():
        return 1.0
    values = np.atleast_1d(np.asarray(effect.values()[name], dtype=np.float64)) - NEUTRAL.get(name, 0.0)
    return float(values[np.argmax(np.abs(values))])
