"""The model as fitted so far: effects, nuisances and unnamed terms, with the residual that is left."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from radiometer.reconciliation.comparison import Comparison, compare
from radiometer.reconciliation.design import CaptureStatistics, Design
from radiometer.reconciliation.linear import Groups, HeldOut, LinearFit, RowBlock, leave_one_group_out
from radiometer.reconciliation.nuisances import Change, NuisanceLayout
from radiometer.reconciliation.repeatability import capture_scale, estimate_tau
from radiometer.reconciliation.shared_errors import (
    FixedError,
    Repeatability,
    darkness_of,
    error_of_borders,
    error_of_histograms,
    errors_of_few_pixels,
    fixed_errors,
    form_floors,
    light_response,
    relative_bands,
    relative_flicker,
)
from radiometer.reconciliation.statistics import Prediction, honest_comb, usable_entries
from radiometer.reconciliation.tile_model import Nuisance, TileModel, Trace, predict_several
from radiometer.typing import Array
from simulators.effects.catalogue import CatalogueEffect

_STEP: Final = 1e-3  # of the parameter's scale
_AT_BOUND: Final = 1e-9


@dataclass(frozen=True, slots=True)
class EffectParameters:
    """Names, scales and bounds of all fitted parameters."""

    effects: tuple[CatalogueEffect, ...]  # the effects
    owner: tuple[int, ...]  # position of the effect that each parameter belongs to
    names: tuple[str, ...]  # its name
    scale: Array  # its typical size
    low: Array  # its lowest value
    high: Array  # its highest value

    @classmethod
    def of(cls, effects: Sequence[CatalogueEffect], full_scale_dn: float) -> EffectParameters:
        """Return the fitted parameters of effects, bounds in digital numbers being those of a camera's full scale."""
        owner, names, scale, low, high = [], [], [], [], []
        for index, effect in enumerate(effects):
            for name in effect.free():
                owner.append(index)
                names.append(name)
                plain = name.split("[")[0]
                scale.append(max(abs(value_of(effect, name)), 0.1 * _typical(effect, plain), 1e-12))
                lowest, highest = effect.reach(plain, full_scale_dn)
                low.append(lowest)
                high.append(highest)
        return cls(tuple(effects), tuple(owner), tuple(names), np.array(scale), np.array(low), np.array(high))

    @property
    def size(self) -> int:
        """Return the number of parameters."""
        return len(self.names)

    @property
    def values(self) -> Array:
        """Return their values in their own units."""
        return np.array([value_of(self.effects[o], n) for o, n in zip(self.owner, self.names, strict=True)])

    def moved(self, scaled_step: Array) -> tuple[tuple[CatalogueEffect, ...], tuple[int, ...]]:
        """Return the effects after a step in units of the scales, and which parameters were stopped by a bound."""
        proposed = self.values + scaled_step * self.scale if self.size else self.values
        kept = np.clip(proposed, self.low, self.high) if self.size else proposed
        stopped = tuple(i for i in range(self.size) if abs(kept[i] - proposed[i]) > _AT_BOUND * self.scale[i])
        return self.replaced(kept), stopped

    def on_bounds(self) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Return which parameters stand on their lower and which on their upper bound."""
        span = _AT_BOUND * self.scale
        return self.values - self.low <= span, self.high - self.values <= span

    def replaced(self, values: Array) -> tuple[CatalogueEffect, ...]:
        """Return the effects with these parameter values."""
        changes: list[dict[str, Any]] = [{} for _ in self.effects]
        for owner, name, value in zip(self.owner, self.names, values.tolist(), strict=True):
            plain, _, place = name.partition("[")
            if not place:
                changes[owner][plain] = value
                continue
            table = list(changes[owner].get(plain, getattr(self.effects[owner], plain)))
            table[int(place[:-1])] = value
            changes[owner][plain] = tuple(table)
        return tuple(_changed(e, c) for e, c in zip(self.effects, changes, strict=True))

    def of_effect(self, place: int) -> list[int]:
        """Return the positions of the parameters of one effect."""
        return [index for index, owner in enumerate(self.owner) if owner == place]

    def a_step_away(
        self, share: float = _STEP, only: Sequence[int] | None = None
    ) -> tuple[Array, list[tuple[CatalogueEffect, ...]]]:
        """Return a step of each parameter in units of the scales, within the bounds, and the effects after it.

        Args:
            only: Positions of the parameters that are moved; by default all are.
        """
        index = np.arange(self.size) if only is None else np.array(only, dtype=np.intp)
        values, scale = self.values, self.scale[index]
        steps = np.where(values[index] + share * scale <= self.high[index], share, -share)
        moved = np.tile(values, (index.size, 1))
        moved[np.arange(index.size), index] += steps * scale
        return steps, [self.replaced(one) for one in moved]


def _changed(effect: CatalogueEffect, values: dict[str, Any]) -> CatalogueEffect:
    if all(getattr(effect, name) == value for name, value in values.items()):
        return effect
    return effect.with_parameters(**values)


def value_of(effect: CatalogueEffect, name: str) -> float:
    """Return a parameter's value; `name[2]` is the third entry of a table."""
    plain, _, place = name.partition("[")
    value = getattr(effect, plain)
    return float(value[int(place[:-1])] if place else value)


