"""Judges the outcome of a search: which names are significant, the doubts about them, and the residual as one entry.

The tests of `localise` look for trends. What moves single tiles or frames at random leaves none, but a reduced χ²
above 1.

The list of fitted models turns into posterior probabilities of models and of effects. A hypothesis is a set of names.
Of its models the one of the highest score represents it: the held-out log density, plus the log prior odds of its
effects, less what parameters cost. With w_k ∝ exp(score_k) alone, one lucky setting could decide. Groups
are therefore weighted at random (Dirichlet), and w_k is averaged over the draws: few settings cannot give certainty.

Source: Yao, Vehtari, Simpson, Gelman, Bayesian Analysis 13 (2018) 917, section 3.4 (pseudo-BMA+). Prior odds of 1 to
the number of entries for each name: Scott, Berger, Ann. Stat. 38 (2010) 2587, multiplicity of variable selection.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from radiometer.reconciliation.comparison import FAMILY, Comparison
from radiometer.reconciliation.descent import fitted_parameters, is_misfit, refit
from radiometer.reconciliation.localise import Disagreement, axis_of, departing, own_place
from radiometer.reconciliation.repeatability import Periodic
from radiometer.reconciliation.result import SURE, FittedParameter, FoundEffect, Verdict
from radiometer.reconciliation.search import Search, Step
from radiometer.reconciliation.state import FitState, ModelFit, with_effects, with_terms
from radiometer.reconciliation.thresholds import ESSENTIAL_SIGMAS, NAMED_NATS, PARAMETER_NATS, SMOOTH_SHARE
from radiometer.typing import Array
from simulators.effects.catalogue import CatalogueEffect
from simulators.effects.free_law import FreeLaw

_REFITS: Final = 8
_LIGHT: Final = ("mean", "slope")  # what changes the light of tiles moves both
_LIT_DN: Final = 1.0  # light below which a share of it says nothing


def verdict_of(
    outcome: Search, doubts: Sequence[str], again: Periodic | None = None, *, other_well: bool = False
) -> Verdict:
    """Return the verdict on a search.

    Args:
        again: What comes back in the order of the frames, which no name explains.
        other_well: Whether the brightest pixels show another full well than the declared one.
    """
    named = other_well or len(outcome.state.effects) > len(insignificant_names(outcome))
    unnamed = leaves_structure(outcome) or again is not None
    if named:
        return Verdict.INCOMPLETE if unnamed or doubts else Verdict.EFFECTS_FOUND
    return Verdict.UNNAMED if unnamed else Verdict.AGREES


def doubts_of(
    outcome: Search, weighed: Posterior, alternatives: Mapping[str, Collection[str]] | None = None
) -> list[str]:
    """Return in words why names are provisional though nothing structured is left.

    Args:
        alternatives: What these data cannot separate from each name; by default the rivals of its step.
    """
    state, effects = outcome.state, outcome.state.effects
    alike: Mapping[str, Collection[str]] = alternatives or {
        step.name: [rival.name for rival in step.rivals] for step in outcome.steps
    }
    doubts = [
        f"{name} has a probability of {probability:.2f}, its alternatives included: other models predict as well"
        for name, probability in uncertain([effect.name for effect in effects], weighed, alike).items()
    ]
    doubts += [
        f"{name} fits by its secondary terms alone: its essential parameter is within three uncertainties of zero"
        for name in without_essential(effects, fitted_parameters(state))
    ]
    doubts += [
        f"{name} is not exactly the law that the data follow: a residual remains where it acts"
        for name in departing(outcome.tests, effects)
    ]
    return doubts


def leaves_structure(outcome: Search) -> bool:
    """Return whether anything disagrees apart from the names: tests, a term without a name, or scatter."""
    unnamed = bool(outcome.left) or any(step.name == "unnamed" for step in outcome.steps)
    return unnamed or is_misfit(outcome.state)


def insignificant_names(outcome: Search) -> list[str]:
    """Return names that are not significant where structure remains: faint ones, and those without essential term.

    Names may absorb a part of the residual of a curve along one covariate for an unknown cause, where that brings most
    of what both bring. An entry whose essential parameter is not significant, its uncertainty including the residual,
    fits by its further terms, as any curve would.
    """
    if not leaves_structure(outcome):
        return []
    bare = without_essential(outcome.state.effects, fitted_parameters(outcome.state))
    present = {effect.name for effect in outcome.state.effects}
    unknown = max((step.gain_nats for step in outcome.steps if step.name == "unnamed"), default=0.0)
    least = (1.0 / SMOOTH_SHARE - 1.0) * unknown
    faint = (step.name for step in outcome.steps if step.name in present and step.gain_nats < least)
    return list(dict.fromkeys([*faint, *bare]))


def with_other_functional_form(outcome: Search) -> tuple[CatalogueEffect, ...]:
    """Return the named effects whose equation is not the one that the data follow, though the name explains most of it.

    A residual in a name's own statistic and along its own covariate is the rest of its law, not one more cause. This
    holds as long as the name brings most of what both bring.
    """
    departed, weak = departing(outcome.tests, outcome.state.effects), insignificant_names(outcome)
    gains = {step.name: step.gain_nats for step in outcome.steps if step.name != "unnamed"}
    found = []
    for effect in outcome.state.effects:
        unnamed_steps = [s for s in outcome.steps if s.name == "unnamed" and _place_of(s) == own_place(effect)]
        nats, more = gains.get(effect.name, 0.0), sum(step.gain_nats for step in unnamed_steps)
        stays = unnamed_steps or effect.name in departed or isinstance(effect, FreeLaw)
        if stays and effect.name not in weak and nats >= SMOOTH_SHARE * (nats + more):
            found.append(effect)
    return tuple(found)


def _places_of_law(effect: CatalogueEffect) -> set[tuple[str, str]]:
    """Return where the rest of an effect's law shows: of a free one along all its covariates, in all that it moves."""
    axes = effect.axes if isinstance(effect, FreeLaw) else ()
    return {own_place(effect)} | {(axis, block) for axis in axes for block in (effect.block, *effect.also, *_LIGHT)}


