"""Fits go to the least χ² over nuisances, term weights and effect parameters, by Gauss and Newton's steps.

The covariance of what was fitted includes what statistics share. The fit weights each statistic by itself, but two of
them may share the same noise, such as the row noise of a few frames. Their information does not add up then. With X
the covariance between statistics that the weights leave out, the estimate A⁻¹·Jᵀ·r has the covariance
A⁻¹ + A⁻¹·Jᵀ·X·J·A⁻¹.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from radiometer.errors import ConfigurationError
from radiometer.reconciliation.comparison import FAMILY
from radiometer.reconciliation.design import CaptureStatistics, Design
from radiometer.reconciliation.linear import leave_one_group_out
from radiometer.reconciliation.nuisances import NuisanceLayout, rough_log_responsivity
from radiometer.reconciliation.reduce import PatternImages
from radiometer.reconciliation.result import FittedParameter
from radiometer.reconciliation.shared_errors import chances_of_rows
from radiometer.reconciliation.state import FitState, ModelFit, reweighted, value_of, weighted, with_effects
from radiometer.reconciliation.thresholds import is_open
from radiometer.reconciliation.tile_model import TileModel
from radiometer.statistics.chances import frames_counted
from radiometer.typing import Array
from simulators.effects.catalogue import CatalogueEffect

_ITERATIONS: Final = 25
_SHORTER, _SHORTENINGS = 0.3, 6  # steps that are tried
_IDLE: Final = 1e-3  # sigmas that a parameter moves by its whole scale
_CONVERGED: Final = 1e-3  # change of χ², in units of the reduced χ² where that is above 1, that ends the fit
_HOLDS: Final = 0.25  # share of the gain before that a step by old derivatives may have; beyond, new ones are taken
_REWEIGHTINGS: Final = 3
_SETTLED: Final = 0.02  # share of a parameter's size
_PAST_WELL: Final = 1.02  # times the declared full well, which is rounded
_NOTHING_U: Final = 2.0  # standard uncertainties about nothing
_ALIVE: Final = 0.5  # share of its shot noise that a tile keeps where charge does not end


def first_state(
    design: Design, seen: CaptureStatistics, images: PatternImages, given: tuple[CatalogueEffect, ...] = ()
) -> FitState:
    """Return the starting camera fitted to the statistics: nuisances only.

    Args:
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
    state = refit(reweighted(refit(state))).recorded()
    return state if layout.is_linear(state.values) else _from_stated(state)


def _from_stated(state: FitState) -> FitState:
    """Return the state at the stated radiances, all else fitted to them; its linearised fit frees them again.

    Radiances that took up an effect by far more than they may be off can stand where means are not linear in them. At
    the stated ones they are, and in what adds light.
    """
    layout = state.layout
    held = replace(state, layout=layout.held(), values=np.where(layout.stated, 0.0, state.values))
    return replace(refit(held), layout=layout)


def _passes_well(design: Design, seen: CaptureStatistics) -> bool:
    """Return whether tiles hold more than the declared full well and still show the noise of their light."""
    camera = design.header.camera
    if camera.full_well_e is None or camera.conversion_gain_e_per_dn is None:
        return False
    black = np.where(np.isnan(design.black_level_dn), np.nanmin(seen.mean), design.black_level_dn)
    e_per_dn = (camera.conversion_gain_e_per_dn * 10.0 ** (-design.gain_db / 20.0))[:, None]
    held_e = (seen.mean - black[:, None]) * e_per_dn
    alive = np.nan_to_num(seen.variance) * e_per_dn**2 > _ALIVE * held_e
    return bool(np.any(alive & (held_e > _PAST_WELL * camera.full_well_e) & (seen.high < 1e-3)))


def refit(state: FitState, iterations: int = _ITERATIONS) -> FitState:
    """Return the state at the least χ² over nuisances, term weights and effect parameters (damped Gauss–Newton).

    Parameters that come frozen within their bounds stay so. They are known by effect and name: a further term that
    falls to nothing on the way is none of its effect's parameters any more, and all behind it move up.
    """
    return _held_at_bounds(coarse_fit(state, iterations), _fixed(state))


