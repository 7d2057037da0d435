"""A wave along the rows of large frames: the phases of few frames bound what is known of its size."""

from dataclasses import replace

import numpy as np
import pytest

from radiometer.reconciliation.fit.descent import accepted, converged_fit, first_state, fitted_parameters, refit
from radiometer.reconciliation.fit.state import FitState, with_effects
from radiometer.reconciliation.measure.design import Design
from radiometer.reconciliation.measure.reduce import reduce_frames
from simulators.effects.rolling_shutter_banding import RollingShutterBanding
from testing.generator.rig import Rig
from testing.generator.session import make_session

LARGER = Rig(rows=480, columns=216, spacing_um=15.0)
SEED = 402


@pytest.fixture(scope="module")
def waving() -> tuple[FitState, dict[str, float]]:
    """Return the fit of a session with bands of 2 %, which an independent generator made, and the truth."""
    session = make_session("rolling_shutter_banding", camera_seed=SEED, scale=2.0, rig=LARGER, plan="short")
    frames = list(session.frames())
    design = Design.of(session.header, frames[0].shape)
    state = first_state(design, *reduce_frames(design, frames.__getitem__))
    truth = {name: float(value) for name, value in session.truth["rolling_shutter_banding"].items()}  # type: ignore[arg-type]
    start = RollingShutterBanding(truth["depth"], truth["frequency_Hz"], truth["row_s"])
    return converged_fit(refit(accepted(state, start))), truth


def test_parameters_agree_with_the_truth(waving: tuple[FitState, dict[str, float]]) -> None:
    """Size, frequency and row time lie within three of their standard uncertainties."""
    found = fitted_parameters(waving[0])["rolling_shutter_banding"]
    for name, true in zip(("modulation", "frequency_hz", "row_time_s"), waving[1].values(), strict=True):
        u = found[name].u
        assert u is not None
        assert abs(found[name].value - true) < 3 * u, name


def test_size_is_known_no_better_than_the_phases_allow(waving: tuple[FitState, dict[str, float]]) -> None:
    """The power of n frames scatters by 1/√(n·(n − 1)), and with it half as much the size, however many the pixels."""
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