def _place_of(step: Step) -> tuple[str, str]:
    return axis_of(step.where, step.block), step.block


def rest_of(outcome: Search, again: Periodic | None = None) -> FoundEffect | None:
    """Return all that has no name as one entry: its clearest place, its size, and its other places.

    Args:
        again: What comes back in the order of the frames.
    """
    state = outcome.state
    explained = {place for effect in with_other_functional_form(outcome) for place in _places_of_law(effect)}
    steps = [step for step in outcome.steps if step.name == "unnamed" and _place_of(step) not in explained]
    places = [_place_of(step) for step in steps]
    places += [(axis_of(test.where, test.block), test.family) for test in outcome.left]
    places = [place for place in places if place not in explained]
    weak = insignificant_names(outcome)
    places += [(step.where, "") for step in outcome.steps if step.name in weak]
    if not places and not explained and is_misfit(state):
        block, where = place_of_scatter(state, outcome.tests)
        places = [(where, block)]
    if again is not None:
        places.insert(0, ("frame", "common"))
    if not places:
        return None
    (where, block), *others = dict.fromkeys(places)
    before, after = (steps[0].gap_before, steps[-1].gap_after) if steps else (state.gap, state.gap)
    return FoundEffect(
        "unnamed",
        size_of_rest(_named_alone(outcome, weak), block)
        if again is None
        else {
            "period_frames": FittedParameter(float(again.period), None, "1"),
            "depth_rel": FittedParameter(again.depth, None, "1"),
        },
        where,
        before,
        after,
        gain_nats=sum(step.gain_nats for step in steps) - (np.log(max(again.p_value, 1e-300)) if again else 0.0),
        block=block,
        closest=steps[0].closest if steps and again is None else None,
        elsewhere=tuple(others),
    )


def _named_alone(outcome: Search, weak: Collection[str]) -> FitState:
    """Return the model that the rest is a rest of: as it came out, or anew without the names that count to the rest."""
    if not weak:
        return outcome.state
    kept = tuple(effect for effect in outcome.state.effects if effect.name not in weak)
    return refit(with_effects(outcome.start, kept), iterations=_REFITS)


def size_of_rest(state: FitState, block: str) -> dict[str, FittedParameter]:
    """Return the size of the residual, root mean square: of means in DN, e⁻ and of the light, of noise relative.

    It is what the unnamed terms took up; where there are none, what the residual holds beyond its uncertainties.
    """
    comparison = state.comparison
    if block in ("variance", "spatial"):
        mask, left = comparison.usable[block], _taken_up(state, block)
        relative = float(np.sqrt(np.mean(np.square(_unwhitened(comparison, block, left)[mask]))))
        return {"rms_rel": FittedParameter(relative, None, "1")} if relative > 0 else {}
    if block != "mean":
        return {}
    mask = comparison.usable["mean"]
    dn = _unwhitened(comparison, "mean", _taken_up(state, "mean"))
    in_e = dn / np.maximum(state.prediction.gain[:, None], 1e-12)
    lit = mask & (state.sensitivity > _LIT_DN)
    found = {"rms_dn": (dn[mask], "DN"), "rms_e": (in_e[mask], "e-")}
    found |= {"rms_rel": (dn[lit] / state.sensitivity[lit], "1")} if lit.any() else {}
    sizes = {name: (float(np.sqrt(np.mean(np.square(values)))), unit) for name, (values, unit) in found.items()}
    return {name: FittedParameter(size, None, unit) for name, (size, unit) in sizes.items() if size > 0}


