"""Which entries a plan cannot tell apart: asked of the captures that were taken, not of what they showed.

An entry changes the expected statistics in some direction; others change them in the directions of their starts and of
their parameters there. What of the first no others follow, nuisances and all other effects moving too, is what these
captures would show of the difference, in units of χ². Where that is less than rivals may differ by, the two names stand
together, whichever of them the data were fitted with.

Source: local identifiability by the Fisher information, T. J. Rothenberg, Econometrica 39 (1971) 577, over starts that
span the range of an entry.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any, Final

import numpy as np

from radiometer.errors import ConfigurationError, MeasurementError
from radiometer.reconcile.advice.next_capture import tells_apart
from radiometer.reconcile.fit.candidate_fit import Candidate, fit_candidate
from radiometer.reconcile.fit.comparison import Comparison
from radiometer.reconcile.fit.descent import refit
from radiometer.reconcile.fit.state import FitState, with_effects
from radiometer.reconcile.measure.design import Array
from radiometer.reconcile.prediction import Prediction
from radiometer.reconcile.search.screening import directions_of
from radiometer.reconcile.thresholds import PARAMETER_NATS, RIVAL_NATS
from simulators.effects.catalogue import CatalogueEffect

_STARTS: Final = 6  # of an entry, spread over all that it has
_ASKED_CHI2: Final = 400.0  # the size at which a plan is asked about an entry: twenty sigma, whatever is usual
_LARGEST_FACTOR: Final = 1000.0  # times the size of its start, beyond which the entry would be absurd
_ABSORBED: Final = 1e-6  # share of what an entry changes that the nuisances must leave
_REACH: Final = 2.0  # scales by which a parameter may leave its start: beyond, its derivative there is another effect
_WORTH_A_FIT: Final = 0.5  # share of another's χ² that an entry must follow at its start to be fitted in its place
_DIRECTION: Final = 1e-6  # share of a column that the others of its entry must leave


@dataclass(frozen=True, slots=True, eq=False)
class _Form:
    """One start of an entry, and where its columns stand: what it changes, and what its parameters do there."""

    effect: CatalogueEffect
    columns: slice


@dataclass(frozen=True, eq=False)
class Directions:
    """What entries change in the statistics of a plan, beside its nuisances.

    Attributes:
        state: The model that they are added to.
        forms: Starts of each entry by name.
        products: Inner products of all columns, freed of what nuisances and other effects explain.
        whole: Squares of the columns before that.
    """

    state: FitState
    forms: Mapping[str, tuple[_Form, ...]]
    products: Array
    whole: Array

    @classmethod
    def of(cls, state: FitState, entries: Mapping[str, Sequence[CatalogueEffect]]) -> Directions:
        """Return the directions of the starts of entries.

        Args:
            state: The model that they are added to.
            entries: Starts by name.
        """
        columns, forms, at = list[Array](), dict[str, tuple[_Form, ...]](), 0
        for name, starts in entries.items():
            found = []
            for start in starts:
                own = _columns(state, start)
                if own is not None:
                    columns.append(own)
                    found.append(_Form(start, slice(at, at + own.shape[1])))
                    at += own.shape[1]
            forms[name] = tuple(found)
        if not columns:
            return cls(state, forms, np.zeros((0, 0)), np.zeros(0))
        moved, part = state.fit.followed_with_half(np.hstack(columns))
        products = np.asarray(moved.T @ moved - part.T @ part)
        return cls(state, forms, products, np.sum(np.square(moved), axis=0))

    def shown(self, form: _Form) -> float:
        """Return the χ² by which a start shows."""
        return float(max(self.products[form.columns.start, form.columns.start], 0.0))

    def left(self, target: _Form, other: _Form) -> tuple[float, float]:
        """Return the χ² of a start that another entry, about one of its own starts, does not follow, and how much of
        that start it takes."""
        whole = self.shown(target)
        left, taken = self._least(target, other.columns)
        if taken[0] <= 0 or np.max(np.abs(taken[1:]), initial=0.0) > _REACH * taken[0]:  # another form than it can take
            left, taken = self._least(target, slice(other.columns.start, other.columns.start + 1))
        return (left, float(taken[0])) if taken[0] > 0 else (whole, 0.0)

    def _least(self, target: _Form, own: slice) -> tuple[float, Array]:
        """Return the χ² of a start that columns do not follow at best, and how much of each they take."""
        gram, right = self.products[own, own], self.products[own, target.columns.start]
        lengths = np.sqrt(np.maximum(np.diag(gram), 1e-300))
        values, vectors = np.linalg.eigh(gram / np.outer(lengths, lengths))
        kept = values > _DIRECTION
        along = (vectors[:, kept].T @ (right / lengths)) / np.sqrt(values[kept])
        taken = (vectors[:, kept] @ (along / np.sqrt(values[kept]))) / lengths
        return max(self.shown(target) - float(along @ along), 0.0), np.asarray(taken)

    def is_seen(self, form: _Form) -> bool:
        """Tell whether a start shows at any size that is not absurd, and is more than the nuisances."""
        shown = self.shown(form)
        asked = _ASKED_CHI2 / _LARGEST_FACTOR**2
        return shown > max(_ABSORBED * float(self.whole[form.columns.start]), asked)

    def followed_by(self, target: _Form, name: str, times_chi2: float = 1.0) -> CatalogueEffect | None:
        """Return an entry at the size that cannot be told from another's start; None where all can.

        Args:
            target: The other's start.
            name: The entry.
            times_chi2: How many times the χ² of that start is asked about.
        """
        rated = [(*self.left(target, form), form) for form in self.forms[name]]
        paid = [(times_chi2 * left + _paid(target.effect, form.effect), amount, form) for left, amount, form in rated]
        least, amount, form = min(paid, key=lambda entry: entry[0], default=(np.inf, 0.0, None))
        return _times(form.effect, amount) if form is not None and least < 2.0 * RIVAL_NATS else None


def _paid(target: CatalogueEffect, other: CatalogueEffect) -> float:
    """Return the χ² that an entry must pay for having more parameters."""
    return 2.0 * PARAMETER_NATS * max(len(other.free()) - len(target.free()), 0)


def _times(effect: CatalogueEffect, amount: float) -> CatalogueEffect:
    """Return an effect with its first parameter times an amount, within its bounds."""
    names = effect.free()
    if not names or "[" in names[0]:
        return effect
    power = 0.5 if effect.acts_by_square else 1.0
    return effect.resized(amount**power, about=effect.neutral(names[0]))


def _columns(state: FitState, start: CatalogueEffect) -> Array | None:
    """Return what a start changes, and what its parameters but the first (its amount) do there; None for nothing."""
    try:
        own = directions_of(state, (*state.effects, start), len(state.effects), first=1)
    except (MeasurementError, ConfigurationError):  # what no camera does is no likeness
        return None
    return own if own[:, 0].any() else None


def inseparable(
    state: FitState, chosen: CatalogueEffect, catalogue: Mapping[str, type[CatalogueEffect]]
) -> tuple[CatalogueEffect, ...]:
    """Return entries, at a start of theirs, that these captures cannot tell from a named effect of its fitted size.

    Args:
        state: The fitted model that holds the effect.
        chosen: The effect.
        catalogue: All entries; also those whose covariate does not vary, for that very reason.
    """
    rest = with_effects(state, [effect for effect in state.effects if effect is not chosen])
    present = {effect.name for effect in (*state.effects, *state.model.given)}
    shows = {chosen.block, *chosen.also}
    kinds = {n: kind for n, kind in catalogue.items() if n not in present and shows & {kind.block, *kind.also}}
    starts = {name: _spread(kind.starts(state.model.context)) for name, kind in kinds.items()}
    directions = Directions.of(rest, starts | {chosen.name: (chosen,)})
    if not directions.forms[chosen.name]:
        return ()
    (target,) = directions.forms[chosen.name]
    found = (directions.followed_by(target, name) or _fitted_like(directions, target, name) for name in kinds)
    return tuple(effect for effect in found if effect is not None)


@dataclass(frozen=True, eq=False)
class Noiseless(Comparison):
    """A comparison whose measured statistics are those that a model expects.

    Attributes:
        offset: Residual of the real data under that model.
    """

    offset: Array = field(default_factory=lambda: np.zeros(0))

    def residual(self, prediction: Prediction) -> Array:
        """Return expected minus predicted, whitened."""
        return super().residual(prediction) - self.offset


def noiseless(state: FitState, effect: CatalogueEffect) -> FitState:
    """Return a state with the data replaced by what its model with a further effect expects."""
    known = {entry.name: getattr(state.comparison, entry.name) for entry in fields(state.comparison)}
    offset = state.comparison.residual(state.predicted_with((*state.effects, effect)))
    return replace(state, comparison=Noiseless(**known | {"offset": offset}))


def left_by_fit(exact: FitState, truth: CatalogueEffect, start: Candidate) -> tuple[float, CatalogueEffect]:
    """Return the χ² that an entry leaves of noiseless data when it is fitted to them, and the entry as fitted.

    Args:
        exact: The state with the noiseless data of another entry.
        truth: That other entry; parameters beyond its number are paid for.
        start: Where the fit begins.
    """
    fitted = fit_candidate(exact, start).effect
    own, foreign = (refit(with_effects(exact, (*exact.effects, effect))) for effect in (truth, fitted))
    return max(foreign.cost - own.cost, 0.0) + _paid(truth, fitted), fitted


def _fitted_like(directions: Directions, target: _Form, name: str, times_chi2: float = 1.0) -> CatalogueEffect | None:
    """Return an entry that fits the noiseless data of a large effect, where derivatives at its start reach not so far.

    Only what follows it for the most part at its start is fitted.

    Args:
        directions: Of the starts of all entries.
        target: The effect's start.
        name: The entry.
        times_chi2: How many times the χ² of that start is asked about.
    """
    whole, size = directions.shown(target), float(np.sqrt(times_chi2))
    rated = sorted(((*directions.left(target, form), form) for form in directions.forms[name]), key=lambda r: r[0])
    near = [_times(form.effect, amount * size) for left, amount, form in rated if left < (1.0 - _WORTH_A_FIT) * whole]
    if not near:
        return None
    start = Candidate(near[0], times_chi2 * whole, max(len(near[0].free()), 1), others=tuple(near[1:2]))
    truth = _times(target.effect, size)
    left, effect = left_by_fit(noiseless(directions.state, truth), truth, start)
    alike = left < 2.0 * RIVAL_NATS and not effect.unlike_itself(directions.state.model.context)
    return effect if alike else None


def _spread(starts: Sequence[CatalogueEffect]) -> tuple[CatalogueEffect, ...]:
    """Return a few starts spread over all."""
    return tuple(starts[:: max(1, -(-len(starts) // _STARTS))])


@dataclass(frozen=True, slots=True)
class Together:
    """Names that a plan cannot separate.

    Attributes:
        name: An entry.
        others: Entries that could show the same.
        capture: The capture that would tell them apart; None where none of the rig's would.
    """

    name: str
    others: tuple[str, ...]
    capture: Mapping[str, Any] | None

    def to_mapping(self) -> dict[str, Any]:
        """Return the mapping that stands in JSON."""
        return {"name": self.name, "others": list(self.others), "next_capture": self.capture and dict(self.capture)}


@dataclass(frozen=True, slots=True)
class Separability:
    """What a plan can tell apart.

    Attributes:
        together: Names that stand together, each set once.
        blind: Entries that do not show at any sensible size, nuisances following.
    """

    together: tuple[Together, ...]
    blind: tuple[str, ...]

    def to_mapping(self) -> dict[str, Any]:
        """Return the mapping that stands in JSON."""
        return {"inseparable": [entry.to_mapping() for entry in self.together], "blind": list(self.blind)}


def separability(
    state: FitState, catalogue: Mapping[str, type[CatalogueEffect]], *, every: bool = False
) -> Separability:
    """Return which entries these captures can tell apart, each at a size of twenty sigma.

    Args:
        state: The starting camera, nuisances fitted; the data's disagreements have no part in it.
        catalogue: All entries.
        every: List a set once for each of its names, without captures, instead of once in all.
    """
    directions, seen = _asked(state, catalogue)
    blind = tuple(sorted(set(catalogue) - set(seen)))
    return Separability(tuple(_together(state, directions, seen, every=every)), blind)


def asked_sizes(state: FitState, catalogue: Mapping[str, type[CatalogueEffect]]) -> dict[str, CatalogueEffect]:
    """Return the entries that show, by name, at the size of twenty sigma at which a plan is asked about them."""
    directions, seen = _asked(state, catalogue)
    amount = {name: np.sqrt(_ASKED_CHI2 / directions.shown(form)) for name, form in seen.items()}
    return {name: _times(form.effect, float(amount[name])) for name, form in seen.items()}


def _asked(state: FitState, catalogue: Mapping[str, type[CatalogueEffect]]) -> tuple[Directions, dict[str, _Form]]:
    context = state.model.context
    directions = Directions.of(state, {n: _spread(kind.starts(context)) for n, kind in catalogue.items()})
    first = {n: next((f for f in forms if directions.is_seen(f)), None) for n, forms in directions.forms.items()}
    return directions, {name: form for name, form in first.items() if form is not None}


def _together(state: FitState, directions: Directions, seen: Mapping[str, _Form], *, every: bool) -> Iterator[Together]:
    told = set[frozenset[str]]()
    for name, target in seen.items():
        times = _ASKED_CHI2 / directions.shown(target)
        followed = (
            directions.followed_by(target, other, times) or _fitted_like(directions, target, other, times)
            for other in seen
            if other != name
        )
        others = [effect for effect in followed if effect is not None]
        names = frozenset({name, *(effect.name for effect in others)})
        if others and (every or names not in told):
            told.add(names)
            capture = None if every else tells_apart(state, target.effect, others)
            yield Together(name, tuple(effect.name for effect in others), capture)
