"""Screens the laws of the grammar: the share of the tiles' means that each would explain, linearised, nuisances
following.

Statistics that follow the light of a tile move with the law as well: the nuisances take them along. A law that left
them in place would seem to disagree with them as soon as a radiance adapts to it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import islice
from typing import Any, Final

import numpy as np
from scipy.special import ndtr

from radiometer.reconciliation.fit.linear import LinearFit
from radiometer.reconciliation.fit.state import FitState
from radiometer.reconciliation.model.tile_context import from_grid, rise_of
from radiometer.reconciliation.propose.grammar import FORMS, PER_FRAME, PLACES, Term
from radiometer.reconciliation.propose.law import Law, effect_of
from radiometer.reconciliation.statistics import STATISTICS
from radiometer.reconciliation.thresholds import PARAMETER_NATS
from radiometer.typing import Array
from simulators.chain.law_stages import LINKS
from simulators.effects.surroundings import column_light, picture_mean

_AT_ONCE: Final = 64  # laws that are projected together
_FAINT: Final = 1e-9
_FOLLOWING: Final = ("mean", *(name for name, row in STATISTICS.items() if row.follows_light))


@dataclass(frozen=True)
class Screened:
    """A law as the means alone show it: best amplitude, χ² that it would explain, and starts that do about as well."""

    law: Law
    amplitude: float
    gain: float
    others: tuple[Screened, ...] = ()

    @cached_property
    def score(self) -> float:
        """Return nats less what the parameters cost."""
        return 0.5 * self.gain - PARAMETER_NATS * self.law.size


def screened(state: FitState, laws: Iterable[Law]) -> list[Screened]:
    """Return the laws with the amplitude and the χ² that the tile means alone give them, nuisances following."""
    look, terms = _Look(state), _Terms(state)
    waiting, found, laws = list[Law](), list[Screened](), iter(laws)
    while waiting := list(islice(laws, _AT_ONCE)):
        found += look.gains(waiting, [terms.of_law(law) for law in waiting])
    return found


@dataclass(frozen=True, slots=True)
class _Values:
    """Values of a law of amplitude 1 in the tiles, broadcasting to (captures, tiles)."""

    mean: Array  # its mean in a tile, over the frames of a capture
    rises: tuple[Array, Array] | None  # from centre to right and to bottom edge; None where it is even within all tiles
    first: Array | None  # in the first frame of a capture less the others; None where frames are alike

    @classmethod
    def of(cls, values: Array, frames: Array) -> _Values:
        """Return those of a law's values.

        Args:
            values: As `values_of` gives them.
            frames: (captures, 1, 1) number of frames.
        """
        first, others = np.nan_to_num(values[[0, -1]])
        alike = values.shape[0] == 1
        average = first if alike else (first + (frames - 1.0) * others) / frames
        even = average.shape[-1] == 1
        rises = None if even else rise_of(np.broadcast_to(average, (*average.shape[:-1], 4)))
        return cls(average.mean(axis=-1), rises, None if alike else (first - others).mean(axis=-1))


class _Look:
    """Changes that laws make in the tested statistics, and how much of the residual they would take up."""

    def __init__(self, state: FitState) -> None:
        self._state = state
        self._response = {key: _response(state, key) for key, link in LINKS.items() if not link.is_noise}
        self._parts: dict[tuple[str, ...], tuple[dict[str, slice], LinearFit, Array]] = {}

    def gains(self, laws: Sequence[Law], shown: Sequence[Sequence[_Values]]) -> list[Screened]:
        """Return laws, of one column each or (a wave) of two, with amplitude and χ².

        Args:
            shown: The values of each column.
        """
        columns = [(values, self._response[law.link]) for law, own in zip(laws, shown, strict=True) for values in own]
        blocks = list(_FOLLOWING)
        blocks += ["slope_x", "slope_y"] if any(values.rises for values, _ in columns) else []
        blocks += ["first"] if any(values.first is not None for values, _ in columns) else []
        cuts, fit, projected = self._part(tuple(blocks))
        changes = np.zeros((fit.residual.size, len(columns)))
        for block, cut in cuts.items():
            own = self._changes(block, columns)
            if own.any():
                changes[cut] = self._state.comparison.whiten(block, np.moveaxis(own, 0, -1)).reshape(-1, len(columns))
        followed, part = fit.followed_with_half(changes)
        slope = followed.T @ projected
        squares, rows = np.einsum("ij,ij->j", changes, changes), np.ascontiguousarray(followed.T)
        found, at = [], 0
        for law, pair in zip(laws, shown, strict=True):
            mine = slice(at, at := at + len(pair))
            curvature = rows[mine] @ rows[mine].T - part[:, mine].T @ part[:, mine]
            whole = float(squares[mine].sum())
            if whole < _FAINT or float(np.linalg.eigvalsh(curvature)[0]) < 1e-6 * whole:
                continue  # nothing of it remains next to the nuisances
            best = np.linalg.solve(curvature, slope[mine])
            found.append(_turned(law, np.asarray(best), float(best @ slope[mine])))
        return found

    def _changes(self, block: str, columns: Sequence[tuple[_Values, Mapping[str, Array]]]) -> Array:
        """Return what columns change of a statistic, (columns, captures, tiles)."""
        found = np.zeros((len(columns), *columns[0][1]["mean"].shape))
        for own, (values, response) in zip(found, columns, strict=True):
            if block == "first":
                factor = values.first
            elif block in ("slope_x", "slope_y"):
                factor = values.rises and values.rises[block == "slope_y"]
            else:
                factor = values.mean
            if factor is not None:
                np.multiply(factor, response.get(block, response["mean"]), out=own)
        return found

    def _part(self, blocks: tuple[str, ...]) -> tuple[dict[str, slice], LinearFit, Array]:
        """Return some statistics' places among theirs alone, the fit in these, and the residual that is left there."""
        if blocks not in self._parts:
            whole, cuts, at = self._state.comparison.cuts, dict[str, slice](), 0
            for block in blocks:
                cuts[block] = slice(at, at := at + whole[block].stop - whole[block].start)
            rows = np.concatenate([np.arange(whole[block].start, whole[block].stop) for block in blocks])
            fit = self._state.fit
            self._parts[blocks] = cuts, fit.within(rows), fit.projected[rows]
        return self._parts[blocks]