def _unwhitened(comparison: Comparison, block: str, values: Array) -> Array:
    if block in comparison.whiteners:
        return np.asarray(np.linalg.solve(comparison.whiteners[block], values[..., None])[..., 0])
    return np.asarray(np.where(comparison.usable[block], values * comparison.deviation[block], 0.0))


def _taken_up(state: FitState, block: str) -> Array:
    """Return what only unnamed terms take up of a statistic's whitened residual, else its excess, as it is shaped."""
    comparison = state.comparison
    cut, shape = comparison.cuts[block], comparison.usable[block].shape
    taken, at = np.zeros(comparison.size), 0
    for term in state.terms:
        if term.is_smooth:
            columns = term.build(comparison, state.prediction, state.sensitivity)
            taken = taken + columns @ state.weights[at : at + term.size]
        at += term.size
    if taken[cut].any():
        alone = with_terms(state, ()).fit.left_of(taken)
        return np.asarray(alone[cut].reshape(shape))
    left = state.data_residual[cut]
    more = max(1.0 - comparison.degrees(block) / max(float(left @ left), 1e-300), 0.0)
    return np.asarray(left.reshape(shape) * np.sqrt(more))


def sizes_by_own_law(state: FitState, effect: FreeLaw) -> dict[str, FittedParameter]:
    """Return the parameters of an effect of another law that its own equation would be fitted by, with u.

    The law is a factor on what the effect does by its own equation, of the size that it was found with. The
    uncertainty of that size is that of the fit by the own equation, with the difference of both where they disagree.

    Args:
        state: The model with the effect by another law.
    """
    own = effect.own
    plain = refit(with_effects(state, [own if other is effect else other for other in state.effects]))
    found = {}
    for name, entry in fitted_parameters(plain)[effect.name].items():
        held = float(getattr(effect, name, entry.value)) if "[" not in name else entry.value
        if entry.u is not None:
            found[name] = FittedParameter(held, float(np.hypot(entry.u, entry.value - held)), entry.unit)
    return found


# ---- what speaks against names --------------------------------------------------------------------------------------
def place_of_scatter(state: FitState, tests: Sequence[Disagreement]) -> tuple[str, str]:
    """Return the statistic that scatters most beyond its uncertainties, and the covariate along which it trends most.

    Args:
        tests: All tests of the model, the most significant first.
    """
    comparison, square = state.comparison, np.square(state.data_residual)
    more = {n: float(np.sum(square[cut])) - comparison.degrees(n) for n, cut in comparison.cuts.items()}
    block = max(more, key=lambda name: more[name])
    where = next((test.where for test in tests if test.block == block), "constant")
    return FAMILY[block], axis_of(where, block)


def uncertain(
    names: Sequence[str], weighed: Posterior, alternatives: Mapping[str, Collection[str]]
) -> dict[str, float]:
    """Return the names that are not almost certain, with their probability.

    Which of several alike names it is may be open. An alternative to every one of several names is no such name: it
    alone may explain what all of them do.

    Args:
        alternatives: What these data cannot separate from each name.
    """
    alike = {name: set(alternatives.get(name, ())) for name in names}
    common = set.intersection(*alike.values()) if len(names) > 1 else set()
    found = {name: weighed.probability(name, *(alike[name] - common)) for name in names}
    return {name: probability for name, probability in found.items() if probability < SURE}


def without_essential(
    effects: Sequence[CatalogueEffect], parameters: Mapping[str, Mapping[str, FittedParameter]]
) -> list[str]:
    """Return the names of effects of which an essential parameter is within three standard uncertainties of nothing.

    One at the end of its range has no uncertainty, and is doubted where that end is nothing. One that this form of the
    effect does not fit says nothing.

    Args:
        parameters: Their fitted parameters by effect and name.
    """
    found = []
    for effect in effects:
        fitted = set(effect.essential).intersection(effect.free())
        sizes = {name: parameters[effect.name].get(name) for name in fitted}
        known = ((abs(size.value - effect.neutral(name)), size.u) for name, size in sizes.items() if size is not None)
        if any(far <= ESSENTIAL_SIGMAS * (u or 0.0) for far, u in known):
            found.append(effect.name)
    return found


