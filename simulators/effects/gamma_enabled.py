"""A camera whose gamma was left on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final, cast

import numpy as np

from simulators.chain.bent_normal import bent_normal
from simulators.effects.base import DIGITAL_NUMBER, PRIOR, Moments, Stage, parameter
from simulators.effects.catalogue import CatalogueEffect
from simulators.effects.context import ExposureContext, Signal

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
    gamma: float = parameter(1.0, "1", 0.2, 5.0, source=PRIOR)
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