def coarse_fit(state: FitState, iterations: int = _ITERATIONS) -> FitState:
    """Return the same, for weights that will be brought up to date there: parameters at bounds are not held yet.

    The end is where derivatives of one point lead, if they hold all the way: none are taken there to confirm it.
    """
    fixed = _fixed(state)
    for _ in range(iterations):
        state = _held_at_bounds(state, fixed)
        lower = next((trial for trial in _trials(state) if trial.cost < state.cost), None)
        if lower is None:
            break
        misfit, (state, gained) = state.misfit, _glided(state, lower, state.cost - lower.cost)
        if gained < _CONVERGED * misfit:
            break
    return state


def converged_fit(state: FitState) -> FitState:
    """Return the state refitted under its own weights, until these no longer move the parameters; it is recorded.

    Of what does not settle the weights that speak less for it count.
    """
    return _converged(state).recorded()


def _converged(state: FitState) -> FitState:
    for _ in range(_REWEIGHTINGS):
        before, state = state.parameters.values, coarse_fit(reweighted(state))
        after = state.parameters.values
        if before.size != after.size:  # a further term fell to nothing, and the form is the plain one again
            continue
        if not after.size or float(np.max(np.abs(after - before) / state.parameters.scale)) < _SETTLED:
            return _held_at_bounds(state)
    last = refit(state)
    # Beside realisations that its former size allowed a pattern may have been fitted to nothing.
    own = refit(reweighted(last))
    return min(last, own, key=lambda found: found.evidence)


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
    if state.cost - state.promised < _CONVERGED * state.misfit:
        return
    for number in range(_SHORTENINGS):
        trial = _moved(state, _SHORTER**number * state.fit.step)
        if _is_within_range(trial):
            yield trial


def _glided(state: FitState, moved: FitState, gained: float) -> tuple[FitState, float]:
    """Return where further steps by the derivatives of one point lead while these hold, and the last one's gain."""
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
    """Return the state after a step of this fit, or of the fit of the point where the derivatives were taken."""
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


# ---- with a further effect ------------------------------------------------------------------------------------------
class UnfitError(ArithmeticError):
    """An effect cannot be fitted to the data; its name is the argument."""


def accepted(state: FitState, effect: CatalogueEffect) -> FitState:
    """Return the state with the effect in the model, not refitted yet; one that repeats joins its like."""
    effects = tuple(old.joined(effect) if old.name == effect.name else old for old in state.effects)
    if all(old.name != effect.name for old in state.effects):
        effects = (*effects, effect)
    return with_effects(state, effects)


def included(state: FitState, effect: CatalogueEffect) -> FitState:
    """Return the state with the effect in the model, refitted in full: all else moves first, then its parameters too.

    Args:
        state: The model without it.
        effect: The effect at its best parameters, nuisances having followed linearly.

    Raises:
        UnfitError: If with it the model predicts what no camera does, or if its essential parameter falls to nothing.
    """
    following = accepted(state, effect)
    mine = frozenset(i for i, at in enumerate(following.parameters.owner) if following.effects[at].name == effect.name)
    try:
        moved = replace(coarse_fit(replace(following, frozen=mine)), frozen=frozenset())
        fitted = _converged(coarse_fit(_profiled_anew(moved)))
    except (np.linalg.LinAlgError, ConfigurationError) as error:  # no covariance, or parameters that are no numbers
        raise UnfitError(effect.name) from error
    if _is_nothing(fitted, effect.name):  # no separate model, so none of the posterior's
        raise UnfitError(effect.name)
    return fitted.recorded()


