"""Row noise: what its few rows can tell bounds the uncertainty, and tiles side by side see the same rows."""

import numpy as np
import pytest

from radiometer.reconciliation.fit.descent import accepted, converged_fit, first_state, fitted_parameters, refit
from radiometer.reconciliation.fit.state import FitState
from radiometer.reconciliation.measure.design import Design, rough_share, tile_groups
from radiometer.reconciliation.measure.reduce import reduce_frames
from simulators.effects.row_temporal_noise import RowTemporalNoise
from testing.generator.session import make_session

SEED = 401
SIGMA_E = 0.9


@pytest.fixture(scope="module")
def dark_state() -> FitState:
    """Return darks with row noise of 0.9 electrons, which an independent generator made, and its fit."""
    session = make_session("row_temporal_noise", camera_seed=SEED, scale=SIGMA_E / 0.5, plan="darks")
    frames = list(session.frames())
    design = Design.of(session.header, frames[0].shape)
    state = first_state(design, *reduce_frames(design, frames.__getitem__))
    return converged_fit(refit(accepted(state, RowTemporalNoise(0.3))))


def test_uncertainty_is_no_smaller_than_the_rows_allow(dark_state: FitState) -> None:
    """A standard deviation from n normal values is known to 1/√(2·n) at best, however many statistics show it."""
    found = fitted_parameters(dark_state)["row_temporal_noise"]["sigma_e"]
    assert found.u is not None
    design = dark_state.design
    rows = {row for tile in design.tiles for row in range(tile.y, tile.y + tile.height)}
    best = found.value / np.sqrt(2 * len(rows) * design.frame_count.sum())
    assert best < found.u < 2 * best
    assert abs(found.value - SIGMA_E) < 3 * found.u


@pytest.mark.parametrize("block", ["variance", "neighbour_x", "spatial"])
def test_whitened_tiles_side_by_side_scatter_apart(dark_state: FitState, block: str) -> None:
    """Sums over the tiles of one band of rows have the variance of as many independent values, within 4 sigma.

    Before they are whitened, the rows that the tiles share make it twice that.
    """
    comparison = dark_state.comparison
    residual = dark_state.plain_residual[comparison.cuts[block]].reshape(comparison.usable[block].shape)
    tops = np.array([tile.y for tile in dark_state.design.tiles])
    sums = np.array([residual[:, tops == y].sum(axis=1) / np.sqrt((tops == y).sum()) for y in np.unique(tops)])
    assert np.mean(sums**2) == pytest.approx(1.0, abs=4 * np.sqrt(2 / sums.size))


def test_share_of_lines_about_a_quadratic_surface(dark_state: FitState) -> None:
    """White rows of variance 1 leave in each tile what `rough_share` says, within 4 sigma of 4000 draws."""
    (group,) = tile_groups(dark_state.design)
    rows = np.random.default_rng(SEED).standard_normal((4000, group.height))
    pictures = np.repeat(rows, group.width, axis=1)
    left = pictures - pictures @ group.trend @ group.trend.T
    seen = np.sum(left**2, axis=1) / (group.height * group.width - 6)
    expected = float(rough_share(np.array(group.height), np.array(group.width)))
    assert np.mean(seen) == pytest.approx(expected, abs=4 * np.std(seen) / np.sqrt(seen.size))
