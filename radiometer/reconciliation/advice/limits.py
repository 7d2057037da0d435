"""Computes the detection limits: the amplitude of every entry that would show at five sigma."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

from radiometer.reconciliation.advice.sizes import SHOWN, Asked, Grown, main_parameter, mildest
from radiometer.reconciliation.fit.state import FitState, with_effects
from radiometer.reconciliation.result import Limit
from radiometer.reconciliation.statistics import partly_at_the_top
from simulators.effects.catalogue import CatalogueEffect

_LARGEST_FACTOR: Final = 50.0  # times the typical size, beyond which the effect would be absurd
_ASKED: Final = Asked(SHOWN, _LARGEST_FACTOR)
_ABSOLUTE_LIGHT: Final = "W m-2"  # has no scale where no radiance is known: the responsivity takes any


def limits(state: FitState, catalogue: Mapping[str, type[CatalogueEffect]]) -> dict[str, Limit]:
    """Return the amplitude of every entry that these data would have shown at five sigma, by name."""
    found = {name: Limit(None, *main_parameter(kind, None)) for name, kind in sorted(catalogue.items())}
    asked = {name: kind for name, kind in catalogue.items() if _can_show(state, kind, found[name].unit)}
    present = {effect.name for effect in state.effects if effect.name in asked}
    starts = [_few(kind.starts(state.model.context)) for name, kind in asked.items() if name not in present]
    found |= _mildest(state, [start for several in starts for start in several])
    for name in sorted(present):  # what is named already: how small could it have been?
        others = with_effects(state, [effect for effect in state.effects if effect.name != name])
        named = _mildest(others, [effect for effect in state.effects if effect.name == name])
        # Further terms that stay while the size shrinks may show at any size: then the plain form tells.
        found |= named or _mildest(others, _few(asked[name].starts(state.model.context)))
    return found


def _can_show(state: FitState, kind: type[CatalogueEffect], unit: str) -> bool:
    if kind.saturates == "sharply" and partly_at_the_top(state.design, state.seen, state.prediction).any():
        return False  # the very tiles that would show it are left out, wherever it lies
    return kind.usable(state.model.context) and (unit != _ABSOLUTE_LIGHT or state.design.has_known_radiance)


def _few(starts: tuple[CatalogueEffect, ...]) -> tuple[CatalogueEffect, ...]:
    """Return a few starts spread over all: the smallest and some others."""
    step = max(1, len(starts) // 6)
    return starts[::step]


def _mildest(state: FitState, starts: Sequence[CatalogueEffect]) -> dict[str, Limit]:
    return {name: _limit(near) for name, near in mildest(state, starts, _ASKED).items()}


def _limit(near: Grown) -> Limit:
    """Return a size as a limit."""
    stated = near.effect.values()["reference_C"] if near.effect.heated else None
    return Limit(abs(near.size) if near.grows else near.size, near.parameter, near.unit, stated)
