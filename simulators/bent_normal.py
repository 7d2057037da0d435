"""What becomes of normal values that a gamma curve bends: a loop, for each value asks for nodes of its own."""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np

from radiometer.compiled import compiled
from simulators.effects.context import Signal

_EVEN: Final = np.linspace(-4.5, 4.5, 37)  # sigmas; even steps, for the curve has a corner
_ABOUT_CORNER: Final = (_EVEN, np.exp(-0.5 * _EVEN**2) / np.sum(np.exp(-0.5 * _EVEN**2)))
_CORNER: Final = 6.0  # sigmas from it within which its steps are needed; the nodes beyond reach 4.5
_SMOOTH: Final = 40.0  # sigmas beyond which five nodes, right to the tenth power of σ over the distance, are exact


def _gauss(count: int) -> tuple[Signal, Signal]:
    nodes, weights = np.polynomial.hermite_e.hermegauss(count)
    return nodes, weights / np.sum(weights)


_FAR_OFF: Final = _gauss(9)
_FARTHER: Final = _gauss(5)
RULES: Final = (*_ABOUT_CORNER, *_FAR_OFF, *_FARTHER)


@compiled
def bent_normal(
    middle: Signal, sigma: Signal, black: Signal, room: Signal, curve: tuple[float, ...], rules: Any, found: Signal
) -> None:
    """Write mean, variance and slope of what becomes of normal values, those close to the corner in even steps.

    Args:
        middle: (n,) means.
        sigma: (n,) standard deviations.
        black: (n,) where the curve begins.
        room: (n,) how far it reaches.
        curve: Power, end and steepness of the toe.
        rules: Nodes and weights about the corner, off it and farther.
        found: (3, n) where to write.
    """
    power, toe, lift = curve
    bent = np.empty(rules[0].size)
    for i in range(middle.size):
        off = abs(middle[i] - black[i])
        sigmas = min(off, abs(off - toe * room[i])) / sigma[i]
        nodes, weights = (rules[0], rules[1]) if sigmas < _CORNER else (rules[2], rules[3])
        if sigmas > _SMOOTH:
            nodes, weights = rules[4], rules[5]
        after = slope = square = 0.0
        for k in range(nodes.size):
            beyond = middle[i] + nodes[k] * sigma[i] - black[i]
            share = abs(beyond) / room[i]
            raised = share**power if share > toe else share * lift
            bent[k] = black[i] + room[i] * math.copysign(raised, beyond)
            after += weights[k] * bent[k]
            slope += weights[k] * nodes[k] * bent[k]
        for k in range(nodes.size):
            square += weights[k] * (bent[k] - after) ** 2
        found[0, i], found[1, i], found[2, i] = after, square, slope / sigma[i]
