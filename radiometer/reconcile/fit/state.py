"""The model as fitted so far: effects, nuisances and unnamed terms, with the residual that is left."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Final

import numpy as np

from radiometer.errors import ConfigurationError
from radiometer.reconcile.fit.comparison import Comparison, compare
from radiometer.reconcile.fit.held_out import Groups, HeldOut, leave_one_group_out
from radiometer.reconcile.fit.linear import LinearFit, RowBlock, descended
from radiometer.reconcile.fit.nuisances import Here, NuisanceLayout, rough_log_responsivity
from radiometer.reconcile.fit.terms import LinearTerm, prior_rows
from radiometer.reconcile.measure.design import Array, Design
from radiometer.reconcile.measure.pattern_images import PatternImages
from radiometer.reconcile.measure.seen import CaptureStatistics
from radiometer.reconcile.model.parameters import EffectParameters
from radiometer.reconcile.model.tile_model import Nuisance, TileModel, Trace
from radiometer.reconcile.noise.fixed_patterns import error_of_borders, fixed_errors
from radiometer.reconcile.noise.repeatability import capture_scale, estimate_tau
from radiometer.reconcile.noise.responses import darkness_of, form_floors, light_response
from radiometer.reconcile.noise.shared_errors import Repeatability, relative_bands, relative_flicker
from radiometer.reconcile.prediction import Prediction
from radiometer.reconcile.statistics import usable_entries
from simulators.effects.catalogue import CatalogueEffect

_ITERATIONS: Final = 25
_SHORTER, _SHORTENINGS = 0.3, 6  # steps that are tried
_IDLE: Final = 1e-3  # sigmas that a parameter moves by its whole scale
_CONVERGED: Final = 1e-3  # change of χ², in units of the reduced χ² where that is above 1, that ends the fit
_HOLDS: Final = 0.25  # share of the gain before that a step by old derivatives may have; beyond, new ones are taken
_REWEIGHTINGS: Final = 3
_SETTLED: Final = 0.02  # share of a parameter's size
_PAST_WELL: Final = 1.02  # times the declared full well, which is rounded
_ALIVE: Final = 0.5  # share of its shot noise that a tile keeps where charge does not end


# What of a state was worked out and hangs on the model and the nuisances alone, whatever is frozen or fitted.
_OF_THE_MODEL: Final = ("nuisance", "trace", "prediction", "sensitivity", "parameters")
_OF_THE_POINT: Final = (
    *_OF_THE_MODEL, "term_columns", "plain_residual", "data_residual", "term_residual", "residual", "misfit",
    "_nuisance_derivatives", "nuisance_jacobian", "effect_jacobian", "groups",
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class FitState:
    """One fitted model of one capture set.

    Attributes:
        seen: Measured statistics.
        model: The camera with its effects.
        layout: Which nuisances are fitted.
        values: Nuisance parameters.
        terms: Smooth unnamed terms that were added.
        weights: Their coefficients and those of the realisations, in order.
        comparison: Measured against predicted, with weights.
        tau: Capture-to-capture repeatability.
        frozen: Positions of the effect parameters that are not fitted.
        held_columns: The terms' whitened columns while a fit moves the parameters: like all weights they come from the
            model before it. None where they are to be worked out.
    """

    seen: CaptureStatistics
    model: TileModel
    layout: NuisanceLayout
    values: Array
    terms: tuple[LinearTerm, ...]
    weights: Array
    comparison: Comparison
    tau: float
    frozen: frozenset[int] = field(default_factory=frozenset)
    held_columns: Array | None = None

    @property
    def design(self) -> Design:
        """Return captures and tiles."""
        return self.model.design

    @property
    def effects(self) -> tuple[CatalogueEffect, ...]:
        """Return the effects that were added."""
        return self.model.effects

    @cached_property
    def nuisance(self) -> Nuisance:
        """Return the nuisances."""
        return self.layout.unpack(self.design, self.values)

    @cached_property
    def prediction(self) -> Prediction:
        """Return the expected statistics, unnamed terms left out."""
        return self.trace.prediction

    @cached_property
    def trace(self) -> Trace:
        """Return the chain of the model as it runs."""
        return self.model.trace(self.nuisance)

    def predicted_with(self, effects: Sequence[CatalogueEffect]) -> Prediction:
        """Return the expected statistics with other effects, nuisances as they are."""
        return self.model.predict_again(self.trace, effects)

    @cached_property
    def sensitivity(self) -> Array:
        """Return d(mean)/d(log light) in DN, (captures, tiles)."""
        return light_response(self.model, self.nuisance, self.prediction)[0]

    @cached_property
    def term_columns(self) -> Array:
        """Return the whitened columns of all linear terms."""
        if self.held_columns is not None:
            return self.held_columns
        pieces = [term.build(self.comparison, self.prediction, self.sensitivity) for term in self.terms]
        return np.hstack(pieces) if pieces else np.zeros((self.comparison.size, 0))

    @cached_property
    def parameters(self) -> EffectParameters:
        """Return the fitted parameters of the effects."""
        return self.parameters_of(self.effects)

    def parameters_of(self, effects: Sequence[CatalogueEffect]) -> EffectParameters:
        """Return the fitted parameters of any effects, within the bounds of this camera."""
        return EffectParameters.of(effects, self.design.header.camera.full_scale_dn)

    @cached_property
    def plain_residual(self) -> Array:
        """Return the whitened residual of the data without the linear terms."""
        return self.comparison.residual(self.prediction)

    @cached_property
    def data_residual(self) -> Array:
        """Return the whitened residual of the data, without prior rows."""
        return self.plain_residual - self.term_residual

    @cached_property
    def term_residual(self) -> Array:
        """Return what the linear terms take up of the whitened residual."""
        return np.asarray(self.term_columns @ self.weights)

    @cached_property
    def residual(self) -> Array:
        """Return the whitened residual with the prior rows of nuisances and terms behind it."""
        nuisance_rows, _ = prior_rows(self.layout.prior, self.values)
        term_rows, _ = prior_rows(self._term_prior, self.weights)
        return np.concatenate([self.data_residual, nuisance_rows, term_rows])

    @property
    def cost(self) -> float:
        """Return χ², priors included."""
        return float(self.residual @ self.residual)

    @cached_property
    def misfit(self) -> float:
        """Return the reduced χ² of the entries that count, at least 1."""
        return max(1.0, self.cost / max(int(self.comparison.counts().sum()), 1))

    @cached_property
    def _nuisance_derivatives(self) -> tuple[Array, RowBlock]:
        here = Here(self.model, self.comparison, self.nuisance, self.prediction, self.plain_residual)
        return self.layout.derivatives(here, self.values)

    @cached_property
    def nuisance_jacobian(self) -> RowBlock:
        """Return −d(residual)/d(nuisances and term weights), prior rows included."""
        data = self._nuisance_derivatives[0]
        prior = np.concatenate([self.layout.prior, self._term_prior])
        _, priors = prior_rows(prior, np.zeros(prior.size))
        return RowBlock.of(data, self.term_columns, below=priors, first=self.comparison.size)

    @cached_property
    def effect_jacobian(self) -> Array:
        """Return −d(residual)/d(scaled effect parameter), prior rows (zero) included."""

        def residual_of(effects: tuple[CatalogueEffect, ...]) -> Array:
            return self.comparison.residual(self.predicted_with(effects))

        return self.pad(-self.parameters.differences(residual_of, self.plain_residual))

    @cached_property
    def fit(self) -> LinearFit:
        """Return the linearised fit in nuisances, term weights and effect parameters."""
        effects = self.effect_jacobian
        if self.frozen:
            effects = np.delete(effects, sorted(self.frozen), axis=1)
        return LinearFit.of(self.residual, self.nuisance_jacobian, effects, self._nuisance_derivatives[1])

    @property
    def promised(self) -> float:
        """Return χ² after the best step, were the model linear."""
        return float(self.fit.projected @ self.fit.projected)

    def effect_step(self, step: Array) -> Array:
        """Return the effects' part of a step of the whole fit, 0 for parameters that are frozen."""
        scaled = np.zeros(self.parameters.size)
        free = [i for i in range(scaled.size) if i not in self.frozen]
        scaled[free] = step[self.layout.size + self.weights.size :]
        return scaled

    @cached_property
    def _term_prior(self) -> Array:
        return np.concatenate([term.prior for term in self.terms]) if self.terms else np.zeros(0)

    def pad(self, columns: Array) -> Array:
        """Return data columns with zero prior rows behind them."""
        below = np.zeros((self.residual.size - columns.shape[0], columns.shape[1]))
        return np.vstack([columns, below])

    @cached_property
    def groups(self) -> Groups:
        """Return group of each row and whether it counts: settings first, then each prior row as its own group."""
        setting = self.design.setting_id[self.comparison.capture_of_rows()]
        priors = self.residual.size - setting.size
        behind = setting.max() + 1 + np.arange(priors)
        informative = np.concatenate([self.layout.prior < 1.0, np.zeros(self._term_prior.size, np.bool_)])
        counts = np.concatenate([self.comparison.counts(), informative])
        return Groups(self.nuisance_jacobian, np.concatenate([setting, behind]), counts)

    @cached_property
    def held_out(self) -> HeldOut:
        """Return how well each setting is predicted by the others."""
        return leave_one_group_out(self.fit, self.groups)

    @property
    def evidence(self) -> float:
        """Return the held-out log density with the weights' determinants: comparable between different weights."""
        comparison = self.comparison
        together = comparison.whiteners.values()
        common = sum(float(np.sum(np.log(np.diagonal(whitener, axis1=1, axis2=2)))) for whitener in together)
        others = [n for n in comparison.cuts if n not in comparison.whiteners]
        spread = sum(float(np.sum(np.log(comparison.deviation[n][comparison.usable[n]]))) for n in others)
        return float(np.sum(self.held_out.log_density)) + common - spread

    @property
    def settings(self) -> int:
        """Return the number of settings: the first groups of what is held out."""
        return int(self.design.setting_id.max()) + 1

    @property
    def gap(self) -> float:
        """Return the reduced χ² of held-out settings; prior rows left out."""
        settings = self.settings
        return float(self.held_out.chi2[:settings].sum() / max(self.held_out.count[:settings].sum(), 1.0))


