"""Tries every entry of the catalogue quickly: how much of the disagreement could it explain at best?"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice
from typing import Any, Final, TypeVar, cast

import numpy as np

from radiometer.errors import ConfigurationError
from radiometer.reconciliation.descent import Candidate, variant_of
from radiometer.reconciliation.design import COMB_PERIODS, CaptureStatistics
from radiometer.reconciliation.lines import RowBins, wave_power
from radiometer.reconciliation.shared_errors import mixing_of_bands, relative_bands
from radiometer.reconciliation.state import FitState
from radiometer.reconciliation.statistics import seen_step
from radiometer.typing import Array
from simulators.effects.base import DIGITAL_NUMBER
from simulators.effects.catalogue import CatalogueEffect, Offset, Scaling
from simulators.effects.tile_moments import TileMoments

Starts = tuple[CatalogueEffect, ...]
Made = TypeVar("Made")
_MANY: Final = 20  # starts, beyond which the likeliest are picked first
_KEPT: Final = 8
_SIZES: Final = np.geomspace(0.01, 30.0, 25)  # times the size that starts have
_SCALES: Final = np.geomspace(1e-3, 1e1, 9)  # of a wave's variance, about the one that has all of what is seen
_REFINED: Final = 3  # waves of different spatial frequency that are searched about
_WORTH_IT: Final = 20.0  # deviance that the best of the coarse grid must bring before
_ROUNDS: Final = 2


class StartPool:
    """The starts of all entries for one capture set; they are made once."""

    def __init__(self) -> None:
        self._known: dict[tuple[str, str], Any] = {}

    def _once(self, what: str, name: str, work: Callable[[], Made]) -> Made:
        if (what, name) not in self._known:
            self._known[what, name] = work()
        return cast(Made, self._known[what, name])

    def likeliest(self, state: FitState, kind: type[CatalogueEffect]) -> Starts:
        """Return the starts of an entry; of many only those that explain most at first sight."""
        starts = self._once("starts", kind.name, lambda: kind.starts(state.model.context))
        if len(starts) <= _MANY:
            return starts
        if issubclass(kind, Scaling | Offset) and _goes_by_captures(state, starts[0]):
            return self._of_captures(state, starts)
        picks: Mapping[str, Callable[[FitState, Starts], Starts]] = {"common": self._of_frames, "bands": _of_bands}
        return picks[kind.block](state, starts) if kind.block in picks and kind.acts_by_square else starts

    def count(self, kind: type[CatalogueEffect]) -> int:
        """Return how many starts an entry has; 1 before they were asked for."""
        return len(self._known.get(("starts", kind.name), (None,)))

    def _of_captures(self, state: FitState, starts: Starts) -> Starts:
        """Return the likeliest of those that scale whole captures, or add something to them."""
        each = partial(map, partial(_of_each_capture, state), starts)
        moves = self._once("moves", starts[0].name, lambda: np.stack(list(each())))
        unit = state.sensitivity if isinstance(starts[0], Scaling) else np.ones_like(state.sensitivity)
        gram, slope = _of_all_captures(state, unit)
        rise = moves @ slope
        curvature = np.einsum("sc,cd,sd->s", moves, gram, moves, optimize=True)
        _, gain = _at_best(rise, curvature, np.full(len(starts), bool(starts[0].free())))
        return tuple(starts[int(i)] for i in np.argsort(-gain)[:_KEPT])

    def _of_frames(self, state: FitState, starts: Starts) -> Starts:
        """Return the likeliest of what shakes whole frames, of each variant one at least, in their likeliest sizes."""
        name, context, captures = starts[0].name, state.model.context, (len(state.design.captures),)
        dense = self._once("between", name, lambda: tuple(between for start in starts for between in start.between()))
        added = (np.ravel(start.common_variance(np.ones(()), context)) for start in dense)
        moves = self._once("moves", name, lambda: np.stack([np.broadcast_to(one, captures) for one in added]))
        here, rows = state.comparison.flicker_of(state.prediction), state.prediction.row_variance
        sizes = np.square(_SIZES)
        rated = [state.comparison.deviances_of_flicker(here + size * moves, rows).sum(axis=1) for size in sizes]
        best, least = np.argmin(rated, axis=0), np.min(rated, axis=0)
        order = [int(i) for i in np.argsort(least)]
        first = {variant_of(dense[i]): i for i in reversed(order)}
        chosen = list(dict.fromkeys([*sorted(first.values(), key=lambda i: least[i]), *order]))[:_KEPT]
        return tuple(dense[i].resized(float(np.sqrt(sizes[best[i]]))) for i in chosen)


def _at_best(rise: Array, curvature: Array, free: Array, least: Array | float = 1e-12) -> tuple[Array, Array]:
    """Return the amplitudes of changes and the χ² that they explain; what is not free acts as it is or not at all."""
    amplitude = np.where(free, np.clip(rise / np.maximum(curvature, least), 0.0, _LARGEST_AMPLITUDE), 1.0)
    return amplitude, amplitude * (2.0 * rise - amplitude * curvature)


def _of_all_captures(state: FitState, unit: Array) -> tuple[Array, Array]:
    """Return the Gram matrix and the slope of χ² for changes of each capture's means, nuisances following."""
    captures, tiles = unit.shape
    raw = np.zeros((captures, tiles, captures))
    index = np.arange(captures)
    raw[index, :, index] = unit
    moves = state.comparison.whiten("mean", raw).reshape(captures * tiles, captures)
    cut = state.comparison.cuts["mean"]
    part = state.fit.half(state.fit.pull(moves, cut.start))
    return moves.T @ moves - part.T @ part, moves.T @ state.fit.projected[cut]


