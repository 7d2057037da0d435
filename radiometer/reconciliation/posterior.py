"""Turns the list of fitted models into posterior probabilities of models and of effects.

A hypothesis is a set of names. Of the models of one hypothesis the one of the highest score represents it. Its score is
the held-out log density, plus the log prior odds of its effects, less what parameters cost. With w_k ∝ exp(score_k)
alone, one lucky setting could decide. Groups are therefore weighted at random (Dirichlet), and w_k is averaged over the
draws, so that few settings cannot give certainty.

Source: Yao, Vehtari, Simpson, Gelman, Bayesian Analysis 13 (2018) 917, section 3.4 (pseudo-BMA+). Prior odds of 1 to
the number of entries for each name: Scott, Berger, Ann. Stat. 38 (2010) 2587, multiplicity of variable selection.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from radiometer.reconciliation.fit.state import ModelFit
from radiometer.reconciliation.result import FittedParameter
from radiometer.reconciliation.thresholds import NAMED_NATS, PARAMETER_NATS
from radiometer.typing import Array

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
    """Return the log prior odds of a model: of its effects as usual as they are, its parameters paid for."""
    odds = sum(effect.log_prior_odds for effect in fit.effects) - len(names) * np.log(max(entries, 1))
    return float(odds - (NAMED_NATS if UNNAMED in names else 0.0) - PARAMETER_NATS * fit.parameters)
