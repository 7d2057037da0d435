"""A response that is no straight line."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final, Self, cast

import numpy as np

from simulators.effects.base import DIGITAL_NUMBER, ELECTRONS, EXPOSURE, Moments, Stage, parameter
from simulators.effects.catalogue import CatalogueEffect, Scaling, well_e
from simulators.effects.context import ExposureContext, Signal

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


_BENT_TO: Final = 4.0  # declared full wells; a well that is declared at less than a quarter is no figure of the sensor


@dataclass(frozen=True)
class ResponseNonlinearity(CatalogueEffect):
    """Bends the response: S' = S·(1 − a₂·z − a₃·z²), z = S/S_FW.

    S_FW is the full well that is declared, which pixels may pass: the curve goes on up to where it rises no more, and
    straight on from there or from four full wells.

    Source: EMVA Standard 1288, release 4.0, linearity error; typical 0.1 to 3 %.
    """

    name = "response_nonlinearity"
    stage = Stage.WELL
    unit_in = unit_out = ELECTRONS
    where = "signal"
    block = "mean"
    trials = ({"a2": 0.01, "a3": 0.0}, {"a2": -0.01, "a3": 0.0}, {"a2": 0.0, "a3": 0.01}, {"a2": 0.0, "a3": -0.01})
    fitted = ("a2", "a3")
    settles = "one signal reached by different pairs of exposure and source level"
    a2: float = parameter(0.0, "1", -0.5, 0.5, source="engineering prior; refined on a real rig")
    a3: float = parameter(0.0, "1", -0.5, 0.5, source="engineering prior; refined on a real rig")

    def mean(self, signal: Signal, context: ExposureContext) -> Signal:
        well = well_e(context)
        z = np.asarray(signal / well)
        bent = np.clip(z, 0.0, self._end())
        curve = bent * (1.0 - self.a2 * bent - self.a3 * bent**2)
        return cast(Signal, (well * (curve + self._rise(bent) * (z - bent))).astype(signal.dtype))

    def slope(self, signal: Signal, context: ExposureContext) -> Any:
        return self._rise(np.clip(signal / well_e(context), 0.0, self._end()))

    def _rise(self, z: Any) -> Any:
        return 1.0 - 2.0 * self.a2 * z - 3.0 * self.a3 * z**2

    def _end(self) -> float:
        """Return the fill z from which the response goes straight on: where it rises no more, or `_BENT_TO`."""
        roots = np.roots([-3.0 * self.a3, -2.0 * self.a2, 1.0])
        ends = roots.real[(np.abs(roots.imag) < 1e-12) & (roots.real > 0.0)]
        return float(min(ends.min(initial=_BENT_TO), _BENT_TO))


_LEAST_DN2: Final = 1e-6  # a step of a fit may try less than no noise


@dataclass(frozen=True)
class GammaEnabled(CatalogueEffect):
    """Bends digital numbers: y' = D·(y/D)^(1/γ), D full scale; black level included.

    Where the black level p is added after the curve, y' = p + (D − p)·((y − p)/(D − p))^(1/γ), and below p the same
    curve turned about p.
    With a toe c a straight line leads from there to zero, as in Rec. 709: y' = y·c^(1/γ − 1) for y/D below c.

    Source: GenICam SFNC, Gamma; must be 1 for radiometry.
    """

    name = "gamma_enabled"
    stage = Stage.DIGITAL
    unit_in = unit_out = DIGITAL_NUMBER
    before = "quantisation"
    where = "signal"
    block = "mean"
    neutral_at_one = ("gamma",)
    trials = (
        {"gamma": 1.02}, {"gamma": 0.98}, {"gamma": 1.1}, {"gamma": 0.9}, {"gamma": 1.5}, {"gamma": 2.2},
        {"gamma": 0.45}, {"gamma": 1.1, "above_black": 1.0}, {"gamma": 1.4, "above_black": 1.0},
        {"gamma": 0.9, "above_black": 1.0},
    )  # fmt: skip
    fitted = ("gamma",)
    further = tuple({"toe": toe} for toe in (0.03, 0.08, 0.2))
    settles = "the same digital number reached at two gains"
    gamma: float = parameter(1.0, "1", 0.2, 5.0, source="engineering prior; refined on a real rig")

    toe: float = parameter(0.0, "1", 0.0, 0.9, source="Rec. 709: 0.018, sRGB: 0.0031; 0 for none")

    above_black: float = parameter(0.0, "1", 0.0, 1.0, source="1 where the black level is added after the curve")

    def mean(self, signal: Signal, context: ExposureContext) -> Signal:
        black, room = self._range(context)
        return cast(Signal, self._bent(signal, black, room).astype(signal.dtype))

    def _bent(self, signal: Any, black: Any, room: Any) -> Any:
        off = signal - black
        share = np.abs(off) / room if self.above_black else np.maximum(signal / room, 0.0)
        bent = share ** (1.0 / self.gamma)
        if self.toe:
            bent = np.where(share > self.toe, bent, share * self._lift())
        return black + room * (np.copysign(bent, off) if self.above_black else bent)

    def slope(self, signal: Signal, context: ExposureContext) -> Any:
        black, room = self._range(context)
        share = np.maximum(np.abs(signal - black) / room, 1e-6)
        return np.where(share > self.toe, share ** (1.0 / self.gamma - 1.0) / self.gamma, self._lift())

    def moments(self, before: Moments, context: ExposureContext) -> Moments:
        """Return the moments; about the beginning of the curve those of normal noise that is bent, no tangent's.

        The slope is that of Stein's lemma, E[z·g(S + σz)]/σ, by quadrature.
        """
        if not self.above_black:
            return super().moments(before, context)
        sigma = np.sqrt(np.maximum(before.variance + before.spatial_variance, _LEAST_DN2))
        mean, square, slope = self._by_quadrature(before.mean, sigma, *self._range(context))
        after = before.passed(cast(Signal, mean), cast(Signal, slope))
        more = np.maximum(square - np.square(slope * sigma), 0.0) / sigma**2  # what no straight line does to the noise
        return after.changed(
            variance=after.variance + more * before.variance,
            spatial_variance=after.spatial_variance + more * before.spatial_variance,
        )

    def _by_quadrature(self, mean: Any, sigma: Any, black: Any, room: Any) -> tuple[Any, Any, Any]:
        """Return mean, variance and slope of what becomes of normal values; close to the corner in even steps."""
        given = np.broadcast_arrays(mean, sigma, black, room)
        middle, width, begin, reach = (np.asarray(values, dtype=np.float64).ravel() for values in given)
        found = bent_normal(middle, width, begin, reach, 1.0 / self.gamma, float(self.toe), self._lift())
        after, square, slope = (values.reshape(given[0].shape) for values in found)
        return after, square, slope

    def _range(self, context: ExposureContext) -> tuple[Any, Any]:
        """Return where the curve begins, and how far it reaches from there."""
        full = float((1 << context.camera.bit_depth) - 1)
        known: Any = context.settings.black_level_dn
        black = self.above_black * np.asarray(0.0 if known is None else known) if self.above_black else 0.0
        return black, full - black

    def _lift(self) -> float:
        """Return the steepness of the toe."""
        return float(self.toe ** (1.0 / self.gamma - 1.0)) if self.toe else 1.0


_NO_THRESHOLD_S: Final = 1e5  # above any exposure
_FEWEST_EXPOSURES: Final = 6  # a power with a threshold bends through fewer by chance


@dataclass(frozen=True)
class ReciprocityFailure(Scaling):
    """Follows a power of the exposure time up to a threshold, from where on it is constant: H' = H·(min(t, t₀)/1 ms)^p.

    Source: Schwarzschild (1900), of photographic emulsions; not expected in silicon.
    """

    name = "reciprocity_failure"
    stage = Stage.SHUTTER
    unit_in = unit_out = EXPOSURE
    where = "exposure_s"
    block = "mean"
    log_prior_odds = -5.0
    prior_reason = "silicon counts photons: nothing of the kind is expected of it"
    trials = ({"exponent": 0.005}, {"exponent": -0.005})
    fitted = ("exponent",)
    settles = "one signal reached by exposure and by source level"
    exponent: float = parameter(0.0, "1", -0.5, 0.5, source="engineering prior; refined on a real rig")
    threshold_s: float = parameter(_NO_THRESHOLD_S, "s", 1e-6, _NO_THRESHOLD_S, source="none by default")

    def factor(self, context: ExposureContext) -> Any:
        return (np.minimum(np.asarray(context.settings.exposure_s), self.threshold_s) / 1e-3) ** self.exponent

    @classmethod
    def covers(cls, context: ExposureContext) -> tuple[Self, ...]:
        """Return powers of either sign up to thresholds among the exposures in use: at 0 a threshold does nothing."""
        times = np.unique(np.asarray(context.settings.exposure_s))
        if times.size < _FEWEST_EXPOSURES:
            return ()
        return tuple(cls(p, float(np.quantile(times, q))) for q in (0.3, 0.5, 0.7) for p in (0.005, -0.005))

    def free(self) -> tuple[str, ...]:
        return ("exponent", "threshold_s") if self.threshold_s < _NO_THRESHOLD_S else ("exponent",)
