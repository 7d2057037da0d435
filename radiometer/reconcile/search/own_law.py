"""Tells which named effects do not quite follow their own law."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from radiometer.reconcile.search.localise import Disagreement
from radiometer.reconcile.search.places import axis_of
from simulators.effects.catalogue import CatalogueEffect

_AS_SEEN: Final = {"screen_x": "image_x", "screen_y": "image_y"}
_UNLIKE: Final = 0.01  # chance of any false alarm among an effect's own tests


def unlike(tests: Sequence[Disagreement], effects: Sequence[CatalogueEffect]) -> list[str]:
    """Return the names of effects beside which structure stays in the very statistic and place that they stand for.

    All tests together share one chance of a false alarm; the few that tell whether an effect follows its law have one
    of their own. Another cause that looks much alike is found out there first.

    Args:
        tests: All tests of the final model.
        effects: Its effects.
    """
    found = []
    for effect in effects:
        place = _AS_SEEN.get(effect.where, effect.where)
        own = [t for t in tests if t.family == effect.block and axis_of(t.where, t.block) == place]
        if any(test.p_value < _UNLIKE / len(own) for test in own):
            found.append(effect.name)
    return found