def first_state(
    design: Design, seen: CaptureStatistics, images: PatternImages, given: tuple[CatalogueEffect, ...] = ()
) -> FitState:
    """Return the starting camera fitted to the statistics: nuisances only.

    Args:
        design: Captures and tiles.
        seen: Measured statistics.
        images: Mean picture of each pattern.
        given: Effects that the starting model holds beside the ideal chain; they are not fitted.
    """
    model = replace(TileModel.of(design, images), given=given, passes_well=_passes_well(design, seen))
    layout = NuisanceLayout.of(design)
    values = np.zeros(layout.size)
    if "black_dn" in layout.scalars:  # else darks would be predicted at zero, and left out as clipped for good
        values[layout.scalars.index("black_dn")] = float(np.nanmin(seen.mean))
    rough = model.predict(layout.unpack(design, values))
    unclipped = (seen.high < 1e-3) & (seen.low < 1e-3)
    values[0] = rough_log_responsivity(design, seen.mean, rough, unclipped)
    state = _weighted(seen, model, layout, values, (), tau=1e-3, floors={}, usable=None)
    state = refit(state)
    return refit(reweighted(state))


def _passes_well(design: Design, seen: CaptureStatistics) -> bool:
    """Tell whether tiles hold more than the declared full well and still show the noise of their light.

    The declared well then is not where charge ends: a model that ends there would predict no noise where there is some.
    A plateau that lies above it, for a wrong conversion gain, has lost its noise.
    """
    camera = design.header.camera
    if camera.full_well_e is None or camera.conversion_gain_e_per_dn is None:
        return False
    black = np.where(np.isnan(design.black_level_dn), np.nanmin(seen.mean), design.black_level_dn)
    e_per_dn = (camera.conversion_gain_e_per_dn * 10.0 ** (-design.gain_db / 20.0))[:, None]
    held_e = (seen.mean - black[:, None]) * e_per_dn
    alive = np.nan_to_num(seen.variance) * e_per_dn**2 > _ALIVE * held_e
    return bool(np.any(alive & (held_e > _PAST_WELL * camera.full_well_e) & (seen.high < 1e-3)))


