"""What blocks that are weighted apart have in common, and what that adds to the parameters' covariance.

The fit weights each block by itself. Where two of them see the same chance (the noise that the rows of a few frames
happened to have), their information does not add up: with X the covariance between the blocks that the weights leave
out, the estimate A⁻¹·Jᵀ·r has the covariance A⁻¹ + A⁻¹·Jᵀ·X·J·A⁻¹.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from radiometer.reconcile.measure.design import Array
from radiometer.reconcile.noise.row_scatter import shared_columns
from radiometer.reconcile.noise.variance_scores import frames_counted

if TYPE_CHECKING:
    from radiometer.reconcile.fit.state import FitState

_WAVE: Final = "bands"
_SIZE: Final = "modulation"
_SEES_WAVE: Final = ("variance", "neighbour_x", "neighbour_y", "row_temporal", _WAVE)


def effect_covariance(state: FitState) -> Array:
    """Return the covariance of the free effect parameters in units of their scales, what blocks share included."""
    first = state.layout.size + state.weights.size
    covariance = state.fit.covariance[first:, first:]
    families = shared_columns(state.comparison, state.prediction)
    wave = _wave_columns(state)
    if not ((families or wave) and covariance.size):
        return covariance
    pulls = _pulls(state, first)
    if wave:
        covariance = covariance + _of_wave(state, pulls, wave)
    for columns in families:
        parts = []
        for name, values in columns.items():
            own = pulls[state.comparison.cuts[name]].reshape(len(values), -1, covariance.shape[0])
            parts.append(np.matmul(own.transpose(0, 2, 1), values.reshape(len(values), own.shape[1], -1)))
        together = np.sum(parts, axis=0)
        covariance = covariance + np.einsum("cpr,cqr->pq", together, together)
        covariance = covariance - sum(np.einsum("cpr,cqr->pq", part, part) for part in parts)
    return covariance


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


def _of_wave(state: FitState, pulls: Array, wave: dict[str, Array]) -> Array:
    """Return what the phases add to the covariance: all but what the weights of each block hold already."""
    held: Array = np.zeros((pulls.shape[1],) * 2)
    parts = []
    for name, values in wave.items():
        own = pulls[state.comparison.cuts[name]].reshape(*values.shape, -1) * values[:, :, None]
        part = own.sum(axis=1)
        counted = part if name == _WAVE else own.reshape(-1, own.shape[-1])
        held = held + counted.T @ counted
        parts.append(part)
    together = np.sum(parts, axis=0)
    return np.asarray(together.T @ together - held)


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
