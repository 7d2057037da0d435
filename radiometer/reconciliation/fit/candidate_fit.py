"""Fits one further effect, the nuisances following linearly, and judges it by what it predicts of held-out settings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from radiometer.reconciliation.fit.comparison import FAMILY
from radiometer.reconciliation.fit.linear import leave_one_group_out
from radiometer.reconciliation.fit.state import FitState, ModelFit
from radiometer.typing import Array
from simulators.effects.catalogue import CatalogueEffect

_ITERATIONS: Final = 25
_CONVERGED: Final = 0.02
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
    fitted = [_fitted(state, trial) for trial in begun]
    judged = _judged(state, min(fitted, key=lambda trial: trial.cost), candidate)
    return replace(judged, forms=tuple(trial.effect for trial in fitted))


def _variants(trials: Sequence[_Trial]) -> list[_Trial]:
    """Return the best trial of each variant, a dozen at most: what is not fitted is tried in all of them."""
    found: dict[tuple[object, ...], _Trial] = {}
    for trial in sorted(trials, key=lambda trial: trial.cost):
        free = {name.split("[")[0] for name in trial.effect.free()}
        found.setdefault(tuple(v for k, v in trial.effect.values().items() if k not in free), trial)
    return list(found.values())[:_VARIANTS]


def _fitted(state: FitState, start: _Trial) -> _Trial:
    damping, trial = _DAMPING, start
    for _ in range(_ITERATIONS if start.effect.free() else 0):
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
        if gained < _CONVERGED * state.misfit:
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
    columns = _off_bounds(state, best.effect, state.fit.followed(best.moves(state)))
    fit = state.fit.extended(columns, best.residual)
    before = family_chi2(state, state.fit.projected)
    after = family_chi2(state, fit.projected)
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


def _off_bounds(state: FitState, effect: CatalogueEffect, columns: Array) -> Array:
    own = state.parameters_of((effect,))
    span = 1e-6 * own.scale
    free = (own.values - own.low > span) & (own.high - own.values > span)
    return columns[:, free]


def family_chi2(state: FitState, residual: Array) -> dict[str, float]:
    """Return χ² by statistic, directions of one statistic together."""
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