def reweighted(state: FitState) -> FitState:
    """Return the state with repeatability, weights and realisations brought up to date; parameters as they are."""
    tau = _estimate_tau(state)
    smooth = tuple(term for term in state.terms if term.is_smooth)
    kept = _kept_weights(state, smooth)
    model = state.model
    errors = (
        *fixed_errors((*model.given, *model.effects), state.prediction, state.seen, state.design, model.context),
        *error_of_borders(state.comparison.usable["edge"]),
    )
    terms = (*smooth, *(LinearTerm.of(error) for error in errors))
    floors = form_floors(state.model, state.nuisance, state.prediction)
    mask = state.comparison.usable
    again = _weighted(state.seen, state.model, state.layout, state.values, terms, tau, floors, mask, state.trace)
    found = replace(again, weights=np.concatenate([kept, np.zeros(sum(t.size for t in terms) - kept.size)]))
    vars(found).update({name: known for name, known in vars(again).items() if name in _OF_THE_MODEL})
    return found


def settled(state: FitState) -> FitState:
    """Return the state refitted under weights of its own, until these no longer move the parameters."""
    for _ in range(_REWEIGHTINGS):
        before, state = state.parameters.values, approached(reweighted(state))
        after = state.parameters.values
        if before.size != after.size:  # a further term fell to nothing, and the form is the plain one again
            continue
        if not after.size or float(np.max(np.abs(after - before) / state.parameters.scale)) < _SETTLED:
            return _held_at_bounds(state)
    return refit(state)


