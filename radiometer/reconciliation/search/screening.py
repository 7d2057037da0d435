"""Tries every entry of the catalogue quickly: how much of the disagreement could it explain at best?"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from typing import Final

import numpy as np

from radiometer.errors import ConfigurationError, MeasurementError
from radiometer.reconciliation.fit.candidate_fit import Candidate
from radiometer.reconciliation.fit.state import FitState
from radiometer.reconciliation.measure.seen import COMB_PERIODS, CaptureStatistics
from radiometer.reconciliation.search.starts import StartPool
from radiometer.reconciliation.statistics import seen_step
from radiometer.typing import Array
from simulators.effects.catalogue import CatalogueEffect

_OTHER_STARTS: Final = 2  # of an entry that are kept for the fit beside the best
_LARGEST_AMPLITUDE: Final = 300.0  # a start may be that much too small …
_FAR_STEP: Final = 0.1  # of a parameter's size: a start is far from the best values
_TOGETHER: Final = 12  # entries that are asked at once
_MAY_RISE: Final = 2.0  # times what an entry explained beside the model before
_SMALLEST_CURVATURE: Final = 1e-9
AT_ONCE: Final = 32  # changes that are projected together: one at a time would read the whole fit for each


def usable_catalogue(
    state: FitState, catalogue: Mapping[str, type[CatalogueEffect]]
) -> dict[str, type[CatalogueEffect]]:
    """Return the entries that the data can speak about at all and that are not in the model yet."""
    taken = {effect.name for effect in state.effects if not effect.repeats}
    return {n: kind for n, kind in catalogue.items() if n not in taken and kind.usable(state.model.context)}


@dataclass(frozen=True, slots=True)
class Before:
    """Results of another model's screening, by which this one tests the likeliest entries first.

    Attributes:
        candidates: Its candidates.
        needed: How many of the best are needed now.
    """

    candidates: Sequence[Candidate] = ()
    needed: int = 0


def screen(
    state: FitState,
    catalogue: Mapping[str, type[CatalogueEffect]],
    pool: StartPool | None = None,
    before: Before = Before(),
) -> list[Candidate]:
    """Return the best start of every usable entry (rigid and flexible apart), the most promising first.

    Where a screening of the model before is known, entries are tested in the order of what they explained there.
    Testing stops once enough explain twice what any of the rest did, since the disagreement falls from model to
    model. The rest come as they were, behind these.

    Args:
        state: The fitted model.
        catalogue: Entries to try, by name.
        pool: Their starts, where they were made before.
        before: What a smaller model's screening found.

    Source: Minoux (1978), accelerated greedy algorithms, for the order.
    """
    pool = pool or StartPool()
    known: dict[str, list[Candidate]] = {}
    for candidate in before.candidates:
        known.setdefault(candidate.effect.name, []).append(candidate)
    gains = {name: max(candidate.gain for candidate in several) for name, several in known.items()}
    kinds = sorted(usable_catalogue(state, catalogue).values(), key=lambda kind: -gains.get(kind.name, np.inf))
    found: list[Candidate] = []
    for first in range(0, len(kinds), _TOGETHER):
        most = _MAY_RISE * gains.get(kinds[first].name, np.inf)
        if before.needed and sum(candidate.gain > most for candidate in found) >= before.needed:
            rest = [candidate for kind in kinds[first:] for candidate in known[kind.name]]
            return sorted(found, key=_by_gain) + sorted(rest, key=_by_gain)
        found += _screened(state, kinds[first : first + _TOGETHER] if known else kinds[first:], pool)
        if not known:
            break
    return sorted(found, key=_by_gain)


def _by_gain(candidate: Candidate) -> float:
    return -candidate.gain


def _screened(state: FitState, kinds: Sequence[type[CatalogueEffect]], pool: StartPool) -> list[Candidate]:
    likeliest = [of_seen_codes(state.comparison.seen, pool.likeliest(state, kind)) for kind in kinds]
    covers = [kind.covers(state.model.context) for kind in kinds]
    rigid = iter(_rigid(state, [start for starts in likeliest for start in starts]))
    flexible = iter(_flexible(state, [cover for several in covers for cover in several]))
    found: list[Candidate] = []
    for kind, starts, several in zip(kinds, likeliest, covers, strict=True):
        best = _best(list(islice(rigid, len(starts))))
        found += [replace(candidate, tries=pool.count(kind)) for candidate in best]
        found += _best(list(islice(flexible, len(several))))
    return found


def of_seen_codes(seen: CaptureStatistics, starts: tuple[CatalogueEffect, ...]) -> tuple[CatalogueEffect, ...]:
    """Return the starts that leave no gaps where codes occur: a coarse step may compensate another effect.

    Args:
        seen: What was measured.
        starts: Starts of one entry.
    """
    step = seen_step(seen)
    if step == 1:  # nothing tells
        return starts
    gaps = [period for period in COMB_PERIODS if step % period]
    return tuple(start for start in starts if not any(start.keeps_only_every(period) for period in gaps))


def best_start(state: FitState, starts: Sequence[CatalogueEffect]) -> Candidate | None:
    """Return the start that would explain most; None where there is none."""
    return next(iter(_best(_rigid(state, starts))), None)


def _best(candidates: Sequence[Candidate]) -> list[Candidate]:
    ranked = sorted(candidates, key=lambda candidate: -candidate.gain)
    near = ranked[: 1 + _OTHER_STARTS]
    others = [start for candidate in near for start in (candidate.effect, *candidate.others)]
    return [replace(ranked[0], others=tuple(others[1:]))] if ranked else []


def changes_with(state: FitState, several: Sequence[Sequence[CatalogueEffect]]) -> Array:
    """Return what sets of effects change in the whitened data residual (minus the residual's change), (entries, sets).

    Args:
        state: The fitted model.
        several: The sets.

    Raises:
        MeasurementError: If the prediction with one of them is not finite.
    """
    changed = state.moved_by(several)
    for number in np.flatnonzero(~np.isfinite(changed).all(axis=0))[:1].tolist():
        names = ", ".join(effect.name for effect in several[number])
        raise MeasurementError(f"the prediction with {names} is not finite; report this with the capture set")
    return changed


def changes_where_possible(state: FitState, several: Sequence[Sequence[CatalogueEffect]]) -> Array:
    """Return the same; numbers that are none for sets with which the model predicts what no camera does.

    Args:
        state: The fitted model.
        several: The sets.
    """
    try:
        return changes_with(state, several)
    except (MeasurementError, ConfigurationError):
        if len(several) == 1:
            return np.full((state.comparison.size, 1), np.nan)
    half = len(several) // 2
    return np.hstack([changes_where_possible(state, part) for part in (several[:half], several[half:])])


def changes_of(state: FitState, effects: Sequence[CatalogueEffect]) -> Array:
    """Return what each of some further effects alone changes, (entries, effects).

    Raises:
        MeasurementError: If the prediction with one of them is not finite.
    """
    return changes_with(state, [(*state.effects, effect) for effect in effects])


def _rigid(state: FitState, starts: Sequence[CatalogueEffect]) -> list[Candidate]:
    batches = (starts[first : first + AT_ONCE] for first in range(0, len(starts), AT_ONCE))
    return [candidate for batch in batches for candidate in _rigid_batch(state, batch)]


def _rigid_batch(state: FitState, starts: Sequence[CatalogueEffect]) -> list[Candidate]:
    rows = state.comparison.size
    fit = state.fit
    changes, part = fit.followed_with_half(changes_of(state, starts))
    whole = np.einsum("ij,ij->j", changes, changes)
    curvature = whole - np.einsum("ij,ij->j", part, part)
    slope = changes.T @ fit.projected[:rows]
    floor = _SMALLEST_CURVATURE * np.maximum(whole, 1e-12)
    safe = np.maximum(curvature, floor)
    amplitude = np.clip(slope / safe, 0.0, _LARGEST_AMPLITUDE)
    free = np.array([bool(effect.free()) for effect in starts])
    amplitude = np.where(free, amplitude, 1.0)  # what has no amplitude acts as it is or not at all
    gain = np.where(curvature > floor, 2.0 * amplitude * slope - amplitude**2 * curvature, 0.0)
    scaled = (_scaled(effect, float(a)) for effect, a in zip(starts, amplitude, strict=True))
    return [
        Candidate(effect, float(g), max(len(effect.free()), 1), others=others)
        for effect, g, others in zip(starts, gain.tolist(), scaled, strict=True)
    ]


def _scaled(effect: CatalogueEffect, amplitude: float) -> tuple[CatalogueEffect, ...]:
    """Return the effect with its first parameter's distance from nothing times the amplitude, and times its root."""
    if not effect.free() or "[" in effect.free()[0] or amplitude <= 0:
        return ()
    about = effect.neutral(effect.free()[0])
    sized = (effect.resized(factor, about) for factor in sorted({amplitude, amplitude**0.5}))
    return tuple({getattr(one, one.free()[0]): one for one in sized}.values())


def _flexible(state: FitState, covers: Sequence[CatalogueEffect]) -> list[Candidate]:
    found: list[Candidate] = []
    waiting: list[CatalogueEffect] = []
    for number, cover in enumerate(covers, start=1):
        waiting.append(cover)
        if sum(1 + len(one.free()) for one in waiting) >= AT_ONCE or number == len(covers):
            own = directions_of_each(state, [((*state.effects, one), len(state.effects), 0) for one in waiting])
            found += _flexible_batch(state, [*zip(waiting, own, strict=True)])
            waiting = []
    return found


def _flexible_batch(state: FitState, covers: Sequence[tuple[CatalogueEffect, Array]]) -> list[Candidate]:
    rows = slice(0, state.comparison.size)
    followed, part = state.fit.followed_with_half(np.hstack([columns for _, columns in covers]))
    found, at = [], 0
    for cover, columns in covers:
        own = slice(at, at + columns.shape[1])
        gain, _ = state.fit.score(rows, followed[:, own], part[:, own])
        found.append(Candidate(cover, gain, columns.shape[1] - 1, flexible=True))
        at = own.stop
    return found


def directions_of(state: FitState, effects: Sequence[CatalogueEffect], index: int, first: int = 0) -> Array:
    """Return what a set of effects changes in the residual, and what the parameters of one of them do then.

    Args:
        state: The fitted model.
        effects: The effects to have instead of the model's.
        index: Position of the one whose parameters are moved.
        first: The first of its parameters that is moved.

    Returns:
        (entries, 1 + parameters).
    """
    return next(iter(directions_of_each(state, [(effects, index, first)])))


_Changes = Callable[[FitState, Sequence[Sequence[CatalogueEffect]]], Array]


def directions_of_each(
    state: FitState, entries: Sequence[tuple[Sequence[CatalogueEffect], int, int]], changes: _Changes = changes_with
) -> Iterator[Array]:
    """Yield the same of several sets of effects; their chains run together.

    Args:
        state: The fitted model.
        entries: Each set, the position of the one whose parameters are moved, and the first of these.
        changes: Gives what sets change.
    """
    sets, steps = list[Sequence[CatalogueEffect]](), list[Array]()
    for effects, index, first in entries:
        own = state.parameters_of(effects)
        step, moved = own.a_step_away(_FAR_STEP, own.of_effect(index)[first:])
        steps.append(step)
        sets += [effects, *moved]
    changed, at = changes(state, sets), 0
    for step in steps:
        there = changed[:, at : at + 1]
        yield np.hstack([there, (changed[:, at + 1 : at + 1 + step.size] - there) / step])
        at += 1 + step.size
