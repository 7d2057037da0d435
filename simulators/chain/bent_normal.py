"""What becomes of normal values that a gamma curve bends, by quadrature; the nodes go by how near a corner is."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from simulators.effects.context import Signal

_EVEN: Final = np.linspace(-4.5, 4.5, 37)  # sigmas; even steps, for the curve has a corner
_CORNER: Final = 6.0  # sigmas from it within which its steps are needed; the nodes beyond reach 4.5
_SMOOTH: Final = 40.0  # sigmas beyond which five nodes, right to the tenth power of σ over the distance, are exact
_AT_ONCE: Final = 512  # values whose nodes stay in the processor's cache
_LEAST: Final = 1e-300  # of a range: its logarithm is a number, and its power nothing


def _gauss(count: int) -> tuple[Signal, Signal]:
    nodes, weights = np.polynomial.hermite_e.hermegauss(count)
    return nodes, weights / np.sum(weights)


def _even() -> tuple[Signal, Signal]:
    weights = np.exp(-0.5 * _EVEN**2) / np.sum(np.exp(-0.5 * _EVEN**2))
    return _EVEN / np.sqrt(weights @ _EVEN**2), weights  # of unit variance, though they end


_ABOUT_CORNER: Final = _even()
_FAR_OFF: Final = _gauss(9)
_FARTHER: Final = _gauss(5)


def bent_normal(
    middle: Signal, sigma: Signal, black: Signal, room: Signal, power: float, toe: float, lift: float
) -> tuple[Any, Any, Any]:
    """Return mean, variance and slope E[z·g(middle + σz)]/σ of what becomes of normal values.

    g(y) = black + room·|s|^power with the sign of s = (y − black)/room, a straight line `lift`·s for |s| within `toe`.

    Args:
        middle: (n,) means.
        sigma: (n,) standard deviations.
        black: (n,) where the curve begins.
        room: (n,) how far it reaches.
        toe: Where its straight beginning ends; 0 for none.
        lift: Steepness of that beginning.

    Returns:
        Three arrays (n,).
    """
    off, width = (middle - black) / room, sigma / room
    sigmas = np.minimum(np.abs(off), np.abs(np.abs(off) - toe)) / width
    straight = np.abs(off) + _ABOUT_CORNER[0][-1] * width <= toe
    near, smooth = (sigmas < _CORNER) & ~straight, (sigmas > _SMOOTH) & ~straight
    found = np.stack([lift * off, np.square(lift * width), np.full(middle.size, lift)])
    for which, rule in ((near, _ABOUT_CORNER), (~near & ~smooth & ~straight, _FAR_OFF), (smooth, _FARTHER)):
        places = np.flatnonzero(which)
        for some in np.split(places, range(_AT_ONCE, places.size, _AT_ONCE)):
            found[:, some] = _bent(off[some], width[some], rule, power, toe, lift)
    return black + room * found[0], room**2 * found[1], found[2]


def _bent(off: Signal, width: Signal, rule: tuple[Signal, Signal], power: float, toe: float, lift: float) -> Signal:
    """Return the same in shares of the range, (3, n): `off` and `width` are mean and deviation of s."""
    nodes, weights = rule
    beyond = np.multiply.outer(nodes, width)
    beyond += off
    share = np.abs(beyond)
    bent = np.maximum(share, _LEAST)
    np.log(bent, out=bent)
    bent *= power
    np.exp(bent, out=bent)
    if toe:
        np.copyto(bent, share * lift, where=share <= toe)
    np.copysign(bent, beyond, out=bent)
    after, slope = weights @ bent, (weights * nodes) @ bent
    bent -= after
    np.square(bent, out=bent)
    return np.stack([after, weights @ bent, slope / width])
