"""The fitted parameters with their covariance, what statistics share included.

The fit weights each statistic by itself. Where two of them see the same chance (the noise that the rows of a few frames
happened to have), their information does not add up: with X the covariance between the statistics that the weights
leave out, the estimate A⁻¹·Jᵀ·r has the covariance A⁻¹ + A⁻¹·Jᵀ·X·J·A⁻¹.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np

from radiometer.reconcile.fit.state import FitState
from radiometer.reconcile.measure.design import Array
from radiometer.reconcile.model.parameters import value_of
from radiometer.reconcile.noise.chances import frames_counted
from radiometer.reconcile.noise.shared_errors import chances_of_rows
from radiometer.reconcile.report.result import FittedParameter

_WAVE: Final = "bands"
_SIZE: Final = "modulation"
_SEES_WAVE: Final = ("variance", "neighbour_x", "neighbour_y", "row_temporal", _WAVE)


def effect_covariance(state: FitState) -> Array:
    """Return the covariance of the free effect parameters in units of their scales, what statistics share included."""
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