def _goes_by_captures(state: FitState, start: CatalogueEffect) -> bool:
    if isinstance(start, Scaling):
        return True
    if not isinstance(start, Offset) or start.unit_out != DIGITAL_NUMBER:
        return False
    return np.size(start.offset(state.model.context)) == len(state.design.captures)


def _of_each_capture(state: FitState, start: CatalogueEffect) -> Array:
    if isinstance(start, Scaling):
        change: Any = np.asarray(start.factor(state.model.context)) - 1.0
    elif isinstance(start, Offset):
        change = np.asarray(start.offset(state.model.context))
    else:
        raise TypeError(f"{start.name} is searched densely but is neither Scaling nor Offset")
    return np.asarray(np.broadcast_to(change.reshape(-1), (len(state.design.captures),)))


# ---- waves along the rows -------------------------------------------------------------------------------------
def _of_bands(state: FitState, starts: Starts) -> Starts:
    """Return the likeliest waves along the rows with their likeliest size, the best first.

    They are rated by the exact likelihood of the bands alone. A wave that stands out by far has its lobes over the
    exposures resolved: about the best of each spatial frequency the starts nearby are looked at.
    """
    rater = _WaveRater(state)
    ranked = sorted((rater.sized(start) for start in starts), key=lambda rated: rated.deviance)
    best: dict[float, _Rated] = {}
    for rated in ranked:
        best.setdefault(round(rated.per_row, 9), rated)
    found = list(best.values())[:_REFINED]
    if rater.nothing - found[0].deviance > _WORTH_IT:
        found = [rater.refined(rated) for rated in found]
    found = sorted([*found, *ranked[:_KEPT]], key=lambda rated: rated.deviance)
    return tuple(rated.wave for rated in found[:_KEPT])


@dataclass(frozen=True, slots=True)
class _Rated:
    deviance: float
    start: CatalogueEffect
    size: float
    per_row: float

    @property
    def wave(self) -> CatalogueEffect:
        return self.start.resized(self.size)


