"""A screen whose gamma is not the stated one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final, Self

import numpy as np

from simulators.effects.base import PRIOR, RADIANCE, Stage, parameter
from simulators.effects.catalogue import Scaling
from simulators.effects.context import ExposureContext

_DARKEST: Final = 1e-3  # level below which the bend no longer grows


@dataclass(frozen=True)
class DisplayGammaError(Scaling):
    """Bends the scale of displayed levels: L' = L·c^(e + k·ln c), c the displayed level (1 is white).

    k is 0 where one exponent serves all levels; else the exponent changes from level to level.

    Source: display gamma 2.2 ± 0.2; an error of e in the exponent. Displays' curves are not exact powers.
    """

    name = "display_gamma_error"
    stage = Stage.SCENE
    unit_in = unit_out = RADIANCE
    where = "patch_level"
    block = "mean"
    trials = ({"exponent": 0.01}, {"exponent": -0.01}, {"exponent": 0.1})
    fitted = ("exponent",)
    bends = ("bend",)
    settles = "the same patches at another exposure"
    essential = ("exponent",)  # a bend alone is no power
    exponent: float = parameter(0.0, "1", -3.0, 3.0, source=PRIOR)
    bend: float = parameter(0.0, "1", -0.5, 0.5, source="change of the exponent per ln(level)")

    def factor(self, context: ExposureContext) -> Any:
        if context.code is None:
            return 1.0
        law = np.maximum(context.code, 1e-9) ** self.exponent
        return law * np.exp(self.bend * np.log(np.maximum(context.code, _DARKEST)) ** 2) if self.bend else law

    @classmethod
    def covers(cls, context: ExposureContext) -> tuple[Self, ...]:
        """Return the form whose exponent changes with the level."""
        return (cls(0.01, 0.001),)