def with_terms(state: FitState, terms: Sequence[LinearTerm]) -> FitState:
    """Return the state with exactly these smooth terms (realisations kept), not refitted."""
    realised = tuple(term for term in state.terms if not term.is_smooth)
    everything = (*terms, *realised)
    weights = np.zeros(sum(term.size for term in everything))
    return replace(state, terms=everything, weights=weights, held_columns=None)


def with_effects(state: FitState, effects: Sequence[CatalogueEffect]) -> FitState:
    """Return the state with exactly these effects, not refitted."""
    return replace(state, model=state.model.with_effects(effects), frozen=frozenset(), held_columns=None)


def beside(state: FitState, effect: CatalogueEffect, iterations: int = _ITERATIONS) -> FitState:
    """Return the state with a further effect as it is; all else follows by the derivatives of the state without it.

    Where these lead nowhere all else is refitted by derivatives of its own, in so many iterations at most.
    """
    start = replace(with_effects(state, (*state.effects, effect)), held_columns=state.term_columns)
    moved = _moved(start, state.fit.step_from(start.residual)[0], state)
    if _is_within_range(moved) and moved.cost < start.cost:
        return _glided(state, moved, start.cost - moved.cost)[0]
    held = frozenset(range(state.parameters.size, start.parameters.size))
    return refit(replace(start, frozen=held, held_columns=None), iterations)


def refit(state: FitState, iterations: int = _ITERATIONS) -> FitState:
    """Return the state at the least χ² over nuisances, term weights and effect parameters (damped Gauss–Newton).

    Parameters that come frozen within their bounds stay so. They are known by effect and name: a further term that
    falls to nothing on the way is none of its effect's parameters any more, and all behind it move up.
    """
    fixed = _fixed(state)

    def trials(at: FitState) -> Iterator[FitState]:
        for trial in _trials(at):
            yield _held_at_bounds(_glided(at, trial, at.cost - trial.cost)[0], fixed) if trial.cost < at.cost else trial

    return descended(_held_at_bounds(state, fixed), trials, lambda at: _CONVERGED * at.misfit, iterations)