def _is_nothing(state: FitState, name: str) -> bool:
    """Return whether an essential parameter of an effect is no further from doing nothing than chance may take it."""
    own, sigma = state.parameters, np.sqrt(np.maximum(np.diag(_of_a_model_that_is_right(state)), 0.0))
    free = [i for i in range(own.size) if i not in state.frozen]
    u = {(own.owner[i], own.names[i]): size * own.scale[i] for i, size in zip(free, sigma, strict=True)}
    return any(
        abs(getattr(effect, essential) - effect.neutral(essential)) <= _NOTHING_U * u.get((at, essential), 0.0)
        for at, effect in enumerate(state.effects)
        for essential in effect.essential
        if effect.name == name and essential in effect.free()
    )


def _profiled_anew(state: FitState) -> FitState:
    """Return the state with a parameter in which the prediction jumps where it fits best next to the newest effect."""
    for effect in state.effects[:-1]:
        if effect.profiled:
            others = with_effects(state, [other for other in state.effects if other is not effect])
            found = fit_candidate(others, Candidate(effect, 0.0, len(effect.free()) or 1)).effect
            state = with_effects(state, [found if other is effect else other for other in state.effects])
    return state


# ---- one further effect, all else following linearly ---------------------------------------------------------------
_CANDIDATE_ITERATIONS: Final = 25
_CANDIDATE_CONVERGED: Final = 0.02
_DAMPING, _LESS, _MORE, _DAMPINGS = 1e-3, 0.3, 10.0, 5
_VARIANTS: Final = 12  # each is a whole fit: bounds the time that one name takes, the likeliest first
_PROFILE_POINTS: Final = 61
_PROFILE_SPANS: Final = (0.002, 0.0002)


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """One start of one entry."""

    effect: CatalogueEffect  # the effect at its start
    gain: float  # χ² that it would explain if it acted linearly
    parameters: int  # number of its fitted parameters (one more where it acts without any)
    flexible: bool = False  # whether it is a cover, a flexible form that takes up any equation of the effect
    others: tuple[CatalogueEffect, ...] = ()  # further starts that did about as well
    tries: int = 1  # number of starts that the entry had: the more, the likelier one fits by chance


@dataclass(frozen=True, eq=False)
class FittedCandidate:
    """An effect at its best parameters."""

    effect: CatalogueEffect  # the effect
    start: Candidate  # where the fit began
    gain: float  # χ² that it explains
    evidence: float  # χ² that it explains in the statistics that must show it
    residual: Array  # whitened residual with the effect, nuisances where they were; prior rows included
    columns: Array  # −d(residual)/d(scaled parameter of the effect), prior rows included
    overrated: float  # nats that the scores of few frames' variances promise beyond their exact likelihood
    forms: tuple[CatalogueEffect, ...] = ()  # the best of each variant: where to begin with another model

    @property
    def name(self) -> str:
        """Return the effect's name."""
        return self.effect.name


def fit_candidate(state: FitState, candidate: Candidate) -> FittedCandidate:
    """Return the effect at the least χ², all nuisances and earlier effects following linearly."""
    trials = _Trial.of_each(state, (candidate.effect, *candidate.others))
    best = min(trials, key=lambda trial: trial.cost)
    begun = [_profiled(state, best)] if best.effect.profiled else _variants(trials)
    fitted = [_fitted_from(state, trial) for trial in begun]
    judged = _judged(state, min(fitted, key=lambda trial: trial.cost), candidate)
    return replace(judged, forms=tuple(trial.effect for trial in fitted))


def _variants(trials: Sequence[_Trial]) -> list[_Trial]:
    """Return the best trial of each variant, a dozen at most: what is not fitted is tried in all of them."""
    found: dict[tuple[object, ...], _Trial] = {}
    for trial in sorted(trials, key=lambda trial: trial.cost):
        found.setdefault(variant_of(trial.effect), trial)
    return list(found.values())[:_VARIANTS]


def variant_of(effect: CatalogueEffect) -> tuple[object, ...]:
    """Return what is not fitted of an effect."""
    free = {name.split("[")[0] for name in effect.free()}
    return tuple(value for name, value in effect.values().items() if name not in free)


