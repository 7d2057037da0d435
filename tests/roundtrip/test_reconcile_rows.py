"""Noise and waves along rows: what few rows and few phases can tell bounds the uncertainty."""

from dataclasses import replace

import numpy as np
import pytest

from radiometer.reconciliation.descent import accepted, converged_fit, first_state, fitted_parameters, refit
from radiometer.reconciliation.design import Design, rough_share, tile_groups
from radiometer.reconciliation.reduce import reduce_frames
from radiometer.reconciliation.state import FitState, with_effects
from simulators.effects.catalogue import CatalogueEffect
from simulators.effects.rolling_shutter_banding import RollingShutterBanding
from simulators.effects.row_temporal_noise import RowTemporalNoise
from testing.generator.rig import Rig
from testing.generator.session import Session, make_session

SEED = 401
SIGMA_E = 0.9
LARGER = Rig(rows=480, columns=216, spacing_um=15.0)


def fitted(session: Session, start: CatalogueEffect) -> FitState:
    """Return the fit of a session by the effect that is hidden in it."""
    frames = list(session.frames())
    design = Design.of(session.header, frames[0].shape)
    return converged_fit(refit(accepted(first_state(design, *reduce_frames(design, frames.__getitem__)), start)))


@pytest.fixture(scope="module")
def dark_state() -> FitState:
    """Return the fit of darks with row noise of 0.9 electrons, which an independent generator made."""
    session = make_session("row_temporal_noise", camera_seed=SEED, scale=SIGMA_E / 0.5, plan="darks")
    return fitted(session, RowTemporalNoise(0.3))


@pytest.fixture(scope="module")
def waving() -> tuple[FitState, dict[str, float]]:
    """Return the fit of a session with bands of 2 %, which an independent generator made, and the truth."""
    session = make_session("rolling_shutter_banding", camera_seed=402, scale=2.0, rig=LARGER, plan="short")
    truth = {name: float(value) for name, value in session.truth["rolling_shutter_banding"].items()}  # type: ignore[arg-type]
    return fitted(session, RollingShutterBanding(truth["depth"], truth["frequency_Hz"], truth["row_s"])), truth


def test_uncertainty_is_no_smaller_than_the_rows_allow(dark_state: FitState) -> None:
    """A standard deviation from n normal values is known to 1/√(2·n) at best, however many statistics show it."""
    found = fitted_parameters(dark_state)["row_temporal_noise"]["sigma_e"]
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


def test_waves_are_fitted_to_their_phases(waving: tuple[FitState, dict[str, float]]) -> None:
    """Within three u; size is known to 1/√(n·(n − 1)) however many the pixels."""
    found = fitted_parameters(waving[0])["rolling_shutter_banding"]
    for name, true in zip(("modulation", "frequency_hz", "row_time_s"), waving[1].values(), strict=True):
        u = found[name].u
        assert abs(found[name].value - true) < 3 * u, name
    found = fitted_parameters(waving[0])["rolling_shutter_banding"]["modulation"]
    frames = waving[0].design.frame_count[waving[0].design.source_level > 0].astype(float)
    best = found.value * 0.5 / np.sqrt(np.sum(frames * (frames - 1)))
    assert found.u is not None
    assert best < found.u < 3 * best


def test_derivative_by_the_row_time_is_that_of_a_small_step(waving: tuple[FitState, dict[str, float]]) -> None:
    """The residual follows its derivative for a thousandth of a period per frame: 5 % of the change are left."""
    state = waving[0]
    (effect,) = (e for e in state.effects if isinstance(e, RollingShutterBanding))
    index = state.parameters.names.index("row_time_s")
    step_s = 1e-3 / (effect.frequency_hz * LARGER.rows)
    moved = with_effects(state, [replace(effect, row_time_s=effect.row_time_s + step_s)])
    change = moved.data_residual - state.data_residual
    expected = -state.effect_jacobian[: change.size, index] * step_s / state.parameters.scale[index]
    assert np.linalg.norm(change - expected) < 0.05 * np.linalg.norm(change)