def known_values(state: FitState) -> dict[str, Array]:
    """Return the covariates that vary within a capture set, by name, each broadcasting to captures × tiles × points.

    What differs between the first frame of a series and the others has an axis in front: first, others.
    """
    context, design = state.model.context, state.design
    side = max(design.shape)
    settings: Any = context.settings
    signal = state.prediction.signal[:, :, None]
    found = {
        "exposure_s": settings.exposure_s,
        "timestamp_s": np.stack([settings.timestamp_s] * 2),
        "temperature_C": settings.temperature_c,
        "gain_db": settings.gain_db,
        "f_number": settings.f_number,
        "source_level": settings.source_level,
        "image_x": context.geometry.x_px / side,
        "image_y": context.geometry.y_px / side,
        "signal": signal,
        "value": signal * state.prediction.gain[:, None, None],
        "column_light": column_light(np.repeat(signal, 4, axis=2), context),
    }
    parts = (context.first_frame, context.later_frames)
    if design.has_timestamps and None not in parts:
        found["timestamp_s"] = np.stack([np.asarray(part.settings.timestamp_s) for part in parts if part])
        found["since_frame_s"] = np.stack([np.asarray(part.since_frame_s) for part in parts if part])
    lit = design.source_level > 0  # a closed shutter is no level of the source
    if not lit.any() or not _varies(design.source_level[lit]):
        del found["source_level"]
    shown = picture_mean(state.model.radiance[design.pattern_index][:, :, None] * settings.source_level, context)
    if lit.any() and _varies(shown[lit]):
        found["picture_mean"] = shown
    known = {name: np.asarray(v, dtype=np.float64) for name, v in found.items() if _varies(np.asarray(v))}
    return known | ({} if None in parts else {"frame": np.stack([part.frame_numbers for part in parts if part])})