class _WaveRater:
    """Rates waves by the bands that count, (entries,), of the captures that have any."""

    def __init__(self, state: FitState) -> None:
        comparison, prediction, seen = state.comparison, state.prediction, state.comparison.seen
        here = comparison.band_power(relative_bands(prediction), prediction.band_frequency)
        mixed = mixing_of_bands(prediction, state.design) if prediction.mixed_x.any() else 0.0
        mask = comparison.usable["bands"]
        self._captures = mask.any(axis=1)
        self._there = np.nonzero(mask[self._captures])
        self._steady = (1.0 + prediction.row_variance[:, None] * seen.bands_of_rows + here + mixed)[mask]
        self._seen, self._dof = seen.bands[mask], np.broadcast_to(comparison.band_freedom, mask.shape)[mask]
        self._more = float(np.sum(np.maximum(self._seen - self._steady, 0.0)))
        self._bins, self._basis = RowBins.of(state.design), seen.bands_basis[self._captures]
        self._context, self._rows = state.model.context, state.design.shape[0]
        self._one = TileMoments.exactly(np.ones((self._captures.size, 1, 1)))
        self._waves: dict[float, Array] = {}
        self.nothing = float(self._deviances(self._steady))

    def sized(self, start: CatalogueEffect) -> _Rated:
        after = start.tile(self._one, self._one, self._context)
        per_row = after.band_frequency
        if per_row not in self._waves:
            self._waves[per_row] = wave_power(self._bins, self._basis, per_row)[0][self._there]
        variance = np.broadcast_to(after.band_variance, (self._captures.size, 1, 1))[self._captures, 0, 0]
        added = variance[self._there[0]] * self._waves[per_row]
        scales = _SCALES * self._more / max(float(np.sum(added)), 1e-30)
        deviances = self._deviances(self._steady + scales[:, None] * added)
        best = int(np.argmin(deviances))
        return _Rated(float(deviances[best]), start, float(np.sqrt(scales[best])), per_row)

    def refined(self, rated: _Rated) -> _Rated:
        """Return the likeliest wave about one: each turn of what the entry calls nearby, twice."""
        for turn in (0, 1) * _ROUNDS:
            nearby = (self.sized(start) for start in rated.wave.nearby(self._rows, turn))
            rated = min((rated, *nearby), key=lambda entry: entry.deviance)
        return rated

    def _deviances(self, expected: Array) -> Array:
        return np.asarray(np.sum(self._dof * (self._seen / expected + np.log(expected)), axis=-1))


_OTHER_STARTS: Final = 2  # of an entry that are kept for the fit next to the best
_LARGEST_AMPLITUDE: Final = 300.0  # a start may be that much too small …
_FAR_STEP: Final = 0.1  # of a parameter's size: a start is far from the best values
_TOGETHER: Final = 12  # entries that are asked at once
_MAY_RISE: Final = 2.0  # times what an entry explained next to the model before
_SMALLEST_CURVATURE: Final = 1e-9
AT_ONCE: Final = 32  # changes that are projected together: one at a time would read the whole fit for each


