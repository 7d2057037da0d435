"""What these data would have shown: the amplitude of every entry that stands out by five sigma."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np

from radiometer.reconcile.parameters import fitted_parameters, value_of
from radiometer.reconcile.result import Limit
from radiometer.reconcile.screening import change_of
from radiometer.reconcile.state import FitState
from simulators.effects.catalogue import CatalogueEffect

SIGMAS: Final = 5.0
NEUTRAL: Final[Mapping[str, float]] = {"gamma": 1.0, "ratio": 1.0}  # parameters that do nothing at another value than 0
_BLIND: Final = 1e-6  # share of a change that must survive the nuisances
_MILD: Final = 0.1  # share of the typical size at which the change is looked at …
_LARGEST_FACTOR: Final = 500.0  # … and how often that may be taken: beyond it the effect would be absurd


def limits(state: FitState, catalogue: Mapping[str, type[CatalogueEffect]]) -> dict[str, Limit]:
    """Return the amplitude of every entry that these data would have shown at five sigma, by name."""
    return {name: _limit(state, name, kind) for name, kind in sorted(catalogue.items())}


def _limit(state: FitState, name: str, kind: type[CatalogueEffect]) -> Limit:
    blind = Limit(None, *_main_parameter(kind, None))
    if not kind.usable(state.model.context):
        return blind
    own = fitted_parameters(state).get(name)
    if own is not None:
        known = own.get(blind.parameter)
        return blind if known is None or not known.u else Limit(SIGMAS * known.u, blind.parameter, blind.unit)
    found = [_from_start(state, start) for start in _few(kind.starts(state.model.context))]
    seen = [limit for limit in found if limit.amplitude is not None]
    if not seen:
        return blind
    mildest = max if name in _MILD_WHEN_LARGE else min
    return mildest(seen, key=lambda limit: abs(limit.amplitude or 0.0))


def _few(starts: tuple[CatalogueEffect, ...]) -> tuple[CatalogueEffect, ...]:
    """Return a few starts spread over all: the smallest and some others."""
    step = max(1, len(starts) // 6)
    return starts[::step]


def _from_start(state: FitState, start: CatalogueEffect) -> Limit:
    name, unit = _main_parameter(type(start), start)
    start = _milder(start, name)
    kept = tuple(effect for effect in state.effects if effect.name != start.name)
    reference = change_of(state, kept) if len(kept) < len(state.effects) else 0.0
    change = state.fit.followed(change_of(state, (*kept, start)) - reference)
    part = state.fit.half(state.fit.pull(change))
    whole = float(change @ change)
    information = whole - float(part @ part)
    if information <= _BLIND * whole or information <= 0:
        return Limit(None, name, unit)
    factor = SIGMAS / float(np.sqrt(information))
    if _is_variance(start):
        factor = float(np.sqrt(factor))  # a standard deviation acts by its square
    if factor > _LARGEST_FACTOR:
        return Limit(None, name, unit)
    if start.name in _STEPWISE:  # it does not grow from nothing: what counts is whether this very form would show
        return Limit(_amplitude(start, name) if factor <= 1.0 else None, name, unit)
    amplitude = abs(_amplitude(start, name)) * factor
    return Limit(float(amplitude) if 0 < amplitude <= _largest(start, name) else None, name, unit)


def _milder(effect: CatalogueEffect, name: str) -> CatalogueEffect:
    """Return the effect at a tenth of its size, where all that follows it is linear; as it is where it has no size."""
    fixed = effect.name in _STEPWISE or effect.block == "edge"  # a narrow blur does not reach the next pixel at all
    if fixed or name not in effect.values() or np.ndim(effect.values()[name]):
        return effect
    return effect.with_parameters(**{name: value_of(effect, name) - (1.0 - _MILD) * _amplitude(effect, name)})


def _largest(effect: CatalogueEffect, name: str) -> float:
    """Return the largest amplitude that the parameter may have."""
    return max((entry.high for entry in effect.parameters() if entry.name == name), default=float("inf"))


def _is_variance(effect: CatalogueEffect) -> bool:
    return effect.name in _SQUARED


_MILD_WHEN_LARGE: Final = frozenset(("full_well_saturation", "soft_saturation"))
_STEPWISE: Final = _MILD_WHEN_LARGE | {"exposure_quantisation", "missing_codes", "nominal_settings"}
_SQUARED: Final = frozenset(
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


def _main_parameter(kind: type[CatalogueEffect], start: CatalogueEffect | None) -> tuple[str, str]:
    names = start.free() if start is not None else kind.fitted
    known = {entry.name: entry.unit for entry in kind.parameters()}
    name = names[0].split("[")[0] if names else kind.profiled or next(iter(known), "share")
    return name, known.get(name, "1")


def _amplitude(effect: CatalogueEffect, name: str) -> float:
    if name not in effect.values():
        return 1.0
    value = value_of(effect, name)
    return value - NEUTRAL.get(name, 0.0)
