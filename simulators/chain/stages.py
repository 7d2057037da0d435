"""The order of effects in a chain: where in it an effect acts."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

from radiometer.errors import ConfigurationError
from simulators.effects.base import RADIANCE, Effect


def place_for(
    effect: Effect | type[Effect], chain: Sequence[Effect | type[Effect]], enabled: Sequence[bool] | None = None
) -> int:
    """Return the position in a chain at which an effect acts: in front of `effect.before`, else late in its stage.

    Args:
        chain: The effects in order, or their kinds.
        enabled: Which of them are switched on; all by default.

    Raises:
        ConfigurationError: If its unit fits nowhere in its stage.
    """
    return _place(_kind(effect), tuple(map(_kind, chain)), None if enabled is None else tuple(enabled))


def _kind(effect: Effect | type[Effect]) -> type[Effect]:
    return effect if isinstance(effect, type) else type(effect)


@lru_cache(maxsize=4096)
def _place(effect: type[Effect], chain: tuple[type[Effect], ...], enabled: tuple[bool, ...] | None) -> int:
    unit, fits = RADIANCE, list[int]()
    for position in range(len(chain) + 1):
        following = chain[position] if position < len(chain) else None
        in_stage = (position == 0 or chain[position - 1].stage <= effect.stage) and (
            following is None or following.stage >= effect.stage
        )
        if in_stage and unit == effect.unit_in == effect.unit_out:
            if following is not None and _is_in_front(effect, following):
                return position
            fits.append(position)
        if following is not None and (enabled is None or enabled[position]):
            unit = following.unit_out
    if not fits:
        raise ConfigurationError(
            f"camera model: effect {effect.name!r} fits nowhere in the {effect.stage.name.lower()} stage: "
            f"no signal in {effect.unit_in} passes there"
        )
    return fits[-1]


def _is_in_front(effect: type[Effect], following: type[Effect]) -> bool:
    """Tell whether an effect belongs right in front of another one."""
    if following.name == effect.before:
        return True
    return effect.before is not None and following.before == effect.before and in_order(effect) < in_order(following)


def in_order(effect: Effect | type[Effect]) -> tuple[int, bool]:
    """Return by what effects at one place are sorted; those that are alike stay as they were added."""
    return int(effect.stage), effect.last_in_place