def _fitted_from(state: FitState, start: _Trial) -> _Trial:
    damping, trial = _DAMPING, start
    for _ in range(_CANDIDATE_ITERATIONS if start.effect.free() else 0):
        lower, normal = None, trial.normal(state)
        for _ in range(_DAMPINGS):
            further = trial.stepped(state, *normal, damping)
            if further is not None and further.cost < trial.cost:
                lower = further
                break
            damping = max(damping * _MORE, _DAMPING)
        if lower is None:
            break
        gained, trial, damping = trial.cost - lower.cost, lower, damping * _LESS
        if gained < _CANDIDATE_CONVERGED * state.misfit:
            break
    return trial


@dataclass(frozen=True, eq=False)
class _Trial:
    effect: CatalogueEffect
    change: Array  # what it changes of the whitened prediction
    residual: Array
    half: Array  # what the nuisances and earlier effects take up of it: L⁻¹·Jᵀ·residual
    cost: float

    @classmethod
    def of_each(cls, state: FitState, effects: Sequence[CatalogueEffect]) -> list[_Trial]:
        """Return the trial of each effect: its residual, and its χ² after the nuisances followed."""
        changes = state.moved_by([(*state.effects, effect) for effect in effects])
        residuals, halves = state.fit.followed_with_half(state.residual[:, None] - state.pad(changes))
        costs = np.einsum("ij,ij->j", residuals, residuals) - np.einsum("ij,ij->j", halves, halves)
        columns = zip(effects, changes.T, residuals.T, halves.T, costs.tolist(), strict=True)
        return [cls(effect, *own) for effect, *own in columns]

    def moves(self, state: FitState) -> Array:
        """Return −d(residual)/d(scaled parameter), prior rows included, with followers that stand still."""
        steps, several = state.parameters_of((self.effect,)).a_step_away()
        moved = state.moved_by([(*state.effects, *own) for own in several])
        return state.pad((moved - self.change[:, None]) / steps)

    def normal(self, state: FitState) -> tuple[Array, Array]:
        """Return AᵀA and Aᵀ·residual for the columns A freed of what the nuisances and earlier effects take up."""
        columns, part = state.fit.followed_with_half(self.moves(state))
        return columns.T @ columns - part.T @ part, columns.T @ self.residual - part.T @ self.half

    def stepped(self, state: FitState, normal: Array, right: Array, damping: float) -> _Trial | None:
        """Return the trial after one damped Gauss–Newton step; None where the step is no number."""
        own = state.parameters_of((self.effect,))
        lifted = normal + np.diag(damping * np.diag(normal) + 1e-9 * max(float(np.trace(normal)), 1e-12))
        step = np.linalg.solve(lifted, right)
        if not np.isfinite(step).all():
            return None
        (effect,), _ = own.moved(np.clip(step, -30.0, 30.0))
        return _Trial.of_each(state, (effect,))[0]


def _profiled(state: FitState, best: _Trial) -> _Trial:
    """Search the parameter in which the prediction jumps on ever denser grids about its start."""
    name = best.effect.profiled
    for span in _PROFILE_SPANS:
        middle = float(getattr(best.effect, name))
        grid = middle * np.linspace(1.0 - span, 1.0 + span, _PROFILE_POINTS)
        trials = _Trial.of_each(state, [best.effect.with_parameters(**{name: value}) for value in grid.tolist()])
        best = min(trials, key=lambda trial: trial.cost)
    return best