def _varies(values: Array) -> bool:
    finite = values[np.isfinite(values)]
    return finite.size > 0 and not np.isnan(values).any() and float(np.ptp(finite)) > 1e-9 * float(np.abs(finite).max())


def _response(state: FitState, link: str) -> dict[str, Array]:
    """Return the change by a unit of a constant law in means and in statistics of the light, (captures, tiles) each."""
    exposure = state.design.exposure_s
    step = {
        "1": 1e-3,
        "s": 1e-3 * float(np.median(exposure)),
        "e-": 1.0,
        "e- s-1": 1.0 / float(exposure.max()),
        "DN": 0.1,
        "W m-2": 1e-3 * np.pi * state.model.context.peak_radiance / 64.0,
    }[LINKS[link].unit]
    moved = state.comparison.expected(state.predicted_with((*state.effects, effect_of(Law(link), step))))
    base = state.comparison.expected(state.prediction)
    return {name: np.asarray((moved[name] - base[name]) / step) for name in _FOLLOWING}


class _Terms:
    """The values of laws in one state; what those at several places of the chain share is worked out once."""

    def __init__(self, state: FitState) -> None:
        self._state, self._known = state, known_values(state)
        self._frames = state.design.frame_count[:, None, None]
        self._found: dict[tuple[object, ...], Array] = {}
        self._shown: dict[tuple[object, ...], _Values] = {}

    def of_law(self, law: Law) -> list[_Values]:
        """Return the values of a law of amplitude 1, and of a wave those of a quarter period later too."""
        found = [self._product(law.terms)]
        if any("phase" in term.values for term in law.terms):
            found.append(self._product([_ahead(term) for term in law.terms]))
        return found

    def _product(self, terms: Sequence[Term]) -> _Values:
        keys = tuple((term.form, term.covariate, *term.constants.items(), *term.values.items()) for term in terms)
        if keys not in self._shown:
            product: Array = np.ones((1, 1, 1, 1))
            for key, term in zip(keys, terms, strict=True):
                if key not in self._found:
                    self._found[key] = values_of(self._state, term, self._known)
                product = product * self._found[key]
            self._shown[keys] = _Values.of(product, self._frames)
        return self._shown[keys]


def _ahead(term: Term) -> Term:
    """Return a wave a quarter of a period later; anything else as it is."""
    later = {name: value + 0.5 * np.pi for name, value in term.values.items() if name == "phase"}
    return replace(term, values={**term.values, **later})


def values_of(state: FitState, term: Term, known: Mapping[str, Array]) -> Array:
    """Return a term's values, broadcasting to frames × captures × tiles × points.

    Frames are the first of each capture and the others where these differ, else one for all.
    """
    own = {name: known[name] for name in term.covariates}
    if term.form == "step" and term.covariate in ("signal", "value"):
        noise = np.sqrt(state.prediction.variance) / (
            1.0 if term.covariate == "value" else state.prediction.gain[:, None]
        )
        share = ndtr((own[term.covariate] - term.values["at"]) / noise[:, :, None])  # of pixels beyond it
        return np.asarray(share[None])
    grid = state.model.context.grid
    if grid is not None and FORMS[term.form].is_steep and set(term.covariates) & set(PLACES):
        side = max(state.design.shape)
        fine = {"image_x": grid.x_px / side, "image_y": grid.y_px / side}
        points, _ = from_grid(term.evaluated(own | {name: fine[name] for name in own if name in fine}))
        return np.asarray(points[None])
    frames = (0, 1) if set(own) & set(PER_FRAME) else (0,)
    parts = [term.evaluated({n: v[i] if n in PER_FRAME else v for n, v in own.items()}) for i in frames]
    return np.stack(parts)


def _turned(law: Law, best: Array, gain: float) -> Screened:
    """Return the law with the amplitude, and of a wave with the phase, that two columns gave."""
    if best.size == 1:
        return Screened(law, float(best[0]), gain)
    phase = float(np.arctan2(best[1], best[0]))
    terms = tuple(replace(t, values={**t.values, "phase": phase}) if "phase" in t.values else t for t in law.terms)
    return Screened(Law(law.link, terms), float(np.hypot(*best)), gain)