def _typical(effect: CatalogueEffect, name: str) -> float:
    """Return a parameter's typical size: the largest among the trials, else its usual value, else 1 %.

    A trial that begins at nothing shows no size. A usual value at the upper end of the range is no size either: a
    threshold there means that there is none.
    """
    tried = [abs(trial[name]) for trial in effect.trials if trial.get(name)]
    usual = {e.name: e.default for e in effect.parameters() if isinstance(e.default, float) and e.default != e.high}
    return max(tried, default=abs(usual.get(name, 0.0)) or 0.01)


ColumnBuilder = Callable[[Comparison, Prediction, Array], Array]


@dataclass(frozen=True, slots=True, eq=False)
class LinearTerm:
    """Something that adds to the statistics in proportion to its coefficients."""

    name: str  # what it is, for messages
    # Gives its whitened columns, (entries, coefficients), for a comparison, prediction and sensitivity
    build: ColumnBuilder
    prior: Array  # (coefficients,) prior standard deviation; infinite for none
    block: str = ""  # statistic that it acts on
    where: str = ""  # covariate along which it acts
    form: str = ""  # multiplicative, additive, or additive × gain

    @classmethod
    def of(cls, error: FixedError) -> LinearTerm:
        """Return the term that fits an error which is the same in all captures."""

        def build(comparison: Comparison, prediction: Prediction, sensitivity: Array) -> Array:
            columns = np.zeros((comparison.size, error.sigma.size))
            for name, part in error.parts(prediction).items():
                columns[comparison.cuts[name]] = comparison.whitened(name, part)
            return columns

        return cls(error.name, build, error.sigma)

    @property
    def size(self) -> int:
        """Return the number of coefficients."""
        return int(self.prior.size)

    @property
    def is_smooth(self) -> bool:
        """Return whether it is an unnamed empirical term (and not a realisation of an accepted effect)."""
        return bool(self.where)


def inverse(prior: Array) -> Array:
    """Return 1/σ of parameters' priors; 0 for infinite ones."""
    return np.where(np.isfinite(prior), 1.0 / np.where(np.isfinite(prior), prior, 1.0), 0.0)


def prior_residual(prior: Array, values: Array) -> Array:
    """Return the residual of the priors' rows: each is an observation that its parameter is nothing."""
    return np.asarray(-values * inverse(prior))


@dataclass(frozen=True, slots=True, eq=False)
class ModelFit:
    """One fitted model."""

    effects: tuple[CatalogueEffect, ...]  # its effects at their fitted parameters
    curves: int  # number of columns of its curves without a name
    # (groups,) held-out log density of settings and stated values, determinants of the weights included
    log_density: Array
    parameters: int  # number of fitted parameters, columns of curves included
    gap: float = np.nan  # reduced χ² of held-out settings; NaN where the nuisances followed linearly
    # Standard uncertainty of each fitted parameter by effect and name; empty where the gap is NaN
    u: dict[tuple[str, str], float] = field(default_factory=dict)

    @property
    def is_full(self) -> bool:
        """Return whether nuisances, weights and all effects were fitted together."""
        return bool(np.isfinite(self.gap))


