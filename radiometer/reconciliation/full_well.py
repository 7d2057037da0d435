"""The full well as the brightest pixels show it: tiles that clip are not compared, so that no other test sees it.

Saturated pixels gather at one digital number. The model predicts the number for the declared full well. Where pixels
gather lower, or go higher, another full well is shown. Where the converter ends first, the declared one is not tested.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from radiometer.data import CaptureHeader
from radiometer.data.pile_up import white_levels_of
from radiometer.data.white_level import EDGE_SIGMAS, WhiteLevel
from radiometer.numbers import lower_limit
from radiometer.reconciliation.fit.descent import fitted_parameters
from radiometer.reconciliation.fit.state import FitState
from radiometer.reconciliation.measure.reduce import FrameReader
from radiometer.reconciliation.result import FittedParameter, FoundEffect
from simulators.effects.base import Stage
from simulators.effects.catalogue import CatalogueEffect
from simulators.effects.registry import all_effects
from simulators.effects.tile_moments import TileMoments

# Datasheets state the saturation capacity of EMVA 1288, at the peak of the variance: up to a tenth below the pile.
_AS_DECLARED: Final = 0.1
_GAINS_LOOKED_AT: Final = 2  # the lowest: a full well needs most light there, and two separate it from a converter
_SIGMAS: Final = 4.0


@dataclass(frozen=True, slots=True)
class ShownWell:
    """The full well that the brightest pixels show."""

    declared_e: float  # as the camera's description states it, in electrons
    # Electrons at which pixels gather; where they gather nowhere below the converter's end, the most that many pixels
    # hold
    shown_e: float
    u_e: float  # standard uncertainty of that
    is_least: bool  # whether pixels gather nowhere, so that the full well is at least `shown_e`
    may_be_converter: bool  # whether one gain alone shows the pile: a converter may end there

    @property
    def least_e(self) -> float:
        """Return the electrons that pixels hold at least, with a probability of 95 %."""
        return lower_limit(self.shown_e, self.u_e)

    @property
    def contradicts(self) -> bool:
        """Return whether the declared full well is wrong."""
        off = self.shown_e - self.declared_e
        size = off if self.is_least else abs(off)
        return size > max(_AS_DECLARED * self.declared_e, _SIGMAS * self.u_e)

    @property
    def remark(self) -> str:
        """Return what a user must know of the full well; nothing where pixels gather where it is declared."""
        if self.contradicts:
            shown = f"at least {self.least_e:.4g} (95 %)" if self.is_least else f"{self.shown_e:.4g} ± {self.u_e:.2g}"
            return f"full well: stated {self.declared_e:.4g} e-, the brightest pixels show {shown} e-"
        if self.is_least and self.shown_e < (1.0 - _AS_DECLARED) * self.declared_e:
            return (
                f"the full well is not tested: pixels show at most {self.shown_e:.4g} e- of the {self.declared_e:.4g} "
                "e- that are declared"
            )
        return ""

    def as_effect(self, gap: float) -> FoundEffect:
        """Return the finding that the full well is another one, at a gap that it leaves as it is."""
        sigmas = (self.shown_e - self.declared_e) / self.u_e
        size = (
            FittedParameter(self.least_e, None, "e-")
            if self.is_least
            else FittedParameter(self.shown_e, self.u_e, "e-")
        )
        well = limit_at(Stage.WELL)
        rivals = (limit_at(Stage.DIGITAL).name,) if self.may_be_converter else ()
        (name,) = well.fitted
        return FoundEffect(well.name, {name: size}, well.where, gap, gap, rivals, None, 0.5 * sigmas**2, well.block)


def limit_at(stage: Stage) -> type[CatalogueEffect]:
    """Return the entry of the catalogue that limits the signal sharply at a stage."""
    kinds = (kind for kind in all_effects().values() if issubclass(kind, CatalogueEffect))
    return next(kind for kind in kinds if kind.saturates == "sharply" and kind.stage is stage)


def levels_of_brightest(header: CaptureHeader, read: FrameReader) -> dict[float, WhiteLevel]:
    """Return where the frames of the lowest gains show that pixels saturate, by gain in dB."""
    settings = [entry.settings for entry in header.frames]
    gains = sorted({one.gain_db for one in settings if not one.is_dark})[:_GAINS_LOOKED_AT]
    places = [place for place, one in enumerate(settings) if one.gain_db in gains and not one.is_dark]
    return white_levels_of([settings[place] for place in places], lambda number: read(places[number]))


def shown_well(state: FitState, levels: Mapping[float, WhiteLevel]) -> ShownWell | None:
    """Return the full well that the brightest pixels show; None where none is declared or the fit has found another.

    Args:
        levels: Where pixels saturate, by gain in dB.
    """
    camera = state.design.header.camera
    limits = [effect for effect in (*state.model.given, *state.effects) if effect.saturates]
    if camera.full_well_e is None or camera.conversion_gain_e_per_dn is None or limits or not levels:
        return None
    full_dn = camera.saturated_dn
    piles, reached = list[tuple[float, float, float]](), list[float]()
    for gain_db, level in levels.items():
        black_dn, end_dn = _range_dn(state, gain_db, camera.full_well_e)
        e_per_dn = camera.full_well_e / (end_dn - black_dn)
        if level.reached_dn is not None:
            reached.append((level.reached_dn - black_dn) * e_per_dn)
        if level.measured_dn is not None and level.measured_dn + EDGE_SIGMAS * level.spread_dn + 1.0 < full_dn:
            u_dn = math.hypot(level.spread_dn / math.sqrt(max(level.piled_pixels, 1)), 1.0 / math.sqrt(12.0))
            piles.append(((level.measured_dn - black_dn) * e_per_dn, u_dn * e_per_dn, level.measured_dn))
    if not reached:
        return None
    most_e, relative_u = max(reached), _relative_u_of_gain(state)
    whole = [pile for pile in piles if pile[0] > (1.0 - _AS_DECLARED) * most_e]
    if whole and not _is_converter(piles):
        shown_e, u_e, _ = max(whole)
        return ShownWell(camera.full_well_e, shown_e, math.hypot(u_e, relative_u * shown_e), False, len(piles) == 1)
    u_e = math.hypot(math.sqrt(max(most_e, 1.0)), relative_u * most_e)
    return ShownWell(camera.full_well_e, most_e, u_e, True, False)


def _is_converter(piles: Sequence[tuple[float, float, float]]) -> bool:
    """Return whether pixels gather at one digital number whatever the gain: a converter's end, no full well."""
    at_dn = [dn for _, _, dn in piles]
    at_e = [electrons for electrons, _, _ in piles]
    return len(piles) > 1 and max(at_dn) / min(at_dn) < max(at_e) / min(at_e)


def _range_dn(state: FitState, gain_db: float, well_e: float) -> tuple[float, float]:
    lit = (state.design.gain_db == gain_db) & ~state.design.closed
    trace, model = state.trace, state.model
    shape = (len(state.design.captures), len(state.design.tiles), 1)
    found = []
    for electrons in (0.0, well_e):
        moments = TileMoments.exactly(np.full(shape, electrons))
        for step in trace.chain:
            if step.stage > Stage.WELL:
                moments = model.through(step, moments)
        level = np.broadcast_to(moments.mean, np.broadcast_shapes(shape, np.shape(moments.mean)))[lit]
        found.append(float(np.median(level)))
    return found[0], found[1]


def _relative_u_of_gain(state: FitState) -> float:
    """Return the relative standard uncertainty of the conversion gain where it was fitted; declared, it has none."""
    effect = next((effect for effect in state.effects if effect.responsivity_taken() != 1.0), None)
    if effect is None:
        return 0.0
    known = fitted_parameters(state)[effect.name][effect.fitted[0]].u
    return (known or 0.0) / effect.responsivity_taken()