def screen(
    state: FitState,
    catalogue: Mapping[str, type[CatalogueEffect]],
    pool: StartPool,
    before: Sequence[Candidate] = (),
    needed: int = 0,
) -> list[Candidate]:
    """Return the best start of every entry (rigid and flexible apart), the most promising first.

    Entries are those that the data can speak about at all and that are not in the model yet.

    Where a screening of the model before is known, entries are tested in the order of what they explained there.
    Testing stops once enough explain twice what any of the rest did, since the disagreement falls from model to
    model. The rest come as they were, behind these.

    Args:
        before: What a smaller model's screening found, by which the likeliest are tested first.
        needed: How many of the best are needed then.

    Source: Minoux (1978), accelerated greedy algorithms, for the order.
    """
    known: dict[str, list[Candidate]] = {}
    for candidate in before:
        known.setdefault(candidate.effect.name, []).append(candidate)
    gains = {name: max(candidate.gain for candidate in several) for name, several in known.items()}
    taken = {effect.name for effect in state.effects if not effect.repeats}
    able = [kind for n, kind in catalogue.items() if n not in taken and kind.usable(state.model.context)]
    kinds = sorted(able, key=lambda kind: -gains.get(kind.name, np.inf))
    found: list[Candidate] = []
    for first in range(0, len(kinds), _TOGETHER):
        most = _MAY_RISE * gains.get(kinds[first].name, np.inf)
        if needed and sum(candidate.gain > most for candidate in found) >= needed:
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
    """Return the starts that leave no gaps where codes occur: a coarse step may compensate another effect."""
    step = seen_step(seen)
    if step == 1:  # nothing is known yet
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

    They are numbers that are none for sets with which the model predicts what no camera does.
    """
    try:
        return state.moved_by(several)
    except ConfigurationError:
        if len(several) == 1:
            return np.full((state.comparison.size, 1), np.nan)
    half = len(several) // 2
    return np.hstack([changes_with(state, part) for part in (several[:half], several[half:])])


def _rigid(state: FitState, starts: Sequence[CatalogueEffect]) -> list[Candidate]:
    batches = (starts[first : first + AT_ONCE] for first in range(0, len(starts), AT_ONCE))
    return [candidate for batch in batches for candidate in _rigid_batch(state, batch)]


def _rigid_batch(state: FitState, starts: Sequence[CatalogueEffect]) -> list[Candidate]:
    rows = state.comparison.size
    fit = state.fit
    moved = np.nan_to_num(state.moved_by([(*state.effects, start) for start in starts]))
    changes, part = fit.followed_with_half(moved)
    whole = np.einsum("ij,ij->j", changes, changes)
    curvature = whole - np.einsum("ij,ij->j", part, part)
    slope = changes.T @ fit.projected[:rows]
    floor = _SMALLEST_CURVATURE * np.maximum(whole, 1e-12)
    amplitude, gain = _at_best(slope, curvature, np.array([bool(effect.free()) for effect in starts]), floor)
    gain = np.where(curvature > floor, gain, 0.0)
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
    rows = slice(0, state.comparison.size)
    for number, cover in enumerate(covers, start=1):
        waiting.append(cover)
        if sum(1 + len(one.free()) for one in waiting) >= AT_ONCE or number == len(covers):
            own = [*directions_of_each(state, [((*state.effects, one), len(state.effects), 0) for one in waiting])]
            followed, part = state.fit.followed_with_half(np.hstack(own))
            at = 0
            for one, columns in zip(waiting, own, strict=True):
                mine = slice(at, at := at + columns.shape[1])
                gain, _ = state.fit.score(rows, followed[:, mine], part[:, mine])
                found.append(Candidate(one, gain, columns.shape[1] - 1, flexible=True))
            waiting = []
    return found


def directions_of(state: FitState, effects: Sequence[CatalogueEffect], index: int) -> Array:
    """Return what a set of effects changes in the residual, and what the parameters of one of them do then.

    Args:
        effects: The effects to have instead of the model's.
        index: Position of the one whose parameters are moved.

    Returns:
        (entries, 1 + parameters).
    """
    return next(iter(directions_of_each(state, [(effects, index, 0)])))


def directions_of_each(
    state: FitState, entries: Sequence[tuple[Sequence[CatalogueEffect], int, int]]
) -> Iterator[Array]:
    """Yield the same of several sets of effects, nothing of what no camera does; their chains run together.

    Args:
        entries: Each set, the position of the one whose parameters are moved, and the first of these.
    """
    sets, steps = list[Sequence[CatalogueEffect]](), list[Array]()
    for effects, index, first in entries:
        own = state.parameters_of(effects)
        step, moved = own.a_step_away(_FAR_STEP, own.of_effect(index)[first:])
        steps.append(step)
        sets += [effects, *moved]
    changed, at = changes_with(state, sets), 0
    for step in steps:
        there = changed[:, at : at + 1]
        found = np.hstack([there, (changed[:, at + 1 : at + 1 + step.size] - there) / step])
        yield found if np.isfinite(found).all() else np.zeros_like(found)
        at += 1 + step.size