# What of a state was worked out and hangs on the model and the nuisances alone, whatever is frozen or fitted.
_OF_THE_MODEL: Final = ("nuisance", "trace", "prediction", "sensitivity", "parameters")
_OF_THE_DATA: Final = (*_OF_THE_MODEL, "plain_residual", "_expected", "_derivatives")  # and weights
_OF_THE_POINT: Final = (
    *_OF_THE_DATA, "term_block", "data_residual", "term_residual", "residual", "misfit",
    "nuisance_jacobian", "effect_jacobian", "whole_fit", "groups",
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class FitState:
    """One fitted model of one capture set."""

    seen: CaptureStatistics  # measured statistics
    model: TileModel  # the camera with its effects
    layout: NuisanceLayout  # which nuisances are fitted
    values: Array  # nuisance parameters
    terms: tuple[LinearTerm, ...]  # smooth unnamed terms that were added
    weights: Array  # their coefficients and those of the realisations, in order
    comparison: Comparison  # measured against predicted, with weights
    tau: float  # capture-to-capture repeatability
    frozen: frozenset[int] = field(default_factory=frozenset)  # positions of the effect parameters that are not fitted
    # The terms' whitened columns while a fit moves the parameters: like all weights they come from the model before it.
    # None where they are to be worked out.
    held_terms: RowBlock | None = None
    # The models fitted to these data so far; all states of one search share the list
    models: list[ModelFit] = field(default_factory=list)

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
        return self.model.with_effects(effects).predict(self.trace.nuisance, self.trace)

    @cached_property
    def sensitivity(self) -> Array:
        """Return d(mean)/d(log light) in DN, (captures, tiles)."""
        return light_response(self.model, self.trace)[0]

    @cached_property
    def term_block(self) -> RowBlock:
        """Return the whitened columns of all linear terms."""
        if self.held_terms is not None:
            return self.held_terms
        pieces = [term.build(self.comparison, self.prediction, self.sensitivity) for term in self.terms]
        return RowBlock.of(np.hstack([np.zeros((self.comparison.size, 0)), *pieces]))

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
    def _expected(self) -> dict[str, Array]:
        return self.comparison.expected(self.prediction)

    @cached_property
    def data_residual(self) -> Array:
        """Return the whitened residual of the data, without prior rows."""
        return self.plain_residual - self.term_residual

    @cached_property
    def term_residual(self) -> Array:
        """Return what the linear terms take up of the whitened residual."""
        return self.term_block.times(self.weights, self.comparison.size)

    @cached_property
    def residual(self) -> Array:
        """Return the whitened residual with the prior rows of nuisances and terms behind it."""
        nuisances = prior_residual(self.layout.prior, self.values)
        return np.concatenate([self.data_residual, nuisances, prior_residual(self._term_prior, self.weights)])

    @property
    def cost(self) -> float:
        """Return χ², priors included."""
        return float(self.residual @ self.residual)

    @cached_property
    def misfit(self) -> float:
        """Return the reduced χ² of the entries that count, at least 1."""
        return max(1.0, self.cost / max(int(self.comparison.counts().sum()), 1))

    @cached_property
    def _derivatives(self) -> tuple[RowBlock, RowBlock, Array]:
        """Return the nuisances' derivatives and those of the scaled effect parameters, all by steps walked together."""
        nuisances = [*self.layout.moves(self.trace.nuisance)]
        steps, effects = self.parameters.a_step_away()
        models = [(self.model, nuisance) for nuisance, _ in nuisances]
        models += [(self.model.with_effects(moved), self.trace.nuisance) for moved in effects]
        means = np.empty((len(models), *self.prediction.mean.shape))
        residuals = np.empty((self.comparison.size, len(models)))
        for numbers, there in predict_several(models, self.trace):
            means[numbers] = there.mean - self.prediction.mean
            residuals[:, numbers] = self.comparison.changes(self._expected, there)
        changes = [
            Change(mean / step, residual / step)
            for (_, step), mean, residual in zip(nuisances, means, residuals.T, strict=False)
        ]
        own = -residuals[:, len(nuisances) :] / steps
        return (*self.layout.derivatives(self.comparison, changes, self.values), own)

    @cached_property
    def nuisance_jacobian(self) -> RowBlock:
        """Return −d(residual)/d(nuisances and term weights), prior rows included."""
        prior = np.concatenate([self.layout.prior, self._term_prior])
        return self._derivatives[0].joined_with(self.term_block, self.comparison.size, inverse(prior))

    @cached_property
    def effect_jacobian(self) -> Array:
        """Return −d(residual)/d(scaled effect parameter), prior rows (zero) included."""
        return self.pad(self._derivatives[2])

    def moved_by(self, several: Sequence[Sequence[CatalogueEffect]]) -> Array:
        """Return what sets of effects change of the whitened prediction of the data, (entries, sets).

        Nuisances stay as they are.
        """
        models = [(self.model.with_effects(effects), self.trace.nuisance) for effects in several]
        moved = np.empty((len(several), self.comparison.size))
        for numbers, prediction in predict_several(models, self.trace):
            moved[numbers] = -self.comparison.changes(self._expected, prediction).T
        return moved.T

    @cached_property
    def fit(self) -> LinearFit:
        """Return the linearised fit in nuisances, term weights and effect parameters."""
        return self.whole_fit.without(sorted(self.frozen)) if self.frozen else self.whole_fit

    @cached_property
    def whole_fit(self) -> LinearFit:
        """Return the same fit with the frozen parameters free."""
        return LinearFit.of(self.residual, self.nuisance_jacobian, self.effect_jacobian, self._derivatives[1])

    @property
    def promised(self) -> float:
        """Return χ² after the best step, were the model linear."""
        return float(self.fit.residual @ self.fit.residual) - self.fit.gain

    def with_frozen(self, held: frozenset[int]) -> FitState:
        """Return the state with these parameters frozen; what does not depend on them is kept."""
        return _knowing(replace(self, frozen=held), self, _OF_THE_POINT)

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
        setting = self.design.held_out_id[self.comparison.capture_of_rows()]
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
    def curves(self) -> int:
        """Return the number of columns of the curves without a name."""
        return sum(term.size for term in self.terms if term.is_smooth)

    @cached_property
    def log_density(self) -> Array:
        """Return the held-out log density of settings and stated values with the weights' determinants, (groups,).

        It is comparable between different weights.
        """
        comparison, setting = self.comparison, self.design.held_out_id
        found = self.held_out.log_density[: self.settings + self.layout.size].copy()
        for name in comparison.cuts:
            if name in comparison.whiteners:
                root = np.log(np.diagonal(comparison.whiteners[name], axis1=1, axis2=2))
            else:
                usable = comparison.usable[name]
                root = -np.where(usable, np.log(np.where(usable, comparison.deviation[name], 1.0)), 0.0)
            found[: self.settings] += np.bincount(setting, root.reshape(len(root), -1).sum(axis=1), self.settings)
        return found

    @property
    def evidence(self) -> float:
        """Return the held-out log density with the weights' determinants, of all groups together."""
        return float(np.sum(self.log_density))

    def recorded(self) -> FitState:
        """Return the state, a full fit, after it was added to the list of models."""
        own, first = self.parameters, self.layout.size + self.weights.size
        free = [i for i in range(own.size) if i not in self.frozen]
        sigma = np.sqrt(np.maximum(np.diag(self.fit.covariance)[first:], 0.0)) * own.scale[free]
        named = ((self.effects[own.owner[i]].name, own.names[i]) for i in free)
        u = dict(zip(named, sigma.tolist(), strict=True))
        self.models.append(ModelFit(self.effects, self.curves, self.log_density, own.size + self.curves, self.gap, u))
        return self

    @property
    def settings(self) -> int:
        """Return the number of settings, or captures of one setting: the first groups of what is held out."""
        return int(self.design.held_out_id.max()) + 1

    @property
    def gap(self) -> float:
        """Return the reduced χ² of held-out settings; prior rows left out."""
        settings = self.settings
        return float(self.held_out.chi2[:settings].sum() / max(self.held_out.count[:settings].sum(), 1.0))


def reweighted(state: FitState) -> FitState:
    """Return the state with repeatability, weights and realisations brought up to date; parameters as they are."""
    tau = _estimate_tau(state)
    smooth = tuple(term for term in state.terms if term.is_smooth)
    starts = np.cumsum([0, *(term.size for term in state.terms)])
    own = (state.weights[at : at + term.size] for at, term in zip(starts, state.terms, strict=False) if term.is_smooth)
    kept = np.concatenate([np.zeros(0), *own])
    model, known = state.model, (state.design, state.seen, state.prediction)
    errors = (
        *fixed_errors((*model.given, *model.effects), state.prediction, state.seen, state.design, model.context),
        *errors_of_few_pixels(state.design, state.seen, state.prediction, state.comparison.usable),
        *error_of_borders(state.comparison.usable["edge"]),
        *error_of_histograms(honest_comb(*known), state.comparison.usable["comb"]),
    )
    terms = (*smooth, *(LinearTerm.of(error) for error in errors))
    floors = form_floors(state.model, state.trace)
    mask = state.comparison.usable
    again = weighted(state.seen, state.model, state.layout, state.values, terms, tau, floors, mask, state.trace)
    weights = np.concatenate([kept, np.zeros(sum(t.size for t in terms) - kept.size)])
    found = replace(again, weights=weights, models=state.models)
    return _knowing(found, again, _OF_THE_MODEL)


def _knowing(found: FitState, state: FitState, names: Sequence[str]) -> FitState:
    """Return a state with what was worked out of another one and is the same for it."""
    vars(found).update({name: known for name, known in vars(state).items() if name in names})
    return found


def with_terms(state: FitState, terms: Sequence[LinearTerm]) -> FitState:
    """Return the state with exactly these smooth terms (realisations kept), not refitted."""
    realised = tuple(term for term in state.terms if not term.is_smooth)
    everything = (*terms, *realised)
    weights = np.zeros(sum(term.size for term in everything))
    return _knowing(replace(state, terms=everything, weights=weights, held_terms=None), state, _OF_THE_DATA)


def with_effects(state: FitState, effects: Sequence[CatalogueEffect]) -> FitState:
    """Return the state with exactly these effects, not refitted."""
    return replace(state, model=state.model.with_effects(effects), frozen=frozenset(), held_terms=None)


def weighted(
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
    """Return the state of a model and its nuisances with weights that come from what it predicts there.

    Args:
        terms: Unnamed terms and realisations, all of weight 0.
        floors: Standard uncertainty of the effects' own form, by statistic.
        usable: Which entries count, by statistic; found anew where None.
        trace: The chain as it runs, where it is known.
    """
    design = model.design
    trace = trace or model.trace(layout.unpack(design, values))
    prediction = trace.prediction
    sensitivity, response = light_response(model, trace)
    flicker = relative_flicker(prediction) * (prediction.common_variance.max(axis=1) > 0)
    bands = (relative_bands(prediction), prediction.band_frequency)
    repeatability = Repeatability(tau, flicker, prediction.row_variance, *bands)
    mask = usable if isinstance(usable, dict) else usable_entries(design, seen, prediction)
    darkness = darkness_of(model, trace, seen)
    comparison = compare(design, seen, prediction, sensitivity, repeatability, response, floors, mask, darkness)
    weights = np.zeros(sum(term.size for term in terms))
    state = FitState(seen, model, layout, values, terms, weights, comparison, tau)
    vars(state).update({"nuisance": trace.nuisance, "trace": trace, "sensitivity": sensitivity})
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
