"""The fitted parameters with their covariance, what statistics share included.

The fit weights each statistic by itself. Two of them may share the same noise, such as the row noise of a few frames.
Their information does not add up then. With X the covariance between statistics that the weights leave out, the
estimate A⁻¹·Jᵀ·r has the covariance A⁻¹ + A⁻¹·Jᵀ·X·J·A⁻¹.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from radiometer.reconciliation.chances import frames_counted
from radiometer.reconciliation.fit.state import FitState
from radiometer.reconciliation.model.parameters import value_of
from radiometer.reconciliation.noise.shared_errors import chances_of_rows
from radiometer.reconciliation.result import FittedParameter
from radiometer.reconciliation.thresholds import CLOSED_GAP, FAR_GAP, SCATTER_SIGMAS
from radiometer.typing import Array

_BLOCKS: Final = 5  # along a covariate, each left out in turn
_ALONE: Final = 0.9  # share of a direction determined by one group, beyond which the others cannot check it
_WAVE: Final = "bands"
_SIZE: Final = "modulation"
_SEES_WAVE: Final = ("variance", "neighbour_x", "neighbour_y", "row_temporal", _WAVE)


def is_misfit(state: FitState) -> bool:
    """Return whether structure remains: the gap of held-out settings exceeds 1 by more than chance."""
    count = max(float(state.held_out.count[: state.settings].sum()), 1.0)
    return state.gap > max(CLOSED_GAP, 1.0 + SCATTER_SIGMAS * float(np.sqrt(2.0 / count)))


def is_far(state: FitState) -> bool:
    """Return whether entries are off by ten of their uncertainties and more: linear predictions mean little there."""
    return state.gap >= FAR_GAP


def scatter_of(state: FitState) -> float:
    """Return by how much χ² counts too high where structure is left: the gap of held-out settings, 1 where none is.

    What entries scatter by for no known reason they do for any model; nats are worth that much less.

    Source: Wedderburn (1974), Biometrika 61 439, the dispersion of a quasi-likelihood.
    """
    return state.gap if is_misfit(state) else 1.0


def effect_covariance(state: FitState) -> Array:
    """Return the covariance of the free effect parameters in units of their scales, what statistics share included.

    While structure is left, it is widened by what that structure does to the parameters.
    """
    covariance = _of_a_model_that_is_right(state)
    if not (covariance.size and is_misfit(state)):
        return covariance
    own = np.diag(covariance)
    wider = np.sqrt(np.maximum(_by_misfit(state), own) / np.where(own > 0, own, 1.0))
    return np.asarray(covariance * wider[:, None] * wider)


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
    """Yield the group of each capture: its setting, then its place along each covariate that settings have."""
    design = state.design
    yield design.setting_id
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
    whitened = fit.half(columns.T).T  # parameters in units of what all rows tell of them
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