def _judged(state: FitState, best: _Trial, candidate: Candidate) -> FittedCandidate:
    own = state.parameters_of((best.effect,))
    inside = (own.values - own.low > 1e-6 * own.scale) & (own.high - own.values > 1e-6 * own.scale)
    columns = state.fit.followed(best.moves(state))[:, inside]
    fit = state.fit.extended(columns, best.residual)
    before = _family_chi2(state, state.fit.projected)
    after = _family_chi2(state, fit.projected)
    rows = state.comparison.size
    stated = float(np.sum(state.fit.projected[rows:] ** 2) - np.sum(fit.projected[rows:] ** 2))
    gain = sum(before.values()) - sum(after.values()) + stated
    shown = (best.effect.block, *best.effect.also)
    evidence = sum(before.get(block, 0.0) - after.get(block, 0.0) for block in shown)
    if "mean" in shown:  # what the means say against the stated radiances stands in the prior rows
        evidence += stated
    more = _overrated(state, best.effect, {name: before[name] - after[name] for name in ("common", "bands")})
    gain, evidence = gain - 2.0 * more, evidence - 2.0 * more
    return FittedCandidate(best.effect, candidate, gain, evidence, best.residual, columns, more)


def _overrated(state: FitState, effect: CatalogueEffect, promised: Mapping[str, float]) -> float:
    """Return by how many nats the normal scores of few frames' variances flatter a variance fitted to them."""
    predicted = state.predicted_with((*state.effects, effect))
    exact = {"common": state.comparison.common_deviance, "bands": state.comparison.band_deviance}
    gains = {n: exact[n](state.prediction) - exact[n](predicted) for n, gain in promised.items() if gain > 0}
    return sum(max(promised[name] - gain, 0.0) for name, gain in gains.items()) / 2.0


def _family_chi2(state: FitState, residual: Array) -> dict[str, float]:
    found: dict[str, float] = {}
    for name, cut in state.comparison.cuts.items():
        family = FAMILY.get(name, name)
        found[family] = found.get(family, 0.0) + float(np.sum(residual[cut] ** 2))
    return found


def judged_gain(state: FitState, fitted: FittedCandidate) -> float:
    """Return by how many nats a fitted effect improves the prediction of held-out settings; its model is recorded."""
    effects, size = (*state.effects, fitted.effect), fitted.start.parameters
    return _recorded_gain(state, effects, fitted.residual, fitted.columns, 0, size, fitted.overrated)


def curve_gain(state: FitState, columns: Array) -> float:
    """Return the same of the columns of a curve without a name; its model is recorded too."""
    size = columns.shape[1]
    return _recorded_gain(state, state.effects, state.fit.residual, columns, size, size)


def _recorded_gain(
    state: FitState, effects: tuple[CatalogueEffect, ...], residual: Array, columns: Array,
    curves: int, parameters: int, overrated: float = 0.0,
) -> float:  # fmt: skip
    """Return by how many nats further columns improve the prediction of held-out groups, and record the model."""
    gains = leave_one_group_out(state.fit.extended(columns, residual), state.groups).log_density
    gains = gains - state.held_out.log_density
    gains[: state.settings] -= overrated / state.settings
    density, own = state.log_density + gains[: state.log_density.size], state.parameters.size + state.curves
    state.models.append(ModelFit(effects, state.curves + curves, density, own + parameters))
    return float(np.sum(gains))


# ---- parameters and covariance --------------------------------------------------------------------------------------
_BLOCKS: Final = 5  # along a covariate, each left out in turn
_ALONE: Final = 0.9  # share of a direction determined by one group, beyond which the others cannot check it
_WAVE: Final = "bands"
_SIZE: Final = "modulation"
_SEES_WAVE: Final = ("variance", "neighbour_x", "neighbour_y", "row_temporal", _WAVE)


def is_misfit(state: FitState) -> bool:
    """Return whether structure remains: the gap of held-out settings exceeds 1 by more than chance."""
    return is_open(state.gap, float(state.held_out.count[: state.settings].sum()))


def scatter_of(state: FitState) -> float:
    """Return by how much χ² counts too high where structure is left: the gap of held-out settings, 1 where none is.

    What entries scatter by for no known reason they do for any model; nats are worth that much less.

    Source: Wedderburn (1974), Biometrika 61 439, the dispersion of a quasi-likelihood.
    """
    return state.gap if is_misfit(state) else 1.0