# ---- probabilities --------------------------------------------------------------------------------------------------
UNNAMED: Final = "unnamed"
_DRAWS: Final = 1000
_DRAWN_WITH: Final = 20261126  # the same draws for the same data
_LEAST_WEIGHT: Final = 1e-3  # of a model that is listed


@dataclass(frozen=True, slots=True, eq=False)
class WeightedModel:
    """One hypothesis with its posterior probability."""

    names: tuple[str, ...]  # names of its effects in alphabetical order; `unnamed` for what no entry explains
    weight: float  # posterior probability
    fit: ModelFit  # the model that represents it


@dataclass(frozen=True, slots=True, eq=False)
class Posterior:
    """All hypotheses, the most probable first; their weights sum to 1."""

    models: tuple[WeightedModel, ...]

    def probability(self, *names: str) -> float:
        """Return the probability that one of these effects is present: the weight of all models that hold any."""
        return float(min(sum(model.weight for model in self.models if set(names) & set(model.names)), 1.0))

    def listed(self) -> tuple[tuple[tuple[str, ...], float], ...]:
        """Return names and weight of the models that have one in a thousand at least."""
        return tuple((model.names, model.weight) for model in self.models if model.weight >= _LEAST_WEIGHT)

    def averaged(self, name: str) -> dict[str, FittedParameter]:
        """Return the parameters of an effect averaged over the models that hold it.

        The variance is the mean variance plus the variance of the means (law of total variance).
        """
        held = [(m.weight, e, m.fit) for m in self.models for e in m.fit.effects if e.name == name and m.fit.is_full]
        found = {}
        for key in dict.fromkeys(key for _, _, fit in held for owner, key in fit.u if owner == name and "[" not in key):
            known = [(w, float(getattr(e, key)), fit.u[name, key]) for w, e, fit in held if (name, key) in fit.u]
            weight, value, u = np.array(known).T
            share = weight / weight.sum() if weight.sum() > 0 else np.full(weight.size, 1.0 / weight.size)
            mean = float(share @ value)
            unit = next(entry.unit for entry in held[0][1].parameters() if entry.name == key)
            found[key] = FittedParameter(mean, float(np.sqrt(share @ (u**2 + (value - mean) ** 2))), unit)
        return found


def posterior(fits: Sequence[ModelFit], catalogue: Collection[str], dispersion: float = 1.0) -> Posterior:
    """Return the posterior probabilities of fitted models.

    Args:
        fits: The models, not none.
        catalogue: Names of the entries that may be named; effects of other names have none.
        dispersion: Reduced χ² that the best of them leaves; log densities are divided by it where it exceeds 1.
    """
    best: dict[frozenset[str], tuple[float, ModelFit]] = {}
    for fit in fits:
        names = frozenset(effect.name if effect.name in catalogue else UNNAMED for effect in fit.effects)
        names |= {UNNAMED} if fit.curves else set()
        score = float(np.sum(fit.log_density)) / dispersion + _log_prior(fit, names, len(catalogue))
        if np.isfinite(score) and (names not in best or score > best[names][0]):
            best[names] = (score, fit)
    density = np.array([fit.log_density for _, fit in best.values()]) / dispersion
    prior = np.array([_log_prior(fit, names, len(catalogue)) for names, (_, fit) in best.items()])
    weights = pseudo_bma(density, prior)
    found = [
        WeightedModel(tuple(sorted(names)), float(weight), fit)
        for weight, (names, (_, fit)) in zip(weights, best.items(), strict=True)
    ]
    return Posterior(tuple(sorted(found, key=lambda model: -model.weight)))


def pseudo_bma(log_density: Array, log_prior: Array) -> Array:
    """Return the weights of models, (models,), averaged over random weights of the groups.

    Args:
        log_density: (models, groups) held-out log density.
        log_prior: (models,) log prior probability, constants left out.
    """
    differing = log_density - log_density[np.argmax(log_density.sum(axis=1) + log_prior)]
    groups = log_density.shape[1]
    shares = groups * np.random.default_rng(_DRAWN_WITH).dirichlet(np.ones(groups), _DRAWS)
    scores = shares @ differing.T + log_prior
    weights = np.exp(scores - scores.max(axis=1, keepdims=True))
    return np.asarray((weights / weights.sum(axis=1, keepdims=True)).mean(axis=0))


def _log_prior(fit: ModelFit, names: Collection[str], entries: int) -> float:
    odds = sum(effect.log_prior_odds for effect in fit.effects) - len(names) * np.log(max(entries, 1))
    return float(odds - (NAMED_NATS if UNNAMED in names else 0.0) - PARAMETER_NATS * fit.parameters)