def approached(state: FitState) -> FitState:
    """Return the state near the least χ², for weights that will be brought up to date there.

    As `refit`, but the end is where derivatives of one point lead, if they hold all the way: none are taken there to
    confirm it. Parameters at bounds are not held yet.
    """
    fixed = _fixed(state)
    for _ in range(_ITERATIONS):
        state = _held_at_bounds(state, fixed)
        lower = next((trial for trial in _trials(state) if trial.cost < state.cost), None)
        if lower is None:
            break
        misfit, (state, gained) = state.misfit, _glided(state, lower, state.cost - lower.cost)
        if gained < _CONVERGED * misfit:
            break
    return state


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
        state = state if state.frozen == held else _frozen(state, held)
        if not (on_low | on_high).any():
            return state
        step = state.effect_step(state.fit.step)
        more = held | frozenset(np.flatnonzero((on_low & (step < 0)) | (on_high & (step > 0))).tolist())
        if more == held:
            return state
        held = more


def _frozen(state: FitState, held: frozenset[int]) -> FitState:
    """Return the state with these parameters frozen; what does not hang on that is kept."""
    other = replace(state, frozen=held)
    vars(other).update({name: known for name, known in vars(state).items() if name in _OF_THE_POINT})
    return other


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
    """Tell whether a trial step leads to a camera: not so far that the light overflows."""
    try:
        with np.errstate(over="raise"):
            return bool(np.isfinite(trial.cost))
    except (FloatingPointError, ConfigurationError):
        return False


def _moved(state: FitState, step: Array, origin: FitState | None = None) -> FitState:
    """Return the state after a step of its own fit, or of the fit of the point where the derivatives were taken.

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
        held_columns=state.term_columns,
    )


def _weighted(
    seen: CaptureStatistics,
    model: TileModel,
    layout: NuisanceLayout,
    values: Array,
    terms: tuple[LinearTerm, ...],
    tau: float,
    floors: dict[str, Array],
    usable: object,
    trace: Trace | None = None,
) -> FitState:
    design = model.design
    trace = trace or model.trace(layout.unpack(design, values))
    nuisance, prediction = trace.nuisance, trace.prediction
    sensitivity, response = light_response(model, nuisance, prediction)
    flicker = relative_flicker(prediction) * (prediction.common_variance.max(axis=1) > 0)
    bands = (relative_bands(prediction), prediction.band_frequency)
    repeatability = Repeatability(tau, flicker, prediction.row_variance, *bands)
    mask = usable if isinstance(usable, dict) else usable_entries(design, seen, prediction)
    darkness = darkness_of(model, nuisance, prediction, seen)
    comparison = compare(design, seen, prediction, sensitivity, repeatability, response, floors, mask, darkness)
    weights = np.zeros(sum(term.size for term in terms))
    state = FitState(seen, model, layout, values, terms, weights, comparison, tau)
    vars(state).update({"trace": trace, "sensitivity": sensitivity})
    return state


def _estimate_tau(state: FitState) -> float:
    comparison = state.comparison
    cut, whitener = comparison.cuts["mean"], comparison.whiteners["mean"]
    unnamed = np.linalg.solve(whitener, state.term_residual[cut].reshape(*whitener.shape[:2], 1))[:, :, 0]
    scale, variance = capture_scale(
        state.seen.mean - state.prediction.mean - unnamed,
        state.sensitivity,
        comparison.deviation["mean"],
        comparison.usable["mean"],
    )
    return estimate_tau(state.design, scale, variance)


def _kept_weights(state: FitState, smooth: tuple[LinearTerm, ...]) -> Array:
    kept, at = [], 0
    for term in state.terms:
        if term in smooth:
            kept.append(state.weights[at : at + term.size])
        at += term.size
    return np.concatenate(kept) if kept else np.zeros(0)