def effect_covariance(state: FitState) -> Array:
    """Return the covariance of the free effect parameters in units of their scales, what statistics share included.

    While structure is left, it is widened by what that structure does to the parameters. It is worked out once for a
    state: verdict, doubts, report and model file all ask for it.
    """
    known = vars(state)
    if "effect_covariance" not in known:
        covariance = _of_a_model_that_is_right(state)
        if covariance.size and is_misfit(state):
            own = np.diag(covariance)
            wider = np.sqrt(np.maximum(_by_misfit(state), own) / np.where(own > 0, own, 1.0))
            covariance = np.asarray(covariance * wider[:, None] * wider)
        known["effect_covariance"] = covariance
    found: Array = known["effect_covariance"]
    return found


def _by_misfit(state: FitState) -> Array:
    """Return the variance of each free effect parameter that follows from the structure in the residual, (parameters,).

    Where structure is left, entries are off by more than their uncertainty (by the gap of their statistic), and not
    independently of each other (along a covariate). The former is the sum over statistics of gap times what they
    would move the parameter; the latter is seen by leaving out settings, and blocks along each covariate, in turn.

    Source: Birge (1932) for the gap; Künsch (1989), Ann. Stat. 17 1217, for the jackknife by blocks.
    """
    first = state.layout.size + state.weights.size
    pulls = _pulls(state, first) ** 2
    found = pulls[state.comparison.size :].sum(axis=0)
    for name, cut in state.comparison.cuts.items():
        gap = float(np.sum(state.fit.projected[cut] ** 2)) / max(state.comparison.degrees(name), 1)
        found = found + max(gap, 1.0) * pulls[cut].sum(axis=0)
    capture = state.comparison.capture_of_rows()
    for group in _groupings(state):
        found = np.maximum(found, _jackknife(state, group[capture], first))
    return np.asarray(found)


def _groupings(state: FitState) -> Iterator[NDArray[np.intp]]:
    design = state.design
    yield design.held_out_id
    for values in (design.exposure_s, design.temperature_c, design.timestamp_s, design.gain_db, design.source_level):
        levels = np.unique(values[np.isfinite(values)])
        if levels.size > 1 and np.isfinite(values).all():
            yield np.searchsorted(levels, values) * min(_BLOCKS, levels.size) // levels.size


def _jackknife(state: FitState, group: NDArray[np.intp], first: int) -> Array:
    """Return the variance of the free effect parameters over fits without one group each, exact where it is linear."""
    fit, size = state.fit, state.comparison.size
    columns = np.zeros((size, first + fit.effects.shape[1]))
    known = fit.nuisances.rows[fit.nuisances.rows < size]
    columns[known, :first] = fit.nuisances.values[: known.size]
    columns[:, first:] = fit.effects[:size]
    whitened = fit.half(columns.T).T  # parameters in units of what all rows show of them
    shifts = []
    for number in np.unique(group):
        mine = whitened[group == number]
        share, vectors = np.linalg.eigh(mine.T @ mine)  # the share of each direction that this group determines
        pulled = vectors.T @ (mine.T @ fit.projected[:size][group == number])
        step = np.where(share < _ALONE, pulled / np.maximum(1.0 - share, 1.0 - _ALONE), 0.0)
        shifts.append(solve_triangular(fit.factor, vectors @ step, lower=True, trans="T")[first:])
    count = len(shifts)
    return np.asarray((count - 1.0) / count * np.sum(np.square(shifts), axis=0))


