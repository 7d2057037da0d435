"""Where fits go: to the least χ² over nuisances, term weights and effect parameters, by Gauss and Newton's steps."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Final

import numpy as np

from radiometer.errors import ConfigurationError
from radiometer.reconciliation.fit.linear import descended
from radiometer.reconciliation.fit.nuisances import NuisanceLayout, rough_log_responsivity
from radiometer.reconciliation.fit.state import FitState, reweighted, weighted, with_effects
from radiometer.reconciliation.measure.design import Design
from radiometer.reconciliation.measure.reduce import PatternImages
from radiometer.reconciliation.measure.seen import CaptureStatistics
from radiometer.reconciliation.model.tile_model import TileModel
from radiometer.typing import Array
from simulators.effects.catalogue import CatalogueEffect

_ITERATIONS: Final = 25
_SHORTER, _SHORTENINGS = 0.3, 6  # steps that are tried
_IDLE: Final = 1e-3  # sigmas that a parameter moves by its whole scale
_CONVERGED: Final = 1e-3  # change of χ², in units of the reduced χ² where that is above 1, that ends the fit
_HOLDS: Final = 0.25  # share of the gain before that a step by old derivatives may have; beyond, new ones are taken
_SLOW: Final = 0.1  # share of what a step promised, below which it creeps along a valley that bends …
_LITTLE: Final = 1.0  # … if it gains less than this χ², too, in units of the reduced one where that is above 1
_PATIENCE: Final = 3  # steps that creep one after the other
_REWEIGHTINGS: Final = 3
_SETTLED: Final = 0.02  # share of a parameter's size
_PAST_WELL: Final = 1.02  # times the declared full well, which is rounded
_ALIVE: Final = 0.5  # share of its shot noise that a tile keeps where charge does not end


def first_state(
    design: Design, seen: CaptureStatistics, images: PatternImages, given: tuple[CatalogueEffect, ...] = ()
) -> FitState:
    """Return the starting camera fitted to the statistics: nuisances only.

    Args:
        seen: Measured statistics.
        given: Effects that the starting model adds to the ideal chain; they are not fitted.
    """
    model = replace(TileModel.of(design, images), given=given, passes_well=_passes_well(design, seen))
    layout = NuisanceLayout.of(design)
    values = np.zeros(layout.size)
    if "black_dn" in layout.scalars:  # else darks would be predicted at zero, and left out as clipped for good
        values[layout.scalars.index("black_dn")] = float(np.nanmin(seen.mean))
    rough = model.predict(layout.unpack(design, values))
    unclipped = (seen.high < 1e-3) & (seen.low < 1e-3)
    values[0] = rough_log_responsivity(design, seen.mean, rough, unclipped)
    state = weighted(seen, model, layout, values, (), tau=1e-3, floors={}, usable=None)
    state = refit(state)
    return refit(reweighted(state)).recorded()


def _passes_well(design: Design, seen: CaptureStatistics) -> bool:
    """Return whether tiles hold more than the declared full well and still show the noise of their light.

    The declared well then is not where charge ends: a model that ends there would predict no noise where there is some.
    A plateau above it, due to a wrong conversion gain, has lost its noise.
    """
    camera = design.header.camera
    if camera.full_well_e is None or camera.conversion_gain_e_per_dn is None:
        return False
    black = np.where(np.isnan(design.black_level_dn), np.nanmin(seen.mean), design.black_level_dn)
    e_per_dn = (camera.conversion_gain_e_per_dn * 10.0 ** (-design.gain_db / 20.0))[:, None]
    held_e = (seen.mean - black[:, None]) * e_per_dn
    alive = np.nan_to_num(seen.variance) * e_per_dn**2 > _ALIVE * held_e
    return bool(np.any(alive & (held_e > _PAST_WELL * camera.full_well_e) & (seen.high < 1e-3)))


def refit(state: FitState, iterations: int = _ITERATIONS, *, early_stop: bool = False) -> FitState:
    """Return the state at the least χ² over nuisances, term weights and effect parameters (damped Gauss–Newton).

    Parameters that come frozen within their bounds stay so. They are known by effect and name: a further term that
    falls to nothing on the way is none of its effect's parameters any more, and all behind it move up.

    With `early_stop` it ends once it creeps. A name's fit goes on: that it leads to the end of a range is a finding.
    """
    fixed, pace = _fixed(state), _Pace()

    def trials(at: FitState) -> Iterator[FitState]:
        if early_stop and pace.creeps(at):
            return
        for trial in _trials(at):
            yield _held_at_bounds(_glided(at, trial, at.cost - trial.cost)[0], fixed) if trial.cost < at.cost else trial

    return descended(_held_at_bounds(state, fixed), trials, lambda at: _CONVERGED * at.misfit, iterations)


class _Pace:
    """Progress of a fit: where parameters nearly replace each other it has no end, but gains next to nothing."""

    def __init__(self) -> None:
        self._before: FitState | None = None
        self._slow = 0

    def creeps(self, at: FitState) -> bool:
        """Return whether the steps to this point, the next one of a fit, were slow ones for too long."""
        before, self._before = self._before, at
        if before is None:
            return False
        gained = before.cost - at.cost
        slow = gained < min(_SLOW * (before.cost - before.promised), _LITTLE * at.misfit)
        self._slow = self._slow + 1 if slow else 0
        return self._slow >= _PATIENCE


def coarse_fit(state: FitState, *, early_stop: bool = False) -> FitState:
    """Return the state near the least χ², for weights that will be brought up to date there.

    As `refit`, but the end is where derivatives of one point lead, if they hold all the way: none are taken there to
    confirm it. Parameters at bounds are not held yet.
    """
    fixed, pace = _fixed(state), _Pace()
    for _ in range(_ITERATIONS):
        state = _held_at_bounds(state, fixed)
        if early_stop and pace.creeps(state):
            break
        lower = next((trial for trial in _trials(state) if trial.cost < state.cost), None)
        if lower is None:
            break
        misfit, (state, gained) = state.misfit, _glided(state, lower, state.cost - lower.cost)
        if gained < _CONVERGED * misfit:
            break
    return state


def converged_fit(state: FitState, *, early_stop: bool = False) -> FitState:
    """Return the state refitted under its own weights, until these no longer move the parameters.

    `early_stop` is that of `refit`. Of what does not settle the weights that speak less for it count.
    """
    for _ in range(_REWEIGHTINGS):
        before, state = state.parameters.values, coarse_fit(reweighted(state), early_stop=early_stop)
        after = state.parameters.values
        if before.size != after.size:  # a further term fell to nothing, and the form is the plain one again
            continue
        if not after.size or float(np.max(np.abs(after - before) / state.parameters.scale)) < _SETTLED:
            return _held_at_bounds(state).recorded()
    last = refit(state, early_stop=early_stop)
    # Beside realisations that its former size allowed a pattern may have been fitted to nothing.
    own = refit(reweighted(last), early_stop=early_stop)
    return min(last, own, key=lambda found: found.evidence).recorded()


def refit_with(state: FitState, effect: CatalogueEffect, iterations: int = _ITERATIONS) -> FitState:
    """Return the state with a further effect as it is; all else follows by the derivatives of the state without it.

    Where these lead nowhere all else is refitted with new derivatives, in so many iterations at most.
    """
    start = replace(with_effects(state, (*state.effects, effect)), held_terms=state.term_block)
    moved = _moved(start, state.fit.step_from(start.residual)[0], state)
    if _is_within_range(moved) and moved.cost < start.cost:
        return _glided(state, moved, start.cost - moved.cost)[0]
    held = frozenset(range(state.parameters.size, start.parameters.size))
    return refit(replace(start, frozen=held, held_terms=None), iterations)


def _fixed(state: FitState) -> frozenset[tuple[int, str]]:
    """Return the effect and the name of each parameter that is frozen within its bounds."""
    own = state.parameters
    on_low, on_high = own.on_bounds()
    inside = state.frozen - frozenset(np.flatnonzero(on_low | on_high).tolist())
    return frozenset((own.owner[i], own.names[i]) for i in inside)


def _held_at_bounds(state: FitState, fixed: frozenset[tuple[int, str]] = frozenset()) -> FitState:
    """Return the state with those effect parameters frozen that stand on a bound and would leave it, and the fixed.

    Were they free, the linearised fit would take up beyond the bound what the model cannot, and hide it. A parameter
    that moves nothing where it stands is frozen too: the fit would send it anywhere.
    """
    on_low, on_high = state.parameters.on_bounds()
    idle = np.flatnonzero(np.linalg.norm(state.effect_jacobian, axis=0) < _IDLE)
    named = zip(state.parameters.owner, state.parameters.names, strict=True)
    held = frozenset(i for i, entry in enumerate(named) if entry in fixed) | frozenset(idle.tolist())
    while True:
        state = state if state.frozen == held else state.with_frozen(held)
        if not (on_low | on_high).any():
            return state
        step = state.effect_step(state.fit.step)
        more = held | frozenset(np.flatnonzero((on_low & (step < 0)) | (on_high & (step > 0))).tolist())
        if more == held:
            return state
        held = more


def _trials(state: FitState) -> Iterator[FitState]:
    """Yield the states after ever shorter steps; none where even the linearised model promises nothing."""
    if state.cost - state.promised < _CONVERGED * state.misfit:
        return
    for number in range(_SHORTENINGS):
        trial = _moved(state, _SHORTER**number * state.fit.step)
        if _is_within_range(trial):
            yield trial


def _glided(state: FitState, moved: FitState, gained: float) -> tuple[FitState, float]:
    """Return where further steps by the derivatives of one point lead, as long as these hold, and the last one's gain.

    Where the next step promises next to nothing, it is what that promises.

    Such a step costs one prediction, new derivatives one for each parameter. They hold where a step gains far less
    than the one before it, as steps of Gauss and Newton do near the least χ².

    Args:
        state: The point of the derivatives.
        moved: The point after the first step by them.
        gained: By how much that step lowered χ².
    """
    names = state.parameters.names
    while not moved.frozen and moved.parameters.names[: len(names)] == names:
        if gained < _CONVERGED * moved.misfit:
            break
        step, promised = state.fit.step_from(moved.residual)
        if promised < _CONVERGED * moved.misfit:
            return moved, promised
        further = _moved(moved, step, state)
        if further.frozen or not _is_within_range(further) or further.cost >= moved.cost:
            break
        before, gained = gained, moved.cost - further.cost
        moved = further
        if gained > _HOLDS * before:
            break
    return moved, gained


def _is_within_range(trial: FitState) -> bool:
    """Return whether a trial step leads to a camera: not so far that the light overflows."""
    try:
        with np.errstate(over="raise"):
            return bool(np.isfinite(trial.cost))
    except (FloatingPointError, ConfigurationError):
        return False


def _moved(state: FitState, step: Array, origin: FitState | None = None) -> FitState:
    """Return the state after a step of this fit, or of the fit of the point where the derivatives were taken.

    Effects that the model there did not have stay as they are.
    """
    m, k = state.layout.size, state.weights.size
    origin = origin or state
    known, scaled = origin.parameters.size, np.zeros(state.parameters.size)
    scaled[:known] = origin.effect_step(step) * origin.parameters.scale / state.parameters.scale[:known]
    effects, at_bound = state.parameters.moved(scaled)
    return replace(
        state,
        values=state.values + step[:m],
        weights=state.weights + step[m : m + k],
        model=state.model.with_effects(effects),
        frozen=frozenset(at_bound),
        held_terms=state.term_block,
    )