def _of_a_model_that_is_right(state: FitState) -> Array:
    first = state.layout.size + state.weights.size
    covariance = state.fit.covariance[first:, first:]
    if not covariance.size:
        return covariance
    pulls: Array | None = None
    for columns, alone in _left_out(state):
        pulls = _pulls(state, first) if pulls is None else pulls
        parts, held = [], np.zeros_like(covariance)
        for name, values in columns.items():
            own = pulls[state.comparison.cuts[name]].reshape(*values.shape[:2], -1)
            part = np.matmul(own.transpose(0, 2, 1), values)  # (captures, parameters, z)
            counted = own.transpose(0, 2, 1) * values.transpose(0, 2, 1) if name in alone else part
            held = held + np.einsum("cpr,cqr->pq", counted, counted)
            parts.append(part)
        together = np.sum(parts, axis=0)
        covariance = covariance + np.einsum("cpr,cqr->pq", together, together) - held
    return np.asarray(covariance)


def _left_out(state: FitState) -> Iterator[tuple[dict[str, Array], frozenset[str]]]:
    """Yield what one z does to several statistics, whitened, (captures, entries, z).

    With it come the names of those of which the weights hold the entries' own variance alone.
    """
    if wave := _wave_columns(state):
        yield {name: values[:, :, None] for name, values in wave.items()}, frozenset(wave) - {_WAVE}
    comparison = state.comparison
    for error in chances_of_rows(comparison.design, comparison.seen, state.prediction, comparison.band_freedom):
        root = np.sqrt(error.variance)[:, None, None]
        whitened = {name: comparison.whitened(name, part) for name, part in error.parts.items()}
        yield {n: root * values.reshape(len(root), -1, values.shape[-1]) for n, values in whitened.items()}, frozenset()


def _wave_columns(state: FitState) -> dict[str, Array]:
    """Return what the phases of a capture's few frames do to its statistics, by block, whitened, (captures, entries).

    The mean over n frames is taken out of a wave along the rows. What that leaves of its power scatters by
    √(1/(n·(n − 1))) relatively, alike in all tiles and all frequencies.
    """
    own, comparison = state.parameters, state.comparison
    size = [i for i, n in enumerate(own.names) if n == _SIZE and own.effects[own.owner[i]].block == _WAVE]
    if not size:
        return {}
    moved = 0.5 * state.effect_jacobian[:, size[0]] * own.values[size[0]] / own.scale[size[0]]
    found = {}
    for name in _SEES_WAVE:
        all_frames = state.design.frame_count
        frames = np.maximum(frames_counted(all_frames) if name == _WAVE else all_frames, 2.0)
        spread = np.sqrt(1.0 / (frames * (frames - 1.0)))
        found[name] = moved[comparison.cuts[name]].reshape(frames.size, -1) * spread[:, None]
    return found


def _pulls(state: FitState, first: int) -> Array:
    """Return by how much each entry of the residual moves each free effect parameter, (entries, parameters)."""
    fit = state.fit
    count = fit.effects.shape[1]
    unit = np.zeros((first + count, count))
    unit[first:] = np.eye(count)
    solved = fit.solve(unit)
    pulls = fit.effects @ solved[first:]
    pulls[fit.nuisances.rows] += fit.nuisances.values @ solved[:first]
    return np.asarray(pulls)


def fitted_parameters(state: FitState) -> dict[str, dict[str, FittedParameter]]:
    """Return the parameters of all effects with their standard uncertainties, by effect and parameter name."""
    own = state.parameters
    free = [i for i in range(own.size) if i not in state.frozen]
    sigma = np.full(own.size, np.nan)
    sigma[free] = np.sqrt(np.maximum(np.diag(effect_covariance(state)), 0.0))
    found: dict[str, dict[str, FittedParameter]] = {}
    for index, effect in enumerate(state.effects):
        units = {entry.name: entry.unit for entry in effect.parameters()}
        found[effect.name] = {
            name: FittedParameter(float(value), None, units[name])
            for name, value in effect.values().items()
            if isinstance(value, float | int)
        }
        for position, name in enumerate(own.names):
            if own.owner[position] == index:
                u = float(sigma[position] * own.scale[position])
                unit = units[name.split("[")[0]]
                found[effect.name][name] = FittedParameter(value_of(effect, name), u if np.isfinite(u) else None, unit)
    return found
